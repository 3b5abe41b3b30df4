//! Short runs of the preset `paper`: repeatable, independent of threads, resumable byte for byte.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use sortie_learn::run::{CurvePoint, Observer, Outcome};
use sortie_learn::session::{MethodEntry, Session, Setup};
use sortie_learn::subtasks::AllocatorNetworks;
use sortie_learn::{Method, Now};
use sortie_methods::alma::{ALMA, COPA, FLAT};

use crate::sessions::{begin, open_windows, resume};

/// A run of a few seconds, with some values replaced.
fn small(method: &MethodEntry, assignments: &[&str]) -> Setup {
    let usual = [
        "environment.name=save-the-city",
        "environment.set=2-5a_2-5b",
        "environment.instances=2",
        "environment.settings.episode_limit=40",
        "low_level.width=16",
        "low_level.base=8",
        "low_level.hypernetwork_width=16",
        "low_level.mixing=8",
        "allocation.width=16",
        "allocation.proposals=4",
        "allocation.rows=40",
        "learning.episodes=40",
        "learning.windows=4",
        "learning.steps=16",
        "learning.copy_agents_every=6",
        "learning.copy_critic_every=4",
        "run.steps=900",
        "run.evaluate_every=400",
        "run.evaluate_episodes=8",
        "run.final_episodes=8",
        "run.checkpoint_minutes=60",
    ];
    crate::sessions::with(&method.preset("paper").unwrap(), &[&usual, assignments].concat())
}

fn config() -> Setup {
    small(&ALMA, &[])
}

/// Sets the stop flag at some steps, and notes what it is told.
struct Recorder<'a> {
    stop_at: u64,
    stop: &'a AtomicBool,
    checkpoints: Vec<PathBuf>,
    curve: Vec<CurvePoint>,
}

impl Observer for Recorder<'_> {
    fn progress(&mut self, progress: Now) {
        self.stop.store(progress.env_steps >= self.stop_at, Ordering::Relaxed);
    }

    fn evaluated(&mut self, point: &CurvePoint) {
        self.curve.push(point.clone());
    }

    fn saved(&mut self, checkpoint: &Path) {
        self.checkpoints.push(checkpoint.to_owned());
    }
}

/// Runs until a step and returns the outcome with the newest checkpoint's tensors and the curve.
fn run(trainer: &mut Session, stop_at: u64) -> (Outcome, Vec<u8>, Vec<CurvePoint>) {
    let stop = AtomicBool::new(false);
    let mut recorder =
        Recorder { stop_at, stop: &stop, checkpoints: Vec::new(), curve: Vec::new() };
    let outcome = trainer.run(&mut recorder, &stop).unwrap();
    let newest = recorder.checkpoints.last().expect("a checkpoint at the end");
    (outcome, std::fs::read(newest.join("tensors.safetensors")).unwrap(), recorder.curve)
}

fn whole_run(config: Setup, seed: u64, threads: usize) -> (Vec<u8>, Vec<CurvePoint>) {
    let folder = tempfile::tempdir().unwrap();
    let mut trainer = begin(config, seed, threads, folder.path()).unwrap();
    let (outcome, tensors, curve) = run(&mut trainer, u64::MAX);
    assert_eq!(outcome, Outcome::Finished);
    assert!(folder.path().join("result.json").exists());
    (tensors, curve)
}

#[test]
fn a_seed_gives_the_same_weights_with_any_number_of_threads() {
    let (one, curve) = whole_run(config(), 5, 1);
    assert!(one == whole_run(config(), 5, 2).0, "two threads give other weights than one");
    assert!(one == whole_run(config(), 5, 3).0, "three threads give other weights than one");
    assert!(one != whole_run(config(), 6, 1).0, "another seed gives the same weights");
    let last = curve.last().expect("an evaluation");
    assert!(last.updates > 10 && last.allocator_updates > 10, "{last:?}");
    assert!(last.loss > 0.0 && last.allocator_loss > 0.0 && last.gradient_norm.is_finite());
}

#[test]
fn a_stopped_and_resumed_run_ends_as_one_that_never_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let mut trainer = begin(config(), 5, 1, folder.path()).unwrap();
    assert_eq!(run(&mut trainer, 300).0, Outcome::Stopped);
    drop(trainer);
    let mut trainer = resume(folder.path(), Some(2)).unwrap();
    let (outcome, tensors, _) = run(&mut trainer, u64::MAX);
    assert_eq!(outcome, Outcome::Finished);
    assert!(tensors == whole_run(config(), 5, 1).0, "the resumed run has other weights");

    let opened = open_windows(folder.path());
    let allocator = opened.method.subtasks().and_then(|subtasks| subtasks.allocator).unwrap();
    assert!(matches!(allocator.networks, AllocatorNetworks::Proposals(_)));
    assert_eq!(opened.curve.last().map(|point| point.env_steps), Some(trainer.env_steps()));
}

/// The same with a coach.
fn coached() -> Setup {
    small(&COPA, &["run.steps=700"])
}

