//! Frees what dead processes left in shared memory, on a thread of its own: what it meets there may block.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;
use std::{fs, thread};

use crate::domain::Domain;
use crate::error::Error;
use crate::iox::Cleaner;

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
    use std::sync::atomic::AtomicU32;
    use std::sync::mpsc;

    use super::*;

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
        let object = |name: &str| PathBuf::from(format!("/dev/shm/{}{name}", domain.prefix()));
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
