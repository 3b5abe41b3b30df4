//! What float32 costs any engine in this very network: one rounding behind every node, drawn at random.
//!
//! A node's result is off by about 2^-24 of what was added up to it, whoever computes it and in whatever order. Runs with
//! such noise show how far the answers of a right engine scatter around the truth, conditioning included, without a
//! bound for any operator.

use std::collections::HashMap;
use std::sync::Arc;

use super::Call;
use super::tensor::{Failure, Numbers, Tensor};

/// Half of the distance between 1 and the next number of 32 bits: the largest error of one rounding.
pub(super) const ROUNDING: f64 = 1.0 / 16_777_216.0;

/// Noise for runs of the reference evaluator.
///
/// What is drawn depends on the number that it is drawn for: equal numbers of one node are rounded alike, as engines
/// do, so that errors of equal rows add up where independent ones would cancel.
#[derive(Debug)]
pub(crate) struct Noise {
    seed: u64,
    /// Counts what was shaken, so that every node draws its own.
    place: u64,
    /// What was added up to the results of sums, by their places: found once, as rounding hardly changes it.
    sums: HashMap<u64, Vec<f64>>,
}

/// How an operator's result scatters.
enum Scatter {
    /// It moves or chooses numbers.
    None,
    /// By some roundings of the result.
    Result(f64),
    /// By a rounding of what was added up: the same node over absolute values.
    Sum,
    /// By roundings of the result, and of numbers around 1 where the input is below zero.
    Unit,
    /// Many steps in one: by a rounding of each input, and of the result.
    Inside,
}

impl Noise {
    pub(crate) fn new(seed: u64) -> Self {
        Self { seed, place: 0, sums: HashMap::new() }
    }

    /// Begins another run, of which everything is drawn anew.
    pub(crate) fn again(&mut self, seed: u64) {
        (self.seed, self.place) = (seed, 0);
    }

    /// What an engine would make of a node that the evaluator found these results for.
    pub(super) fn behind(
        &mut self,
        call: &Call<'_>,
        found: Vec<Tensor>,
    ) -> Result<Vec<Tensor>, Failure> {
        let found = match scatter(call.operator()) {
            Scatter::None => return Ok(found),
            Scatter::Result(roundings) => self.around(found, |_, y| roundings * y.abs()),
            Scatter::Sum => {
                let length = found.first().map_or(0, Tensor::len);
                let known = self.sums.remove(&self.place).filter(|sums| sums.len() == length);
                let sums = match known {
                    Some(sums) => sums,
                    None => {
                        let inputs = call.inputs.iter().map(absolute).collect();
                        let sums = call.with(inputs).evaluate()?;
                        sums.first().map(Tensor::to_reals).unwrap_or_default()
                    }
                };
                let place = self.place;
                let found = self.around(found, |at, _| sums.get(at).copied().unwrap_or(0.0));
                self.sums.insert(place, sums);
                found
            }
            Scatter::Unit => {
                let input = call.input(0)?.to_reals();
                let below = |at: usize| input.get(at).is_some_and(|x| *x < 0.0);
                self.around(found, |at, y| 2.0 * y.abs() + f64::from(below(at)))
            }
            Scatter::Inside => {
                let inputs = call.inputs.iter().enumerate();
                let inputs = inputs.map(|(index, input)| {
                    input.as_ref().map(|input| Arc::new(self.input(call, index, input)))
                });
                let shaken = call.with(inputs.collect()).evaluate()?;
                self.around(shaken, |_, y| 2.0 * y.abs())
            }
        };
        Ok(found)
    }

    /// Results off by a normal draw each, so many roundings large.
    fn around(&mut self, found: Vec<Tensor>, roundings: impl Fn(usize, f64) -> f64) -> Vec<Tensor> {
        self.place += 1;
        let shake = |tensor: Tensor| {
            let Numbers::Real(mut numbers) = tensor.numbers else { return tensor };
            for (at, y) in numbers.iter_mut().enumerate() {
                let width = ROUNDING * roundings(at, *y);
                // What is infinite or no number is so for every engine.
                if width.is_finite() && width > 0.0 {
                    *y += width * self.normal(*y);
                }
                // Where 32 bits end, numbers are infinite, and close to zero they have few digits.
                if y.abs() < f64::from(f32::MIN_POSITIVE) || y.abs() > f64::from(f32::MAX) {
                    *y = f64::from(*y as f32);
                }
            }
            Tensor::real(tensor.shape, numbers)
        };
        found.into_iter().map(shake).collect()
    }

