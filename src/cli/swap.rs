//! `sortie control swap`: another bundle for a running team, at one tick for all, with a way back.

use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::{Duration, Instant};

use clap::{Args, ValueEnum};
use serde::Serialize;
use sortie_bundle::Bundle;
use sortie_core::wire::{ControlStatus, Role, SwapMoment, TurnBack};
use sortie_ipc::{Answer, Domain, ProcessInfo, Readiness, Stop, Swap, model_text};

use crate::allocation::AllocatorChoice;
use crate::allocator::{DeployedAllocator, ProposalArguments};
use crate::deployment::{beside, bundle_name, is_bundle_name, model_id, open_bundle};
use crate::failure::{Exit, Failure, Outcome};
use crate::listener::Listener;
use crate::output::{print_json, say};
use crate::policy::{Backend, DeployedPolicy};
use crate::quantities::time;
use crate::remake::{Shadowed, shadow_team};
use crate::terminal::stop_on_signals;

/// How long processes may take to open a bundle, whose plans are compiled before.
const OPENING: Duration = Duration::from_secs(30);
/// Pause between two looks at them.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// A share of fewer actions says nothing.
const LEAST_ACTIONS: u64 = 100;

#[derive(Clone, Debug, Args)]
pub(crate) struct SwapArguments {
    /// Folder of the bundle, beside that of the bundle in use: processes are told its name only
    bundle: PathBuf,
    /// Let it decide beside the team for so long first, 30s or 5min, without acting, and tell how often it does the same
    #[arg(long, value_name = "TIME", value_parser = time)]
    shadow: Option<u64>,
    /// The tick from which on it acts
    #[arg(long, value_enum, default_value_t)]
    at: At,
    /// Turn back when this happens: fallbacks, late, disagreement=SHARE. A disagreement in the shadow keeps the change from
    /// being made
    #[arg(long, value_name = "CAUSES", value_delimiter = ',')]
    back_if: Vec<Cause>,
    /// For how long after the change that holds
    #[arg(long, value_name = "TIME", value_parser = time, default_value = "30s", requires = "back_if")]
    watch: u64,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
enum At {
    /// The next
    #[default]
    NextTick,
    /// The first of the next episode
    NextEpisode,
}

/// What makes a team turn back.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Cause {
    /// A policy has refused an observation.
    Fallbacks,
    /// An answer was late, or did not come.
    Late,
    /// The other bundle would have done otherwise in a larger share of actions.
    Disagreement(f64),
}

impl FromStr for Cause {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let share = |text: &str| text.parse().ok().filter(|share| (0.0..1.0).contains(share));
        let disagreement = text.strip_prefix("disagreement=").map(share);
        match (text, disagreement) {
            ("fallbacks", _) => Ok(Self::Fallbacks),
            ("late", _) => Ok(Self::Late),
            (_, Some(Some(share))) => Ok(Self::Disagreement(share)),
            (_, Some(None)) => Err("a share is from 0 to 1: disagreement=0.2".to_owned()),
            _ => Err("one of fallbacks, late, disagreement=SHARE is wanted".to_owned()),
        }
    }
}

impl SwapArguments {
    /// The plain form: at the next tick, without shadow or watch.
    pub(crate) fn plain(bundle: PathBuf) -> Self {
        Self { bundle, shadow: None, at: At::NextTick, back_if: Vec::new(), watch: 0 }
    }

    fn turn_back(&self) -> TurnBack {
        TurnBack {
            on_fallback: self.back_if.contains(&Cause::Fallbacks),
            on_late: self.back_if.contains(&Cause::Late),
        }
    }

    /// The largest share of actions that may be otherwise.
    fn most_otherwise(&self) -> Option<f64> {
        self.back_if.iter().find_map(|cause| match cause {
            Cause::Disagreement(share) => Some(*share),
            _ => None,
        })
    }
}

