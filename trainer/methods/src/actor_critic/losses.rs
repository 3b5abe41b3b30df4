//! What the policies lose by what the critic values (dissertation section 3.3), and steps down a gradient: as Adam takes
//! them today, and as it did when the dissertation was written.

use std::ops::Range;

use sortie_nn::optimise::Adam;
use sortie_nn::tape::{Chunks, Pass, Var};

use super::acting::Policies;
use super::batch::Batch;
use super::groups::Groups;

/// What a state is worth to an agent that draws its action: `sum of p (Q - entropy log p)`.
pub(crate) fn soft_value(values: &[f32], logarithms: &[f32], entropy: f32) -> f32 {
    let worth = values.iter().zip(logarithms);
    worth.map(|(value, log)| log.exp() * (value - entropy * log)).sum()
}

/// The sum over rows of `sum of p (entropy log p - Q)`.
pub(crate) fn expected_loss(pass: &mut Pass<'_>, scores: Var, values: &[f32], entropy: f32) -> Var {
    let columns = pass.size(scores)[1];
    let (chances, logarithms) = (pass.softmax(scores), pass.log_softmax(scores));
    let values = pass.input(columns, values);
    let (cost, values) = (pass.scale(logarithms, entropy), pass.scale(values, -1.0));
    let cost = pass.add(cost, values);
    let cost = pass.multiply(chances, cost);
    sum(pass, cost)
}

/// The sum over rows of `log p(a) (entropy log p(a) - advantage)`, the bracket a constant: the advantage is the value of
/// the action beyond the mean value of all by their chances.
pub(crate) fn drawn_loss(
    pass: &mut Pass<'_>,
    scores: Var,
    values: &[f32],
    actions: &[u32],
    entropy: f32,
) -> Var {
    let columns = pass.size(scores)[1];
    let logarithms = pass.log_softmax(scores);
    let rows = pass.values(logarithms).chunks_exact(columns).zip(values.chunks_exact(columns));
    let factors: Vec<f32> = rows
        .zip(actions)
        .map(|((logarithms, values), action)| {
            let mean: f32 =
                logarithms.iter().zip(values).map(|(log, value)| log.exp() * value).sum();
            let action = *action as usize;
            entropy * logarithms[action] - (values[action] - mean)
        })
        .collect();
    let chosen = pass.pick(logarithms, actions);
    let factors = pass.input(1, &factors);
    let cost = pass.multiply(chosen, factors);
    sum(pass, cost)
}

/// The sum over rows of the slopes of a cost by actions times their relaxed chances: straight-through, as the critic was
/// shown the largest of the shaken scores instead, whose slopes these are.
pub(crate) fn relaxed_loss(pass: &mut Pass<'_>, scores: Var, noise: &[f32], slopes: &[f32]) -> Var {
    let columns = pass.size(scores)[1];
    let (noise, slopes) = (pass.input(columns, noise), pass.input(columns, slopes));
    let shaken = pass.add(scores, noise);
    let chances = pass.softmax(shaken);
    let cost = pass.multiply(chances, slopes);
    sum(pass, cost)
}

pub(crate) fn sum(pass: &mut Pass<'_>, x: Var) -> Var {
    let [rows, columns] = pass.size(x);
    let row = pass.reshape(x, rows * columns);
    pass.sum_columns(row)
}

pub(crate) fn added(pass: &mut Pass<'_>, loss: Option<Var>, part: Var) -> Var {
    match loss {
        Some(loss) => pass.add(loss, part),
        None => part,
    }
}

/// Policies, and how their gradient is computed.
pub(crate) struct Following<'a> {
    pub(crate) policies: &'a Policies,
    pub(crate) groups: &'a Groups,
    /// What the mean squared score of an action counts.
    pub(crate) score_penalty: f32,
    pub(crate) threads: usize,
    pub(crate) chunks: &'a mut Chunks,
}

