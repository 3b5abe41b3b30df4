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
pub(super) struct Caretaker {
    is_over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Caretaker {
    /// Starts to look after `domain`.
    pub(super) fn start(domain: &Domain) -> Result<Self, Error> {
        let mut caretaker = Self { is_over: Arc::default(), threads: Vec::new() };
        let (swept, cleaned) = (domain.clone(), domain.clone());
        let mut unfinished = BTreeSet::new();
        caretaker.repeat("sweeper", move || unfinished = sweep(&swept, &unfinished))?;
        // The library waits without end for an object without size; the sweeper frees it then.
        let mut cleaner = None;
        caretaker.repeat("cleaner", move || {
            if cleaner.is_none() {
                cleaner = Cleaner::open(&cleaned).ok();
            }
            if let Some(cleaner) = &mut cleaner {
                cleaner.clean_up();
            }
        })?;
        Ok(caretaker)
    }

    fn repeat(&mut self, name: &str, mut work: impl FnMut() + Send + 'static) -> Result<(), Error> {
        let is_over = Arc::clone(&self.is_over);
        let body = move || {
            while !is_over.load(Ordering::SeqCst) {
                work();
                thread::park_timeout(PAUSE);
            }
        };
        let builder = thread::Builder::new().name(name.to_string());
        self.threads.push(builder.spawn(body).map_err(Error::io("start", name))?);
        Ok(())
    }
}

impl Drop for Caretaker {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::SeqCst);
        // The cleaner first: the sweeper may have to free it.
        while let Some(thread) = self.threads.pop() {
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
    use super::*;

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
