//! An environment of one's own: four carts clear three sites on a track of seven fields, together rather than alone.

use sortie_envs::picture::{Bar, Disc, Field, Outline};
use sortie_envs::random::below;
use sortie_envs::{
    EntitySet, Environment, Episode, Observation, Picture, Random, Rewards, Rule, Shape, Spec,
    Split, StateError, Step, StepError, UNASSIGNED, members,
};

const CARTS: usize = 4;
const SITES: usize = 3;
const FIELDS: usize = 7;
const STEPS: u8 = 12;
/// What lies at a site. So many carts that lift there in one step take their square away.
const LOAD: u8 = 6;
/// Actions that aim at no site: left, stay, right.
const MOVES: usize = 3;
/// Columns of a row: the field, whether it is a site, its load, then two for each site that say how a cart stands to it.
const IS_SITE: usize = FIELDS;
const IS_LEFT: usize = FIELDS + 1;
const PAIRS: usize = FIELDS + 2;
const FEATURES: usize = PAIRS + 2 * SITES;

/// Instances of the yard.
pub(crate) struct Yard {
    spec: Spec,
    tracks: Vec<Track>,
}

/// One instance, as its bytes are, and what the last step took from each site.
#[derive(Clone, Copy, Default)]
struct Track {
    steps: u8,
    sites: [u8; SITES],
    loads: [u8; SITES],
    carts: [u8; CARTS],
    earned: [f64; SITES],
}

impl Yard {
    /// So many instances, whose episodes are over.
    pub(crate) fn new(instances: usize) -> Self {
        let fields = (0..FIELDS).map(|field| format!("field-{field}"));
        let pairs = (0..SITES).flat_map(|site| ["near", "here"].map(|it| format!("{it}-{site}")));
        let own = ["is-site", "is-left"].map(str::to_owned);
        let lifts = (0..SITES).map(|site| format!("lift-{site}"));
        let spec = Spec {
            name: "yard".into(),
            shape: Shape {
                agents: CARTS,
                entities: CARTS + SITES,
                tasks: SITES,
                actions: MOVES + SITES,
                features: FEATURES,
            },
            features: fields.chain(own).chain(pairs).collect(),
            actions: ["left", "stay", "right"]
                .map(str::to_owned)
                .into_iter()
                .chain(lifts)
                .collect(),
            targets: CARTS..CARTS + SITES,
            pairs: PAIRS..FEATURES,
            safe_action: Some(1),
            rewards: Rewards { tasks: true, agents: false },
            rules: vec![
                Rule::new("even", "carts are shared out among the sites that are left"),
                Rule::new("nearest", "every cart goes to the nearest site that is left"),
            ],
            row_entries: 2 + 2 * SITES,
            state_bytes: 1 + 2 * SITES + CARTS,
            episode_limit: STEPS.into(),
            ..Spec::default()
        };
        Self { spec, tracks: vec![Track { steps: STEPS, ..Track::default() }; instances] }
    }
}

impl Track {
    /// The sites at which something is left, as bits.
    fn open(&self) -> u128 {
        (0..SITES).filter(|site| self.loads[*site] > 0).fold(0, |open, site| open | 1 << site)
    }

    fn available(&self, cart: usize) -> u128 {
        let (left, right) = (self.carts[cart] > 0, usize::from(self.carts[cart]) < FIELDS - 1);
        u128::from(left) | 0b10 | u128::from(right) << 2 | self.open() << MOVES
    }

    fn distance(&self, cart: usize, site: usize) -> u8 {
        self.carts[cart].abs_diff(self.sites[site])
    }

    /// Carts move and lift; what they take from each site is its share of everything that there was.
    fn step(&mut self, actions: &[u16]) {
        let mut lifting = [0; SITES];
        for (cart, action) in actions.iter().enumerate().take(CARTS) {
            match usize::from(*action).checked_sub(MOVES) {
                None => self.carts[cart] = self.carts[cart] + *action as u8 - 1,
                Some(site) => lifting[site] += u8::from(self.distance(cart, site) == 0),
            }
        }
        for (site, lifting) in lifting.into_iter().enumerate() {
            let taken = (lifting * lifting).min(self.loads[site]);
            self.loads[site] -= taken;
            self.earned[site] = f64::from(taken) / f64::from(LOAD) / SITES as f64;
        }
        self.steps += 1;
    }
}

impl TryFrom<&[u8]> for Track {
    type Error = StateError;

    fn try_from(state: &[u8]) -> Result<Self, StateError> {
        let wanted = 1 + 2 * SITES + CARTS;
        let &[steps, ref rest @ ..] = state else {
            return Err(StateError::Length { found: 0, wanted });
        };
        let mut track = Self { steps, ..Self::default() };
        let places = track.sites.iter_mut().chain(&mut track.loads).chain(&mut track.carts);
        if rest.len() + 1 != wanted {
            return Err(StateError::Length { found: state.len(), wanted });
        }
        places.zip(rest).for_each(|(place, byte)| *place = *byte);
        let mut fields = track.sites.iter().chain(&track.carts);
        if fields.any(|field| usize::from(*field) >= FIELDS)
            || track.loads.iter().any(|load| *load > LOAD)
            || steps > STEPS
        {
            return Err(StateError::Impossible("something is beyond what there is".to_owned()));
        }
        Ok(track)
    }
}

