//! What turns gradients into better weights: clipping, Adam, RMSprop, and two kinds of moving averages.
//!
//! All of them run over flat parameter vectors.

use crate::layers::vectors::run_widest;

/// Scales the gradient so that its Euclidean norm is at most `limit`; returns the norm before.
///
/// The scale is `min(1, limit / (norm + 1e-6))`, as in the public code. The norm is summed in f64.
pub fn clip_norm(gradient: &mut [f32], limit: f32) -> f32 {
    let norm = gradient.iter().map(|g| f64::from(*g) * f64::from(*g)).sum::<f64>().sqrt() as f32;
    let scale = limit / (norm + 1e-6);
    if scale < 1.0 {
        gradient.iter_mut().for_each(|g| *g *= scale);
    }
    norm
}

/// Moves `average` a share `rate` of the way towards `values`.
pub fn move_towards(average: &mut [f32], values: &[f32], rate: f32) {
    run_widest(
        #[inline(always)]
        || {
            for (average, value) in average.iter_mut().zip(values) {
                *average += rate * (value - *average);
            }
        },
    );
}

/// The Adam optimiser (Kingma and Ba 2015), with bias correction.
#[derive(Clone, Debug, PartialEq)]
pub struct Adam {
    /// Running mean of the gradient.
    pub mean: Vec<f32>,
    /// Running mean of the squared gradient.
    pub square: Vec<f32>,
    /// Steps taken.
    pub steps: u64,
}

/// What is added to what.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AdamRules {
    /// Added to the denominator.
    pub epsilon: f32,
    /// Whether that is added before the correction of first steps, as PyTorch did until version 1.2.
    pub early_epsilon: bool,
    /// How much of a weight is added to its slope.
    pub decay: f32,
}

/// What counts as zero where weights decay: those of units that serve nobody would shrink to denormal numbers, which
/// processors multiply a hundred times as slowly.
const NOTHING: f32 = 1e-20;

impl Adam {
    const DECAY_MEAN: f32 = 0.9;
    const DECAY_SQUARE: f32 = 0.999;

    /// An optimiser that has taken no step yet.
    pub fn new(parameters: usize) -> Self {
        Self { mean: vec![0.0; parameters], square: vec![0.0; parameters], steps: 0 }
    }

    /// Takes one step down the gradient, which has a number for every parameter.
    pub fn step(
        &mut self,
        rules: AdamRules,
        parameters: &mut [f32],
        gradient: &[f32],
        learning_rate: f32,
    ) {
        self.steps += 1;
        let AdamRules { mut epsilon, early_epsilon, decay } = rules;
        if early_epsilon {
            // Before the correction: what is added is corrected as well.
            let correction = 1.0 - 0.999_f64.powf(self.steps as f64);
            epsilon = (f64::from(epsilon) / correction.sqrt()) as f32;
        }
        let correction = |decay: f32| (1.0 - f64::from(decay).powf(self.steps as f64)) as f32;
        let rate = learning_rate / correction(Self::DECAY_MEAN);
        let square_scale = 1.0 / correction(Self::DECAY_SQUARE);
        let decays = decay != 0.0;
        let settled = |number: f32| if decays && number.abs() < NOTHING { 0.0 } else { number };
        let moments = self.mean.iter_mut().zip(&mut self.square);
        let all = parameters.iter_mut().zip(gradient).zip(moments);
        run_widest(
            #[inline(always)]
            || {
                for ((parameter, gradient), (mean, square)) in all {
                    let slope = if decays { gradient + decay * *parameter } else { *gradient };
                    *mean += (1.0 - Self::DECAY_MEAN) * (slope - *mean);
                    *square += (1.0 - Self::DECAY_SQUARE) * (slope * slope - *square);
                    *parameter -= rate * *mean / ((*square * square_scale).sqrt() + epsilon);
                    (*parameter, *mean) = (settled(*parameter), settled(*mean));
                }
            },
        );
    }
}

/// RMSprop without momentum or centring, as PyTorch has it: the optimiser of the public code.
#[derive(Clone, Debug, PartialEq)]
pub struct RmsProp {
    /// Running mean of the squared gradient.
    pub square: Vec<f32>,
}

impl RmsProp {
    const DECAY: f32 = 0.99;
    const EPSILON: f32 = 1e-5;

    /// An optimiser that has taken no step yet.
    pub fn new(parameters: usize) -> Self {
        Self { square: vec![0.0; parameters] }
    }

