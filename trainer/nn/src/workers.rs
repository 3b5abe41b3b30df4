//! Threads that do one job together, again and again.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::{self, JoinHandle};

use crate::layers::products::Products;

type Job = Arc<dyn Fn() + Send + Sync>;

/// A fixed number of threads; the calling thread is one of them.
///
/// The job itself divides the work, for instance by drawing piece numbers from an atomic counter.
pub struct Workers {
    job: Job,
    helpers: Vec<Helper>,
}

struct Helper {
    start: Option<SyncSender<Products>>,
    done: Receiver<()>,
    thread: Option<JoinHandle<()>>,
}

impl Workers {
    /// Starts `threads - 1` helpers that wait for work.
    pub fn new(threads: usize, job: Job) -> Self {
        let helper = |_| {
            let (start, started) = sync_channel::<Products>(1);
            let (finish, done) = sync_channel::<()>(1);
            let job = Arc::clone(&job);
            let thread = thread::spawn(move || {
                while let Ok(products) = started.recv() {
                    products.use_here();
                    job();
                    if finish.send(()).is_err() {
                        break;
                    }
                }
            });
            Helper { start: Some(start), done, thread: Some(thread) }
        };
        let helpers = (1..threads).map(helper).collect();
        Self { job, helpers }
    }

    /// Runs the job once on every thread and returns when all have finished.
    ///
    /// Products are those of the calling thread. Panics if the job panicked on a helper.
    pub fn run(&self) {
        for helper in &self.helpers {
            let started = helper.start.as_ref().map(|start| start.send(Products::here()));
            assert!(started == Some(Ok(())), "a worker thread panicked");
        }
        (self.job)();
        for helper in &self.helpers {
            assert!(helper.done.recv().is_ok(), "a worker thread panicked");
        }
    }
}

impl std::fmt::Debug for Workers {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Workers({} threads)", self.helpers.len() + 1)
    }
}

impl Drop for Workers {
    fn drop(&mut self) {
        for helper in &mut self.helpers {
            helper.start = None;
            // A panic of the helper has been reported by `run`.
            let _ = helper.thread.take().map(JoinHandle::join);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    #[test]
    fn every_thread_runs_the_job_each_time() {
        Products::Plain.use_here();
        let count = Arc::new(AtomicUsize::new(0));
        let shared = Arc::clone(&count);
        let workers = Workers::new(
            3,
            Arc::new(move || {
                assert_eq!(Products::here(), Products::Plain);
                shared.fetch_add(1, Ordering::Relaxed);
            }),
        );
        workers.run();
        workers.run();
        assert_eq!(count.load(Ordering::Relaxed), 6);
    }

    #[test]
    #[should_panic(expected = "a worker thread panicked")]
    fn a_panic_on_a_helper_reaches_the_caller() {
        let caller = thread::current().id();
        let workers = Workers::new(
            2,
            Arc::new(move || {
                assert_eq!(thread::current().id(), caller, "only the caller survives");
            }),
        );
        workers.run();
    }
}
