//! Runs of value factorisation: they learn, repeat, and go on as if they had never stopped.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use sortie_envs::{Environment, Split};
use sortie_learn::export::DeployedNetworks;
use sortie_learn::run::{CurvePoint, Observer, Outcome, RunDescription, RunResult};
use sortie_learn::session::{MethodEntry, Opening, Session, Setup, load_weights};
use sortie_learn::{LearnError, Method, Now, play};
use sortie_methods::find;

/// Keeps what a run tells, and stops it after so many steps.
#[derive(Default)]
struct Watch<'a> {
    stop: Option<(&'a AtomicBool, u64)>,
    result: Option<RunResult>,
}

impl Observer for Watch<'_> {
    fn progress(&mut self, progress: Now) {
        if let Some((stop, steps)) = self.stop {
            stop.store(progress.env_steps >= steps, Ordering::Relaxed);
        }
    }

    fn finished(&mut self, result: &RunResult) {
        self.result = Some(result.clone());
    }
}

fn ring(name: &str) -> Box<dyn Environment> {
    sortie_envs::open(name, Split::Train, 1, &Default::default()).unwrap()
}

/// A run on a small ring that takes a moment.
fn small(method: &str, assignments: &[&str]) -> (&'static MethodEntry, Setup) {
    let entry = find(method).unwrap();
    let mut setup = entry.preset("fast").unwrap();
    setup.environment.name = "group-matching".to_owned();
    setup.environment.set = "4x3x2".to_owned();
    let usual = ["network.width=16", "replay.batch=64", "optimiser.learning_rate=0.006"];
    let short = ["run.evaluate_every=500", "run.evaluate_episodes=20", "run.final_episodes=200"];
    for assignment in usual.iter().chain(&short).chain(assignments) {
        setup = entry.set(&setup, assignment).unwrap();
    }
    (entry, setup)
}

type Parts = (Box<dyn Environment>, Box<dyn Method>);

fn open(
    entry: &MethodEntry,
    description: &RunDescription,
    threads: usize,
) -> Result<Parts, LearnError> {
    let RunDescription { config: setup, seed, .. } = description;
    let environment = ring(&setup.environment.to_string());
    let opening = Opening { setup, environment: &*environment, seed: *seed, threads };
    let method = entry.method(&opening)?;
    Ok((environment, method))
}

fn begin(
    (entry, setup): &(&MethodEntry, Setup),
    seed: u64,
    threads: usize,
    folder: &Path,
) -> Session {
    let description = RunDescription::new(setup.clone(), seed, threads);
    let (environment, method) = open(entry, &description, threads).unwrap();
    Session::begin(description, environment, method, folder).unwrap()
}

fn weights(folder: &Path) -> Vec<u8> {
    let checkpoints = std::fs::read_dir(folder.join("checkpoints")).unwrap();
    let newest = checkpoints.map(|entry| entry.unwrap().path()).max().unwrap();
    std::fs::read(newest.join("tensors.safetensors")).unwrap()
}

/// The curve without its times.
fn curve(session: &Session) -> Vec<CurvePoint> {
    let timeless = |point: &CurvePoint| CurvePoint { wall_s: 0.0, cpu_s: 0.0, ..point.clone() };
    session.curve().iter().map(timeless).collect()
}

#[test]
fn a_small_ring_is_learned_by_every_method() {
    for method in ["vdn", "refil"] {
        let folder = tempfile::tempdir().unwrap();
        let run = small(method, &["run.steps=10000", "optimiser.average_rate=0.02"]);
        let mut session = begin(&run, 1, 2, folder.path());
        let mut watch = Watch::default();
        let outcome = session.run(&mut watch, &AtomicBool::new(false)).unwrap();
        assert_eq!(outcome, Outcome::Finished);
        let result = watch.result.expect("a result");
        assert!(result.evaluation.success > 0.9, "{method}: {result:?}");
        assert!(result.evaluation.metrics.contains_key("matches"), "{result:?}");
        assert!(folder.path().join("result.json").is_file());
    }
}

/// Agents with a memory that learn from whole episodes as the dissertation's do.
const REMEMBERING: [&str; 8] = [
    "network.memory=8",
    "mixer.hypernetworks=separate",
    "replay.unit=episodes",
    "replay.capacity=20",
    "replay.batch=8",
    "replay.steps_per_update=0",
    "update.rule=rmsprop",
    "update.target_every=10",
];