    /// Takes one step down the gradient, which has a number for every parameter.
    pub fn step(&mut self, parameters: &mut [f32], gradient: &[f32], learning_rate: f32) {
        let parameters = parameters.iter_mut().zip(gradient).zip(&mut self.square);
        run_widest(
            #[inline(always)]
            || {
                for ((parameter, gradient), square) in parameters {
                    *square = Self::DECAY * *square + (1.0 - Self::DECAY) * gradient * gradient;
                    *parameter -= learning_rate * gradient / (square.sqrt() + Self::EPSILON);
                }
            },
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULES: AdamRules = AdamRules { epsilon: 1e-5, early_epsilon: false, decay: 0.0 };

    #[test]
    fn clipping_keeps_the_direction_and_the_limit() {
        let mut gradient = [3.0, -4.0];
        assert_eq!(clip_norm(&mut gradient, 10.0), 5.0);
        assert_eq!(gradient, [3.0, -4.0]);
        assert_eq!(clip_norm(&mut gradient, 1.0), 5.0);
        assert!((gradient[0] - 0.6).abs() < 1e-6 && (gradient[1] + 0.8).abs() < 1e-6);
    }

    #[test]
    fn first_adam_steps_agree_with_the_formula() {
        let mut adam = Adam::new(1);
        let mut parameter = [1.0];
        adam.step(RULES, &mut parameter, &[0.5], 0.1);
        assert!((parameter[0] - (1.0 - 0.1 * 0.5 / (0.5 + 1e-5))).abs() < 1e-6);
        adam.step(RULES, &mut parameter, &[-0.25], 0.1);
        let mean = (0.9 * 0.1 * 0.5 + 0.1 * -0.25) / (1.0 - 0.81);
        let square = (0.999 * 0.001 * 0.25 + 0.001 * 0.0625) / (1.0 - 0.999_f32.powi(2));
        let want = 1.0 - 0.1 * 0.5 / (0.5 + 1e-5) - 0.1 * mean / (square.sqrt() + 1e-5);
        assert!((parameter[0] - want).abs() < 1e-5, "{} against {want}", parameter[0]);
    }

    #[test]
    fn weights_that_only_decay_end_at_zero_and_never_as_denormal_numbers() {
        let rules = AdamRules { epsilon: 1e-8, early_epsilon: true, decay: 1e-3 };
        let (mut adam, mut weights) = (Adam::new(2), [0.3, 0.3]);
        for time in 0..40_000 {
            // The first is of a unit that served somebody once, the second of one that still does.
            let once = if time < 10 { 1.0 } else { 0.0 };
            adam.step(rules, &mut weights, &[once, 1.0 - 2.0 * (time % 2) as f32], 1e-3);
            let small = |number: &f32| *number != 0.0 && number.abs() < NOTHING;
            assert!(!weights.iter().chain(&adam.mean).any(small), "{time}: {weights:?} {adam:?}");
        }
        assert_eq!((weights[0], adam.mean[0]), (0.0, 0.0));
        assert!(weights[1] != 0.0);
    }

    #[test]
    fn what_is_added_early_is_corrected_as_well() {
        let step = |early_epsilon: bool, epsilon: f32| {
            let (mut adam, mut weight) = (Adam::new(1), [1.0]);
            let rules = AdamRules { epsilon, early_epsilon, decay: 0.0 };
            adam.step(rules, &mut weight, &[0.5], 0.1);
            weight[0]
        };
        // The square of the first step counts a thousandth.
        assert_eq!(step(true, 0.1), step(false, 0.1 / 0.001_f32.sqrt()));
        assert_ne!(step(true, 0.1), step(false, 0.1));
    }

    #[test]
    fn adam_finds_the_bottom_of_a_bowl() {
        let mut adam = Adam::new(2);
        let mut at = [3.0, -2.0];
        for step in 0..2000 {
            let slope = [2.0 * (at[0] - 1.0), 8.0 * (at[1] - 0.5)];
            adam.step(RULES, &mut at, &slope, 0.05 * (1.0 - step as f32 / 2000.0));
        }
        assert!((at[0] - 1.0).abs() < 1e-3 && (at[1] - 0.5).abs() < 1e-3, "{at:?}");
    }

    #[test]
    fn averages_move_by_their_rate() {
        let mut average = [0.0, 1.0];
        move_towards(&mut average, &[1.0, 1.0], 0.25);
        assert_eq!(average, [0.25, 1.0]);
    }
}