impl Following<'_> {
    /// Writes the gradient of the mean, over records, of what `loss` says of the scores of each group and head, by their
    /// number, in some of the group's rows.
    pub(crate) fn gradient(
        self,
        batch: &Batch,
        gradient: &mut Vec<f32>,
        loss: impl Fn(&mut Pass<'_>, usize, Var, Range<usize>) -> Var + Sync,
    ) {
        let Self { policies, groups, score_penalty, threads, chunks } = self;
        let share = 1.0 / batch.records as f32;
        let weights = &policies.parameters.values;
        gradient.clear();
        gradient.resize(weights.len(), 0.0);
        chunks.gradient(threads, weights, batch.records, gradient, |pass, range| {
            let all = policies.scores(pass, groups, &batch.observations, range.clone());
            let mut whole = None;
            for (index, scores) in all.into_iter().enumerate() {
                let group = &groups.0[index / policies.heads()];
                let rows = range.start * group.agents.len()..range.end * group.agents.len();
                let gain = loss(pass, index, scores, rows);
                let gain = pass.scale(gain, share);
                whole = Some(added(pass, whole, gain));
                let squares = pass.multiply(scores, scores);
                let squares = sum(pass, squares);
                let penalty = score_penalty * share / group.actions as f32;
                let squares = pass.scale(squares, penalty);
                whole = Some(added(pass, whole, squares));
            }
            whole.expect("there are agents")
        });
    }
}

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
    use sortie_nn::layers::softmax;
    use sortie_nn::tape::Tape;

    use super::*;

    /// The slopes by the scores of one row of a loss.
    fn slopes(scores: &[f32], loss: impl Fn(&mut Pass<'_>, Var) -> Var) -> Vec<f32> {
        let mut tape = Tape::default();
        let mut pass = tape.begin(&[]);
        let leaf = pass.leaf(scores.len(), scores);
        let loss = loss(&mut pass, leaf);
        pass.backward(loss, &mut []);
        pass.slopes(leaf).unwrap().to_vec()
    }

    #[test]
    fn the_expected_loss_has_the_slopes_that_drawn_losses_have_on_average() {
        let (scores, values, entropy) = ([0.3, -0.7, 1.1], [2.0, -1.0, 0.5], 0.4);
        let mut chances = scores;
        softmax::forward(&mut chances);
        let expected =
            slopes(&scores, |pass, scores| expected_loss(pass, scores, &values, entropy));
        let mut mean = [0.0; 3];
        for (action, chance) in chances.iter().enumerate() {
            let drawn = |pass: &mut Pass<'_>, scores| {
                drawn_loss(pass, scores, &values, &[action as u32], entropy)
            };
            let of_action = slopes(&scores, drawn);
            mean.iter_mut().zip(of_action).for_each(|(mean, slope)| *mean += chance * slope);
        }
        for (expected, mean) in expected.iter().zip(mean) {
            assert!((expected - mean).abs() < 1e-6, "{expected} {mean}");
        }
        let worth = soft_value(&values, &chances.map(f32::ln), entropy);
        let parts = chances.iter().zip(values).map(|(p, q)| p * (q - entropy * p.ln()));
        assert!((worth - parts.sum::<f32>()).abs() < 1e-6);
    }

    #[test]
    fn the_relaxed_loss_has_the_slopes_of_differences() {
        let (scores, noise, slopes_by) = ([0.3, -0.7, 1.1], [0.5, 1.2, -0.4], [2.0, -1.0, 0.5]);
        let loss = |pass: &mut Pass<'_>, scores| relaxed_loss(pass, scores, &noise, &slopes_by);
        let found = slopes(&scores, loss);
        let at = |scores: &[f32]| {
            let mut chances: Vec<f32> = scores.iter().zip(noise).map(|(s, n)| s + n).collect();
            softmax::forward(&mut chances);
            chances.iter().zip(slopes_by).map(|(p, slope)| p * slope).sum::<f32>()
        };
        for (place, found) in found.into_iter().enumerate() {
            let (mut above, mut below) = (scores, scores);
            above[place] += 1e-2;
            below[place] -= 1e-2;
            let want = (at(&above) - at(&below)) / 2e-2;
            assert!((found - want).abs() < 1e-3, "{found} {want}");
        }
    }

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
