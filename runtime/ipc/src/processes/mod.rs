//! The roles as processes: locks, link, loop, goodbye.

mod allocator;
mod children;
mod grouping;
mod runner;
mod world;

pub(crate) use allocator::into_error as into_allocator_error;
pub(crate) use world::into_error as into_world_error;

use std::time::Duration;

use rustix::process::{Pid, Signal, getppid, set_parent_process_death_signal};
use sortie_core::link::{Bell, Clock};
use sortie_core::roles::Poll;

pub use allocator::allocator_process;
pub use children::Children;
pub use grouping::group_agents;
pub use runner::runner_process;
pub use world::{WorldSettings, world_process};

use crate::error::Error;
use crate::iox::Housekeeping;
use crate::stop::Stop;

/// Longest wait for a bell, so that signals and missed wake-ups are noticed.
const HEARTBEAT_NS: u64 = 100_000_000;
/// Longest wait of runners and the allocator for a world.
const WORLD_PATIENCE: Duration = Duration::from_secs(10);

/// What a runner or allocator process is started with, beside its contract.
#[derive(Clone, Copy, Debug, Default)]
pub struct ProcessSettings {
    /// First 16 bytes of the model's id.
    pub model: [u8; 16],
    /// Most entities that the model takes; `None` = any.
    pub entities_max: Option<usize>,
    /// Most subtasks that the model takes; `None` = any.
    pub tasks_max: Option<usize>,
    /// Process id of the parent with which this process is to end: the kernel sends SIGHUP when it
    /// dies, which [`Stop::on_signals`] understands.
    pub parent: Option<u32>,
}

impl ProcessSettings {
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

    /// Has the kernel end this process when its parent dies.
    fn end_with_parent(&self) -> Result<(), Error> {
        let Some(parent) = self.parent else { return Ok(()) };
        set_parent_process_death_signal(Some(Signal::HUP))
            .map_err(|error| Error::io("follow", "the parent process")(error.into()))?;
        // A parent that died before the call above sends nothing.
        let alive =
            getppid().map(Pid::as_raw_nonzero).is_some_and(|pid| pid.get() as u32 == parent);
        if alive { Ok(()) } else { Err(Error::Interrupted) }
    }
}

/// Polls a role and waits for its bell, until it ends or is stopped.
fn drive<L: Bell + Clock + Housekeeping>(
    link: &mut L,
    stop: &Stop,
    mut poll: impl FnMut(&mut L) -> Result<Poll, Error>,
    mut each_heartbeat: impl FnMut() -> Result<(), Error>,
) -> Result<(), Error> {
    let mut kept_house_ns = link.now_ns();
    loop {
        let token = link.token();
        let polled = poll(link);
        // What fails while a signal ends the whole group is the signal's doing.
        if stop.is_set() {
            return Err(Error::Interrupted);
        }
        let until_ns = match polled? {
            Poll::Again => continue,
            Poll::Ended => return Ok(()),
            Poll::Wait { until_ns } => until_ns,
        };
        let now = link.now_ns();
        if now.saturating_sub(kept_house_ns) >= HEARTBEAT_NS {
            link.housekeep();
            each_heartbeat()?;
            kept_house_ns = now;
        }
        link.wait_until(token, until_ns.min(now.saturating_add(HEARTBEAT_NS)));
    }
}
