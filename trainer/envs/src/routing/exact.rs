//! The shortest routes, exactly: by the best trip through every set of customers (Held and Karp 1962), and the best split
//! of all customers into trips.

use alloc::vec;
use alloc::vec::Vec;

use super::instance::Instance;

/// Most customers of an instance that is solved: twice as many steps for each, and three times as many for each further trip.
const MOST: usize = 15;

/// The total length of the shortest routes of at most so many trips; none for more than 15 customers, or where so many trips
/// cannot serve them.
///
/// Takes 9 ms for 15 customers and four trips (one core of a Zen 4), a third of that for each customer fewer.
pub fn optimum(instance: &Instance, trips: usize) -> Option<f64> {
    let customers = instance.customers();
    if !(1..=MOST).contains(&customers) {
        return None;
    }
    let alone = single_trips(instance);
    // Who splits a set may say which part the lowest of all customers is in: sets of further trips are without it.
    let all = (1_usize << customers) - 1;
    let mut best = alone.clone();
    for _ in 2..trips {
        best = one_trip_more(&alone, &best, customers);
    }
    let rest = all & !1;
    let least = match trips {
        0 => f64::INFINITY,
        1 => alone[all],
        _ => subsets(rest)
            .map(|with| alone[with | 1] + best[rest & !with])
            .fold(f64::INFINITY, f64::min),
    };
    least.is_finite().then_some(least)
}

/// By sets of customers the shortest trip that serves them: infinite where a vehicle cannot hold what they ask for.
fn single_trips(instance: &Instance) -> Vec<f64> {
    let customers = instance.customers();
    let sets = 1_usize << customers;
    let distances: Vec<f64> = (0..=customers)
        .flat_map(|from| (0..=customers).map(move |to| (from, to)))
        .map(|(from, to)| instance.distance(from, to))
        .collect();
    let distance = |from: usize, to: usize| distances[from * (customers + 1) + to];
    // Of every set and every one of its customers: the shortest way that ends there.
    let mut ways = vec![f64::INFINITY; sets * customers];
    let mut trips = vec![f64::INFINITY; sets];
    trips[0] = 0.0;
    for set in 1..sets {
        let members = || (0..customers).filter(move |customer| set >> customer & 1 == 1);
        let load: usize =
            members().map(|customer| usize::from(instance.demands[customer + 1])).sum();
        if load > usize::from(instance.capacity) {
            continue;
        }
        for last in members() {
            let before = set & !(1 << last);
            let way = if before == 0 {
                distance(0, last + 1)
            } else {
                let from =
                    |other: usize| ways[before * customers + other] + distance(other + 1, last + 1);
                members().filter(|other| *other != last).map(from).fold(f64::INFINITY, f64::min)
            };
            ways[set * customers + last] = way;
            trips[set] = trips[set].min(way + distance(last + 1, 0));
        }
    }
    trips
}

/// The same by at most one trip more than `best` tells, for sets without the lowest customer.
fn one_trip_more(alone: &[f64], best: &[f64], customers: usize) -> Vec<f64> {
    let mut more = best.to_vec();
    for set in (2..1_usize << customers).step_by(2) {
        let lowest = set & set.wrapping_neg();
        let rest = set & !lowest;
        let split = |with: usize| alone[with | lowest] + best[rest & !with];
        more[set] = subsets(rest).map(split).fold(best[set], f64::min);
    }
    more
}

/// All subsets of a set, itself and the empty one included.
fn subsets(set: usize) -> impl Iterator<Item = usize> {
    let mut next = Some(set);
    core::iter::from_fn(move || {
        let subset = next?;
        next = (subset > 0).then(|| (subset - 1) & set);
        Some(subset)
    })
}
