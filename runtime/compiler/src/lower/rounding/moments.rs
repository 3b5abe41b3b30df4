//! What a product is given: means and second moments.

/// Sums over the inputs of a product. They are taken in the order of the inputs, in f64, so that every machine has the
/// same bits.
#[derive(Clone, Debug)]
pub(crate) struct Moments {
    count: usize,
    sums: Vec<f64>,
    /// Sums of x_i x_j, `[inputs, inputs]`, of j up to i.
    products: Vec<f64>,
}

impl Moments {
    /// Of nothing yet.
    pub(crate) fn new(inputs: usize) -> Self {
        Self { count: 0, sums: vec![0.0; inputs], products: vec![0.0; inputs * inputs] }
    }

    /// Adds one input; one that is too large for a number is left out, as a plan refuses it.
    pub(crate) fn add(&mut self, input: &[f32]) {
        if input.iter().any(|value| !value.is_finite()) {
            return;
        }
        self.count += 1;
        let rows = self.products.chunks_exact_mut(input.len().max(1));
        for (place, ((value, sum), row)) in input.iter().zip(&mut self.sums).zip(rows).enumerate() {
            let value = f64::from(*value);
            if value == 0.0 {
                continue;
            }
            *sum += value;
            for (product, other) in row.iter_mut().zip(input).take(place + 1) {
                *product += value * f64::from(*other);
            }
        }
    }

    /// The mean of every input.
    pub(crate) fn mean(&self) -> Vec<f64> {
        self.sums.iter().map(|sum| sum / self.count.max(1) as f64).collect()
    }

    /// The mean of x xᵀ, row by row.
    pub(crate) fn second(&self) -> Vec<Vec<f64>> {
        let width = self.sums.len();
        let at = |row: usize, column: usize| {
            let (row, column) = (row.max(column), row.min(column));
            self.products[row * width + column] / self.count.max(1) as f64
        };
        (0..width).map(|row| (0..width).map(|column| at(row, column)).collect()).collect()
    }

    /// The same around the mean: what is left of errors whose mean is made up for.
    pub(crate) fn around_mean(&self) -> Vec<Vec<f64>> {
        let (mean, mut moments) = (self.mean(), self.second());
        for (row, of_row) in moments.iter_mut().zip(&mean) {
            row.iter_mut().zip(&mean).for_each(|(moment, of_column)| *moment -= of_row * of_column);
        }
        moments
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_those_of_the_inputs() {
        let mut moments = Moments::new(2);
        for input in [[1.0, 2.0], [3.0, 0.0], [f32::INFINITY, 1.0], [2.0, -5.0]] {
            moments.add(&input);
        }
        assert_eq!(moments.mean(), [2.0, -1.0]);
        let third = 1.0 / 3.0;
        let close = |got: Vec<Vec<f64>>, want: [[f64; 2]; 2]| {
            let pairs = got.concat().into_iter().zip(want.concat());
            assert!(pairs.into_iter().all(|(got, want)| (got - want).abs() < 1e-12), "{got:?}");
        };
        close(moments.second(), [[14.0 * third, -8.0 * third], [-8.0 * third, 29.0 * third]]);
        close(moments.around_mean(), [[2.0 * third, -2.0 * third], [-2.0 * third, 26.0 * third]]);
    }
}
