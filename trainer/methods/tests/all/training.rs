//! Short runs: repeatable, independent of threads, resumable byte for byte.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use sortie_envs::Split;
use sortie_learn::play::evaluate;
use sortie_learn::run::{Observer, Outcome};
use sortie_learn::session::{Session, Setup};
use sortie_learn::subtasks::RuleAllocator;
use sortie_learn::{Method, Now};
use sortie_methods::alma::{ALMA, FLAT};

use crate::sessions::{begin, open_records, resume};

/// A run of a few seconds whose replay overflows, with some values replaced.
fn with(assignments: &[&str]) -> Setup {
    let usual = [
        "environment.name=save-the-city",
        "environment.set=2-5a_2-5b",
        "environment.instances=4",
        "network.width=16",
        "network.base=16",
        "allocation.heuristic=0.5",
        "allocation.random=0.5",
        "replay.capacity=3000",
        "replay.warm_up=300",
        "replay.batch=96",
        "allocator.learns_from=400",
        "allocator.decides_from=800",
        "allocator.network.width=16",
        "allocator.network.base=16",
        "allocator.replay.warm_up=100",
        "allocator.replay.capacity=500",
        "allocator.replay.batch=40",
        "allocator.replay.steps_per_update=32",
        "run.steps=3200",
        "run.evaluate_every=1000",
        "run.evaluate_episodes=20",
        "run.final_episodes=20",
        "run.checkpoint_minutes=60",
    ];
    let method = if assignments.contains(&WITHOUT_SUBTASKS) { FLAT } else { ALMA };
    crate::sessions::with(&method.preset("fast").unwrap(), &[&usual, assignments].concat())
}

/// What `flat` has and `alma` has not.
const WITHOUT_SUBTASKS: &str = "network.subtask=none";

fn usual() -> Setup {
    with(&[])
}

/// Sets the stop flag at some steps, and notes what it is told.
struct Recorder<'a> {
    stop_at: u64,
    stop: &'a AtomicBool,
    checkpoints: Vec<PathBuf>,
    evaluated: Vec<u64>,
}

impl Observer for Recorder<'_> {
    fn progress(&mut self, progress: Now) {
        self.stop.store(progress.env_steps >= self.stop_at, Ordering::Relaxed);
    }

    fn evaluated(&mut self, point: &sortie_learn::run::CurvePoint) {
        self.evaluated.push(point.env_steps);
    }

    fn saved(&mut self, checkpoint: &Path) {
        self.checkpoints.push(checkpoint.to_owned());
    }
}

/// Runs until a step and returns the outcome with the newest checkpoint's tensors.
fn run(trainer: &mut Session, stop_at: u64) -> (Outcome, Vec<u8>, Vec<u64>) {
    let stop = AtomicBool::new(false);
    let mut recorder =
        Recorder { stop_at, stop: &stop, checkpoints: Vec::new(), evaluated: Vec::new() };
    let outcome = trainer.run(&mut recorder, &stop).unwrap();
    let newest = recorder.checkpoints.last().expect("a checkpoint at the end");
    (outcome, std::fs::read(newest.join("tensors.safetensors")).unwrap(), recorder.evaluated)
}

fn whole_run(seed: u64, threads: usize) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let mut trainer = begin(usual(), seed, threads, folder.path()).unwrap();
    let (outcome, tensors, evaluated) = run(&mut trainer, u64::MAX);
    assert_eq!(outcome, Outcome::Finished);
    assert_eq!(evaluated, [1000, 2000, 3000, 3200]);
    tensors
}

#[test]
fn a_seed_gives_the_same_weights_with_any_number_of_threads() {
    let one = whole_run(5, 1);
    assert!(one == whole_run(5, 2), "two threads give other weights than one");
    assert!(one == whole_run(5, 3), "three threads give other weights than one");
    assert!(one != whole_run(6, 1), "another seed gives the same weights");
}