/// What came of it, for scripts.
#[derive(Serialize)]
struct Swapped<'a> {
    domain: &'a str,
    bundle: &'a str,
    generation: u16,
    turned_back: bool,
    processes: Vec<SwappedProcess>,
    shadow: Option<Shadowed>,
}

#[derive(Serialize)]
struct SwappedProcess {
    role: &'static str,
    pid: u32,
    outcome: &'static str,
    model: String,
}

pub(crate) fn run(arguments: &SwapArguments, domain: &Domain, json: bool) -> Outcome {
    let stop = stop_on_signals()?;
    let bundle = open_bundle(&arguments.bundle)?;
    let name = prepare(&bundle)?;
    let swap = Swap::begin(domain, &name, model_id(&bundle))?.map_err(|told| refused(&told))?;
    await_ready(&swap, &stop)?;
    let shadow =
        arguments.shadow.map(|span| shadow(&swap, domain, &bundle, span, &stop)).transpose()?;
    if let Some(shadow) = &shadow {
        if !json {
            shadow.print_table();
        }
        if arguments.most_otherwise().is_some_and(|most| shadow.disagreement() > most) {
            let share = 100.0 * shadow.disagreement();
            let message =
                format!("`{name}` does {share:.1} % otherwise: the team keeps what it has");
            return Err(Failure::difference(message));
        }
    }
    let before = before(arguments, domain)?;
    let ticks = watched_ticks(domain, arguments.watch)?;
    let changed = swap.change(moment(arguments.at), arguments.turn_back(), ticks)?;
    changed.map_err(|told| refused(&told))?;
    let processes = await_change(&swap, &bundle, &stop)?;
    let cause = match arguments.back_if.is_empty() {
        true => None,
        false => watch(arguments, before, &swap, domain, &stop)?,
    };
    if json {
        let processes = processes.iter().map(SwappedProcess::new).collect();
        let (domain, bundle, turned_back) = (domain.id(), swap.name(), cause.is_some());
        let generation = swap.next_generation();
        print_json(&Swapped { domain, bundle, generation, turned_back, processes, shadow });
    } else {
        for process in &processes {
            say!("{} {}, model {:.8}", process.role.name(), process.pid, model_text(process.model));
        }
    }
    let back = |cause: &str| Failure::difference(format!("the team has turned back: {cause}"));
    cause.map_or(Ok(()), |cause| Err(back(cause)))
}

fn moment(at: At) -> SwapMoment {
    match at {
        At::NextTick => SwapMoment::NextTick,
        At::NextEpisode => SwapMoment::NextEpisode,
    }
}

/// The name of a bundle for those who are to open it, once it can be opened fast: compiled here, not by processes that
/// others wait for.
fn prepare(bundle: &Bundle) -> Result<String, Failure> {
    DeployedPolicy::open(bundle, Backend::Plan)?;
    if bundle.has_allocator() {
        let (choice, proposals) = (AllocatorChoice::Learned, ProposalArguments::default());
        DeployedAllocator::open(bundle, choice, Backend::Plan, 0, proposals)?;
    }
    bundle_name(bundle.folder()).ok_or_else(|| {
        let message = "the bundle's folder needs a name of up to 32 letters, digits, `.`, `_`, `-`";
        Failure::new(Exit::Usage, message)
    })
}

/// Why processes did not do as they were told.
fn refused(told: &[Answer]) -> Failure {
    let refusal = told.iter().find_map(|answer| {
        let status = answer.status.filter(|status| *status != ControlStatus::Done)?;
        Some((answer.process, status))
    });
    match refusal {
        Some((process, status)) => refused_by(&process, status),
        None => Failure::new(Exit::NotRunning, "no process that could do it has answered"),
    }
}

