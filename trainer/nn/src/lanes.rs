//! Work in a fixed number of lanes, whatever the number of threads.

use std::sync::{Mutex, PoisonError};
use std::thread;

/// Runs `work` once for every lane, with its number, on so many threads, the calling one included.
///
/// What a lane computes depends on its number only, so that results are the same for any number of
/// threads. Panics if `work` does.
pub fn in_lanes<L: Send>(threads: usize, lanes: &mut [L], work: impl Fn(usize, &mut L) + Sync) {
    let rest = Mutex::new(lanes.iter_mut().enumerate());
    let next = || rest.lock().unwrap_or_else(PoisonError::into_inner).next();
    let run = || {
        while let Some((index, lane)) = next() {
            work(index, lane);
        }
    };
    thread::scope(|scope| {
        (1..threads).for_each(|_| drop(scope.spawn(run)));
        run();
    });
}