#[test]
fn a_coach_learns_the_same_with_any_number_of_threads_and_when_resumed() {
    let (one, curve) = whole_run(coached(), 5, 1);
    let last = curve.last().expect("an evaluation");
    assert!(last.updates > 10 && last.decisions > 100 && last.loss.is_finite(), "{last:?}");
    assert_eq!((last.allocation.as_str(), last.allocator_updates), ("none", 0));

    let folder = tempfile::tempdir().unwrap();
    let mut trainer = begin(coached(), 5, 3, folder.path()).unwrap();
    assert_eq!(run(&mut trainer, 500).0, Outcome::Stopped);
    assert!(trainer.curve().last().is_some_and(|point| point.updates > 0));
    drop(trainer);
    let mut trainer = resume(folder.path(), Some(2)).unwrap();
    let (outcome, tensors, _) = run(&mut trainer, u64::MAX);
    assert_eq!(outcome, Outcome::Finished);
    assert!(tensors == one, "the resumed run has other weights");

    let mut opened = open_windows(folder.path());
    assert_eq!(opened.description.config.method, "copa");
    // The run's own last evaluation, to the last digit, and another one without the coach.
    let last = trainer.curve().last().expect("an evaluation");
    assert_eq!(opened.measured(8, u64::MAX - 5).return_mean, last.return_mean);
    let refused = opened.refused();
    assert!(refused.contains("coach") && refused.contains("8 numbers"), "{refused}");
    let level = &mut opened.method.low_level;
    let coach = level.part("coach");
    level.online.values[coach].fill(0.0);
    assert_ne!(opened.measured(8, u64::MAX - 5).return_mean, last.return_mean);
}

#[test]
fn every_way_to_allocate_and_to_be_conditioned_learns() {
    for (method, assignments) in [
        (FLAT, &[][..]),
        (
            ALMA,
            &[
                "low_level.conditioning=input",
                "low_level.extra_tasks=2",
                "allocation.extra_tasks=2",
            ],
        ),
        (ALMA, &["allocation.by=heuristic"]),
        (ALMA, &["allocation.by=heuristic", "low_level.recurrent=true"]),
        (ALMA, &["allocation.by=random"]),
    ] {
        let config = small(&method, &[&["run.steps=500"], assignments].concat());
        let learned =
            method.name == "alma" && config.own["allocation"]["by"].as_str() == Some("learned");
        let (_, curve) = whole_run(config, 3, 2);
        let last = curve.last().expect("an evaluation");
        assert!(last.updates > 0 && last.loss.is_finite(), "{assignments:?}");
        assert_eq!(last.allocator_updates > 0, learned, "{assignments:?}");
    }
}

#[test]
fn agents_with_a_memory_are_saved_resumed_and_measured() {
    let folder = tempfile::tempdir().unwrap();
    let assignments = [
        "low_level.recurrent=true",
        "low_level.skip=true",
        "allocation.by=heuristic",
        "run.steps=500",
    ];
    let config = small(&ALMA, &assignments);
    let mut trainer = begin(config.clone(), 5, 1, folder.path()).unwrap();
    assert_eq!(run(&mut trainer, 200).0, Outcome::Stopped);
    drop(trainer);
    let mut trainer = resume(folder.path(), Some(2)).unwrap();
    let (_, tensors, curve) = run(&mut trainer, u64::MAX);
    assert!(tensors == whole_run(config, 5, 1).0, "the resumed run has other weights");

    let mut opened = open_windows(folder.path());
    // The run's own last evaluation, to the last digit, and another one without the memory.
    let last = curve.last().expect("an evaluation");
    assert_eq!(opened.measured(8, u64::MAX - 5).return_mean, last.return_mean);
    assert!(opened.refused().contains("memory"));
    let level = &mut opened.method.low_level;
    let memory = level.part("memory");
    level.online.values[memory].fill(0.0);
    assert_ne!(opened.measured(8, u64::MAX - 5).return_mean, last.return_mean);
}

#[test]
fn an_allocator_learns_for_agents_of_another_run_that_stay_as_they_are() {
    let (first, second) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    run(&mut begin(config(), 1, 1, first.path()).unwrap(), 300);
    let from = format!("run.from={}", first.path().display());
    let frozen = [&from, "low_level.frozen=true"];
    run(&mut begin(small(&ALMA, &frozen), 2, 1, second.path()).unwrap(), u64::MAX);
    let [one, other] = [&first, &second].map(|folder| open_windows(folder.path()).method);
    let agents = one.low_level.shape().parameters();
    let [first, second] = [&one, &other].map(|method| &method.low_level.online.values[..agents]);
    assert_eq!(first, second);
    let [one, other] = [one, other].map(|method| method.allocation.unwrap());
    assert_ne!(one.networks().policy, other.networks().policy);

    let other = tempfile::tempdir().unwrap();
    let wide = small(&ALMA, &[&frozen[..], &["low_level.width=32"]].concat());
    let error = begin(wide, 2, 1, other.path()).unwrap_err().to_string();
    assert!(error.contains("shape"), "{error}");
}
