//! The processes that a world started: which agents share one, and how each ends with its parent; and what frees what dead
//! processes left in shared memory.

use std::collections::BTreeSet;
use std::fs;
use std::os::fd::OwnedFd;
use std::path::PathBuf;
use std::process::{Child, Command};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, PidfdFlags, Signal, getppid, kill_process, pidfd_open};

use crate::domain::Domain;
use crate::error::Error;
use crate::iox::Cleaner;

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

/// Deals agents to runners: one fewer than the cores, so that the world has one for itself, at
/// least one and at most one per agent. `isolate` gives each agent its own process.
pub fn group_agents(agents: usize, cores: usize, isolate: bool) -> Vec<Vec<u16>> {
    let most = agents.max(1);
    let runners = if isolate { most } else { cores.saturating_sub(1).clamp(1, most) };
    let mut groups = vec![Vec::new(); runners];
    // The limit of agents fits 16 bits.
    for (agent, runner) in (0..agents as u16).zip((0..runners).cycle()) {
        groups[runner].push(agent);
    }
    groups
}

/// Pause between two looks. Whoever creates an object gives it a size within microseconds.
const PAUSE: Duration = Duration::from_millis(250);

/// Looks after a domain until it is dropped.
pub(crate) struct Caretaker {
    // In this order: the library waits without end for an object without size, and the sweeper frees it then.
    _cleaner: Repeated,
    _sweeper: Repeated,
}

impl Caretaker {
    /// Starts to look after `domain`.
    pub(crate) fn start(domain: &Domain) -> Result<Self, Error> {
        let (swept, cleaned) = (domain.clone(), domain.clone());
        let mut unfinished = BTreeSet::new();
        let mut cleaner = None;
        Self::of(
            move || {
                if cleaner.is_none() {
                    cleaner = Cleaner::open(&cleaned).ok();
                }
                if let Some(cleaner) = &mut cleaner {
                    cleaner.clean_up();
                }
            },
            move || unfinished = sweep(&swept, &unfinished),
        )
    }

    fn of(
        clean: impl FnMut() + Send + 'static,
        sweep: impl FnMut() + Send + 'static,
    ) -> Result<Self, Error> {
        let sweeper = Repeated::start("sweeper", sweep)?;
        Ok(Self { _cleaner: Repeated::start("cleaner", clean)?, _sweeper: sweeper })
    }
}

/// Work that a thread does again and again until this value is dropped, which waits for its end.
struct Repeated {
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Repeated {
    fn start(name: &str, mut work: impl FnMut() + Send + 'static) -> Result<Self, Error> {
        let is_over = Arc::new(AtomicBool::new(false));
        let seen = Arc::clone(&is_over);
        let body = move || {
            while !seen.load(Ordering::SeqCst) {
                work();
                thread::park_timeout(PAUSE);
            }
        };
        let builder = thread::Builder::new().name(name.to_string());
        let thread = builder.spawn(body).map_err(Error::io("start", name))?;
        Ok(Self { is_over, thread: Some(thread) })
    }
}

impl Drop for Repeated {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::SeqCst);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            let _ = thread.join();
        }
    }
}

/// Removes the objects that had no size at the look before either: whoever was creating them is dead, and
/// whoever opens one would wait without end. Returns those of this look.
fn sweep(domain: &Domain, before: &BTreeSet<PathBuf>) -> BTreeSet<PathBuf> {
    let is_empty = |path: &PathBuf| path.metadata().is_ok_and(|object| object.len() == 0);
    let objects = domain.shared_memory().unwrap_or_default();
    let unfinished: BTreeSet<PathBuf> = objects.into_iter().filter(is_empty).collect();
    for object in unfinished.intersection(before) {
        // It may be gone just now; else the next look finds it again.
        let _ = fs::remove_file(object);
    }
    unfinished
}

#[cfg(test)]
mod tests {
    use std::os::unix::process::ExitStatusExt;
    use std::sync::atomic::AtomicU32;
    use std::sync::mpsc;

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

    #[test]
    fn leaves_a_core_to_the_world() {
        assert_eq!(group_agents(5, 2, false), [[0, 1, 2, 3, 4]]);
        assert_eq!(group_agents(5, 3, false), [vec![0, 2, 4], vec![1, 3]]);
        assert_eq!(group_agents(2, 16, false), [[0], [1]]);
        assert_eq!(group_agents(3, 1, false), [[0, 1, 2]]);
        assert_eq!(group_agents(3, 1, true), [[0], [1], [2]]);
    }

    /// The library's wait for an object without size ends only once the sweeper has removed it, at its second look.
    #[test]
    fn a_cleaner_that_needs_the_sweeper_does_not_keep_the_world_from_ending() {
        let looks = Arc::new(AtomicU32::new(0));
        let (swept, (begun, begins)) = (Arc::clone(&looks), mpsc::channel());
        let clean = move || {
            let seen = looks.load(Ordering::SeqCst);
            let _ = begun.send(());
            while looks.load(Ordering::SeqCst) < seen + 2 {
                thread::yield_now();
            }
        };
        let sweep = move || {
            swept.fetch_add(1, Ordering::SeqCst);
        };
        let caretaker = Caretaker::of(clean, sweep).unwrap();
        begins.recv().unwrap();
        let (ended, ends) = mpsc::channel();
        // A thread that hangs cannot be ended: it is left behind.
        thread::spawn(move || {
            drop(caretaker);
            let _ = ended.send(());
        });
        assert_eq!(ends.recv_timeout(Duration::from_secs(30)), Ok(()), "the caretaker hangs");
    }

    #[test]
    fn what_stays_without_size_is_removed_at_the_second_look() {
        let domain = Domain::new(&format!("sweep-{}", std::process::id())).unwrap();
        let object = |name: &str| PathBuf::from(format!("/dev/shm/{}{name}", domain.prefix));
        let (dead, alive) = (object("dead"), object("alive"));
        fs::write(&dead, []).unwrap();
        fs::write(&alive, [1]).unwrap();
        let first = sweep(&domain, &BTreeSet::new());
        assert_eq!(first, BTreeSet::from([dead.clone()]));
        assert!(dead.exists());
        sweep(&domain, &first);
        assert!(!dead.exists() && alive.exists());
        fs::remove_file(alive).unwrap();
    }
}
