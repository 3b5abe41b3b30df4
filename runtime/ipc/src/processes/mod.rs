//! The roles as processes: locks, link, loop, goodbye.

mod abandoned;
mod allocator;
mod bundles;
mod children;
mod models;
mod runner;
mod stand_in;
mod world;

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::time::Duration;

use sortie_core::link::{Bell, Clock, Wake};
use sortie_core::roles::{Counters, Identity, Poll};
use sortie_core::wire::{Command, ControlRep, ControlReq, ControlStatus};

use crate::domain::nanoseconds;
use crate::error::Error;
use crate::iox::{ControlRx, Housekeeping, set_log_level};
use crate::process_info::{BUILD, ProcessInfo};
use crate::real_time::RealTime;
use crate::stop::{Stop, Wakeable};

pub(crate) use allocator::into_error as into_allocator_error;
pub use allocator::{AllocatorProcess, SwappedAllocator, allocator_process};
pub(crate) use children::Caretaker;
pub use children::{Children, group_agents};
pub use models::{Loaded, LoadedModel, Registry};
pub use runner::{RunnerProcess, SwappedPolicy, runner_process, runner_process_with_heuristic};
pub use stand_in::{allocator_offer, stand_in_allocator_process, stand_in_process};
pub(crate) use world::into_error as into_world_error;
pub use world::{Fill, WorldSettings, world_process, world_process_with_fill};

/// Longest wait for a bell, so that signals and missed wake-ups are noticed.
pub(crate) const HEARTBEAT_NS: u64 = 100_000_000;
/// Longest wait for a signal that explains a failure.
const SIGNAL_PATIENCE: Duration = Duration::from_millis(100);
/// How long who stands in for another host looks for the world's end after a signal to all: that host would wait for the team.
const FAR_SIGNAL_PATIENCE: Duration = Duration::from_millis(500);
/// Longest wait of runners and the allocator for a world.
const WORLD_PATIENCE: Duration = Duration::from_secs(10);

/// How long waits linger: some times as long as a sleeper takes to run.
pub(crate) const LINGER: Duration = Duration::from_micros(100);

/// How long the waits of a world or runner linger, if nobody says. A team that is paced has time, and what it needs
/// most is never to be late.
fn linger(stated: Option<Duration>, is_paced: bool) -> Duration {
    stated.unwrap_or(if is_paced { Duration::ZERO } else { LINGER })
}

/// What a runner or allocator process is started with, beside its contract.
#[derive(Clone, Copy, Debug, Default)]
pub struct ProcessSettings {
    /// First 16 bytes of the model's id.
    pub model: [u8; 16],
    /// Whether an engine runs the model's graph: it allocates, and promises nothing about bits or time.
    pub is_graph: bool,
    /// Most entities that the model takes; `None` = any.
    pub entities_max: Option<usize>,
    /// Most subtasks that the model takes; `None` = any.
    pub tasks_max: Option<usize>,
    /// Whether a runner gets its agent's private frames, see [`WorldSettings::private`].
    pub private: bool,
    /// Process id of the parent with which this process is to end.
    pub parent: Option<u32>,
    /// How long it lives on without a world; `None` = a minute.
    pub world_patience: Option<Duration>,
    /// How long a runner's waits linger before they sleep; with doorbells only. `None` = 100 us, or not at all where
    /// the world has a period.
    pub linger: Option<Duration>,
    /// What the role's thread asks the system for.
    pub real_time: RealTime,
}

impl ProcessSettings {
    /// Who the process of port `name` is.
    fn identity(&self, name: &str) -> Identity {
        Identity {
            model: self.model,
            is_graph: self.is_graph,
            build: BUILD,
            ..Identity::new(std::process::id(), name)
        }
    }

    fn check_limits(&self, shape: sortie_core::Shape) -> Result<(), Error> {
        let limits = [
            ("entities", shape.entities, self.entities_max),
            ("subtasks", shape.tasks, self.tasks_max),
        ];
        for (what, got, max) in limits {
            if let Some(max) = max.filter(|&max| got > max) {
                return Err(Error::Limits { what, got, max });
            }
        }
        Ok(())
    }
}

/// A role with all that it works with, as the loop around it sees it.
trait Process: Controlled {
    type Link: Bell + Clock + ControlRx + Housekeeping + Wakeable;

    fn poll(&mut self, link: &mut Self::Link) -> Result<Poll, Error>;

    /// Whether it leaves the loop.
    fn leaves_loop(&self) -> bool {
        false
    }

    /// How long it looks for the world's end after a signal, which may be here first.
    fn signal_patience(&self) -> Duration {
        Duration::ZERO
    }

    /// Looks at the processes that it depends on, once per heartbeat.
    fn look_around(&mut self) -> Result<(), Error>;
}

/// Polls a role and waits for its bell, until it ends or is stopped.
fn drive<P: Process>(process: &mut P, link: &mut P::Link, stop: &Stop) -> Result<(), Error> {
    stop.wakes(link.waker());
    let ended = run(process, link, stop);
    if ended.is_err() && !stop.is_set() {
        // A signal to the whole group may reach others first, and this process last.
        std::thread::sleep(SIGNAL_PATIENCE);
    }
    // What fails while a signal ends the whole group is the signal's doing.
    if ended.is_err() && stop.is_set() { Err(Error::Interrupted) } else { ended }
}

