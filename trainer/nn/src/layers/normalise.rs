//! Normalisation: of the columns of a whole batch, before a network sees it, and of rows within one.

use super::matrix::Store;

/// Added to a variance, and to a mean square.
pub const EPSILON: f32 = 1e-5;

/// Mean and variance of every column of a batch.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Moments {
    /// `[columns]`
    pub means: Vec<f64>,
    /// `[columns]`, those of the batch itself: its sum of squares over its number of rows.
    pub variances: Vec<f64>,
}

impl Moments {
    /// Those of a batch `[rows, columns]`.
    pub fn of(columns: usize, rows: &[f32]) -> Self {
        let share = 1.0 / (rows.len() / columns).max(1) as f64;
        let mut means = vec![0.0; columns];
        for row in rows.chunks_exact(columns) {
            means.iter_mut().zip(row).for_each(|(mean, x)| *mean += share * f64::from(*x));
        }
        let mut variances = vec![0.0; columns];
        for row in rows.chunks_exact(columns) {
            for ((variance, mean), x) in variances.iter_mut().zip(&means).zip(row) {
                *variance += share * (f64::from(*x) - mean) * (f64::from(*x) - mean);
            }
        }
        Self { means, variances }
    }

    /// Takes them away from a batch `[rows, columns]`: columns of which they are the moments get mean 0 and variance 1.
    pub fn normalise(&self, rows: &mut [f32]) {
        let inverse = |variance: &f64| 1.0 / (variance + f64::from(EPSILON)).sqrt();
        let inverses: Vec<f64> = self.variances.iter().map(inverse).collect();
        for row in rows.chunks_exact_mut(self.means.len()) {
            for ((x, mean), inverse) in row.iter_mut().zip(&self.means).zip(&inverses) {
                *x = ((f64::from(*x) - mean) * inverse) as f32;
            }
        }
    }
}

/// Gives every column of a batch `[rows, columns]` mean 0 and variance 1, in place: batch normalisation of
/// inputs. Its numbers depend on the data only, so it comes before the network and before any chunks.
pub fn batch(columns: usize, rows: &mut [f32]) -> Moments {
    let moments = Moments::of(columns, rows);
    moments.normalise(rows);
    moments
}

/// Writes rows so scaled that the mean of their squares is 1 (RMSNorm, Zhang and Sennrich 2019, without its factors: those are
/// part of the layer behind it).
pub fn rows(columns: usize, x: &[f32], y: &mut [f32]) {
    for (x, y) in x.chunks_exact(columns).zip(y.chunks_exact_mut(columns)) {
        let scale = scale_of(x);
        x.iter().zip(y).for_each(|(x, y)| *y = scale * x);
    }
}

/// Takes the slopes by such rows `y` to slopes by the rows `x` that they were made of.
pub fn rows_backward(columns: usize, [x, y, d_y]: [&[f32]; 3], store: Store, d_x: &mut [f32]) {
    let rows = x.chunks_exact(columns).zip(y.chunks_exact(columns)).zip(d_y.chunks_exact(columns));
    for (((x, y), d_y), d_x) in rows.zip(d_x.chunks_exact_mut(columns)) {
        let scale = scale_of(x);
        let along = y.iter().zip(d_y).map(|(y, d)| y * d).sum::<f32>() / columns as f32;
        for ((y, d_y), d_x) in y.iter().zip(d_y).zip(d_x) {
            let slope = scale * (d_y - along * y);
            *d_x = if store == Store::Add { *d_x + slope } else { slope };
        }
    }
}

fn scale_of(row: &[f32]) -> f32 {
    let square = row.iter().map(|x| x * x).sum::<f32>() / row.len() as f32;
    1.0 / (square + EPSILON).sqrt()
}

#[cfg(test)]
mod tests {
    use crate::gradient_check::random;

    #[test]
    fn columns_of_a_batch_get_their_moments() {
        let mut batch = random(1, 40 * 3);
        batch.iter_mut().step_by(3).for_each(|x| *x = 5.0 + 2.0 * *x);
        super::batch(3, &mut batch);
        for column in 0..3 {
            let numbers = || batch.iter().skip(column).step_by(3);
            let mean = numbers().sum::<f32>() / 40.0;
            let variance = numbers().map(|x| x * x).sum::<f32>() / 40.0;
            assert!(mean.abs() < 1e-5 && (variance - 1.0).abs() < 1e-3, "{mean}, {variance}");
        }
    }
}
