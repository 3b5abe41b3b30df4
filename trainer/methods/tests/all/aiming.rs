//! Actions that aim at entities: who is aimed at is learned by what it looks like, in an environment where numbers say nothing.

use std::sync::atomic::AtomicBool;

use sortie_envs::random::below;
use sortie_envs::{
    EntitySet, Environment, Episode, Observation, Random, Rewards, Rule, Shape, Spec, Split,
    StateError, Step, StepError, conformance,
};
use sortie_learn::draft::{MethodRun, draft_method};
use sortie_learn::play;
use sortie_learn::run::{RunConfig, RunDescription};
use sortie_learn::session::{EnvironmentChoice, Opening, Session};
use sortie_methods::find;

use crate::sessions::with;

const PICKERS: usize = 2;
const TREES: usize = 4;
const STEPS: u8 = 12;

/// Two pickers and four trees, one of which is ripe and another hidden, others in every step. To pick is to aim at a tree.
/// All of it is one subtask.
struct Orchard {
    spec: Spec,
    /// Whether pickers are told how each tree is; else it is to be seen of the tree.
    is_told: bool,
    /// Of every instance steps, pickings of ripe trees, the ripe tree and the hidden one.
    states: Vec<[u8; 4]>,
    /// What the last step of each was worth.
    rewards: Vec<f64>,
}

impl Orchard {
    fn new(instances: usize, is_told: bool) -> Self {
        let entities = PICKERS + TREES;
        let aimed = (0..TREES).map(|tree| format!("pick-{tree}"));
        let own = ["is-picker", "is-tree", "is-ripe"];
        let features = if is_told { 3 + TREES } else { 3 };
        let ripe = (0..TREES).map(|tree| format!("is-ripe-{tree}"));
        let spec = Spec {
            name: "orchard".into(),
            shape: Shape { agents: PICKERS, entities, tasks: 1, actions: 1 + TREES, features },
            features: own.map(str::to_owned).into_iter().chain(ripe).take(features).collect(),
            actions: std::iter::once("wait".to_owned()).chain(aimed).collect(),
            targets: PICKERS..entities,
            pairs: 3..features,
            safe_action: Some(0),
            rewards: Rewards { tasks: true, agents: false },
            rules: vec![Rule::new("together", "Everybody picks")],
            row_entries: 2,
            state_bytes: 4,
            episode_limit: STEPS.into(),
            ..Spec::default()
        };
        let (states, rewards) = (vec![[STEPS, 0, 0, 1]; instances], vec![0.0; instances]);
        Self { spec, is_told, states, rewards }
    }
}

/// The entities that there are to be seen.
fn seen(hidden: u8) -> EntitySet {
    let all: EntitySet = (1 << (PICKERS + TREES)) - 1;
    all & !(1 << (PICKERS + usize::from(hidden)))
}

/// Waiting, and the trees that are to be seen.
fn available(hidden: u8) -> u128 {
    1 | (seen(hidden) >> PICKERS) << 1
}

/// A ripe tree and a hidden one, which are two.
fn draw(random: &mut Random) -> [u8; 2] {
    let ripe = below(random, TREES);
    [ripe as u8, ((ripe + 1 + below(random, TREES - 1)) % TREES) as u8]
}

impl Environment for Orchard {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn instances(&self) -> usize {
        self.states.len()
    }

    fn open(&self, instances: usize, _: Split) -> Box<dyn Environment> {
        Box::new(Self::new(instances, self.is_told))
    }

    fn reset(&mut self, instance: usize, random: &mut Random) {
        let [ripe, hidden] = draw(random);
        self.states[instance] = [0, 0, ripe, hidden];
    }

    fn step(
        &mut self,
        instance: usize,
        actions: &[u16],
        random: &mut Random,
    ) -> Result<Step, StepError> {
        let [steps, picked, ripe, hidden] = &mut self.states[instance];
        if *steps == STEPS {
            return Err(StepError::EpisodeOver);
        }
        let is_open = |agent: &usize| available(*hidden) >> actions[*agent] & 1 == 1;
        if let Some(agent) = (0..PICKERS).find(|agent| !is_open(agent)) {
            return Err(StepError::Unavailable { agent, action: actions[agent] });
        }
        let hits = actions.iter().filter(|action| **action == u16::from(*ripe) + 1).count();
        (*steps, *picked) = (*steps + 1, *picked + hits as u8);
        [*ripe, *hidden] = draw(random);
        self.rewards[instance] = hits as f64;
        Ok(Step { reward: hits as f64, timed_out: *steps == STEPS, ..Step::default() })
    }

    fn task_rewards(&self, instance: usize) -> &[f64] {
        &self.rewards[instance..][..1]
    }

    fn allocate(&self, _: usize, _: &[u8], _: &mut Random, allocation: &mut [u8]) {
        allocation.fill(0);
    }

    fn save(&self, instance: usize, state: &mut Vec<u8>) {
        state.extend(self.states[instance]);
    }

    fn load(&mut self, instance: usize, state: &[u8]) -> Result<(), StateError> {
        let length = StateError::Length { found: state.len(), wanted: 4 };
        self.states[instance] = state.try_into().map_err(|_| length)?;
        Ok(())
    }