fn with<'a>(more: &[&'a str]) -> Vec<&'a str> {
    REMEMBERING.into_iter().chain(more.iter().copied()).collect()
}

#[test]
fn a_stopped_and_resumed_run_ends_as_one_that_never_stopped() {
    let short = ["run.steps=2000", "run.final_episodes=0"];
    goes_on_as_if_it_had_not_stopped(&small("refil", &short));
}

#[test]
fn agents_with_a_memory_go_on_as_if_they_had_not_stopped() {
    let short = with(&["run.steps=2000", "run.final_episodes=0", "optimiser.learning_rate=0.001"]);
    goes_on_as_if_it_had_not_stopped(&small("refil", &short));
}

fn goes_on_as_if_it_had_not_stopped(run: &(&'static MethodEntry, Setup)) {
    let (whole, parted) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let mut session = begin(run, 3, 1, whole.path());
    session.run(&mut (), &AtomicBool::new(false)).unwrap();

    let stop = AtomicBool::new(false);
    let mut first = begin(run, 3, 1, parted.path());
    let mut watch = Watch { stop: Some((&stop, 1_100)), ..Watch::default() };
    assert_eq!(first.run(&mut watch, &stop).unwrap(), Outcome::Stopped);
    drop(first);
    let again = |folder: &Path| Session::resume(folder, |description| open(run.0, description, 2));
    let mut second = again(parted.path()).unwrap();
    // A round of whole episodes ends some time after the stop.
    assert!((1_100..2_000).contains(&second.env_steps()), "{}", second.env_steps());
    second.run(&mut (), &AtomicBool::new(false)).unwrap();
    assert!(weights(whole.path()) == weights(parted.path()), "other weights");
    assert_eq!(curve(&session), curve(&second));
    assert!(session.curve().iter().all(|point| point.loss > 0.0), "{:?}", session.curve());

    let other = tempfile::tempdir().unwrap();
    let mut other_seed = begin(run, 4, 1, other.path());
    other_seed.run(&mut (), &AtomicBool::new(false)).unwrap();
    assert!(weights(whole.path()) != weights(other.path()), "another seed gives the same weights");
}

#[test]
fn states_of_different_lengths_are_learned_from() {
    let whole_episodes = with(&["network.memory=0"]);
    for replay in [&[][..], &whole_episodes] {
        let folder = tempfile::tempdir().unwrap();
        let (entry, mut setup) = small("qmix", replay);
        setup.environment.name = "save-the-city".to_owned();
        setup.environment.set = "2-5a_2-5b".to_owned();
        for assignment in ["run.steps=1000", "run.final_episodes=8"] {
            setup = entry.set(&setup, assignment).unwrap();
        }
        let mut session = begin(&(entry, setup), 1, 1, folder.path());
        let mut watch = Watch::default();
        session.run(&mut watch, &AtomicBool::new(false)).unwrap();
        assert!(session.curve().iter().any(|point| point.loss > 0.0), "{:?}", session.curve());
        let failures = watch.result.expect("a result").evaluation.failures;
        assert!(failures.values().sum::<usize>() > 0, "{failures:?}");
    }
}

#[test]
fn a_run_ends_after_its_processor_seconds_and_its_learning_rate_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let (steps, time) = ("run.steps=1_000_000_000", "run.cpu_seconds=0.5");
    let run = small("vdn", &[steps, time, "run.final_episodes=0", "run.evaluate_every=1_000_000"]);
    let mut session = begin(&run, 1, 1, folder.path());
    assert_eq!(session.run(&mut (), &AtomicBool::new(false)).unwrap(), Outcome::Finished);
    let last = session.curve().last().unwrap();
    assert!(last.env_steps > 0 && last.learning_rate < 1e-4, "{last:?}");
    // Nothing is left to be done.
    drop(session);
    let again = Session::resume(folder.path(), |description| open(run.0, description, 1));
    let mut again = again.unwrap();
    let steps = again.env_steps();
    again.run(&mut (), &AtomicBool::new(false)).unwrap();
    assert_eq!(again.env_steps(), steps);
}