fn refused_by(process: &ProcessInfo, status: ControlStatus) -> Failure {
    let who = format!("{} {}", process.role.name(), process.pid);
    let (exit, why) = match status {
        ControlStatus::Foreign => (Exit::Mismatch, "contract or sizes do not fit its own"),
        ControlStatus::BadArgument => {
            (Exit::Missing, "there is none of this name beside its own, or it cannot be read")
        }
        ControlStatus::Outdated => (Exit::Busy, "another change has come before this one"),
        _ => (Exit::NotRunning, "it can change to no other bundle"),
    };
    Failure::new(exit, format!("the team keeps what it has: {who}: {why}"))
}

fn interrupted() -> Failure {
    Failure::new(Exit::Interrupted, "interrupted: the team keeps what it has")
}

/// Waits until all who decide have opened the bundle.
fn await_ready(swap: &Swap, stop: &Stop) -> Outcome {
    let begun = Instant::now();
    loop {
        match swap.readiness()? {
            Readiness::Ready => return Ok(()),
            Readiness::Refused(by) => {
                let first = by.first().map(|(process, status)| refused_by(process, *status));
                return Err(first.unwrap_or_else(interrupted));
            }
            Readiness::Opening if begun.elapsed() > OPENING => {
                let message =
                    "not all processes have opened it in time: the team keeps what it has";
                return Err(Failure::new(Exit::NotRunning, message));
            }
            Readiness::Opening if stop.is_set() => return Err(interrupted()),
            Readiness::Opening => std::thread::sleep(LOOK_EVERY),
        }
    }
}

/// Has a bundle decide beside the team for so many nanoseconds.
fn shadow(
    swap: &Swap,
    domain: &Domain,
    bundle: &Bundle,
    span: u64,
    stop: &Stop,
) -> Result<Shadowed, Failure> {
    let (begun, span) = (Instant::now(), Duration::from_nanos(span));
    let mut goes_on = |_, _| begun.elapsed() < span && !stop.is_set();
    let shadow = decide_beside(swap, domain, bundle, &mut goes_on)?;
    if stop.is_set() { Err(interrupted()) } else { Ok(shadow) }
}

fn decide_beside(
    swap: &Swap,
    domain: &Domain,
    bundle: &Bundle,
    goes_on: &mut dyn FnMut(u64, u64) -> bool,
) -> Result<Shadowed, Failure> {
    let processes = swap.processes()?;
    let mut listener = Listener::enter(domain, "shadow")?;
    let draws = (1, ProposalArguments::default());
    shadow_team(&mut listener, &processes, bundle, draws, goes_on)
}

/// A team that is held to no rate is taken for one of a thousand ticks a second.
fn watched_ticks(domain: &Domain, watch_ns: u64) -> Result<u32, Failure> {
    const MILLISECOND: u64 = 1_000_000;
    let period_ns = domain.facts()?.map_or(0, |facts| facts.period_ns());
    let period_ns = if period_ns == 0 { MILLISECOND } else { period_ns };
    Ok(u32::try_from(watch_ns.div_ceil(period_ns)).unwrap_or(u32::MAX))
}

/// Waits until all decide by the bundle. Returns who does.
fn await_change(swap: &Swap, bundle: &Bundle, stop: &Stop) -> Result<Vec<ProcessInfo>, Failure> {
    loop {
        let mut processes = swap.processes()?;
        // It may have turned back already, or stand still: then it changes with the tick after.
        let world = processes.iter().find(|process| process.role == Role::World);
        let after = swap.next_generation().wrapping_add(1);
        let is_over = world.is_some_and(|world| world.generation == after || world.is_paused);
        let decides = |process: &ProcessInfo| process.role != Role::World && !process.serves;
        processes.retain(decides);
        if is_over || processes.iter().all(|process| process.model == model_id(bundle)) {
            return Ok(processes);
        }
        if stop.is_set() {
            let message = "interrupted: the change is made, or is due with the next episode";
            return Err(Failure::new(Exit::Interrupted, message));
        }
        std::thread::sleep(LOOK_EVERY);
    }
}

