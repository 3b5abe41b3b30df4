//! Ending with the process that started this one.

use std::os::fd::OwnedFd;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{PidfdFlags, getppid, pidfd_open};

use crate::error::Error;

/// A parent process with which this one is to end.
///
/// A death signal would come too early, with the first thread of the parent that dies: its locks
/// are held until the last one is dead, which is what the descriptor tells.
pub(super) struct Parent {
    process: OwnedFd,
}

impl Parent {
    /// Follows the parent `pid`, if there is one to follow.
    pub(super) fn follow(pid: Option<u32>) -> Result<Option<Self>, Error> {
        let Some(pid) = pid else { return Ok(None) };
        let parent = getppid().filter(|parent| parent.as_raw_pid().cast_unsigned() == pid);
        // A parent that is not ours any more has died already.
        let parent = parent.ok_or(Error::Interrupted)?;
        match pidfd_open(parent, PidfdFlags::empty()) {
            Ok(process) => Ok(Some(Self { process })),
            Err(_) => Err(Error::Interrupted),
        }
    }

    /// Fails once the parent is dead.
    pub(super) fn check(parent: &Option<Self>) -> Result<(), Error> {
        let Some(Self { process }) = parent else { return Ok(()) };
        let now = Timespec { tv_sec: 0, tv_nsec: 0 };
        match poll(&mut [PollFd::new(process, PollFlags::IN)], Some(&now)) {
            Ok(0) | Err(_) => Ok(()),
            Ok(_) => Err(Error::Interrupted),
        }
    }
}