#[test]
fn what_was_learned_is_opened_and_taken_over() {
    let folder = tempfile::tempdir().unwrap();
    let run =
        small("vdn", &["run.steps=1000", "run.final_episodes=0", "optimiser.average_rate=0.1"]);
    let mut session = begin(&run, 5, 1, folder.path());
    session.run(&mut (), &AtomicBool::new(false)).unwrap();
    let description = session.description().clone();
    let measure = |method: &dyn Method| {
        play::evaluate(&*ring("group-matching/4x3x2"), &mut *method.team(), 50, 7).unwrap()
    };
    let (_, mut opened) = open(run.0, &description, 1).unwrap();
    assert_ne!(measure(&*opened), measure(session.method()));
    load_weights(folder.path(), &mut *opened).unwrap();
    assert_eq!(measure(&*opened), measure(session.method()));

    let from = format!("run.from={}", folder.path().display());
    let (again, next) = (tempfile::tempdir().unwrap(), small("vdn", &[&from, "run.steps=16"]));
    let taken = begin(&next, 6, 1, again.path());
    assert_eq!(measure(taken.method()), measure(session.method()));
    let wide = small("vdn", &["network.width=32"]);
    let (_, mut wide) = open(wide.0, &RunDescription::new(wide.1, 1, 1), 1).unwrap();
    let error = load_weights(folder.path(), &mut *wide).unwrap_err().to_string();
    assert!(error.contains("another size"), "{error}");
}

#[test]
fn the_deployed_policy_plays_as_the_team_that_learned() {
    let remembers = with(&["network.skip=true"]);
    for changes in [&["network.skip=true"][..], &["network.skip=false"], &remembers] {
        let (entry, setup) = small("refil", changes);
        let description = RunDescription::new(setup, 2, 1);
        let (ring, method) = open(entry, &description, 1).unwrap();
        let mut deployed = method.deployed().unwrap();
        let DeployedNetworks::Attention { network, memory } = &deployed.networks else {
            panic!("agents that attend")
        };
        assert_eq!(network.skip.is_some(), changes.contains(&"network.skip=true"));
        assert_eq!(memory.is_some(), changes.len() > 1);
        let mut policy = play::PolicyTeam::new(&mut *deployed.policy);
        let mine = play::evaluate(&*ring, &mut policy, 40, 3).unwrap();
        assert_eq!(mine, play::evaluate(&*ring, &mut *method.team(), 40, 3).unwrap());
    }
}

#[test]
fn what_cannot_work_is_refused_with_what_would() {
    let open_with = |method, assignments: &[&str]| {
        let (entry, setup) = small(method, assignments);
        open(entry, &RunDescription::new(setup, 1, 1), 1).map(drop).unwrap_err().to_string()
    };
    let error = open_with("qmix", &["network.width=48"]);
    assert!(error.contains("48") && error.contains("[16, 32, 64, 128]"), "{error}");
    let error = open_with("refil", &["replay.capacity=100"]);
    assert!(error.contains("replay.capacity") && error.contains("group-matching"), "{error}");
    let error = open_with("refil", &["network.memory=8"]);
    assert!(error.contains("`replay.unit=episodes`"), "{error}");
    let error = open_with("refil", &["replay.steps_per_update=0"]);
    assert!(error.contains("`replay.steps_per_update` is 0"), "{error}");
    let error = open_with("refil", &with(&["replay.batch=21"]));
    assert!(error.contains("20 episodes, an update draws 21"), "{error}");
    let entry = find("refil").unwrap();
    let setup = entry.preset("fast").unwrap();
    for (assignment, parts) in [
        ("replay.batsch=3", ["`replay.batsch`", "did you mean `replay.batch`?"]),
        ("imagination.share=2", ["`imagination.share`", "from 0 to 1"]),
        ("imagination.partitions=all", ["all", "drawn-companions"]),
    ] {
        let error = entry.set(&setup, assignment).unwrap_err().to_string();
        assert!(parts.iter().all(|part| error.contains(part)), "{error}");
    }
    let error = entry.preset("slow").unwrap_err().to_string();
    assert!(error.contains("`slow`") && error.contains("`fast`, `paper`"), "{error}");
}

#[test]
fn a_setup_reads_back_with_its_settings() {
    let (entry, setup) = small("qmix", &["environment.settings.noise=0.25"]);
    let text = entry.explained(&setup).unwrap();
    assert!(text.contains("noise = 0.25") && text.contains("# "), "{text}");
    assert_eq!(entry.read(&text).unwrap(), setup, "{text}");
    let file = RunDescription::new(setup, 3, 1);
    let written = file.to_toml().unwrap();
    assert_eq!(RunDescription::from_toml(&written).unwrap(), file, "{written}");
}
