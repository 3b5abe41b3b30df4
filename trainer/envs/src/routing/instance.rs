//! Instances, drawn bit for bit from their seeds.

use alloc::vec::Vec;

use serde::{Deserialize, Serialize};

/// Most customers.
pub const CUSTOMERS: usize = 100;
/// Largest demand of a customer.
const DEMAND: usize = 9;
/// Tries to pack demands before an instance counts as too hard to serve; up to 15 customers take fewer by far.
const TRIES: usize = 100_000;

/// A depot, customers, what each asks for, and what a vehicle holds. Places are points of the unit square; number 0 is the
/// depot, customers follow.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Instance {
    /// Places.
    pub places: Vec<[f64; 2]>,
    /// What each place asks for, the depot nothing.
    pub demands: Vec<u8>,
    /// What a vehicle holds.
    pub capacity: u8,
}

impl Instance {
    /// The one of a seed, and how many were drawn before it that so many vehicles could not serve in a single trip each.
    pub fn drawn(seed: u64, customers: usize, capacity: u8, vehicles: usize) -> (Self, usize) {
        let mut random = SplitMix(seed);
        let mut redraws = 0;
        loop {
            let places = (0..=customers).map(|_| [random.unit(), random.unit()]).collect();
            let mut demands = Vec::with_capacity(1 + customers);
            demands.push(0);
            demands.extend((0..customers).map(|_| 1 + random.below(DEMAND) as u8));
            if fits(&demands, capacity, vehicles) {
                return (Self { places, demands, capacity }, redraws);
            }
            redraws += 1;
        }
    }

    /// Number of customers.
    pub fn customers(&self) -> usize {
        self.places.len().saturating_sub(1)
    }

    /// How far two places are apart.
    pub fn distance(&self, from: usize, to: usize) -> f64 {
        distance(self.places[from], self.places[to])
    }

    /// Whether anybody could ask for this.
    pub(super) fn is_sound(&self) -> bool {
        let within = |place: &[f64; 2]| place.iter().all(|part| (0.0..=1.0).contains(part));
        let [at_depot, demands @ ..] = &self.demands[..] else { return false };
        self.places.len() == self.demands.len()
            && (1..=CUSTOMERS).contains(&demands.len())
            && self.places.iter().all(within)
            && *at_depot == 0
            && demands.iter().all(|demand| (1..=self.capacity).contains(demand))
    }
}

pub(super) fn distance([x, y]: [f64; 2], [to_x, to_y]: [f64; 2]) -> f64 {
    let (dx, dy) = (x - to_x, y - to_y);
    let square = dx * dx + dy * dy;
    // The processor's own instruction has the same bits, and does not wait for the upper halves of wide registers.
    #[cfg(feature = "std")]
    let root = square.sqrt();
    #[cfg(not(feature = "std"))]
    let root = libm::sqrt(square);
    root
}

/// Whether the demands can be packed into so many loads.
fn fits(demands: &[u8], capacity: u8, vehicles: usize) -> bool {
    let mut sorted: Vec<u8> = demands[1..].to_vec();
    sorted.sort_unstable_by(|one, other| other.cmp(one));
    let mut free = alloc::vec![capacity; vehicles];
    let mut tries = TRIES;
    pack(&sorted, &mut free, &mut tries)
}

/// Packs what is left, the largest first, into loads with so much room.
fn pack(left: &[u8], free: &mut [u8], tries: &mut usize) -> bool {
    let Some((demand, rest)) = left.split_first() else { return true };
    let room: usize = free.iter().map(|room| usize::from(*room)).sum();
    if *tries == 0 || left.iter().map(|demand| usize::from(*demand)).sum::<usize>() > room {
        return false;
    }
    *tries -= 1;
    for load in 0..free.len() {
        // Loads with the same room are one and the same.
        if free[load] < *demand || free[..load].contains(&free[load]) {
            continue;
        }
        free[load] -= demand;
        if pack(rest, free, tries) {
            return true;
        }
        free[load] += demand;
    }
    false
}

/// Steele, Lea and Flood's generator (2014), from which the recorded instances were drawn.
struct SplitMix(u64);

impl SplitMix {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ self.0 >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ mixed >> 31
    }

    fn unit(&mut self) -> f64 {
        const STEP: f64 = 1.0 / (1_u64 << 53) as f64;
        (self.next() >> 11) as f64 * STEP
    }

    fn below(&mut self, bound: usize) -> usize {
        (((self.next() >> 32) * bound as u64) >> 32) as usize
    }
}
