//! Rounding for what products are given, on random networks.

use sortie_bundle::{OwnedObservation, Recording};
use sortie_plans::random_observations;

use super::int8::ask;
use super::networks::{Random, Shape, int8_plan_for, reference};
use crate::lower::rounding::{Products, Rounded, equalise, nearest, round};
use crate::matching::AgentLayers;

const SHAPE: Shape =
    Shape { n_max: 8, features: 12, actions: 5, last_action: true, width: 32, heads: 2, base: 16 };

/// Its heads are narrower than what a plan has for them.
const NARROW: Shape = Shape { width: 24, ..SHAPE };

fn network_of(shape: Shape, seed: u64) -> AgentLayers {
    let mut random = Random::new(seed);
    let layers = random.layers(shape);
    if seed.is_multiple_of(2) { random.with_skip(layers) } else { layers }
}

fn network(seed: u64) -> AgentLayers {
    network_of(SHAPE, seed)
}

fn products(network: &AgentLayers) -> Products {
    Products::of(network, SHAPE.features).unwrap()
}

/// Observations whose features go together: few numbers make all of them.
fn observations(count: usize, seed: u64) -> Vec<OwnedObservation> {
    let Shape { n_max, features, actions, .. } = SHAPE;
    let mut observations = random_observations(count, n_max, features, actions, seed);
    for row in observations.iter_mut().flat_map(|seen| seen.rows.chunks_mut(features)) {
        for place in 3..features {
            row[place] = 0.1 * row[place] + row[place % 3] + 0.5;
        }
    }
    observations
}

fn recording(observations: &[OwnedObservation]) -> Recording {
    let mut recording = Recording::new(0, SHAPE.features, SHAPE.actions);
    observations.iter().for_each(|seen| recording.add(&seen.view()));
    recording
}

fn utilities(products: &Products, observation: &OwnedObservation) -> Vec<f32> {
    products.follow(&observation.view(), usize::MAX, |_, _| {}).unwrap()
}

/// The products with these weights.
fn of_whole(products: &Products, rounded: &[Rounded]) -> Products {
    let mut whole = products.clone();
    for (layer, rounded) in whole.layers.iter_mut().zip(rounded) {
        *layer = rounded.layer(layer.relu);
    }
    whole
}

#[test]
fn products_are_the_network() {
    for (shape, seed) in [(SHAPE, 0), (SHAPE, 1), (NARROW, 2), (NARROW, 3)] {
        let network = network_of(shape, seed);
        let products = products(&network);
        for observation in observations(40, seed) {
            let want = reference(&network, &observation, &mut Vec::new());
            for (got, want) in utilities(&products, &observation).iter().zip(want) {
                assert!((f64::from(*got) - want).abs() < 1e-4, "{got}, want {want}");
            }
        }
    }
}

#[test]
fn moving_scales_changes_no_bit_of_the_network() {
    for (shape, seed) in [(SHAPE, 5), (NARROW, 6)] {
        let exact = products(&network_of(shape, seed));
        let mut moved = exact.clone();
        equalise(&mut moved);
        assert_ne!(exact, moved);
        for observation in observations(60, seed) {
            let bits = |products: &Products| -> Vec<u32> {
                utilities(products, &observation).iter().map(|value| value.to_bits()).collect()
            };
            assert_eq!(bits(&exact), bits(&moved));
        }
    }
}

#[test]
fn moving_scales_makes_the_weights_of_inputs_of_like_size() {
    let mut products = products(&network(6));
    let last = products.layers.len() - 1;
    // As a network that learned may be: units that speak up, and units that are listened to.
    for (unit, scale) in [(3, 40.0), (7, 0.02)] {
        let row = &mut products.layers[last].matrix.values[unit * SHAPE.actions..][..SHAPE.actions];
        row.iter_mut().for_each(|weight| *weight *= scale);
    }
    equalise(&mut products);
    for row in products.layers[last].matrix.values.chunks(SHAPE.actions) {
        let largest = row.iter().fold(0.0_f32, |most, weight| most.max(weight.abs()));
        assert!((0.7..1.42).contains(&largest), "{largest}");
    }
}

