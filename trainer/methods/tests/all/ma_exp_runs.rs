//! Runs of MA-Exp: agents find everything, and go on as if they had never stopped.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use sortie_learn::export::DeployedNetworks;
use sortie_learn::run::Observer;
use sortie_learn::session::{Opening, Setup, load_weights};
use sortie_learn::{Method, Now, play};
use sortie_methods::find;

use crate::sessions::{begin, environment_of, resume, with};

fn set(set: &str, assignments: &[&str]) -> Setup {
    let mut setup = find("ma-exp").unwrap().preset("fast").unwrap();
    setup.environment.name = "gridworld".to_owned();
    setup.environment.set = set.to_owned();
    let world = environment_of(&setup).unwrap();
    (find("ma-exp").unwrap().suit)("fast", &mut setup, world.spec());
    let small = ["run.final_episodes=0", "run.evaluate_every=1000000"];
    with(&with(&setup, &small), assignments)
}

/// What the agents look up.
fn answers(method: &dyn Method) -> Vec<f32> {
    match method.deployed().unwrap().networks {
        DeployedNetworks::Lookup(tables) => tables.answers,
        _ => panic!("tables"),
    }
}

/// Treasures that a team finds, and the steps that it takes.
fn measured(setup: &Setup, method: &dyn Method) -> [f64; 2] {
    let world = environment_of(setup).unwrap();
    let played = play::evaluate(&*world, &mut *method.team(), 100, 1).unwrap();
    [played.metrics["treasures"], played.length_mean]
}

#[test]
fn frozen_teams_find_everything() {
    for (name, steps, treasures, most) in [
        ("task1-2", 300_000, 2.0, 200.0),
        ("task2-2", 150_000, 2.0, 150.0),
        ("task3-3", 200_000, 3.0, 150.0),
    ] {
        let setup = set(name, &[&format!("run.steps={steps}")]);
        let folder = tempfile::tempdir().unwrap();
        let mut session = begin(setup.clone(), 1, 1, folder.path()).unwrap();
        session.run(&mut (), &AtomicBool::new(false)).unwrap();
        let [found, length] = measured(&setup, session.method());
        assert!(found >= treasures - 0.1 && length < most, "{name}: {found} in {length}");
    }
}

#[test]
fn without_intrinsic_rewards_and_hopeless_at_first_nothing_is_found() {
    let setup = set("task1-2", &["run.steps=60000", "heads.intrinsic=none"]);
    let folder = tempfile::tempdir().unwrap();
    let mut session = begin(setup.clone(), 1, 1, folder.path()).unwrap();
    session.run(&mut (), &AtomicBool::new(false)).unwrap();
    assert_eq!(measured(&setup, session.method())[0], 0.0);
}

/// Stops a run after so many steps.
struct Stopping<'a>(&'a AtomicBool, u64);

impl Observer for Stopping<'_> {
    fn progress(&mut self, progress: Now) {
        self.0.store(progress.env_steps >= self.1, Ordering::Relaxed);
    }
}

#[test]
fn a_stopped_and_resumed_run_ends_as_one_that_never_stopped() {
    let setup = set("flip-2", &["run.steps=12000", "heads.intrinsic=centralized"]);
    let [whole, parted] = [0, 1].map(|_| tempfile::tempdir().unwrap());
    let mut session = begin(setup.clone(), 3, 1, whole.path()).unwrap();
    session.run(&mut (), &AtomicBool::new(false)).unwrap();
    let want = answers(session.method());
    drop(session);
    let stop = AtomicBool::new(false);
    let mut session = begin(setup.clone(), 3, 1, parted.path()).unwrap();
    session.run(&mut Stopping(&stop, 5_000), &stop).unwrap();
    assert_ne!(answers(session.method()), want);
    drop(session);
    let mut session = resume(parted.path(), Some(1)).unwrap();
    session.run(&mut (), &AtomicBool::new(false)).unwrap();
    assert_eq!(answers(session.method()), want);

    let world = environment_of(&setup).unwrap();
    let opening = Opening { setup: &setup, environment: &*world, seed: 4, threads: 1 };
    let mut method = find("ma-exp").unwrap().method(&opening).unwrap();
    load_weights(parted.path(), &mut *method).unwrap();
    assert_eq!(answers(&*method), want, "what was learned is read back to be used");
}

/// The published learner in small.
fn networks(assignments: &[&str]) -> Setup {
    let mut setup = find("ma-exp").unwrap().preset("paper").unwrap();
    setup.environment.name = "gridworld".to_owned();
    setup.environment.set = "task1-2".to_owned();
    let small = [
        "environment.instances=4",
        "network.critic_width=16",
        "network.base_width=16",
        "network.head_width=8",
        "replay.batch=150",
        "replay.updates_per_period=1",
        "replay.capacity=3000",
        "run.steps=4400",
        "run.final_episodes=0",
        "run.evaluate_every=1000000",
        "run.evaluate_episodes=4",
    ];
    with(&with(&setup, &small), assignments)
}

fn weights(folder: &Path) -> Vec<u8> {
    let checkpoints = std::fs::read_dir(folder.join("checkpoints")).unwrap();
    let newest = checkpoints.map(|entry| entry.unwrap().path()).max().unwrap();
    std::fs::read(newest.join("tensors.safetensors")).unwrap()
}

#[test]
fn networks_go_on_as_if_they_had_never_stopped() {
    for kind in [
        &[][..],
        &["heads.intrinsic=centralized", "heads.exploits=true", "meta.uniform=true"],
        &["heads.intrinsic=none"],
    ] {
        let setup = networks(kind);
        let [whole, parted] = [0, 1].map(|_| tempfile::tempdir().unwrap());
        let mut session = begin(setup.clone(), 3, 1, whole.path()).unwrap();
        session.run(&mut (), &AtomicBool::new(false)).unwrap();
        // Stopped amid a turn.
        let stop = AtomicBool::new(false);
        let mut session = begin(setup.clone(), 3, 2, parted.path()).unwrap();
        session.run(&mut Stopping(&stop, 2_100), &stop).unwrap();
        drop(session);
        assert_ne!(weights(whole.path()), weights(parted.path()));
        let mut session = resume(parted.path(), Some(1)).unwrap();
        session.run(&mut (), &AtomicBool::new(false)).unwrap();
        assert_eq!(weights(whole.path()), weights(parted.path()), "{kind:?}");
        let played = measured(&setup, session.method());

        let world = environment_of(&setup).unwrap();
        let opening = Opening { setup: &setup, environment: &*world, seed: 4, threads: 1 };
        let mut method = find("ma-exp").unwrap().method(&opening).unwrap();
        load_weights(parted.path(), &mut *method).unwrap();
        assert_eq!(measured(&setup, &*method), played, "what was learned is read back to be used");
    }
}

#[test]
fn larger_tasks_take_longer_and_other_worlds_do_not_fit() {
    let steps = |name: &str| set(name, &[]).run.steps;
    assert_eq!(
        [steps("task1-2"), steps("task2-4"), steps("flip-4")],
        [300_000, 600_000, 1_000_000]
    );
    let mut setup = find("ma-exp").unwrap().preset("fast").unwrap();
    setup.environment.name = "particle".to_owned();
    let world = environment_of(&setup).unwrap();
    let opening = Opening { setup: &setup, environment: &*world, seed: 4, threads: 1 };
    let refused = find("ma-exp").unwrap().method(&opening).err().unwrap().to_string();
    assert!(refused.contains("count their visits to cells of a grid"), "{refused}");
}
