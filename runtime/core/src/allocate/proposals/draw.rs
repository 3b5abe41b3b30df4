//! How an agent's subtask is drawn from its logits.

use crate::limits;
use crate::math::ln;

/// Numbers of noise that are computed at once.
const TOGETHER: usize = 8;

/// The place of each within a group.
const LANES: [u32; TOGETHER] = [0, 1, 2, 3, 4, 5, 6, 7];

/// Chooses one agent's subtask in one proposal.
///
/// Agents choose in rising order; proposals may be asked in any. The logits `[T]` are finite, and not normalised: their
/// softmax over the open subtasks is the policy. A choice that is not open makes the decision fail.
pub trait Draw {
    /// The subtask; at least one is open.
    fn draw(&mut self, proposal: usize, agent: usize, logits: &[f32], open_tasks: u32) -> usize;
}

/// Draws from the policy by Gumbel noise that is computed from a seed and a place: the largest sum of logit and noise.
/// Proposal 0 gets no noise, and so is the greedy allocation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GumbelDraw {
    /// The seed.
    pub seed: u64,
}

impl Draw for GumbelDraw {
    #[inline(always)]
    fn draw(&mut self, proposal: usize, agent: usize, logits: &[f32], open_tasks: u32) -> usize {
        let mut sums = [0.0; limits::TASKS];
        if proposal > 0 {
            let first = ((proposal as u32) << 16) | ((agent as u32) << 8);
            // Whole groups, of a size that the compiler knows: all numbers of a group are computed at once.
            let (groups, _) = sums.as_chunks_mut::<TOGETHER>();
            let groups = groups.iter_mut().zip((first..).step_by(TOGETHER));
            for (noise, first) in groups.take(logits.len().div_ceil(TOGETHER)) {
                for (noise, place) in noise.iter_mut().zip(LANES) {
                    *noise = gumbel(self.seed, first | place);
                }
            }
        }
        for (sum, logit) in sums.iter_mut().zip(logits) {
            *sum += logit;
        }
        largest_open(sums.get(..logits.len()).unwrap_or(&[]), open_tasks)
    }
}

/// The open subtask of the largest number, the first of several. A number that is none never wins.
#[inline(always)]
pub fn largest_open(numbers: &[f32], open_tasks: u32) -> usize {
    // No branches: nobody could predict them.
    let mut open = [f32::NEG_INFINITY; limits::TASKS];
    for ((place, number), task) in open.iter_mut().zip(numbers).zip(0..) {
        let counts = (open_tasks >> task & 1 == 1) & (*number > f32::NEG_INFINITY);
        *place = if counts { *number } else { f32::NEG_INFINITY };
    }
    let largest = largest(open);
    let mut winners = 0_u32;
    for (task, number) in (0..).zip(open) {
        winners |= u32::from((number == largest) & (number > f32::NEG_INFINITY)) << task;
    }
    if winners == 0 { usize::MAX } else { winners.trailing_zeros() as usize }
}

/// The largest of numbers none of which is NaN.
#[inline(always)]
fn largest(mut numbers: [f32; limits::TASKS]) -> f32 {
    let mut half = limits::TASKS / 2;
    while half > 0 {
        if let Some((low, high)) = numbers.split_at_mut_checked(half) {
            for (low, high) in low.iter_mut().zip(high) {
                *low = if *high > *low { *high } else { *low };
            }
        }
        half /= 2;
    }
    let [largest, ..] = numbers;
    largest
}

/// -ln(-ln u) of a uniform number u between 0 and 1 that belongs to a seed and a place.
#[inline(always)]
fn gumbel(seed: u64, place: u32) -> f32 {
    let word = scramble(scramble(place ^ seed as u32).wrapping_add((seed >> 32) as u32));
    let uniform = ((word >> 9) as f32 + 0.5) * (1.0 / 8_388_608.0);
    -ln(-ln(uniform))
}

/// Every bit of the result depends on every bit of `word`, and no two words give the same.
#[inline(always)]
pub(super) fn scramble(mut word: u32) -> u32 {
    word ^= word >> 16;
    word = word.wrapping_mul(0x7feb_352d);
    word ^= word >> 15;
    word = word.wrapping_mul(0x846c_a68b);
    word ^ word >> 16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_distributed_as_gumbel_noise() {
        let (mut sum, mut squares) = (0.0, 0.0);
        let count = 200_000;
        for place in 0..count {
            let noise = f64::from(gumbel(7, place));
            assert!(noise.is_finite());
            (sum, squares) = (sum + noise, squares + noise * noise);
        }
        let mean = sum / f64::from(count);
        let variance = squares / f64::from(count) - mean * mean;
        assert!((mean - 0.577_216).abs() < 0.01, "{mean}");
        assert!((variance - 1.644_934).abs() < 0.03, "{variance}");
    }

    #[test]
    fn draws_have_the_shares_of_the_softmax() {
        let logits = [1.0_f32, -0.5, 9.0, 0.25, 0.0];
        let open = 0b11011;
        let mut drawn = [0_u32; 5];
        let mut draw = GumbelDraw { seed: 3 };
        for seed in 0..2_000 {
            draw.seed = seed;
            for proposal in 1..20 {
                drawn[draw.draw(proposal, 2, &logits, open)] += 1;
            }
        }
        let total: f32 = [0, 1, 3, 4].iter().map(|task| logits[*task as usize].exp()).sum();
        assert_eq!(drawn[2], 0, "closed");
        for task in [0, 1, 3, 4] {
            let (got, want) = (drawn[task] as f32 / 38_000.0, logits[task].exp() / total);
            assert!((got - want).abs() < 0.01, "subtask {task}: {got}, want {want}");
        }
    }

    #[test]
    fn proposal_zero_is_greedy_and_ties_go_to_the_first() {
        let mut draw = GumbelDraw { seed: 1 };
        assert_eq!(draw.draw(0, 5, &[0.5, 2.0, 7.0, 2.0], 0b1011), 1);
        assert_eq!(largest_open(&[f32::NAN, -1.0], 0b11), 1);
        assert_eq!(largest_open(&[1.0], 0), usize::MAX);
    }
}