/// The bundle in use, where it is to be asked after the change, and what it may find otherwise.
fn before(arguments: &SwapArguments, domain: &Domain) -> Result<Option<(Bundle, f64)>, Failure> {
    let Some(most) = arguments.most_otherwise() else { return Ok(None) };
    let facts = domain.facts()?;
    let name = facts.map(|facts| facts.bundles().in_use().name.clone()).unwrap_or_default();
    if !is_bundle_name(&name) {
        let message = "a disagreement is found by the bundle in use, and its folder has no name to find it by";
        return Err(Failure::new(Exit::Usage, message));
    }
    Ok(Some((open_bundle(&folder_beside(&arguments.bundle, &name)?)?, most)))
}

/// Watches over the new bundle. Returns why the team has turned back, if it has.
fn watch(
    arguments: &SwapArguments,
    before: Option<(Bundle, f64)>,
    swap: &Swap,
    domain: &Domain,
    stop: &Stop,
) -> Result<Option<&'static str>, Failure> {
    let (begun, span) = (Instant::now(), Duration::from_nanos(arguments.watch));
    let is_over = || begun.elapsed() >= span;
    if let Some((before, most)) = before {
        let is_too_much =
            |same: u64, of: u64| of >= LEAST_ACTIONS && (of - same) as f64 > most * of as f64;
        let mut is_otherwise = false;
        let mut goes_on = |same, of| {
            is_otherwise = is_too_much(same, of);
            !is_otherwise && !is_over() && !stop.is_set()
        };
        decide_beside(swap, domain, &before, &mut goes_on)?;
        if is_otherwise && !has_turned_back(swap)? {
            swap.turn_back()?.map_err(|told| refused(&told))?;
            return Ok(Some("the bundle before would have done too much otherwise"));
        }
    }
    while !is_over() {
        if has_turned_back(swap)? {
            break;
        }
        if stop.is_set() {
            let message = "interrupted: the change is made, and this no longer watches over it";
            return Err(Failure::new(Exit::Interrupted, message));
        }
        std::thread::sleep(LOOK_EVERY);
    }
    Ok(has_turned_back(swap)?
        .then_some("a policy has refused an observation, or an answer was late"))
}

fn has_turned_back(swap: &Swap) -> Result<bool, Failure> {
    let processes = swap.processes()?;
    let world = processes.iter().find(|process| process.role == Role::World);
    Ok(world.is_some_and(|world| world.generation != swap.next_generation()))
}

fn folder_beside(bundle: &Path, name: &str) -> Result<PathBuf, Failure> {
    let folder = bundle.canonicalize().map_err(|error| Failure::file(bundle, &error))?;
    Ok(beside(&folder, name))
}

impl SwappedProcess {
    fn new(process: &ProcessInfo) -> Self {
        let (role, model) = (process.role.name(), model_text(process.model));
        Self { role, pid: process.pid, outcome: "done", model }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn causes_are_read_by_name() {
        assert_eq!("fallbacks".parse(), Ok(Cause::Fallbacks));
        assert_eq!("late".parse(), Ok(Cause::Late));
        assert_eq!("disagreement=0.2".parse(), Ok(Cause::Disagreement(0.2)));
        for (text, words) in
            [("disagreement=2", "from 0 to 1"), ("disagreement", "one of"), ("", "one of")]
        {
            let refused = text.parse::<Cause>().expect_err("it is none");
            assert!(refused.contains(words), "{text}: {refused}");
        }
    }

    #[test]
    fn who_refuses_is_named_and_the_exit_code_says_why() {
        let told = |status| refused_by(&process(), status);
        let exits = [ControlStatus::Foreign, ControlStatus::BadArgument, ControlStatus::Outdated]
            .map(|status| told(status).exit);
        assert_eq!(exits, [Exit::Mismatch, Exit::Missing, Exit::Busy]);
        assert!(told(ControlStatus::Foreign).message.contains("runner 7"));
        assert_eq!(refused(&[]).exit, Exit::NotRunning);
    }

    fn process() -> ProcessInfo {
        "role=runner pid=7".parse().expect("a process")
    }
}
