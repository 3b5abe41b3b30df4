//! Runs of HAL and of what it is compared with: they learn what leads to milestones, repeat themselves, and go on as if they had never
//! stopped.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use sortie_envs::Split;
use sortie_learn::Now;
use sortie_learn::play::{self, PolicyTeam};
use sortie_learn::run::Observer;
use sortie_learn::session::{Opening, Setup, load_weights};
use sortie_methods::find;
use sortie_methods::hal::{Hal, MaskCounts, MeasuredConfig};

use crate::sessions::{begin, environment_of, resume, with};

/// Iron by two milestones, small networks.
fn small(method: &str, assignments: &[&str]) -> Setup {
    let mut setup = find(method).unwrap().preset("fast").unwrap();
    setup.environment.name = "crafting".to_owned();
    setup.environment.set = "iron".to_owned();
    let small = [
        "environment.instances=16",
        "network.width=16",
        "replay.batch=32",
        "replay.steps_per_update=32",
        "exploration.first=800",
        "optimiser.average_rate=0.01",
        "run.final_episodes=0",
        "run.evaluate_every=100000",
        "run.evaluate_episodes=1",
    ];
    let options = [
        "affordances.batch=8",
        "affordances.triplets=8",
        "affordances.population=20",
        "meta.batch=16",
    ];
    let options = if method == "dqn" { &[][..] } else { &options };
    with(&with(&with(&setup, &small), options), assignments)
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

/// The published learner, of a smaller picture and smaller networks, for a few hundred updates.
fn published(method: &str, assignments: &[&str]) -> Setup {
    let mut setup = find(method).unwrap().preset("paper").unwrap();
    setup.environment.name = "crafting".to_owned();
    setup.environment.set = "iron".to_owned();
    let small = [
        "network.crop=7",
        "network.width=16",
        "returns.target_every=100",
        "replay.capacity=1600",
        "replay.batch=8",
        "replay.steps_per_update=8",
        "exploration.first=800",
        "run.steps=4000",
        "run.final_episodes=0",
        "run.evaluate_every=100000",
        "run.evaluate_episodes=1",
    ];
    let options = [
        "network.embedding=8",
        "affordances.kept=300",
        "affordances.population=20",
        "meta.batch=8",
        "meta.first=40",
        "meta.kept=60",
        "exploration.start=1000",
    ];
    let options = if method == "dqn" { &[][..] } else { &options };
    with(&with(&with(&setup, &small), options), assignments)
}

#[test]
fn a_stopped_and_resumed_run_ends_as_one_that_never_stopped() {
    for setup in [
        small("hal", &["run.steps=6000", "affordances.kept=300"]),
        small("hal-oracle", &["run.steps=6000", "replay.capacity=3000"]),
        small("h-dqn", &["run.steps=6000", "returns.relabel=false", "network.crop=11"]),
        published("hal", &[]),
        published("hal-oracle", &["meta.every=2"]),
        published("h-dqn", &["returns.relabel=false"]),
        small("dqn", &["run.steps=6000", "replay.capacity=3000"]),
        published("dqn", &["returns.milestones=false"]),
    ] {
        let [whole, parted] = [0, 1].map(|_| tempfile::tempdir().unwrap());
        let mut session = begin(setup.clone(), 3, 1, whole.path()).unwrap();
        session.run(&mut (), &AtomicBool::new(false)).unwrap();
        let stop = AtomicBool::new(false);
        let mut session = begin(setup.clone(), 3, 2, parted.path()).unwrap();
        session.run(&mut Stopping(&stop, 2100), &stop).unwrap();
        drop(session);
        assert!(!parted.path().join("result.json").exists());
        let mut session = resume(parted.path(), Some(1)).unwrap();
        session.run(&mut (), &AtomicBool::new(false)).unwrap();
        assert!(weights(whole.path()) == weights(parted.path()), "{}", setup.method);
    }
}

#[test]
fn a_short_run_reaches_more_milestones_than_none_and_is_read_back_as_it_was() {
    let chances = ["measured.varied=false", "measured.actions=0.05", "measured.goals=0.05"];
    for (method, chances) in [("hal", &chances[..]), ("dqn", &chances[..2])] {
        let more = [
            "environment.instances=64",
            "environment.settings.limit=300",
            "network.width=32",
            "replay.batch=128",
            "run.steps=40000",
        ];
        let setup = with(&small(method, &more), chances);
        let folder = tempfile::tempdir().unwrap();
        let mut session = begin(setup.clone(), 1, 1, folder.path()).unwrap();
        session.run(&mut (), &AtomicBool::new(false)).unwrap();
        let world = environment_of(&setup).unwrap();
        let learned = play::evaluate(&*world, &mut *session.method().team(), 40, 1).unwrap();
        let opening = Opening { setup: &setup, environment: &*world, seed: 1, threads: 1 };
        let mut method = find(method).unwrap().method(&opening).unwrap();
        let fresh = play::evaluate(&*world, &mut *method.team(), 40, 1).unwrap();
        let milestones = [fresh, learned.clone()].map(|found| found.metrics["milestones"]);
        assert!(milestones[1] > milestones[0] + 1.0, "{} {milestones:?}", setup.method);

        load_weights(folder.path(), &mut *method).unwrap();
        let again = play::evaluate(&*world, &mut *method.team(), 40, 1).unwrap();
        assert_eq!(again, learned);
    }
}

#[test]
fn the_deployed_agent_acts_as_the_measured_one_over_whole_episodes() {
    let more = [
        "environment.instances=64",
        "environment.settings.limit=300",
        "replay.batch=128",
        "run.steps=40000",
        "measured.actions=0",
        "measured.goals=0",
    ];
    let setup = small("hal", &more);
    let folder = tempfile::tempdir().unwrap();
    let mut session = begin(setup.clone(), 2, 1, folder.path()).unwrap();
    session.run(&mut (), &AtomicBool::new(false)).unwrap();
    let world = environment_of(&setup).unwrap();
    let measured = play::evaluate(&*world, &mut *session.method().team(), 60, 1).unwrap();
    let deployed = session.method().deployed().unwrap();
    let mut team = PolicyTeam::new(deployed.policy);
    let found = play::evaluate(&*world, &mut team, 60, 1).unwrap();
    assert!(measured.metrics["milestones"] > 1.0, "{measured:?}");
    assert_eq!(found, measured);

    for (setup, words) in [
        (small("hal-oracle", &[]), "those of `hal`"),
        (small("h-dqn", &[]), "those of `hal`"),
        (published("hal", &[]), "those of `network.body=layers`"),
        (small("dqn", &[]), "evaluated only"),
    ] {
        let opening = Opening { setup: &setup, environment: &*world, seed: 1, threads: 1 };
        let method = find(&setup.method).unwrap().method(&opening).unwrap();
        let refused = method.deployed().err().unwrap().to_string();
        assert!(refused.contains(words), "{refused}");
    }
}

#[test]
fn what_it_cannot_learn_in_or_by_is_refused() {
    let world = sortie_envs::open("particle/navigation-3", Split::Train, 1, &Default::default());
    let refusal = |setup: &Setup, world: &dyn sortie_envs::Environment| {
        let opening = Opening { setup, environment: world, seed: 1, threads: 1 };
        find("hal").unwrap().method(&opening).err().unwrap().to_string()
    };
    let narrow = with(&published("hal", &[]), &["network.crop=5"]);
    let setup = small("hal", &[]);
    assert!(refusal(&setup, &*world.unwrap()).contains("its agent sees a picture"));
    let world = environment_of(&setup).unwrap();
    assert!(refusal(&narrow, &*world).contains("`network.crop` to at least 7"));
    for (assignment, words) in [
        ("network.width=12", "must be a multiple of 8"),
        ("network.embedding=12", "must be a multiple of 8"),
        (
            "network.body=convolution",
            "set `network.nearest=false` and `network.crop` to at least 7",
        ),
        ("network.crop=13", "the picture has no such middle"),
        ("network.crop=4", "the picture has no such middle"),
        ("replay.capacity=1000", "leaves 62 steps for each instance"),
    ] {
        let error = refusal(&with(&setup, &[assignment]), &*world);
        assert!(error.contains(words), "{error}");
    }
}

#[test]
fn what_the_published_learner_learned_is_read_back_as_it_was() {
    let short = ["environment.settings.limit=300", "run.steps=3000"];
    let setup = published("hal", &short);
    let folder = tempfile::tempdir().unwrap();
    let mut session = begin(setup.clone(), 1, 1, folder.path()).unwrap();
    session.run(&mut (), &AtomicBool::new(false)).unwrap();
    let world = environment_of(&setup).unwrap();
    let learned = play::evaluate(&*world, &mut *session.method().team(), 20, 1).unwrap();
    let opening = Opening { setup: &setup, environment: &*world, seed: 2, threads: 1 };
    let mut method = find("hal").unwrap().method(&opening).unwrap();
    let fresh = play::evaluate(&*world, &mut *method.team(), 20, 1).unwrap();
    load_weights(folder.path(), &mut *method).unwrap();
    let again = play::evaluate(&*world, &mut *method.team(), 20, 1).unwrap();
    assert_eq!(again, learned);
    assert_ne!(again, fresh);
}

/// What a mask says is counted where goals are chosen: the truth errs nowhere, no mask lets everything through.
#[test]
fn masks_are_held_against_the_truth_where_goals_are_chosen() {
    for (method, lets_through) in [("hal-oracle", false), ("h-dqn", true)] {
        let setup = small(method, &["environment.settings.limit=300"]);
        let world = environment_of(&setup).unwrap();
        let opening = Opening { setup: &setup, environment: &*world, seed: 1, threads: 1 };
        let hal = Hal::new(setup.own().unwrap(), &opening).unwrap();
        let mut team = hal.measured(MeasuredConfig::default());
        let measured = play::evaluate(&*world, &mut team, 5, 3).unwrap();
        let sum = |count: fn(&MaskCounts) -> u64| team.masks.iter().map(count).sum::<u64>();
        let choices = team.masks[0].afforded + team.masks[0].others;
        assert!(choices >= 5 && (choices as f64) < 5.0 * measured.length_mean / 2.0, "{choices}");
        assert!(team.masks.iter().all(|it| it.afforded + it.others == choices));
        assert!(sum(|it| it.afforded) > 0 && sum(|it| it.others) > 0);
        assert_eq!(sum(|it| it.over_pruned), 0, "{method}");
        let wanted = if lets_through { sum(|it| it.others) } else { 0 };
        assert_eq!(sum(|it| it.under_pruned), wanted, "{method}");
    }
}