#[test]
fn a_stopped_and_resumed_run_ends_as_one_that_never_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let mut trainer = begin(usual(), 5, 1, folder.path()).unwrap();
    assert_eq!(run(&mut trainer, 1500).0, Outcome::Stopped);
    drop(trainer);
    let mut trainer = resume(folder.path(), Some(2)).unwrap();
    assert_eq!(run(&mut trainer, 2500).0, Outcome::Stopped);
    drop(trainer);
    let mut trainer = resume(folder.path(), None).unwrap();
    let (outcome, tensors, evaluated) = run(&mut trainer, u64::MAX);
    assert_eq!((outcome, &evaluated[..]), (Outcome::Finished, &[3000, 3200][..]));
    assert!(tensors == whole_run(5, 1), "the resumed run has other weights");

    let whole = tempfile::tempdir().unwrap();
    let mut trainer = begin(usual(), 5, 1, whole.path()).unwrap();
    run(&mut trainer, u64::MAX);
    let [resumed, whole] = [folder, whole].map(|folder| open_records(folder.path()));
    assert_eq!(resumed.method.agents.average, whole.method.agents.average);
    let [ours, theirs] = [&resumed, &whole].map(|run| run.method.allocator.as_ref().unwrap());
    assert_eq!(ours.learner.average, theirs.learner.average);
    assert_eq!(resumed.curve.len(), 4);
    for (resumed, whole) in resumed.curve.iter().zip(&whole.curve) {
        assert_eq!(resumed.success, whole.success);
        assert_eq!(resumed.loss, whole.loss, "at {}", resumed.env_steps);
        assert_eq!(resumed.allocator_loss, whole.allocator_loss);
        assert_eq!(resumed.training_success, whole.training_success);
    }
}

#[test]
fn every_way_to_learn_resumes_exactly() {
    for assignments in [
        &["mixer.kind=qmix", "network.subtask=input", "mixer.width=16"][..],
        &["mixer.kind=linear", "mixer.width=16"],
        &["network.subtask=none", "replay.warm_up=200"],
        &["network.skip=false", "allocator.network.skip=false"],
    ] {
        let config = with(&[assignments, &["run.steps=1600"]].concat());
        let state = |folder: &Path| {
            let place = folder.join("checkpoints/000000001600");
            ["tensors.safetensors"].map(|name| std::fs::read(place.join(name)).unwrap())
        };
        let whole = tempfile::tempdir().unwrap();
        run(&mut begin(config.clone(), 5, 1, whole.path()).unwrap(), u64::MAX);

        let stopped = tempfile::tempdir().unwrap();
        let mut trainer = begin(config.clone(), 5, 2, stopped.path()).unwrap();
        assert_eq!(run(&mut trainer, 900).0, Outcome::Stopped);
        drop(trainer);
        let mut trainer = resume(stopped.path(), Some(1)).unwrap();
        assert_eq!(run(&mut trainer, u64::MAX).0, Outcome::Finished);
        assert!(state(whole.path()) == state(stopped.path()), "{assignments:?}");

        let [resumed, whole] = [stopped, whole].map(|folder| open_records(folder.path()));
        assert!(whole.curve.last().unwrap().updates > 50, "{assignments:?}");
        for (resumed, whole) in resumed.curve.iter().zip(&whole.curve) {
            assert_eq!(resumed.loss, whole.loss, "{assignments:?} at {}", resumed.env_steps);
            assert_eq!(resumed.success, whole.success);
        }
    }
}

#[test]
fn a_run_without_subtasks_learns_no_allocator_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let config = with(&["network.subtask=none", "run.steps=400"]);
    run(&mut begin(config, 5, 1, folder.path()).unwrap(), u64::MAX);
    let opened = open_records(folder.path());
    let subtasks = opened.method.subtasks().unwrap();
    assert!(subtasks.allocator.is_none() && !subtasks.are_seen);
    assert_eq!(opened.description.config.method, "flat");
    assert!(opened.curve.iter().all(|point| point.allocation == "none"));
    assert!(opened.refused().contains("network.subtask"), "{}", opened.refused());
}

#[test]
fn agents_that_see_no_subtasks_learn_where_there_are_none() {
    let folder = tempfile::tempdir().unwrap();
    let ring = ["environment.name=group-matching", "environment.set=4x3x2"];
    let steps = ["run.steps=12000", "run.final_episodes=200", WITHOUT_SUBTASKS];
    run(&mut begin(with(&[&ring[..], &steps].concat()), 5, 1, folder.path()).unwrap(), u64::MAX);
    let curve = open_records(folder.path()).curve;
    // Agents that have learned for 200 steps gather in time in half of the episodes.
    let success = curve.last().unwrap().success;
    assert!(success > 0.9, "{success}");
}

#[test]
fn a_network_that_marks_subtasks_refuses_a_city_with_more_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let config = with(&["network.subtask=input", "run.steps=400"]);
    run(&mut begin(config, 5, 1, folder.path()).unwrap(), u64::MAX);
    let opened = open_records(folder.path());
    let environment =
        sortie_envs::open("save-the-city/12a_12b", Split::Test, 1, &Default::default()).unwrap();
    let subtasks = opened.method.subtasks().unwrap();
    let mut team = subtasks.under(Box::new(RuleAllocator("coordinated")));
    let error = evaluate(&*environment, &mut team, 1, 1).unwrap_err().to_string();
    assert!(error.contains("fewer subtasks"), "{error}");
}

