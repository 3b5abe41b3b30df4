//! Runs of an allocator alone: they learn, go on as if they had never stopped, and choose among symmetries.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use sortie_learn::Now;
use sortie_learn::play;
use sortie_learn::run::Observer;
use sortie_learn::session::{Opening, Setup};
use sortie_learn::subtasks::{Allocate, AllocatedTeam, RuleAllocator, ScriptedAgents};
use sortie_methods::find;

use crate::sessions::{begin, environment_of, resume, with};

/// A short run, with some values replaced.
fn setup(environment: &str, assignments: &[&str]) -> Setup {
    let mut setup = find("allocator").unwrap().preset("fast").unwrap();
    let (name, set) = environment.split_once('/').unwrap();
    (setup.environment.name, setup.environment.set) = (name.to_owned(), set.to_owned());
    let small = [
        "network.width=16",
        "network.layers=1",
        "environment.instances=64",
        "run.evaluate_every=2000",
        "run.evaluate_episodes=20",
        "run.final_episodes=0",
    ];
    with(&with(&setup, &small), assignments)
}

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

/// What tells that it does: no rule is as good, and nobody who is sent out and back for each customer either.
#[test]
fn routes_of_a_few_customers_are_learned() {
    let setup =
        setup("routing/4-sequential", &["run.steps=150000", "optimiser.learning_rate=0.003"]);
    let folder = tempfile::tempdir().unwrap();
    let mut session = begin(setup.clone(), 1, 2, folder.path()).unwrap();
    session.run(&mut (), &AtomicBool::new(false)).unwrap();
    let world = environment_of(&setup).unwrap();
    let measured = |allocator: Box<dyn Allocate + '_>| {
        let mut team = AllocatedTeam::new(Box::new(ScriptedAgents::new(1)), allocator, 1);
        play::evaluate(&*world, &mut team, 500, 1).unwrap().metrics["over_optimum"]
    };
    let learned = || session.method().subtasks().unwrap().allocator.unwrap().allocate;
    let [nearest, greedy] =
        ["nearest", "greedy"].map(|rule| measured(Box::new(RuleAllocator(rule))));
    let mut chooses = learned();
    assert!(chooses.choose_among(Some(8), world.spec()));
    let [single, chosen] = [measured(learned()), measured(chooses)];
    assert!(single < 0.99 * nearest && nearest < greedy, "{single} {nearest} {greedy}");
    assert!((1.0..single).contains(&chosen), "{chosen} {single}");
    // The team that a run is measured by is the same.
    let team = play::evaluate(&*world, &mut *session.method().team(), 500, 1).unwrap();
    assert_eq!(team.metrics["over_optimum"], single);
}

#[test]
fn a_stopped_and_resumed_run_ends_as_one_that_never_stopped() {
    let setup = setup("routing/5-15", &["run.steps=6000"]);
    let [whole, parted, other] = [0, 1, 2].map(|_| tempfile::tempdir().unwrap());
    begin(setup.clone(), 3, 1, whole.path())
        .unwrap()
        .run(&mut (), &AtomicBool::new(false))
        .unwrap();
    let stop = AtomicBool::new(false);
    let mut first = begin(setup.clone(), 3, 2, parted.path()).unwrap();
    first.run(&mut Stopping(&stop, 3000), &stop).unwrap();
    assert!((3000..5000).contains(&first.env_steps()), "{}", first.env_steps());
    drop(first);
    resume(parted.path(), Some(1)).unwrap().run(&mut (), &AtomicBool::new(false)).unwrap();
    assert!(weights(whole.path()) == weights(parted.path()), "other weights");
    begin(setup, 4, 1, other.path()).unwrap().run(&mut (), &AtomicBool::new(false)).unwrap();
    assert!(weights(whole.path()) != weights(other.path()), "another seed, the same weights");
}

/// One vehicle has nobody to look at; in environments whose subtasks change nothing is known of them.
#[test]
fn what_cannot_work_is_refused_with_what_would_and_one_agent_can() {
    let refused = |environment: &str, assignments: &[&str]| {
        let setup = setup(environment, assignments);
        let world = environment_of(&setup).unwrap();
        let opening = Opening { setup: &setup, environment: &*world, seed: 1, threads: 1 };
        find("allocator").unwrap().method(&opening).map(drop).unwrap_err().to_string()
    };
    let error = refused("routing/5-15", &["network.width=18"]);
    assert!(error.contains("`network.width`") && error.contains("multiple of 4"), "{error}");
    let error = refused("routing/5-15", &["environment.instances=12"]);
    assert!(error.contains("multiple of `baseline.samples`"), "{error}");
    let error = refused("save-the-city/2-5a_2-5b", &[]);
    assert!(error.contains("stays as it is"), "{error}");
    let error = refused("group-matching/4x3x2", &[]);
    assert!(error.contains("no"), "{error}");
    let alone =
        ["environment.settings.vehicles=1", "environment.settings.capacity=60", "run.steps=2000"];
    let folder = tempfile::tempdir().unwrap();
    let mut session = begin(setup("routing/5", &alone), 1, 1, folder.path()).unwrap();
    session.run(&mut (), &AtomicBool::new(false)).unwrap();
    assert!(session.env_steps() >= 2000);
}
