//! Weights as whole numbers, chosen so that the error of the product is small, not that of each weight.

use crate::matching::{Layer, Matrix};

/// The largest weight: as far from zero as the smallest, -127.
const MOST: f32 = 127.0;

/// Weights that are smaller throughout count for nothing: no quotient by them is a number.
const LEAST: f32 = 1.0e-30;

/// Part of the mean variance that is added to every variance: inputs that never differed are no licence to be wrong.
const DAMPING: f64 = 0.01;

/// Steps that are tried for an output, as parts of the one by which its largest weight becomes [`MOST`].
const STEPS: [f32; 13] =
    [1.0, 0.98, 0.96, 0.94, 0.92, 0.9, 0.88, 0.86, 0.84, 0.82, 0.8, 0.76, 0.72];

/// Most rounds of improvements of an output's weights.
const ROUNDS: usize = 64;

/// A layer of int8 weights.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Rounded {
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    /// The weights `[inputs, outputs]`, from -127 to 127.
    pub(crate) integers: Vec<i8>,
    /// What a weight of each output counts; 0 where all are zero.
    pub(crate) steps: Vec<f32>,
    pub(crate) bias: Vec<f32>,
}

impl Rounded {
    /// Every weight becomes the nearest.
    pub(crate) fn nearest(layer: &Layer) -> Self {
        let Matrix { outputs, values, .. } = &layer.matrix;
        let steps = largest(&layer.matrix).map(|most| most / MOST).collect::<Vec<_>>();
        let weight = |(place, value): (usize, &f32)| match steps[place % outputs] {
            step if step > 0.0 => (value / step).round() as i8,
            _ => 0,
        };
        let integers = values.iter().enumerate().map(weight).collect();
        Self::with(layer, integers, steps)
    }

    /// Weights and steps that err least on inputs of these second moments, as far as a search finds them.
    pub(crate) fn for_moments(layer: &Layer, form: &Form) -> Self {
        let Matrix { inputs, outputs, values } = &layer.matrix;
        let mut integers = vec![0; inputs * outputs];
        let mut steps = vec![0.0; *outputs];
        for (output, most) in largest(&layer.matrix).enumerate().filter(|(_, most)| *most > 0.0) {
            let column = values.iter().skip(output).step_by(*outputs);
            let weights: Vec<f64> = column.map(|value| f64::from(*value)).collect();
            let mut best = f64::INFINITY;
            for part in STEPS {
                let step = most / MOST * part;
                let (found, error) = form.round(&weights, f64::from(step));
                if error < best {
                    best = error;
                    steps[output] = step;
                    let column = integers.iter_mut().skip(output).step_by(*outputs);
                    column.zip(&found).for_each(|(to, from)| *to = *from as i8);
                }
            }
        }
        Self::with(layer, integers, steps)
    }

    fn with(layer: &Layer, integers: Vec<i8>, steps: Vec<f32>) -> Self {
        let Matrix { inputs, outputs, .. } = layer.matrix;
        Self { inputs, outputs, integers, steps, bias: layer.bias.clone() }
    }

    /// The layer that these weights are.
    pub(crate) fn layer(&self, relu: bool) -> Layer {
        let values = self.integers.iter().zip(self.steps.iter().cycle());
        let values = values.map(|(integer, step)| f32::from(*integer) * step).collect();
        let matrix = Matrix { inputs: self.inputs, outputs: self.outputs, values };
        Layer { matrix, bias: self.bias.clone(), relu }
    }
}