#[test]
fn resuming_uses_the_checkpoint_before_a_damaged_one() {
    let folder = tempfile::tempdir().unwrap();
    let mut trainer = begin(usual(), 1, 1, folder.path()).unwrap();
    run(&mut trainer, 1200);
    run(&mut trainer, 2000);
    let newest = folder.path().join("checkpoints/000000002000/state.postcard");
    let content = std::fs::read(&newest).unwrap();
    std::fs::write(&newest, &content[..content.len() / 2]).unwrap();
    drop(trainer);

    let trainer = resume(folder.path(), None).unwrap();
    assert_eq!(trainer.env_steps(), 1200);
    assert!(trainer.refused()[0].contains("state.postcard"), "{:?}", trainer.refused());
    let refused =
        sortie_learn::session::load_weights(folder.path(), &mut open_records(folder.path()).method);
    assert!(refused.unwrap()[0].contains("state.postcard"));
}

#[test]
fn a_folder_with_a_run_is_not_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    begin(usual(), 1, 1, folder.path()).unwrap();
    let error = begin(usual(), 2, 1, folder.path()).unwrap_err();
    assert!(error.to_string().contains("holds a run already"), "{error}");
}

#[test]
fn a_run_describes_and_draws_itself() {
    let folder = tempfile::tempdir().unwrap();
    let mut trainer = begin(usual(), 3, 1, folder.path()).unwrap();
    run(&mut trainer, u64::MAX);
    let opened = open_records(folder.path());
    let mut setup = usual();
    setup.run.settle_products().unwrap();
    assert_ne!(setup.run.products, "widest");
    assert_eq!((opened.description.seed, opened.description.config), (3, setup));
    assert!(opened.curve.iter().all(|point| point.loss > 0.0 && point.cpu_s > 0.0));
    let svg = std::fs::read_to_string(folder.path().join("curve.svg")).unwrap();
    assert!(svg.contains("alma on save-the-city/2-5a_2-5b, seed 3"));
    let result = std::fs::read_to_string(folder.path().join("result.json")).unwrap();
    assert!(result.contains("\"allocation\": \"learned\""), "{result}");
    let last = opened.curve.last().unwrap();
    assert!(last.decisions > 300 && last.allocator_updates > 30 && last.allocator_loss > 0.0);
}

#[test]
fn a_run_under_a_rule_learns_no_allocator() {
    let folder = tempfile::tempdir().unwrap();
    let mut trainer = begin(with(&["allocation.learned=0"]), 3, 1, folder.path()).unwrap();
    run(&mut trainer, u64::MAX);
    let opened = open_records(folder.path());
    assert!(opened.method.subtasks().unwrap().allocator.is_none());
    assert_eq!(opened.curve[0].allocation, "heuristic");
    assert_eq!(opened.curve[0].allocator_updates, 0);
    drop(trainer);
    assert_eq!(resume(folder.path(), None).unwrap().env_steps(), 3200);
}

#[test]
fn a_run_can_begin_with_what_another_learned() {
    let first = tempfile::tempdir().unwrap();
    let mut trainer = begin(usual(), 3, 1, first.path()).unwrap();
    run(&mut trainer, 1200);
    let learned = open_records(first.path()).method;

    let from = format!("run.from={}", first.path().display());
    let config = with(&[&from, "environment.set=2-8a_2-8b"]);
    let second = tempfile::tempdir().unwrap();
    let mut trainer = begin(config, 4, 1, second.path()).unwrap();
    // Stopped before its first step.
    let stop = AtomicBool::new(true);
    assert_eq!(trainer.run(&mut (), &stop).unwrap(), Outcome::Stopped);
    assert_eq!(trainer.env_steps(), 0);
    let begun = open_records(second.path()).method;
    assert_eq!(begun.agents.average, learned.agents.average);
    let [begun, learned] = [begun, learned].map(|method| method.allocator.unwrap().learner.average);
    assert_eq!(begun, learned);

    let third = tempfile::tempdir().unwrap();
    let error = begin(with(&[&from, "network.width=32"]), 4, 1, third.path()).unwrap_err();
    assert!(error.to_string().contains("another shape"), "{error}");

    for (key, of) in [("network.skip", "shape"), ("allocator.network.skip", "allocator")] {
        let fourth = tempfile::tempdir().unwrap();
        let error = begin(with(&[&from, &format!("{key}=false")]), 4, 1, fourth.path())
            .unwrap_err()
            .to_string();
        assert!(error.ends_with(&format!("{of}: `--set {key}=true`")), "{error}");
    }
}
