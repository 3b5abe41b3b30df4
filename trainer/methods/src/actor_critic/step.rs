//! Steps down a gradient, as Adam takes them today and as it did when the dissertation was written.

use sortie_nn::optimise::Adam;

/// What counts as zero where weights decay: those of units that serve nobody would shrink to denormal numbers, which
/// processors multiply a hundred times as slowly.
const NOTHING: f32 = 1e-20;

/// How weights move.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Step {
    /// Step size.
    pub(crate) rate: f32,
    /// What a weight adds to its gradient.
    pub(crate) decay: f32,
    /// Added to the denominator.
    pub(crate) epsilon: f32,
    /// Whether that is added before the correction of first steps, as PyTorch did until version 1.2.
    pub(crate) early_epsilon: bool,
}

impl Step {
    /// Takes one.
    pub(crate) fn take(self, adam: &mut Adam, weights: &mut [f32], gradient: &[f32]) {
        if self.early_epsilon {
            // Before the correction: what is added is corrected as well.
            let correction = 1.0 - 0.999_f64.powf((adam.steps + 1) as f64);
            adam.epsilon = (f64::from(self.epsilon) / correction.sqrt()) as f32;
        }
        if self.decay == 0.0 {
            adam.step(&mut [weights], gradient, self.rate);
            return;
        }
        let slopes = gradient.iter().zip(&*weights);
        let decayed: Vec<f32> = slopes.map(|(slope, weight)| slope + self.decay * weight).collect();
        adam.step(&mut [&mut *weights], &decayed, self.rate);
        for number in weights.iter_mut().chain(&mut adam.mean) {
            if number.abs() < NOTHING {
                *number = 0.0;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_that_only_decay_end_at_zero_and_never_as_denormal_numbers() {
        let step = Step { rate: 1e-3, decay: 1e-3, epsilon: 1e-8, early_epsilon: true };
        let (mut adam, mut weights) = (Adam::new(2, 1e-8), [0.3, 0.3]);
        for time in 0..40_000 {
            // The first is of a unit that served somebody once, the second of one that still does.
            let once = if time < 10 { 1.0 } else { 0.0 };
            step.take(&mut adam, &mut weights, &[once, 1.0 - 2.0 * (time % 2) as f32]);
            let small = |number: &f32| *number != 0.0 && number.abs() < NOTHING;
            assert!(!weights.iter().chain(&adam.mean).any(small), "{time}: {weights:?} {adam:?}");
        }
        assert_eq!((weights[0], adam.mean[0]), (0.0, 0.0));
        assert!(weights[1] != 0.0);
    }
}