fn run<P: Process>(process: &mut P, link: &mut P::Link, stop: &Stop) -> Result<(), Error> {
    let switches = ContextSwitches::of_this_thread();
    let mut kept_house_ns = link.now_ns();
    // The bell's state after a heartbeat that nobody ended.
    let mut unrung = None;
    let mut stopped_ns = None;
    loop {
        let token = link.token();
        // Before a signal is looked at: what came sooner, the world's end above all, is taken in.
        let polled = process.poll(link)?;
        if polled != Poll::Ended && stop.is_set() {
            let stopped_ns = *stopped_ns.get_or_insert_with(|| link.now_ns());
            let patience_ns = nanoseconds(process.signal_patience());
            if link.now_ns().saturating_sub(stopped_ns) >= patience_ns {
                return Err(Error::Interrupted);
            }
        }
        // Somebody did not ring, or was not heard.
        let is_missed = unrung.take() == Some(token) && polled != Poll::Wait { until_ns: u64::MAX };
        process.counters_mut().missed_wake_ups += u64::from(is_missed);
        let now = link.now_ns();
        let is_due = now.saturating_sub(kept_house_ns) >= HEARTBEAT_NS;
        let until_ns = match polled {
            Poll::Ended => return Ok(()),
            Poll::Again => continue,
            // Looks once more where nothing is to be answered, for what waits until then.
            Poll::Answered if is_due => continue,
            Poll::Answered => u64::MAX,
            Poll::Wait { until_ns } => {
                if link.answer_requests(&mut |request| answer(process, request)) {
                    if process.leaves_loop() {
                        return Ok(());
                    }
                    continue;
                }
                until_ns
            }
        };
        if is_due {
            link.housekeep();
            process.look_around()?;
            process.counters_mut().context_switches = switches.count().unwrap_or(0);
            kept_house_ns = now;
        }
        let heartbeat_ns = now.saturating_add(HEARTBEAT_NS);
        let woken = link.wait_until(token, until_ns.min(heartbeat_ns));
        // A role that waits for a time has something to do then without any ring.
        if woken == Wake::Timeout && until_ns == u64::MAX {
            process.counters_mut().bell_timeouts += 1;
            unrung = Some(token);
        }
    }
}

/// A process that can be told what to do.
pub(crate) trait Controlled {
    /// Hash of the domain's contract and shape.
    fn schema(&self) -> u64;

    /// The newest tick that it knows.
    fn tick(&self) -> u64;

    fn info(&self) -> ProcessInfo;

    fn counters_mut(&mut self) -> &mut Counters;

    /// Obeys a command of its role, which `request` is.
    fn obey(&mut self, command: Command, request: &ControlReq) -> ControlStatus;
}

/// Obeys a request, if it is this process that is meant.
pub(crate) fn answer(process: &mut impl Controlled, request: &ControlReq) -> ControlRep {
    let status = status(process, request);
    let answer = request.answer(process.schema(), status, process.tick());
    answer.with_text(&process.info().to_string())
}

fn status(process: &mut impl Controlled, request: &ControlReq) -> ControlStatus {
    if !request.fits(process.schema()) {
        process.counters_mut().schema_rejects += 1;
        return ControlStatus::Foreign;
    }
    if request.arg != 0 && request.arg != std::process::id() {
        return ControlStatus::NotMine;
    }
    match Command::from_number(request.cmd) {
        None => ControlStatus::NotSupported,
        Some(Command::Info) => ControlStatus::Done,
        Some(Command::SetLogLevel) if set_log_level(request.arg64) => ControlStatus::Done,
        Some(Command::SetLogLevel) => ControlStatus::BadArgument,
        Some(command) => process.obey(command, request),
    }
}

/// Whether a role without a world of its own obeys a request to end.
fn is_named(request: &ControlReq) -> bool {
    request.arg == std::process::id() || request.arg64 == ControlReq::EVERYBODY
}

/// Where Linux tells it; other systems do not.
const THREAD_STATUS: &str = "/proc/thread-self/status";
const SWITCHES: &str = "nonvoluntary_ctxt_switches:";

/// The counter of the thread that opened it.
struct ContextSwitches(Option<File>);

impl ContextSwitches {
    fn of_this_thread() -> Self {
        Self(File::open(THREAD_STATUS).ok())
    }

    /// Involuntary switches so far, if the system tells.
    fn count(&self) -> Option<u64> {
        // The kernel's page; the line is the last one.
        let mut page = [0; 4096];
        let length = self.0.as_ref()?.read_at(&mut page, 0).ok()?;
        let text = std::str::from_utf8(page.get(..length)?).ok()?;
        let line = text.lines().find_map(|line| line.strip_prefix(SWITCHES))?;
        line.trim().parse().ok()
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn linux_tells() {
        assert!(ContextSwitches::of_this_thread().count().is_some());
    }
}
