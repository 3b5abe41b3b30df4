//! Steps down a gradient, as Adam takes them today and as it did when the dissertation was written.

use sortie_nn::optimise::Adam;

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
        adam.step(&mut [weights], &decayed, self.rate);
    }
}
