//! Time of its own for the thread of a role: a core, a priority above all ordinary work, memory that stays.

use std::io;

use rustix::mm::{MlockAllFlags, mlockall};
use rustix::thread::{CpuSet, sched_setaffinity};

use crate::error::Error;

/// What the thread of a role asks the system for; by default nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RealTime {
    /// Priority from 1 to 99 under the policy `SCHED_FIFO`: it runs until it waits, before everything of a
    /// lower one. Its memory is kept from being swapped out. `None` = the default scheduler.
    pub priority: Option<u8>,
    /// The core that it stays on; `None` = any.
    pub core: Option<usize>,
}

impl RealTime {
    /// Claims it for the calling thread. Threads and processes that this one starts later are ordinary ones, on
    /// the same core.
    ///
    /// # Errors
    /// [`Error::RealTime`]: the user may not, or there is no such core.
    pub fn claim(&self) -> Result<(), Error> {
        if let Some(core) = self.core {
            pin(core).map_err(refused(format!("core {core}"), "name one that this machine has"))?;
        }
        if let Some(priority) = self.priority {
            let memory = mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE);
            memory.map_err(|error| refused("locked memory", "raise `ulimit -l`")(error.into()))?;
            schedule(priority)
                .map_err(refused(format!("real-time priority {priority}"), "raise `ulimit -r`"))?;
        }
        Ok(())
    }
}

fn pin(core: usize) -> io::Result<()> {
    let mut cores = CpuSet::new();
    if core >= CpuSet::MAX_CPU {
        return Err(io::ErrorKind::InvalidInput.into());
    }
    cores.set(core);
    Ok(sched_setaffinity(None, &cores)?)
}

#[allow(unsafe_code)]
fn schedule(priority: u8) -> io::Result<()> {
    let parameters = libc::sched_param { sched_priority: priority.into() };
    let policy = libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK;
    // SAFETY: the pointer is to a value that lives until the call returns; the call keeps nothing of it.
    match unsafe { libc::sched_setscheduler(0, policy, &raw const parameters) } {
        0 => Ok(()),
        _ => Err(io::Error::last_os_error()),
    }
}

fn refused(what: impl Into<String>, advice: &'static str) -> impl FnOnce(io::Error) -> Error {
    let what = what.into();
    move |source| Error::RealTime { what, advice, source }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_machine_does_not_have_is_refused_by_name() {
        for core in [CpuSet::MAX_CPU - 1, CpuSet::MAX_CPU] {
            let refused = RealTime { core: Some(core), priority: None }.claim().unwrap_err();
            let told = refused.to_string();
            assert!(told.starts_with(&format!("core {core} is refused")), "{told}");
            assert_eq!(refused.exit_code(), 77);
        }
        let refused = RealTime { core: None, priority: Some(100) }.claim().unwrap_err();
        assert_eq!(refused.exit_code(), 77, "{refused}");
    }
}
