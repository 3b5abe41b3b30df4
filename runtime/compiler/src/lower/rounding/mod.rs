//! Which whole numbers the weights of an int8 plan become, and which biases make up for it.
//!
//! The nearest whole numbers are not the best: what counts is the error of a product, and inputs that go together let
//! one weight make up for another. So weights are rounded for the second moments of what products are given on
//! observations of the real environment, after scales were moved between neighbours ([`equalise`]). Products are rounded
//! in the order of a decision, each for what those before it, rounded, really give; and every bias is moved so that the
//! mean of its output stays what it was.
//!
//! Everything is computed in a fixed order, so that every machine has the same plan.

mod equalise;
mod moments;
mod products;
mod whole;

use std::ops::Range;

use sortie_bundle::Recording;
use sortie_core::Observation;

use crate::matching::Layer;
pub(crate) use equalise::equalise;
use moments::Moments;
pub(crate) use products::{EMBED, Products, QUERY};
pub(crate) use whole::Rounded;

/// Most observations that are looked at, evenly spread over a recording.
const MOST: usize = 2000;

/// The weights of every product, each the nearest.
pub(crate) fn nearest(products: &Products) -> Vec<Rounded> {
    products.layers.iter().map(Rounded::nearest).collect()
}

/// The weights of every product, rounded for what it is given on these observations.
pub(crate) fn round(products: &Products, examples: &Recording) -> Vec<Rounded> {
    let every = examples.observations().count().div_ceil(MOST).max(1);
    let seen: Vec<Observation<'_>> = examples.observations().step_by(every).collect();
    let mut exact = products.clone();
    equalise(&mut exact);
    let wanted = moments(&exact, &seen, EMBED..exact.layers.len());
    let mut so_far = exact.clone();
    let mut rounded = Vec::new();
    for stage in exact.stages() {
        let given = moments(&so_far, &seen, stage.clone());
        for (index, given) in stage.zip(given) {
            let layer = &exact.layers[index];
            // No bias makes up for the mean error of absorbed keys; that of the output makes up for the values' one.
            let is_made_up_for = !exact.keys().contains(&index);
            let second = if is_made_up_for { given.around_mean() } else { given.second() };
            let mut whole = Rounded::for_moments(layer, &second);
            if exact.has_bias(index) {
                make_up(&mut whole, layer, &wanted[index].mean(), &given.mean());
            }
            so_far.layers[index] = whole.layer(layer.relu);
            rounded.push(whole);
        }
    }
    rounded
}

/// Moves biases so that the mean output is that of `layer`, the means of whose inputs are `wanted`, where those of the
/// rounded one are `given`.
fn make_up(whole: &mut Rounded, layer: &Layer, wanted: &[f64], given: &[f64]) {
    let mean = |layer: &Layer, inputs: &[f64], output: usize| -> f64 {
        let weights = layer.matrix.values.iter().skip(output).step_by(layer.matrix.outputs);
        weights.zip(inputs).map(|(weight, input)| f64::from(*weight) * input).sum()
    };
    let rounded = whole.layer(layer.relu);
    for (output, bias) in whole.bias.iter_mut().enumerate() {
        let missing = mean(layer, wanted, output) - mean(&rounded, given, output);
        *bias = (f64::from(*bias) + missing) as f32;
    }
}

/// What some of the products are given.
fn moments(products: &Products, seen: &[Observation<'_>], of: Range<usize>) -> Vec<Moments> {
    let inputs = |index: usize| products.layers[index].matrix.inputs;
    let mut moments: Vec<Moments> = of.clone().map(|index| Moments::new(inputs(index))).collect();
    for observation in seen {
        products.follow(observation, of.end, |index, input| {
            if of.contains(&index) {
                moments[index - of.start].add(input);
            }
        });
    }
    moments
}