    fn observe(&self, state: &[u8], _: usize, wanted: EntitySet, seen_by: &mut Observation) {
        let (ripe, hidden) = (usize::from(state[2]), state[3]);
        *seen_by = Observation::new(&self.spec.shape);
        seen_by.present = (1 << (PICKERS + TREES)) - 1;
        seen_by.entities = wanted & seen_by.present;
        seen_by.observable.fill(seen(hidden));
        seen_by.available.fill(available(hidden));
        seen_by.entity_task[PICKERS..].fill(1);
        seen_by.open_tasks = 1;
        for entity in sortie_envs::members(seen_by.entities) {
            seen_by.rows.push((entity >= PICKERS).into(), 1.0);
            match entity.checked_sub(PICKERS) {
                None if self.is_told => seen_by.rows.push(3 + ripe, 1.0),
                Some(tree) if tree == ripe && !self.is_told => seen_by.rows.push(2, 1.0),
                _ => {}
            }
            seen_by.rows.end_row();
        }
    }

    fn episode(&self, instance: usize) -> Episode {
        let [steps, picked, ..] = self.states[instance];
        let done = steps == STEPS;
        let solved = done && usize::from(picked) == PICKERS * usize::from(STEPS);
        let (steps, episode_return) = (steps.into(), picked.into());
        Episode { steps, done, solved, timed_out: done, episode_return, ..Episode::default() }
    }
}

/// By a rule, which is there from the first step on, and as quickly as the others.
const ALMA: &[&str] = &[
    "allocation.rule=together",
    "exploration.steps=1000",
    "replay.warm_up=100",
    "optimiser.average_rate=0.01",
    "returns.shaping=0",
];

/// A run of a method in the orchard, whose greedy team picks such a share of what can be picked.
fn learned(method: &str, assignments: &[&str], is_told: bool) -> (Session, f64, tempfile::TempDir) {
    let orchard = || Box::new(Orchard::new(1, is_told));
    let setup = with(&find(method).unwrap().preset("fast").unwrap(), assignments);
    let environment = EnvironmentChoice::of(&*orchard(), 16);
    // What is told is one number for each tree; looks are as many as an embedding is wide.
    let steps = if is_told { 6_000 } else { 3_000 };
    let run = RunConfig { steps, evaluate_every: steps, final_episodes: 0, ..setup.run };
    let setup = sortie_learn::session::Setup { environment, run, ..setup };
    let description = RunDescription::new(setup, 1, 1);
    let (setup, environment) = (&description.config, &*orchard());
    let opening = Opening { setup, environment, seed: 1, threads: 1 };
    let method = find(&setup.method).unwrap().method(&opening).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("run");
    let mut session = Session::begin(description.clone(), orchard(), method, &place).unwrap();
    session.run(&mut (), &AtomicBool::new(false)).unwrap();
    let found = play::evaluate(environment, &mut *session.method().team(), 200, 2).unwrap();
    (session, found.return_mean / f64::from(STEPS) / PICKERS as f64, folder)
}

#[test]
fn an_orchard_holds_to_the_laws() {
    for is_told in [false, true] {
        assert_eq!(conformance::check(&Orchard::new(2, is_told), 1, 20), Ok(()));
    }
}

/// By chance one in four hits, without the looks of the targets one in three.
#[test]
fn a_head_that_points_learns_whom_to_aim_at_and_a_numbered_one_cannot() {
    for (method, assignments) in [
        ("vdn", &[][..]),
        ("qmix", &[]),
        ("refil", &[]),
        ("vdn", &["network.memory=16", "replay.unit=episodes"]),
        ("alma", ALMA),
    ] {
        let (_, picked, _) = learned(method, assignments, false);
        assert!(picked > 0.85, "{method} {assignments:?}: {picked}");
    }
    let numbered = "network.head=numbered";
    for (method, assignments) in [("vdn", vec![numbered]), ("alma", [ALMA, &[numbered]].concat())] {
        let (_, picked, _) = learned(method, &assignments, false);
        assert!(picked < 0.5, "{method}: {picked}");
    }
}

#[test]
fn what_is_told_of_pairs_says_whom_to_aim_at() {
    for (method, assignments) in [("vdn", &[][..]), ("qmix", &[]), ("refil", &[]), ("alma", ALMA)] {
        let (_, picked, _) = learned(method, assignments, true);
        assert!(picked > 0.85, "{method}: {picked}");
    }
}

#[test]
fn what_points_is_exported_with_its_targets_and_gives_its_golden_answers() {
    let told = [false, true];
    for ((method, assignments), is_told) in [("vdn", &[][..]), ("alma", ALMA)]
        .into_iter()
        .flat_map(|method| told.map(|is_told| (method, is_told)))
    {
        let (session, _, folder) = learned(method, assignments, is_told);
        let orchard = Orchard::new(1, is_told);
        let (description, method, curve) =
            (session.description(), session.method(), session.curve());
        let run = MethodRun { description, environment: &orchard, method, curve };
        let draft =
            draft_method(&run, &folder.path().join("run"), &[orchard.spec.shape], &[], 1).unwrap();
        let bundle = draft.write(&folder.path().join("bundle")).unwrap();
        let onnx = std::fs::read(bundle.folder().join("agent.onnx")).unwrap();
        let says = |text: &[u8]| onnx.windows(text.len()).any(|bytes| bytes == text);
        assert!(says(b"sortie.targets") && says(b"2..6") && says(b"pointing.query"));
        assert_eq!([says(b"sortie.pairs"), says(b"3..7"), says(b"pairs.weights")], [is_told; 3]);
        // Of ALMA's mask all of a subtask is to be seen.
        let hides = bundle.golden().cases.iter().any(|case| case.observation.visible.len() < 6);
        assert_eq!(hides, assignments.is_empty());
    }
}