#[test]
fn it_does_not_matter_how_loud_a_unit_is() {
    let quiet = products(&network(7));
    let mut loud = quiet.clone();
    let last = loud.layers.len() - 1;
    let (unit, width) = (3, loud.layers[last].matrix.inputs);
    let before = &mut loud.layers[last - 1];
    let column = before.matrix.values.iter_mut().skip(unit).step_by(width);
    column.chain(before.bias.get_mut(unit)).for_each(|weight| *weight /= 64.0);
    let row = &mut loud.layers[last].matrix.values[unit * SHAPE.actions..][..SHAPE.actions];
    row.iter_mut().for_each(|weight| *weight *= 64.0);
    let examples = recording(&observations(50, 7));
    assert_eq!(round(&loud, &examples), round(&quiet, &examples));
}

#[test]
fn rounded_for_observations_a_network_errs_less_than_with_the_nearest_weights() {
    let error = |products: &Products, exact: &Products| -> f64 {
        // None of them is among those that weights were rounded for.
        let unseen = observations(300, 99);
        let of = |seen: &OwnedObservation| -> f64 {
            let pairs = utilities(products, seen).into_iter().zip(utilities(exact, seen));
            pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum()
        };
        unseen.iter().map(of).sum()
    };
    for seed in 0..4 {
        let exact = products(&network(seed));
        let rounded = of_whole(&exact, &round(&exact, &recording(&observations(400, seed))));
        let nearest = of_whole(&exact, &nearest(&exact));
        let (rounded, nearest) = (error(&rounded, &exact), error(&nearest, &exact));
        assert!(rounded < 0.5 * nearest, "seed {seed}: {rounded}, nearest {nearest}");
    }
}

#[test]
fn a_plan_has_the_weights_that_were_rounded() {
    for (shape, seed) in [(SHAPE, 0), (NARROW, 1), (NARROW, 2)] {
        let network = network_of(shape, seed);
        let examples = recording(&observations(100, seed));
        let exact = products(&network);
        let rounded = of_whole(&exact, &round(&exact, &examples));
        let unseen = observations(20, 77);
        let answers = ask(&int8_plan_for(&network, shape, Some(&examples)), &unseen);
        for (observation, got) in unseen.iter().zip(answers) {
            for (got, want) in got.iter().zip(utilities(&rounded, observation)) {
                // A plan's inputs have 16 bits.
                assert!((got - want).abs() < 1e-3, "{got}, want {want}");
            }
        }
    }
}

#[test]
fn biases_make_up_for_the_means_of_errors() {
    let exact = products(&network(8));
    let seen = observations(200, 8);
    let mean = |products: &Products| -> Vec<f64> {
        let mut sums = [0.0; SHAPE.actions];
        for observation in &seen {
            let utilities = utilities(products, observation);
            sums.iter_mut().zip(utilities).for_each(|(sum, value)| *sum += f64::from(value));
        }
        sums.iter().map(|sum| sum / seen.len() as f64).collect()
    };
    let distance = |products: &Products| {
        let pairs = mean(products).into_iter().zip(mean(&exact));
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    };
    let rounded = round(&exact, &recording(&seen));
    let made_up = distance(&of_whole(&exact, &rounded));
    let nearest = distance(&of_whole(&exact, &nearest(&exact)));
    // Some rounding of f32 is left, whatever the weights.
    assert!(made_up < 2.0e-6 && nearest > 1.0e-4, "{made_up}, nearest {nearest}");
}

#[test]
fn rounding_repeats() {
    let products = products(&network(9));
    let examples = recording(&observations(100, 9));
    assert_eq!(round(&products, &examples), round(&products, &examples));
}

#[test]
fn observations_that_are_no_numbers_round_nothing() {
    let products = products(&network(10));
    let mut seen = observations(50, 10);
    let want = round(&products, &recording(&seen));
    let mut broken = seen[0].clone();
    broken.rows.fill(f32::NAN);
    seen.push(broken);
    assert_eq!(round(&products, &recording(&seen)), want);
}