    /// An input of an operator of many steps, whose sums over K numbers err by about the square root of K roundings.
    fn input(&mut self, call: &Call<'_>, index: usize, input: &Tensor) -> Tensor {
        let length = input.shape.last().copied().unwrap_or(1) as f64;
        let of_sum = 0.35 * length.sqrt();
        let mean = |numbers: &[f64]| {
            numbers.iter().map(|x| x.abs()).sum::<f64>() / numbers.len().max(1) as f64
        };
        let is_unit = ["RNN", "GRU", "LSTM"].contains(&call.operator());
        let is_norm =
            call.operator().ends_with("Normalization") && call.operator() != "BatchNormalization";
        let mean = mean(&input.to_reals());
        let width = |_: usize, x: f64| match index {
            0 if is_norm => of_sum * mean,
            1 | 2 if is_unit => of_sum * x.abs(),
            0..3 if call.operator() == "Attention" => of_sum * x.abs(),
            _ => x.abs(),
        };
        self.around(vec![input.clone()], width).swap_remove(0)
    }

    /// A number's draw from the normal distribution, by the method of Box and Muller.
    fn normal(&self, number: f64) -> f64 {
        let mixed = mixed(mixed(self.seed) ^ mixed(self.place) ^ number.to_bits());
        let uniform = |bits: u64| (bits >> 11) as f64 / (1_u64 << 53) as f64;
        let (radius, turn) = (1.0 - uniform(mixed), uniform(self::mixed(mixed)));
        (-2.0 * radius.ln()).sqrt() * (std::f64::consts::TAU * turn).cos()
    }
}

/// Bits that depend on all bits of a number (the last step of the generator SplitMix64).
fn mixed(number: u64) -> u64 {
    let mut bits = number.wrapping_add(0x9E37_79B9_7F4A_7C15);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    bits ^ (bits >> 31)
}

fn absolute(input: &Option<Arc<Tensor>>) -> Option<Arc<Tensor>> {
    let input = input.as_ref()?;
    let Numbers::Real(numbers) = &input.numbers else { return Some(Arc::clone(input)) };
    let numbers = numbers.iter().map(|x| x.abs()).collect();
    Some(Arc::new(Tensor::real(input.shape.clone(), numbers)))
}

fn scatter(operator: &str) -> Scatter {
    match operator {
        "MatMul" | "Gemm" | "Einsum" | "Conv" | "ConvTranspose" | "ReduceSum" | "ReduceMean"
        | "ReduceL1" | "ReduceSumSquare" | "Sum" | "Mean" | "CumSum" | "AveragePool"
        | "GlobalAveragePool" | "Resize" | "Upsample" => Scatter::Sum,
        "Add" | "Sub" | "Mul" | "Div" | "Reciprocal" | "Mod" | "Scaler" | "LeakyRelu" | "PRelu"
        | "DequantizeLinear" => Scatter::Result(1.0),
        "Tanh" | "Erf" | "HardSigmoid" | "HardSwish" | "Softsign" | "Asinh" | "Atan" | "Asin"
        | "Sinh" | "Atanh" => Scatter::Result(2.0),
        "Exp" | "Sigmoid" | "Sqrt" | "Sin" | "Cos" | "Tan" | "Log" | "Pow" | "Cosh" | "Acos"
        | "Acosh" | "Gelu" | "Mish" | "Swish" | "ReduceL2" | "ReduceProd" => Scatter::Result(3.0),
        "Elu" | "Selu" | "Celu" | "Softplus" => Scatter::Unit,
        "RNN"
        | "GRU"
        | "LSTM"
        | "BatchNormalization"
        | "LayerNormalization"
        | "RMSNormalization"
        | "InstanceNormalization"
        | "GroupNormalization"
        | "MeanVarianceNormalization"
        | "LpNormalization"
        | "Normalizer"
        | "Softmax"
        | "LogSoftmax"
        | "ReduceLogSumExp"
        | "ReduceLogSum"
        | "Attention"
        | "LpPool" => Scatter::Inside,
        _ => Scatter::None,
    }
}
