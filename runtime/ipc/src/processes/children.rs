//! The processes that a world started.

use std::process::{Child, Command};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, PidfdFlags, Signal, kill_process, pidfd_open};

use crate::error::Error;

/// Runner and allocator processes. None outlives this value.
#[derive(Debug, Default)]
pub struct Children {
    children: Vec<(String, Child)>,
}

impl Children {
    /// Starts a process; `name` is what errors call it.
    ///
    /// # Errors
    /// It could not be started.
    pub fn spawn(&mut self, name: impl Into<String>, command: &mut Command) -> Result<(), Error> {
        let name = name.into();
        match command.spawn() {
            Ok(child) => {
                self.children.push((name, child));
                Ok(())
            }
            Err(source) => Err(Error::Spawn { name, source }),
        }
    }

    /// Number of processes started.
    pub fn len(&self) -> usize {
        self.children.len()
    }

    /// Whether none was started.
    pub fn is_empty(&self) -> bool {
        self.children.is_empty()
    }

    /// Looks for a process that failed.
    ///
    /// # Errors
    /// [`Error::Child`] for the first that did.
    pub fn check(&mut self) -> Result<(), Error> {
        for (name, child) in &mut self.children {
            if let Ok(Some(status)) = child.try_wait()
                && !status.success()
            {
                return Err(Error::Child { name: name.clone(), status });
            }
        }
        Ok(())
    }

    /// Asks all to end. One that has not joined yet would wait for a world in vain.
    pub fn terminate(&mut self) {
        for (_, child) in &mut self.children {
            // One that is not reaped keeps its id, even if it ends just now.
            if matches!(child.try_wait(), Ok(None)) {
                let _ = kill_process(Pid::from_child(child), Signal::TERM);
            }
        }
    }

    /// Waits for all to end, and kills those that take longer than `patience`.
    pub fn finish(&mut self, patience: Duration) {
        let until = Instant::now() + patience;
        for (_, child) in &mut self.children {
            if !ended_until(child, until) {
                // It may have ended just now; either way it is reaped below.
                let _ = child.kill();
            }
            let _ = child.wait();
        }
    }
}

impl Drop for Children {
    fn drop(&mut self) {
        self.finish(Duration::ZERO);
    }
}

/// Waits until `child` has ended, or until the time; returns whether it has.
fn ended_until(child: &mut Child, until: Instant) -> bool {
    if matches!(child.try_wait(), Ok(Some(_))) {
        return true;
    }
    let Ok(descriptor) = pidfd_open(Pid::from_child(child), PidfdFlags::empty()) else {
        return false;
    };
    let left = until.saturating_duration_since(Instant::now());
    let Ok(timeout) = Timespec::try_from(left) else { return false };
    let _ = poll(&mut [PollFd::new(&descriptor, PollFlags::IN)], Some(&timeout));
    matches!(child.try_wait(), Ok(Some(_)))
}

#[cfg(test)]
mod tests {
    use std::os::unix::process::ExitStatusExt;

    use super::*;

    #[test]
    fn who_has_not_joined_ends_when_told() {
        let mut children = Children::default();
        children.spawn("a sleeper", Command::new("sleep").arg("100")).unwrap();
        children.terminate();
        let status = loop {
            if let Err(Error::Child { status, .. }) = children.check() {
                break status;
            }
            std::thread::yield_now();
        };
        assert_eq!(status.signal(), Some(Signal::TERM.as_raw()));
    }
}
