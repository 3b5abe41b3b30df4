//! Runs of MAAC: agents of two roles learn to work together, repeat themselves, and go on as if they had never stopped.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use sortie_learn::draft::{MethodRun, draft_method};
use sortie_learn::run::Observer;
use sortie_learn::session::{Opening, Setup, load_weights};
use sortie_learn::{Act, Now, play};
use sortie_methods::find;

use crate::sessions::{begin, environment_of, resume, with};

/// A rover that hears its tower's messages learns where to go.
fn pair(assignments: &[&str]) -> Setup {
    pair_of("maac", assignments)
}

fn pair_of(method: &str, assignments: &[&str]) -> Setup {
    let mut setup = find(method).unwrap().preset("fast").unwrap();
    setup.environment.name = "particle".to_owned();
    setup.environment.set = "rover-tower-2".to_owned();
    let small = [
        "environment.instances=16",
        "network.critic_width=16",
        "network.policy_width=32",
        "replay.first=1000",
        "replay.batch=64",
        "replay.steps_per_period=16",
        "run.final_episodes=0",
        "run.evaluate_every=100000",
    ];
    with(&with(&setup, &small), assignments)
}

fn weights(folder: &Path) -> Vec<u8> {
    let checkpoints = std::fs::read_dir(folder.join("checkpoints")).unwrap();
    let newest = checkpoints.map(|entry| entry.unwrap().path()).max().unwrap();
    std::fs::read(newest.join("tensors.safetensors")).unwrap()
}

/// Stops a run after so many steps.
struct Stopping<'a>(&'a AtomicBool, u64);

impl Observer for Stopping<'_> {
    fn progress(&mut self, progress: Now) {
        self.0.store(progress.env_steps >= self.1, Ordering::Relaxed);
    }
}

/// What a pair earns before and after it learned so.
fn learned(method: &str, assignments: &[&str]) -> [f64; 2] {
    let quick =
        ["optimiser.critic_rate=0.01", "optimiser.policy_rate=0.005", "returns.discount=0.9"];
    let setup = with(&pair_of(method, &quick), assignments);
    let folder = tempfile::tempdir().unwrap();
    let mut session = begin(setup.clone(), 1, 1, folder.path()).unwrap();
    session.run(&mut (), &AtomicBool::new(false)).unwrap();
    let world = environment_of(&setup).unwrap();
    let chance = play::evaluate(&*world, &mut play::RandomTeam::new(1), 300, 1).unwrap();
    let learned = play::evaluate(&*world, &mut *session.method().team(), 300, 1).unwrap();
    [chance, learned].map(|report| report.return_mean)
}

#[test]
fn a_rover_learns_what_its_tower_says() {
    let [chance, learned] = learned("maac", &["run.steps=40000"]);
    assert!(chance < 10.0 && learned > 60.0, "{chance} {learned}");
}

/// Critics that see only their agent's row do not know what the other is told; and who learns once learns slowly.
#[test]
fn a_rover_learns_by_the_methods_that_are_compared() {
    for (method, least, assignments) in [
        ("coma-sac", 60.0, &["run.steps=20000"][..]),
        ("maddpg-sac", 40.0, &["run.steps=20000"]),
        ("maddpg", 40.0, &["run.steps=20000"]),
        ("ddpg", 20.0, &["run.steps=30000"]),
        ("coma", 30.0, &["run.steps=100000", "environment.instances=4"]),
    ] {
        let [_, learned] = learned(method, assignments);
        assert!(learned > least, "{method}: {learned}");
    }
}

#[test]
fn a_stopped_and_resumed_run_ends_as_one_that_never_stopped() {
    for kind in [
        &["update.own_actions=expected", "network.critic=uniform", "returns.decision_interval=3"][..],
        &[
            "update.own_actions=drawn",
            "update.policy_values=fresh",
            "network.normalised=true",
            "network.shared=false",
            "replay.batch=200",
        ],
        &["network.critic=all", "update.own_actions=relaxed"],
        &["network.critic=own", "network.normalised=true", "update.own_actions=relaxed"],
        &["network.critic=one", "update.policy_values=fresh"],
        &[
            "network.critic=one",
            "replay.on_policy=true",
            "returns.steps=1",
            "returns.lambda=0.8",
            "update.own_actions=drawn",
        ],
    ] {
        let setup =
            with(&pair(&["run.steps=2600", "replay.capacity=1200", "replay.first=500"]), kind);
        let [whole, parted] = [0, 1].map(|_| tempfile::tempdir().unwrap());
        let mut session = begin(setup.clone(), 3, 1, whole.path()).unwrap();
        session.run(&mut (), &AtomicBool::new(false)).unwrap();
        let stop = AtomicBool::new(false);
        let mut session = begin(setup, 3, 2, parted.path()).unwrap();
        session.run(&mut Stopping(&stop, 1500), &stop).unwrap();
        drop(session);
        assert!(!parted.path().join("result.json").exists());
        let mut session = resume(parted.path(), Some(1)).unwrap();
        session.run(&mut (), &AtomicBool::new(false)).unwrap();
        assert_eq!(weights(whole.path()), weights(parted.path()), "{kind:?}");
    }
}

/// Rovers and towers see rows of other lengths.
#[test]
fn every_agent_is_exported_with_the_graph_of_its_role() {
    let setup = pair(&["run.steps=200"]);
    let folder = tempfile::tempdir().unwrap();
    let mut session = begin(setup.clone(), 1, 1, folder.path()).unwrap();
    session.run(&mut (), &AtomicBool::new(false)).unwrap();
    let world = environment_of(&setup).unwrap();
    let (description, method, curve) = (session.description(), session.method(), session.curve());
    let run = MethodRun { description, environment: &*world, method, curve };
    let draft = draft_method(&run, folder.path(), &[world.spec().shape], &[], 1).unwrap();
    let network = draft.network;
    assert!(network.graphs.len() > 1, "{network:?}");
    for (agent, graph) in network.graph_of.iter().enumerate() {
        let features = world.spec().features_of(agent).len();
        let graph = &network.graphs[usize::from(*graph)];
        assert_eq!(usize::from(graph.features), features, "agent {agent}: {graph:?}");
    }
    assert_eq!(network.graph_of.len(), world.spec().shape.agents);
}

#[test]
fn a_run_that_is_read_back_shows_its_policies_what_they_know() {
    let setup = with(&pair(&["run.steps=4000"]), &["network.normalised=true"]);
    let folder = tempfile::tempdir().unwrap();
    let mut session = begin(setup.clone(), 1, 1, folder.path()).unwrap();
    session.run(&mut (), &AtomicBool::new(false)).unwrap();
    let world = environment_of(&setup).unwrap();
    let opening = Opening { setup: &setup, environment: &*world, seed: 2, threads: 1 };
    let mut method = find("maac").unwrap().method(&opening).unwrap();
    load_weights(folder.path(), &mut *method).unwrap();
    let play = |mut team: Box<dyn Act + '_>| play::evaluate(&*world, &mut *team, 40, 1).unwrap();
    assert_eq!(play(method.team()), play(session.method().team()));
}
