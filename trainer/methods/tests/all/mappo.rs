//! Runs of MAPPO and IPPO: they learn, go on as if they had never stopped, and play as they are deployed.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use sortie_learn::Now;
use sortie_learn::draft::{MethodRun, draft_method};
use sortie_learn::export::DeployedNetworks;
use sortie_learn::play;
use sortie_learn::run::{CurvePoint, Observer};
use sortie_learn::session::{Opening, Session, Setup};
use sortie_methods::find;

use crate::sessions::{begin, environment_of, resume, with};

/// A short run, with some values replaced.
fn setup(method: &str, environment: &str, assignments: &[&str]) -> Setup {
    let mut setup = find(method).unwrap().preset("fast").unwrap();
    let (name, set) = environment.split_once('/').unwrap();
    (setup.environment.name, setup.environment.set) = (name.to_owned(), set.to_owned());
    let small = [
        "network.width=16",
        "environment.instances=8",
        "rollout.steps=32",
        "run.evaluate_every=1000",
        "run.evaluate_episodes=20",
        "run.final_episodes=0",
    ];
    with(&with(&setup, &small), assignments)
}

const VECTORS: &str = "environment.settings.vectors=true";

/// Stops a run after so many steps.
struct Stopping<'a>(&'a AtomicBool, u64);

impl Observer for Stopping<'_> {
    fn progress(&mut self, progress: Now) {
        self.0.store(progress.env_steps >= self.1, Ordering::Relaxed);
    }
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
fn a_small_ring_is_learned() {
    for method in ["mappo", "ippo"] {
        let quick = ["run.steps=30000", "optimiser.learning_rate=0.005"];
        let setup = setup(method, "group-matching/4x3x2", &quick);
        let folder = tempfile::tempdir().unwrap();
        let mut session = begin(setup.clone(), 1, 2, folder.path()).unwrap();
        session.run(&mut (), &AtomicBool::new(false)).unwrap();
        let ring = environment_of(&setup).unwrap();
        let found = play::evaluate(&*ring, &mut *session.method().team(), 500, 1).unwrap();
        assert!(found.success > 0.9, "{method}: {found:?}");
    }
}

/// In the midst of a rollout, with other threads.
#[test]
fn a_stopped_and_resumed_run_ends_as_one_that_never_stopped() {
    for (method, vectors) in [("mappo", false), ("ippo", false), ("mappo", true)] {
        let words = ["run.steps=2000", if vectors { VECTORS } else { "run.evaluate_episodes=20" }];
        let setup = setup(method, "smax/2s3z", &words);
        let [whole, parted, other] = [0, 1, 2].map(|_| tempfile::tempdir().unwrap());
        let mut session = begin(setup.clone(), 3, 1, whole.path()).unwrap();
        session.run(&mut (), &AtomicBool::new(false)).unwrap();
        let stop = AtomicBool::new(false);
        let mut first = begin(setup.clone(), 3, 2, parted.path()).unwrap();
        first.run(&mut Stopping(&stop, 1100), &stop).unwrap();
        assert!((1100..1200).contains(&first.env_steps()), "{}", first.env_steps());
        drop(first);
        let mut second = resume(parted.path(), Some(1)).unwrap();
        second.run(&mut (), &AtomicBool::new(false)).unwrap();
        assert!(weights(whole.path()) == weights(parted.path()), "other weights: {method}");
        assert_eq!(curve(&session), curve(&second));
        assert!(session.curve().iter().all(|point| point.loss != 0.0), "{:?}", session.curve());
        let mut session = begin(setup, 4, 1, other.path()).unwrap();
        session.run(&mut (), &AtomicBool::new(false)).unwrap();
        assert!(weights(whole.path()) != weights(other.path()), "another seed, the same weights");
    }
}

#[test]
fn the_deployed_policy_plays_as_the_team_that_learned() {
    let pairs = "environment.settings.pairs=true";
    for (method, said) in [("mappo", VECTORS), ("mappo", pairs), ("ippo", "network.width=20")] {
        let setup = setup(method, "smax/2s3z", &[said, "run.steps=8000"]);
        let folder = tempfile::tempdir().unwrap();
        let mut session = begin(setup.clone(), 2, 2, folder.path()).unwrap();
        session.run(&mut (), &AtomicBool::new(false)).unwrap();
        let (world, method) = (environment_of(&setup).unwrap(), session.method());
        let mut deployed = method.deployed().unwrap();
        let is_own_row = matches!(deployed.networks, DeployedNetworks::OwnRow(_));
        assert_eq!(is_own_row, said == VECTORS);
        let mut policy = play::PolicyTeam::new(&mut *deployed.policy);
        let mine = play::evaluate(&*world, &mut policy, 40, 3).unwrap();
        assert_eq!(mine, play::evaluate(&*world, &mut *method.team(), 40, 3).unwrap(), "{said}");
        assert!(mine.return_mean > 0.0, "{mine:?}");
        let (description, curve) = (session.description(), session.curve());
        let run = MethodRun { description, environment: &*world, method, curve };
        let place = folder.path().join("bundle");
        let draft = draft_method(&run, folder.path(), &[world.spec().shape], &[], 1).unwrap();
        let bundle = draft.write(&place).unwrap();
        assert!(!bundle.golden().cases.is_empty() && place.join("agent.onnx").is_file());
    }
}

#[test]
fn what_cannot_work_is_refused_with_what_would() {
    let refused = |environment: &str, assignments: &[&str]| {
        let setup = setup("mappo", environment, assignments);
        let world = environment_of(&setup).unwrap();
        let opening = Opening { setup: &setup, environment: &*world, seed: 1, threads: 1 };
        find("mappo").unwrap().method(&opening).map(drop).unwrap_err().to_string()
    };
    let error = refused("smax/2s3z", &["network.width=18"]);
    assert!(error.contains("18") && error.contains("multiple of 4"), "{error}");
    let error = refused("crafting/iron", &[]);
    assert!(error.contains("shows a picture"), "{error}");
    let error = refused("particle/rover-tower-2", &[]);
    assert!(error.contains("share one policy"), "{error}");
}
