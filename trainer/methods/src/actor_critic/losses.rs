//! What the policies lose by what the critic values (dissertation section 3.3).

use sortie_nn::tape::{Pass, Var};

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

/// What several terms, at least one, come to.
pub(crate) fn whole(pass: &mut Pass<'_>, terms: Vec<Var>) -> Var {
    let sum = terms.into_iter().reduce(|sum, term| pass.add(sum, term));
    sum.expect("there are agents")
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
}