/// The layer that gives, on inputs y behind rounded products, what `layer` gives on the exact ones x, as far as least squares
/// can: its weights are w + (E y yᵀ)⁻¹ E y (x - y)ᵀ w. `second` is E y yᵀ, `drift` E (x - y) yᵀ.
pub(crate) fn fitted(layer: &Layer, second: &Form, drift: &[Vec<f64>]) -> Layer {
    let Matrix { outputs, values, .. } = &layer.matrix;
    let mut fitted = layer.clone();
    for output in 0..*outputs {
        let weights = values.iter().skip(output).step_by(*outputs);
        let mut missing = vec![0.0; drift.len()];
        for (weight, row) in weights.zip(drift) {
            missing.iter_mut().zip(row).for_each(|(sum, drift)| *sum += f64::from(*weight) * drift);
        }
        let change = second.solve(&missing);
        let column = fitted.matrix.values.iter_mut().skip(output).step_by(*outputs);
        column
            .zip(change)
            .for_each(|(weight, change)| *weight = (f64::from(*weight) + change) as f32);
    }
    fitted
}

/// The size of the largest weight of each output, 0 where it counts for nothing.
fn largest(matrix: &Matrix) -> impl Iterator<Item = f32> + use<> {
    let mut largest = vec![0.0_f32; matrix.outputs];
    for row in matrix.values.chunks_exact(matrix.outputs) {
        for (largest, value) in largest.iter_mut().zip(row) {
            *largest = largest.max(value.abs());
        }
    }
    largest.into_iter().map(|most| if most > LEAST { most } else { 0.0 })
}

/// The mean square of a product's error, as a quadratic form of its weights' errors.
pub(crate) struct Form {
    moments: Vec<Vec<f64>>,
    /// L of L Lᵀ = moments, by rows.
    root: Vec<Vec<f64>>,
}

impl Form {
    pub(crate) fn of(moments: &[Vec<f64>]) -> Self {
        let mut moments = moments.to_vec();
        let variances = moments.iter().enumerate().map(|(place, row)| row[place]);
        let damping = DAMPING * variances.sum::<f64>() / moments.len().max(1) as f64;
        for (place, row) in moments.iter_mut().enumerate() {
            row[place] += damping.max(f64::MIN_POSITIVE);
        }
        let root = cholesky(&moments);
        Self { moments, root }
    }

    /// The x of moments x = wanted.
    fn solve(&self, wanted: &[f64]) -> Vec<f64> {
        let mut half: Vec<f64> = Vec::with_capacity(wanted.len());
        for (row, wanted) in self.root.iter().zip(wanted) {
            half.push((wanted - dot(row, &half)) / row[half.len()]);
        }
        let mut found = half;
        for place in (0..found.len()).rev() {
            let rest: f64 =
                (place + 1..found.len()).map(|row| self.root[row][place] * found[row]).sum();
            found[place] = (found[place] - rest) / self.root[place][place];
        }
        found
    }

    /// Whole numbers for weights that count steps, and the mean square error that they leave.
    fn round(&self, weights: &[f64], step: f64) -> (Vec<f64>, f64) {
        let wanted: Vec<f64> = weights.iter().map(|weight| weight / step).collect();
        let mut whole = self.nearest_plane(&wanted);
        self.improve(&wanted, &mut whole);
        let errors: Vec<f64> = wanted.iter().zip(&whole).map(|(a, b)| a - b).collect();
        let error: f64 =
            errors.iter().zip(&self.moments).map(|(e, row)| e * dot(row, &errors)).sum();
        (whole, error * step * step)
    }

    /// Rounds one weight after the other, from the last to the first; each makes up for the errors of those before it.
    fn nearest_plane(&self, wanted: &[f64]) -> Vec<f64> {
        let mut whole = vec![0.0; wanted.len()];
        let mut errors = vec![0.0; wanted.len()];
        for place in (0..wanted.len()).rev() {
            let rest: f64 =
                (place + 1..wanted.len()).map(|row| self.root[row][place] * errors[row]).sum();
            let number = wanted[place] + rest / self.root[place][place];
            whole[place] = in_range(number.round());
            errors[place] = wanted[place] - whole[place];
        }
        whole
    }

