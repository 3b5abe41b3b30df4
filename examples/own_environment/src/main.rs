//! An environment of one's own: carts that gather at a depot, learned by a shipped method.

use std::error::Error;
use std::sync::atomic::AtomicBool;

use sortie_envs::random::below;
use sortie_envs::{
    EntitySet, Environment, Episode, Observation, Random, Shape, Spec, Split, StateError, Step,
    StepError, conformance,
};
use sortie_learn::draft::{MethodRun, draft_method};
use sortie_learn::play;
use sortie_learn::run::{RunConfig, RunDescription};
use sortie_learn::session::{EnvironmentChoice, Opening, Session};

const CARTS: usize = 3;
const FIELDS: usize = 9;
const STEPS: u8 = 20;

/// Three carts on a track of nine fields, one of which is the depot. The more of them stand there, the better.
struct Depot {
    spec: Spec,
    tracks: Vec<Track>,
}

/// One instance, as its bytes are: steps, ninths of the reward that were earned, depot and carts.
#[derive(Clone, Copy, Default)]
struct Track {
    steps: u8,
    earned: u8,
    depot: u8,
    carts: [u8; CARTS],
}

impl Depot {
    fn new(instances: usize) -> Self {
        let fields = (0..FIELDS).map(|field| format!("field-{field}"));
        let spec = Spec {
            name: "depot",
            shape: Shape {
                agents: CARTS,
                entities: CARTS + 1,
                tasks: 0,
                actions: 3,
                features: FIELDS + 1,
            },
            features: fields.chain(["is-depot".to_owned()]).collect(),
            actions: ["left", "stay", "right"].map(str::to_owned).to_vec(),
            safe_action: Some(1),
            row_entries: 2,
            state_bytes: 3 + CARTS,
            episode_limit: STEPS.into(),
            ..Spec::default()
        };
        Self { spec, tracks: vec![Track { steps: STEPS, ..Track::default() }; instances] }
    }
}

impl Track {
    fn gathered(&self) -> usize {
        self.carts.iter().filter(|field| **field == self.depot).count()
    }
}

/// Left only behind the first field, right only before the last.
fn available(field: u8) -> u64 {
    u64::from(field > 0) | 0b10 | u64::from(usize::from(field) < FIELDS - 1) << 2
}

impl Environment for Depot {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn instances(&self) -> usize {
        self.tracks.len()
    }

    fn open(&self, instances: usize, _: Split) -> Box<dyn Environment> {
        Box::new(Self::new(instances))
    }

    fn reset(&mut self, instance: usize, random: &mut Random) {
        let mut field = || below(random, FIELDS) as u8;
        let (depot, carts) = (field(), [field(), field(), field()]);
        self.tracks[instance] = Track { depot, carts, ..Track::default() };
    }

    fn step(
        &mut self,
        instance: usize,
        actions: &[u16],
        _: &mut Random,
    ) -> Result<Step, StepError> {
        let track = &mut self.tracks[instance];
        if track.steps == STEPS {
            return Err(StepError::EpisodeOver);
        }
        if actions.len() < CARTS {
            return Err(StepError::TooFewActions { agents: CARTS, actions: actions.len() });
        }
        let is_open = |agent: usize| {
            actions[agent] < 3 && available(track.carts[agent]) >> actions[agent] & 1 == 1
        };
        if let Some(agent) = (0..CARTS).find(|agent| !is_open(*agent)) {
            return Err(StepError::Unavailable { agent, action: actions[agent] });
        }
        for (field, action) in track.carts.iter_mut().zip(actions) {
            *field = *field + *action as u8 - 1;
        }
        track.steps += 1;
        let earned = (track.gathered() * track.gathered()) as u8;
        track.earned += earned;
        let reward = f64::from(earned) / 9.0;
        Ok(Step { reward, timed_out: track.steps == STEPS, ..Step::default() })
    }

    fn save(&self, instance: usize, state: &mut Vec<u8>) {
        let Track { steps, earned, depot, carts } = self.tracks[instance];
        state.extend([steps, earned, depot]);
        state.extend(carts);
    }

    fn load(&mut self, instance: usize, state: &[u8]) -> Result<(), StateError> {
        let Ok([steps, earned, depot, carts @ ..]) = <[u8; 3 + CARTS]>::try_from(state) else {
            return Err(StateError::Length { found: state.len(), wanted: self.spec.state_bytes });
        };
        if carts.iter().chain([&depot]).any(|field| usize::from(*field) >= FIELDS) || steps > STEPS
        {
            return Err(StateError::Impossible("something stands beyond the track".to_owned()));
        }
        self.tracks[instance] = Track { steps, earned, depot, carts };
        Ok(())
    }

    fn observe(&self, state: &[u8], _: usize, wanted: EntitySet, seen: &mut Observation) {
        const ALL: EntitySet = (1 << (CARTS + 1)) - 1;
        let fields = state[3..].iter().chain([&state[2]]);
        *seen = Observation::new(&self.spec.shape);
        (seen.present, seen.entities) = (ALL, wanted & ALL);
        for (entity, field) in fields.enumerate() {
            if entity < CARTS {
                (seen.observable[entity], seen.available[entity]) = (ALL, available(*field));
            }
            if wanted >> entity & 1 == 1 {
                seen.rows.push((*field).into(), 1.0);
                if entity == CARTS {
                    seen.rows.push(FIELDS, 1.0);
                }
                seen.rows.end_row();
            }
        }
    }

    fn episode(&self, instance: usize) -> Episode {
        let track = &self.tracks[instance];
        let done = track.steps == STEPS;
        Episode {
            steps: track.steps.into(),
            done,
            solved: done && track.gathered() == CARTS,
            timed_out: done,
            episode_return: f64::from(track.earned) / 9.0,
            ..Episode::default()
        }
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let depot = || Box::new(Depot::new(1));
    conformance::check(&*depot(), 1, 20)?;
    let by_chance = play::evaluate(&*depot(), &mut play::RandomTeam::new(1), 1000, 1)?;

    let entry = sortie_methods::find("vdn").ok_or("no such method")?;
    let mut setup = entry.preset("fast")?;
    setup.environment = EnvironmentChoice::of(&*depot(), 16);
    setup.run = RunConfig { steps: 40_000, evaluate_every: 10_000, final_episodes: 0, ..setup.run };
    let description = RunDescription::new(setup, 1, 1);
    let (setup, environment) = (&description.config, &*depot());
    let method = entry.method(&Opening { setup, environment, seed: 1, threads: 1 })?;
    let folder = std::env::temp_dir().join(format!("own-environment-{}", std::process::id()));
    let mut session = Session::begin(description.clone(), depot(), method, &folder)?;
    session.run(&mut (), &AtomicBool::new(false))?;

    let learned = play::evaluate(&*depot(), &mut *session.method().team(), 1000, 2)?;
    println!("return: {:.2} at random, {:.2} learned", by_chance.return_mean, learned.return_mean);
    println!(
        "all gathered at the end: {:.3} at random, {:.3} learned",
        by_chance.success, learned.success
    );
    let (method, curve) = (session.method(), session.curve());
    let run = MethodRun { description: &description, environment: &*depot(), method, curve };
    let bundle = draft_method(&run, &folder, &[depot().spec.shape], &[], 1)?
        .write(&folder.join("bundle"))?;
    println!("exported: {}", bundle.folder().join("agent.onnx").display());
    Ok(())
}
