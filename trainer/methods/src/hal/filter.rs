//! False negatives: states that look like positives though something else happened (dissertation section 6.3).

/// Degrees of freedom, as the public code has them whatever the sample.
const FREEDOM: f64 = 999.0;
/// The percentile that is to be covered, in deviations of a normal distribution: 0.9.
const COVERED: f64 = 1.281_551_6;
/// The confidence, likewise: 0.95.
const CONFIDENCE: f64 = 1.644_853_6;

/// How many deviations above the mean of so many numbers nine tenths of all lie, with a confidence of 0.95: the
/// one-sided tolerance bound of a normal distribution, whose non-central t is approximated in closed form.
pub fn tolerance(numbers: usize) -> f64 {
    let root = (numbers as f64).sqrt();
    let centre = COVERED * root;
    let shrink = CONFIDENCE * CONFIDENCE / (2.0 * FREEDOM);
    let spread = (1.0 + centre * centre / (2.0 * FREEDOM) - shrink).sqrt();
    (centre + CONFIDENCE * spread) / (1.0 - shrink) / root
}

/// Positives of a milestone, and how far others may be from the nearest of them.
#[derive(Clone, Debug, Default, serde::Serialize, serde::Deserialize)]
pub(super) struct Population {
    /// `[members, width]`: where they are embedded.
    members: Vec<f32>,
    margin: f32,
}

impl Population {
    /// From members and others of the same kind, `[others, width]`.
    pub(super) fn new(members: &[f32], others: &[f32], width: usize) -> Self {
        let mut distances: Vec<f32> =
            others.chunks_exact(width).map(|other| nearest(members, other)).collect();
        let count = distances.len() as f64;
        let mean = distances.iter().map(|it| f64::from(*it)).sum::<f64>() / count;
        let square = distances.iter().map(|it| (f64::from(*it) - mean).powi(2)).sum::<f64>();
        let deviation = (square / (count - 1.0).max(1.0)).sqrt();
        distances.sort_unstable_by(f32::total_cmp);
        distances.dedup();
        let margin = mean + tolerance(distances.len()) * deviation;
        Self { members: members.to_vec(), margin: margin as f32 }
    }

    /// Whether an embedded state looks like one of them.
    pub(super) fn holds(&self, state: &[f32]) -> bool {
        !self.members.is_empty() && nearest(&self.members, state) <= self.margin
    }
}

/// The distance to the nearest of some rows.
fn nearest(rows: &[f32], to: &[f32]) -> f32 {
    let squares = rows.chunks_exact(to.len()).map(|row| square_distance(row, to));
    squares.fold(f32::INFINITY, f32::min).sqrt()
}

/// The squared distance of two rows, in eight sums that the compiler keeps apart.
pub(super) fn square_distance(one: &[f32], other: &[f32]) -> f32 {
    let mut sums = [0.0_f32; 8];
    for (one, other) in one.chunks_exact(8).zip(other.chunks_exact(8)) {
        for (sum, (one, other)) in sums.iter_mut().zip(one.iter().zip(other)) {
            *sum += (one - other) * (one - other);
        }
    }
    sums.iter().sum()
}

#[cfg(test)]
mod tests {
    use sortie_nn::random::{normals, stream};

    use super::*;

    #[test]
    fn tolerances_agree_with_the_table_of_the_public_code() {
        for (numbers, want) in [
            (1, 2.9307),
            (2, 2.4487),
            (5, 2.0214),
            (10, 1.8064),
            (50, 1.5212),
            (100, 1.4549),
            (500, 1.3710),
            (1_000, 1.3538),
        ] {
            assert!((tolerance(numbers) / want - 1.0).abs() < 4e-4, "{numbers}");
        }
    }

    #[test]
    fn what_lies_among_positives_is_held_and_what_lies_far_off_is_not() {
        let mut random = stream(1, 1, 0);
        let mut cloud = |centre: f32, count: usize| -> Vec<f32> {
            normals(&mut random, 8 * count).iter().map(|number| centre + number).collect()
        };
        let population = Population::new(&cloud(0.0, 300), &cloud(0.0, 300), 8);
        let held =
            |rows: Vec<f32>| rows.chunks_exact(8).filter(|row| population.holds(row)).count();
        let near = held(cloud(0.0, 1_000));
        assert!((860..=960).contains(&near), "{near}");
        assert_eq!(held(cloud(5.0, 1_000)), 0);
        assert!(!Population::default().holds(&[0.0; 8]));
    }
}