    /// Changes single weights as long as one of them lowers the error.
    fn improve(&self, wanted: &[f64], whole: &mut [f64]) {
        let errors: Vec<f64> = wanted.iter().zip(&*whole).map(|(a, b)| a - b).collect();
        let mut slopes: Vec<f64> = self.moments.iter().map(|row| dot(row, &errors)).collect();
        for _ in 0..ROUNDS {
            let mut changed = false;
            for (place, row) in self.moments.iter().enumerate() {
                let change = slopes[place] / row[place];
                // Up to half, the weight stays where it is, and so do ties.
                if change.abs() <= 0.5 + 1.0e-9 {
                    continue;
                }
                let before = whole[place];
                whole[place] = in_range(before + change.round());
                let change = whole[place] - before;
                if change != 0.0 {
                    changed = true;
                    slopes
                        .iter_mut()
                        .zip(row)
                        .for_each(|(slope, moment)| *slope -= change * moment);
                }
            }
            if !changed {
                return;
            }
        }
    }
}

fn in_range(number: f64) -> f64 {
    number.clamp(-f64::from(MOST), f64::from(MOST))
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// L of L Lᵀ, by rows, of a matrix whose diagonal is positive; what rounding leaves of too small a pivot becomes as
/// small a one.
fn cholesky(matrix: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let mut root: Vec<Vec<f64>> = Vec::with_capacity(matrix.len());
    for (place, row) in matrix.iter().enumerate() {
        let mut new: Vec<f64> = Vec::with_capacity(place + 1);
        for (column, above) in root.iter().enumerate() {
            let rest = row[column] - dot(&new, &above[..column]);
            new.push(rest / above[column]);
        }
        let pivot = row[place] - dot(&new, &new);
        new.push(pivot.max(1.0e-9 * row[place]).sqrt());
        root.push(new);
    }
    root
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fractions that look like chance, the same ones each time.
    fn fractions(count: usize, seed: usize) -> Vec<f64> {
        let number = |place: usize| (place * 7919 + seed * 104_729) % 1009;
        (1..=count).map(|place| number(place * place + place) as f64 / 1009.0).collect()
    }

    /// Second moments of inputs that go together, and weights.
    fn task(seed: usize) -> (Vec<Vec<f64>>, Vec<f64>) {
        let inputs: Vec<Vec<f64>> = (0..12)
            .map(|case| {
                let fresh = fractions(4, 31 * seed + case);
                (0..3).map(|input| fresh[3] + 0.3 * fresh[input]).collect()
            })
            .collect();
        let moment =
            |a: usize, b: usize| inputs.iter().map(|row| row[a] * row[b]).sum::<f64>() / 12.0;
        let moments = (0..3).map(|a| (0..3).map(|b| moment(a, b)).collect()).collect();
        (moments, fractions(3, 1000 + seed).iter().map(|part| 9.0 * part - 4.5).collect())
    }

    fn error(form: &Form, wanted: &[f64], whole: &[f64]) -> f64 {
        let errors: Vec<f64> = wanted.iter().zip(whole).map(|(a, b)| a - b).collect();
        errors.iter().zip(&form.moments).map(|(error, row)| error * dot(row, &errors)).sum()
    }

    /// The least error of all whole numbers near the weights.
    fn brute_force(form: &Form, wanted: &[f64]) -> f64 {
        let near = |weight: f64| (-6..=6).map(move |change| weight.round() + f64::from(change));
        let mut least = f64::INFINITY;
        for a in near(wanted[0]) {
            for b in near(wanted[1]) {
                for c in near(wanted[2]) {
                    least = least.min(error(form, wanted, &[a, b, c]));
                }
            }
        }
        least
    }

    #[test]
    fn the_search_finds_nearly_what_trying_everything_finds() {
        let (mut sum, mut best, mut nearest) = (0.0, 0.0, 0.0);
        for seed in 0..200 {
            let (moments, wanted) = task(seed);
            let form = Form::of(&moments);
            let (whole, found) = form.round(&wanted, 1.0);
            assert!((found - error(&form, &wanted, &whole)).abs() < 1e-12);
            let least = brute_force(&form, &wanted);
            assert!(found >= least - 1e-12, "seed {seed}: {found}, brute force {least}");
            sum += found;
            best += least;
            nearest += error(&form, &wanted, &wanted.iter().map(|x| x.round()).collect::<Vec<_>>());
        }
        assert!(sum < 1.1 * best, "found ones err by {sum}, the best by {best}");
        assert!(nearest > 1.3 * sum, "the nearest weights err by {nearest}, found ones by {sum}");
    }

    #[test]
    fn no_single_change_would_lower_the_error() {
        for seed in 0..50 {
            let (moments, wanted) = task(seed);
            let form = Form::of(&moments);
            let (whole, found) = form.round(&wanted, 1.0);
            for (place, change) in (0..3).flat_map(|place| [(place, 1.0), (place, -1.0)]) {
                let mut other = whole.clone();
                other[place] += change;
                assert!(error(&form, &wanted, &other) >= found - 1e-9, "seed {seed}");
            }
        }
    }

    #[test]
    fn a_fitted_layer_makes_up_for_errors_of_its_inputs() {
        let matrix = Matrix { inputs: 2, outputs: 1, values: vec![0.5, -2.0] };
        let layer = Layer { bias: vec![0.0], relu: false, matrix };
        // x = (y0 + y1 / 4, y1 / 2), so that 0.5 y0 - 0.875 y1 are wanted.
        let second = vec![vec![4.0, 1.0], vec![1.0, 3.0]];
        let drift = vec![vec![0.25, 0.75], vec![-0.5, -1.5]];
        let second = Form::of(&second);
        let got = fitted(&layer, &second, &drift).matrix.values;
        // Damping leaves a hundredth.
        assert!((got[0] - 0.5).abs() < 0.02 && (got[1] + 0.875).abs() < 0.02, "{got:?}");
        let unmoved = vec![vec![0.0; 2]; 2];
        assert_eq!(fitted(&layer, &second, &unmoved), layer);
    }

    #[test]
    fn the_nearest_weights_are_within_half_a_step() {
        let values: Vec<f32> = (0..64).map(|i| ((i * 37 % 64) as f32 - 31.0) / 50.0).collect();
        let matrix = Matrix { inputs: 4, outputs: 16, values };
        let layer = Layer { bias: vec![0.5; 16], relu: true, matrix };
        let nearest = Rounded::nearest(&layer).layer(true);
        assert_eq!((&nearest.bias, nearest.relu), (&layer.bias, true));
        let largest: Vec<f32> = largest(&layer.matrix).collect();
        let pairs = layer.matrix.values.iter().zip(&nearest.matrix.values).enumerate();
        for (place, (want, got)) in pairs {
            let error = (want - got).abs() * MOST / largest[place % 16];
            assert!(error <= 0.501, "{want} became {got}");
        }
    }

    #[test]
    fn an_output_without_weights_stays_zero() {
        let matrix = Matrix { inputs: 2, outputs: 2, values: vec![0.0, 1.0, 1.0e-38, 0.5] };
        let layer = Layer { bias: vec![0.0; 2], relu: false, matrix };
        let moments = vec![vec![1.0, 0.2], vec![0.2, 0.5]];
        for rounded in [Rounded::nearest(&layer), Rounded::for_moments(&layer, &Form::of(&moments))]
        {
            assert_eq!([rounded.integers[0], rounded.integers[2]], [0; 2]);
            assert!(rounded.steps[0] == 0.0 && rounded.steps[1] > 0.0);
        }
    }

    #[test]
    fn inputs_that_never_differ_leave_weights_near_the_nearest() {
        let matrix = Matrix { inputs: 2, outputs: 1, values: vec![0.31, -1.0] };
        let layer = Layer { bias: vec![0.0], relu: false, matrix };
        let rounded = Rounded::for_moments(&layer, &Form::of(&[vec![0.0; 2], vec![0.0; 2]]));
        let got = rounded.layer(false).matrix.values;
        assert!((got[0] - 0.31).abs() < 0.01 && (got[1] + 1.0).abs() < 0.01, "{got:?}");
    }
}
