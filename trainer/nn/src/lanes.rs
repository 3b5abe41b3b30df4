//! Work in a fixed number of lanes, whatever the number of threads.

use std::sync::{Mutex, PoisonError};
use std::thread;

use crate::layers::products::Products;

/// Runs `work` once for every lane, with its number, on so many threads, the calling one included.
///
/// What a lane computes depends on its number only, so that results are the same for any number of
/// threads; products are those of the calling thread. Panics if `work` does.
pub fn in_lanes<L: Send>(threads: usize, lanes: &mut [L], work: impl Fn(usize, &mut L) + Sync) {
    if threads <= 1 {
        // A scope of threads allocates, even where none is spawned.
        lanes.iter_mut().enumerate().for_each(|(index, lane)| work(index, lane));
        return;
    }
    let rest = Mutex::new(lanes.iter_mut().enumerate());
    let next = || rest.lock().unwrap_or_else(PoisonError::into_inner).next();
    let run = || {
        while let Some((index, lane)) = next() {
            work(index, lane);
        }
    };
    let products = Products::here();
    let help = || {
        products.use_here();
        run();
    };
    thread::scope(|scope| {
        (1..threads).for_each(|_| drop(scope.spawn(help)));
        run();
    });
}

#[cfg(test)]
mod tests {
    use std::sync::Barrier;

    use super::*;

    #[test]
    fn every_lane_is_worked_on_once_with_the_products_of_the_caller() {
        Products::Plain.use_here();
        let mut lanes = [(0, Products::Avx2); 9];
        // No thread takes a second lane before every other has taken one.
        let together = Barrier::new(3);
        in_lanes(3, &mut lanes, |index, lane| {
            together.wait();
            *lane = (lane.0 + index, Products::here());
        });
        assert_eq!(lanes, std::array::from_fn(|index| (index, Products::Plain)));
    }
}
