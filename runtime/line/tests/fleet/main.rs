//! The fleet in one process: world, runners and allocators over a simulated link, runners on other hosts over simulated lines, by
//! seed.
//!
//! Processes are killed in the middle of their work, stopped, sent away and started again; messages
//! are lost, late, doubled and damaged; time jumps. An oracle that sees everything holds the roles to
//! the invariants of `oracle.rs`. The same seed always gives the same run.
//!
//! ```text
//! cargo test --release -p sortie-line --test fleet                              # some hundred seeds
//! SORTIE_FLEET_SEEDS=10000 cargo test --release -p sortie-line --test fleet    # more
//! SORTIE_FLEET_SEED=17 cargo test -p sortie-line --test fleet replay -- --nocapture   # one, with its trace
//! ```
#![allow(clippy::print_stdout, clippy::unwrap_used, missing_docs, reason = "helpers of tests")]

mod air;
mod crossing;
mod decision_log;
mod hosts;
mod link;
mod network;
mod oracle;
mod planted;
mod process;
mod random;
mod scheduler;
mod setup;
mod toy;

use std::panic::{AssertUnwindSafe, catch_unwind};

use oracle::{Coverage, Invariant};
use planted::Planted;
use scheduler::{Outcome, run};
use setup::Setup;

/// Seeds of an ordinary run of the tests.
const SEEDS: u64 = 300;
/// Lines of the trace before a violation.
const TRACE_LINES: usize = 60;

fn number_of(variable: &str) -> Option<u64> {
    let value = std::env::var(variable).ok()?;
    Some(value.parse().unwrap_or_else(|_| panic!("{variable}={value} is not a number")))
}

/// Runs one seed; explains what went wrong, if something did.
fn try_seed(seed: u64, planted: Option<Planted>) -> Result<Coverage, (Option<Invariant>, String)> {
    let outcome = catch_unwind(AssertUnwindSafe(|| run(Setup::new(seed, planted), false)));
    match outcome {
        Ok(Outcome { violation: None, coverage, .. }) => Ok(coverage),
        Ok(Outcome { violation: Some(violation), .. }) => {
            let detail = format!(
                "{:?} at {} ns: {}",
                violation.invariant, violation.now_ns, violation.detail
            );
            Err((Some(violation.invariant), detail))
        }
        Err(_) => Err((None, "a role, or the simulation, panicked".to_string())),
    }
}

fn command(seed: u64) -> String {
    format!("SORTIE_FLEET_SEED={seed} cargo test -p sortie-line --test fleet replay -- --nocapture")
}

#[test]
fn every_seed_keeps_the_invariants() {
    let seeds = number_of("SORTIE_FLEET_SEEDS").unwrap_or(SEEDS);
    let threads = std::thread::available_parallelism().map_or(1, |threads| threads.get() as u64);
    let coverage = std::thread::scope(|scope| {
        let of_thread = |first: u64| {
            let mut coverage = Coverage::default();
            for seed in (first..seeds).step_by(threads as usize) {
                match try_seed(seed, None) {
                    Ok(one) => coverage.add(&one),
                    Err((_, detail)) => panic!("seed {seed}: {detail}\nreplay: {}", command(seed)),
                }
            }
            coverage
        };
        let started: Vec<_> =
            (0..threads).map(|first| scope.spawn(move || of_thread(first))).collect();
        started.into_iter().fold(Coverage::default(), |mut all, one| {
            all.add(&one.join().expect("a seed failed; see above"));
            all
        })
    });
    println!("{seeds} seeds: {coverage:?}");
    if seeds >= SEEDS {
        assert!(coverage.reaches_everything(seeds), "storms that reach nothing: {coverage:?}");
    }
}

#[test]
fn replay() {
    let seed = number_of("SORTIE_FLEET_SEED").unwrap_or(1);
    let Outcome { violation, trace, coverage } = run(Setup::new(seed, None), true);
    for line in &trace[trace.len().saturating_sub(TRACE_LINES)..] {
        println!("{line}");
    }
    println!("{:?}\n{coverage:?}", Setup::new(seed, None));
    assert!(violation.is_none(), "{violation:?}");
}

#[test]
fn a_seed_is_a_run() {
    for seed in [3, 4] {
        let [one, other] = [(); 2].map(|()| run(Setup::new(seed, None), true));
        assert!(one.trace.len() > 1_000);
        assert!(one.trace == other.trace, "seed {seed} gives two different runs");
    }
}

/// Finds the planted bug within so many seeds; tells by which invariant.
fn find(planted: Planted, seeds: u64) -> (u64, Invariant) {
    let found = (0..seeds).find_map(|seed| match try_seed(seed, Some(planted)) {
        Err((Some(invariant), _)) => Some((seed, invariant)),
        _ => None,
    });
    let found = found.unwrap_or_else(|| panic!("{planted:?} is not found in {seeds} seeds"));
    println!("{planted:?} is found by seed {}: {:?}", found.0, found.1);
    found
}

#[test]
fn an_old_term_that_is_accepted_is_found() {
    assert_eq!(find(Planted::OldTermAccepted, 100).1, Invariant::NoOldTerm);
}

#[test]
fn two_who_stand_in_for_the_same_agents_are_found() {
    assert_eq!(find(Planted::TwoSeats, 20).1, Invariant::OneSeat);
}

#[test]
fn an_answer_that_is_passed_on_twice_is_found() {
    assert_eq!(find(Planted::AnswerRestamped, 20).1, Invariant::NothingOld);
}

#[test]
fn a_cut_that_is_not_told_is_found() {
    assert_eq!(find(Planted::CutUnsaid, 20).1, Invariant::SaysSo);
}

#[test]
fn a_wake_up_before_its_data_is_found() {
    assert_eq!(find(Planted::WakeUpBeforeData, 20).1, Invariant::WokenAfterData);
}

#[test]
fn the_allocation_of_an_agent_that_has_gone_is_found() {
    assert_eq!(find(Planted::DeadAgentKept, 20).1, Invariant::Feasible);
}