impl Environment for Yard {
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
        let mut field = |_| below(random, FIELDS) as u8;
        let (sites, carts) = (std::array::from_fn(&mut field), std::array::from_fn(&mut field));
        self.tracks[instance] = Track { sites, carts, loads: [LOAD; SITES], ..Track::default() };
    }

    fn step(
        &mut self,
        instance: usize,
        actions: &[u16],
        _: &mut Random,
    ) -> Result<Step, StepError> {
        let track = &mut self.tracks[instance];
        let open = track.open();
        if track.steps == STEPS || open == 0 {
            return Err(StepError::EpisodeOver);
        }
        if actions.len() < CARTS {
            return Err(StepError::TooFewActions { agents: CARTS, actions: actions.len() });
        }
        let is_open = |cart: &usize| track.available(*cart).checked_shr(actions[*cart].into());
        let refused = (0..CARTS).find(|cart| is_open(cart).is_none_or(|open| open & 1 == 0));
        if let Some(agent) = refused {
            return Err(StepError::Unavailable { agent, action: actions[agent] });
        }
        track.step(actions);
        let terminated = track.open() == 0;
        Ok(Step {
            reward: track.earned.iter().sum(),
            terminated,
            timed_out: !terminated && track.steps == STEPS,
            tasks_changed: track.open() != open,
        })
    }

    fn task_rewards(&self, instance: usize) -> &[f64] {
        &self.tracks[instance].earned
    }

    fn save(&self, instance: usize, state: &mut Vec<u8>) {
        let Track { steps, sites, loads, carts, .. } = &self.tracks[instance];
        state.push(*steps);
        state.extend(sites.iter().chain(loads).chain(carts));
    }

    fn load(&mut self, instance: usize, state: &[u8]) -> Result<(), StateError> {
        self.tracks[instance] = state.try_into()?;
        Ok(())
    }

    fn observe(&self, state: &[u8], _: usize, wanted: EntitySet, seen: &mut Observation) {
        const ALL: EntitySet = (1 << (CARTS + SITES)) - 1;
        let track = Track::try_from(state).expect("a state of this environment");
        *seen = Observation::new(&self.spec.shape);
        (seen.present, seen.entities, seen.open_tasks) = (ALL, wanted & ALL, track.open());
        seen.observable.fill(ALL);
        (0..CARTS).for_each(|cart| seen.available[cart] = track.available(cart));
        (0..SITES).for_each(|site| seen.entity_task[CARTS + site] = 1 << site);
        for entity in members(seen.entities) {
            if let Some(site) = entity.checked_sub(CARTS) {
                seen.rows.push(track.sites[site].into(), 1.0);
                seen.rows.push(IS_SITE, 1.0);
                seen.rows.push(IS_LEFT, f32::from(track.loads[site]) / f32::from(LOAD));
            } else {
                seen.rows.push(track.carts[entity].into(), 1.0);
                for site in 0..SITES {
                    let distance = track.distance(entity, site);
                    seen.rows.push(PAIRS + 2 * site, 1.0 - f32::from(distance) / FIELDS as f32);
                    seen.rows.push(PAIRS + 2 * site + 1, f32::from(u8::from(distance == 0)));
                }
            }
            seen.rows.end_row();
        }
    }

    /// Sites in the upper row with what is left there, carts in rows of their own.
    fn picture(&self, state: &[u8]) -> Picture {
        let track = Track::try_from(state).expect("a state of this environment");
        let site = |site: usize| {
            let left = f64::from(track.loads[site]) / f64::from(LOAD);
            Disc {
                name: ["a", "b", "c"][site].to_owned(),
                kind: "site",
                outline: Outline::Square,
                place: Some([track.sites[site].into(), 0.0]),
                bars: vec![Bar { name: "left", share: left }],
                status: if left > 0.0 { "open" } else { "cleared" }.to_owned(),
                task: Some(site),
                ..Disc::default()
            }
        };
        let cart = |cart: usize| Disc {
            name: cart.to_string(),
            kind: "cart",
            colour: Some(cart as u8),
            place: Some([track.carts[cart].into(), 1.0 + cart as f64]),
            ..Disc::default()
        };
        Picture {
            field: Some(Field::grid(FIELDS, 1 + CARTS)),
            agents: (0..CARTS).map(cart).collect(),
            things: (0..SITES).map(site).collect(),
            ..Picture::default()
        }
    }

    fn episode(&self, instance: usize) -> Episode {
        let track = &self.tracks[instance];
        let left: u8 = track.loads.iter().sum();
        let solved = left == 0 && track.steps > 0;
        let timed_out = !solved && track.steps == STEPS;
        Episode {
            steps: track.steps.into(),
            done: solved || timed_out,
            solved,
            timed_out,
            episode_return: 1.0 - f64::from(left) / f64::from(LOAD) / SITES as f64,
            ..Episode::default()
        }
    }

    fn subtask_of(&self, _: &[u8], _: usize, action: u16) -> Option<usize> {
        usize::from(action).checked_sub(MOVES)
    }

    fn allocate(&self, rule: usize, state: &[u8], _: &mut Random, allocation: &mut [u8]) {
        let track = Track::try_from(state).expect("a state of this environment");
        let open: Vec<usize> = members(track.open()).collect();
        for (cart, task) in allocation.iter_mut().enumerate() {
            let site = match rule {
                0 => open.get(cart % open.len().max(1)),
                _ => open.iter().min_by_key(|site| track.distance(cart, **site)),
            };
            *task = site.map_or(UNASSIGNED, |site| *site as u8);
        }
    }
}
