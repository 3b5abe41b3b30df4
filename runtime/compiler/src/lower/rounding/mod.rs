//! Which whole numbers the weights of an int8 plan become, and which biases make up for it.
//!
//! The nearest whole numbers are not the best: what counts is the error of a product, and inputs that go together let
//! one weight make up for another. So weights are rounded for the second moments of what products are given on
//! observations of the real environment, after scales were moved between neighbours ([`equalise`]). Products are rounded
//! in the order of a decision, each for what those before it, rounded, really give: its weights are first fitted so that it
//! makes up for their errors. Every bias is moved so that the mean of its output stays what it was.
//!
//! Everything is computed in a fixed order, so that every machine has the same plan.

mod whole;

use std::ops::Range;

use sortie_bundle::Recording;
use sortie_core::internal::kernels::product::padded;
use sortie_core::internal::math::exp;
use sortie_core::{NO_ACTION, Observation};
use sortie_plans::CompileError;

use crate::lower::agent::{behind_heads, padded_heads, side_by_side};
use crate::matching::{AgentLayers, Layer, Matrix, Step};

pub(crate) use whole::Rounded;
use whole::{Form, fitted};

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
    let mut so_far = exact.clone();
    let mut rounded = Vec::new();
    for stage in exact.stages() {
        let given = moments([&exact, &so_far], &seen, stage.clone());
        for (index, given) in stage.zip(given) {
            let layer = &exact.layers[index];
            // No bias makes up for the mean error of absorbed keys; that of the output makes up for the values' one.
            let around_mean = !exact.keys().contains(&index);
            let second = Form::of(&given.second(around_mean));
            let wanted = fitted(layer, &second, &given.drift(around_mean));
            let mut whole = Rounded::for_moments(&wanted, &second);
            if exact.has_bias(index) {
                make_up(&mut whole, layer, &given.mean(&given.wanted), &given.mean(&given.sums));
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

/// What some of the products are given: in the exact network, and in the one that is rounded so far.
fn moments(
    [exact, so_far]: [&Products; 2],
    seen: &[Observation<'_>],
    of: Range<usize>,
) -> Vec<Moments> {
    let inputs = |index: usize| so_far.layers[index].matrix.inputs;
    let mut moments: Vec<Moments> = of.clone().map(|index| Moments::new(inputs(index))).collect();
    let mut wanted = Vec::new();
    for observation in seen {
        exact.follow(observation, of.end, |index, input| {
            if of.contains(&index) {
                wanted.push(input.to_vec());
            }
        });
        let mut wanted = wanted.drain(..);
        so_far.follow(observation, of.end, |index, input| {
            if of.contains(&index)
                && let Some(wanted) = wanted.next()
            {
                moments[index - of.start].add(&wanted, input);
            }
        });
    }
    moments
}

// Scales moved between neighbouring products, so that the weights of one output are of like size.
//
// All weights of an output count in the same step, so that the largest decides how coarse the others become. Where
// one product's outputs are the next one's inputs, with nothing or a ReLU between them, an output may be multiplied and
// the next product's weights of it divided by the same: the network stays what it is. Powers of two change no bit.

/// Moves scales in a whole network, from the first product to the last.
pub(crate) fn equalise(products: &mut Products) {
    let head_width = products.head_width();
    let inner = products.heads * head_width;
    let skips = products.layers[products.output()].matrix.inputs > inner;
    for unit in 0..products.layers[EMBED].matrix.outputs {
        let takers = products.values().chain([QUERY]).map(|index| (index, unit));
        let skip = skips.then_some((products.output(), inner + unit));
        let takers: Vec<(usize, usize)> = takers.chain(skip).collect();
        let scale = scale(products, &takers);
        products.layers[EMBED].scale_output(unit, scale);
        // Scores are products of rows and absorbed keys.
        products.keys().for_each(|keys| products.layers[keys].scale_output(unit, 1.0 / scale));
        for (index, input) in takers {
            products.layers[index].scale_input(input, 1.0 / scale);
        }
        if let (Some(first), Some(last)) = (products.pointing, products.layers.last_mut()) {
            last.scale_output(first + unit, 1.0 / scale);
        }
    }
    for (head, (keys, values)) in products.keys().zip(products.values()).enumerate() {
        for unit in 0..head_width {
            let place = head * head_width + unit;
            pass(products, (QUERY, place), (keys, unit));
            // What a narrower head has beyond its width is zero.
            if unit < products.layers[values].matrix.outputs {
                pass(products, (values, unit), (products.output(), place));
            }
        }
    }
    for index in products.output()..products.layers.len() - 1 {
        for unit in 0..products.layers[index].matrix.outputs {
            pass(products, (index, unit), (index + 1, unit));
        }
    }
}

/// Moves the scale of an output, `(product, output)`, to the input that it is, `(product, input)`.
fn pass(products: &mut Products, from: (usize, usize), to: (usize, usize)) {
    let scale = scale(products, &[to]);
    products.layers[from.0].scale_output(from.1, scale);
    products.layers[to.0].scale_input(to.1, 1.0 / scale);
}

/// The power of two next to the largest weight of an input, in all products that take it; 1 where there is none.
fn scale(products: &Products, takers: &[(usize, usize)]) -> f32 {
    let weights = takers.iter().flat_map(|&(index, input)| products.layers[index].of_input(input));
    let largest = weights.fold(0.0_f32, |largest, weight| largest.max(weight.abs()));
    if !(1.0e-6..1.0e6).contains(&largest) {
        return 1.0;
    }
    // Without its fraction, a number times the root of two is the power of two that is nearer in ratio.
    f32::from_bits((largest * std::f32::consts::SQRT_2).to_bits() & 0x7f80_0000)
}

trait Scaled {
    fn of_input(&self, input: usize) -> &[f32];
    fn scale_input(&mut self, input: usize, by: f32);
    fn scale_output(&mut self, output: usize, by: f32);
}

impl Scaled for Layer {
    fn of_input(&self, input: usize) -> &[f32] {
        let outputs = self.matrix.outputs;
        &self.matrix.values[input * outputs..(input + 1) * outputs]
    }

    fn scale_input(&mut self, input: usize, by: f32) {
        let outputs = self.matrix.outputs;
        let weights = &mut self.matrix.values[input * outputs..(input + 1) * outputs];
        weights.iter_mut().for_each(|weight| *weight *= by);
    }

    fn scale_output(&mut self, output: usize, by: f32) {
        let weights = self.matrix.values.iter_mut().skip(output).step_by(self.matrix.outputs);
        weights.chain(self.bias.get_mut(output)).for_each(|weight| *weight *= by);
    }
}

/// Sums over the inputs of a product. They are taken in the order of the inputs, in f64, so that every machine has the
/// same bits.
#[derive(Clone, Debug)]
struct Moments {
    count: usize,
    /// Sums of the inputs x in the exact network.
    wanted: Vec<f64>,
    /// Sums of the inputs y behind rounded products.
    sums: Vec<f64>,
    /// Sums of y_i y_j, `[inputs, inputs]`, of j up to i.
    products: Vec<f64>,
    /// Sums of (x_i - y_i) y_j, `[inputs, inputs]`.
    drifts: Vec<f64>,
}

impl Moments {
    fn new(inputs: usize) -> Self {
        let [wanted, sums] = [0, 1].map(|_| vec![0.0; inputs]);
        let [products, drifts] = [0, 1].map(|_| vec![0.0; inputs * inputs]);
        Self { count: 0, wanted, sums, products, drifts }
    }

    /// Adds one input; one that is too large for a number is left out, as a plan refuses it.
    fn add(&mut self, wanted: &[f32], input: &[f32]) {
        if input.iter().chain(wanted).any(|value| !value.is_finite()) {
            return;
        }
        self.count += 1;
        let width = input.len();
        for (place, (wanted, value)) in wanted.iter().zip(input).enumerate() {
            let (wanted, value) = (f64::from(*wanted), f64::from(*value));
            self.wanted[place] += wanted;
            self.sums[place] += value;
            if value != 0.0 {
                let row = &mut self.products[place * width..][..=place];
                row.iter_mut()
                    .zip(input)
                    .for_each(|(sum, other)| *sum += value * f64::from(*other));
            }
            let missing = wanted - value;
            if missing != 0.0 {
                let row = &mut self.drifts[place * width..][..width];
                row.iter_mut()
                    .zip(input)
                    .for_each(|(sum, other)| *sum += missing * f64::from(*other));
            }
        }
    }

    /// The mean of sums.
    fn mean(&self, sums: &[f64]) -> Vec<f64> {
        sums.iter().map(|sum| sum / self.count.max(1) as f64).collect()
    }

    /// The mean of y yᵀ, row by row; around the mean, which is what is left of errors whose mean is made up for.
    fn second(&self, around_mean: bool) -> Vec<Vec<f64>> {
        let width = self.sums.len();
        let at = |row: usize, column: usize| {
            let (row, column) = (row.max(column), row.min(column));
            self.products[row * width + column] / self.count.max(1) as f64
        };
        let mut moments: Vec<Vec<f64>> =
            (0..width).map(|row| (0..width).map(|column| at(row, column)).collect()).collect();
        if around_mean {
            let mean = self.mean(&self.sums);
            subtract(&mut moments, &mean, &mean);
        }
        moments
    }

    /// The mean of (x - y) yᵀ, likewise.
    fn drift(&self, around_mean: bool) -> Vec<Vec<f64>> {
        let width = self.sums.len();
        let mut drift: Vec<Vec<f64>> =
            self.drifts.chunks_exact(width.max(1)).map(|row| self.mean(row)).collect();
        if around_mean {
            let mean = self.mean(&self.sums);
            let missing: Vec<f64> =
                self.mean(&self.wanted).iter().zip(&mean).map(|(x, y)| x - y).collect();
            subtract(&mut drift, &missing, &mean);
        }
        drift
    }
}

/// Takes a bᵀ from a matrix.
fn subtract(matrix: &mut [Vec<f64>], a: &[f64], b: &[f64]) {
    for (row, a) in matrix.iter_mut().zip(a) {
        row.iter_mut().zip(b).for_each(|(value, b)| *value -= a * b);
    }
}

/// The first product, of entities' rows.
pub(crate) const EMBED: usize = 0;

/// The queries of all heads.
pub(crate) const QUERY: usize = 1;

/// The products of a network, in the order in which a decision needs them: the embedding, the queries of all heads,
/// absorbed keys and then values head by head, the attention's output, and what follows it.
///
/// Keys and values have no bias. A head takes and gives as many numbers as the plan has for it, those of padding included.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Products {
    pub(crate) heads: usize,
    /// Of the last product's outputs the first of the vector that points at rows, where there is one.
    pointing: Option<usize>,
    /// Features d; the last action's one-hot follows them, if the embedding has more inputs.
    features: usize,
    pub(crate) layers: Vec<Layer>,
}

impl Products {
    /// The products of a network of so many features.
    ///
    /// # Errors
    /// The network has a recurrent unit.
    pub(crate) fn of(network: &AgentLayers, features: usize) -> Result<Self, CompileError> {
        let heads = network.heads;
        let width = network.key.outputs / heads;
        let parts = |matrix: &Matrix| -> Vec<Matrix> {
            (0..heads).map(|head| matrix.columns(head * width, width)).collect()
        };
        let plain = |matrix: Matrix| Layer { bias: vec![0.0; matrix.outputs], relu: false, matrix };
        let query: Vec<Layer> = parts(&network.query.matrix)
            .into_iter()
            .zip(network.query.bias.chunks_exact(width))
            .map(|(matrix, bias)| Layer { matrix, bias: bias.to_vec(), relu: false })
            .collect();
        let keys = parts(&network.key).into_iter().map(|keys| padded_heads(&keys.transposed(), 1));
        let mut layers = vec![network.embed.clone(), side_by_side(&query)];
        layers.extend(keys.chain(parts(&network.value)).map(plain));
        layers.push(behind_heads(network));
        for step in &network.steps {
            match step {
                Step::Dense(layer) => layers.push(layer.clone()),
                Step::Gru(_) => {
                    return Err(CompileError::NoInt8 { what: "a recurrent unit (Gru)".into() });
                }
            }
        }
        let pointing = network.targets.map(|targets| padded(targets.untargeted.into()));
        Ok(Self { heads, pointing, features, layers })
    }

    /// Absorbed keys, head by head.
    pub(crate) fn keys(&self) -> Range<usize> {
        QUERY + 1..QUERY + 1 + self.heads
    }

    /// Values, head by head.
    pub(crate) fn values(&self) -> Range<usize> {
        self.keys().end..self.keys().end + self.heads
    }

    /// The attention's output, which takes the heads' values, and behind them the own row where there is a skip.
    pub(crate) fn output(&self) -> usize {
        self.values().end
    }

    /// Whether a product has a bias.
    pub(crate) fn has_bias(&self, index: usize) -> bool {
        !(self.keys().start..self.values().end).contains(&index)
    }

    /// Numbers that a head hands to the output.
    pub(crate) fn head_width(&self) -> usize {
        self.layers[QUERY].matrix.outputs / self.heads
    }

    /// Products that do not depend on each other, in order: what one of them is given depends on those before it.
    fn stages(&self) -> Vec<Range<usize>> {
        let mut stages = vec![EMBED..QUERY, QUERY..QUERY + 1, self.keys(), self.values()];
        stages.extend((self.output()..self.layers.len()).map(|index| index..index + 1));
        stages
    }

    /// The utilities of an observation, in f32. `note` is told what every product is given. Only products before
    /// `until` are computed: nothing is returned where that is not all.
    pub(crate) fn follow(
        &self,
        observation: &Observation<'_>,
        until: usize,
        mut note: impl FnMut(usize, &[f32]),
    ) -> Option<Vec<f32>> {
        let mut product = |index: usize, input: &[f32]| {
            let layer = self.layers.get(index).filter(|_| index < until)?;
            note(index, input);
            Some(layer.apply(input))
        };
        let own = observation.self_index;
        let mut rows = Vec::new();
        let mut own_row = None;
        for entity in observation.visible.iter() {
            let row = product(EMBED, &self.input(observation, entity)?)?;
            if entity == own {
                own_row = Some(row.clone());
            }
            rows.push(row);
        }
        let own_row = match own_row {
            Some(row) => row,
            None => product(EMBED, &self.input(observation, own)?)?,
        };
        let mixed = match rows.as_slice() {
            [] => Vec::new(),
            [only] => vec![only.clone(); self.heads],
            _ => {
                let queries = product(QUERY, &own_row)?;
                let asked = self.keys().zip(queries.chunks_exact(self.head_width()));
                let absorbed = asked.map(|(keys, query)| product(keys, query));
                let absorbed: Vec<Vec<f32>> = absorbed.collect::<Option<_>>()?;
                absorbed.iter().map(|absorbed| mix(&rows, absorbed)).collect()
            }
        };
        let mut answer = Vec::new();
        for (head, (values, mixed)) in (1..).zip(self.values().zip(&mixed)) {
            answer.extend(product(values, mixed)?);
            answer.resize(head * self.head_width(), 0.0);
        }
        answer.resize(self.heads * self.head_width(), 0.0);
        if self.layers[self.output()].matrix.inputs > answer.len() {
            answer.extend(own_row);
        }
        for index in self.output()..self.layers.len() {
            answer = product(index, &answer)?;
        }
        Some(answer)
    }

    /// An entity's features and last action, if they are numbers.
    fn input(&self, observation: &Observation<'_>, entity: usize) -> Option<Vec<f32>> {
        let start = entity * observation.stride;
        let mut input = observation.rows.get(start..start + self.features)?.to_vec();
        input.resize(self.layers[EMBED].matrix.inputs, 0.0);
        let action = observation.last_actions.get(entity).filter(|action| **action != NO_ACTION);
        if let Some(one) =
            action.and_then(|action| input.get_mut(self.features + usize::from(*action)))
        {
            *one = 1.0;
        }
        input.iter().all(|value| value.is_finite()).then_some(input)
    }
}

/// Rows, mixed by how well they answer the absorbed query.
fn mix(rows: &[Vec<f32>], absorbed: &[f32]) -> Vec<f32> {
    let scores = rows.iter().map(|row| row.iter().zip(absorbed).map(|(a, b)| a * b).sum::<f32>());
    let scores: Vec<f32> = scores.collect();
    let largest = scores.iter().copied().fold(f32::MIN, f32::max);
    let weights: Vec<f32> = scores.iter().map(|score| exp(score - largest)).collect();
    let sum: f32 = weights.iter().sum();
    let mut mixed = vec![0.0; absorbed.len()];
    for (row, weight) in rows.iter().zip(weights) {
        mixed.iter_mut().zip(row).for_each(|(mixed, value)| *mixed += weight / sum * value);
    }
    mixed
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_those_of_the_inputs() {
        let mut moments = Moments::new(2);
        for input in [[1.0, 2.0], [3.0, 0.0], [f32::INFINITY, 1.0], [2.0, -5.0]] {
            moments.add(&[input[0] + 1.0, input[1]], &input);
        }
        assert_eq!(
            (moments.mean(&moments.sums), moments.mean(&moments.wanted)),
            (vec![2.0, -1.0], vec![3.0, -1.0])
        );
        let third = 1.0 / 3.0;
        let close = |got: Vec<Vec<f64>>, want: [[f64; 2]; 2]| {
            let pairs = got.concat().into_iter().zip(want.concat());
            assert!(pairs.into_iter().all(|(got, want)| (got - want).abs() < 1e-12), "{got:?}");
        };
        close(moments.second(false), [[14.0 * third, -8.0 * third], [-8.0 * third, 29.0 * third]]);
        close(moments.second(true), [[2.0 * third, -2.0 * third], [-2.0 * third, 26.0 * third]]);
        close(moments.drift(false), [[2.0, -1.0], [0.0, 0.0]]);
        close(moments.drift(true), [[0.0; 2]; 2]);
    }
}
