//! How an agent's subtask is drawn from its logits.

use core::ops::Range;

use super::Proposing;
use super::memory::Memory;
use super::scene::Scene;
use crate::allocator::AllocateError;
use crate::limits;
use crate::math::ln;
use crate::ops::proposal_arena::TOGETHER;
use crate::plan::Plan;

/// The place of each of them.
const LANES: [u32; TOGETHER] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];

/// Chooses one agent's subtask in one proposal.
///
/// Agents choose in rising order; proposals may be asked in any. The logits `[T]` are finite, and not normalised: their
/// softmax over the open subtasks is the policy. A choice that is not open makes the decision fail.
#[expect(private_interfaces, reason = "the run is for draws of this crate to have compiled once")]
pub trait Draw {
    /// The subtask; at least one is open.
    fn draw(&mut self, proposal: usize, agent: usize, logits: &[f32], open_tasks: u32) -> usize;

    /// The same for at most [`TOGETHER`] proposals, which have a column each in the logits `[T]`.
    fn draw_together(
        &mut self,
        proposals: Range<usize>,
        agent: usize,
        logits: &[[f32; TOGETHER]],
        open_tasks: u32,
    ) -> [usize; TOGETHER] {
        let mut choices = [usize::MAX; TOGETHER];
        for (column, (choice, proposal)) in choices.iter_mut().zip(proposals).enumerate() {
            let mut own = [0.0; limits::TASKS];
            for (own, logits) in own.iter_mut().zip(logits) {
                *own = logits.get(column).copied().unwrap_or(f32::NAN);
            }
            let own = own.get(..logits.len()).unwrap_or(&own);
            *choice = self.draw(proposal, agent, own, open_tasks);
        }
        choices
    }

    /// Runs the networks of a plan, with every choice drawn here.
    #[doc(hidden)]
    #[inline(always)]
    fn propose(
        &mut self,
        plan: &Plan<'_>,
        scene: Scene<'_>,
        memory: &mut Memory<'_>,
    ) -> Result<(), AllocateError>
    where
        Self: Sized,
    {
        plan.arithmetic().run(Proposing { scene, memory, draw: self })
    }
}

/// Draws from the policy by Gumbel noise that is computed from a seed and a place: the largest sum of logit and noise.
/// Proposal 0 gets no noise, and so is the greedy allocation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GumbelDraw {
    /// The seed.
    pub seed: u64,
}

#[expect(private_interfaces, reason = "those of the trait")]
impl Draw for GumbelDraw {
    #[inline(always)]
    fn draw(&mut self, proposal: usize, agent: usize, logits: &[f32], open_tasks: u32) -> usize {
        let mut sums = [0.0; limits::TASKS];
        let first = ((proposal as u32) << 16) | ((agent as u32) << 8);
        for ((sum, logit), place) in sums.iter_mut().zip(logits).zip(first..) {
            let noise = if proposal == 0 { 0.0 } else { gumbel(self.seed, place) };
            *sum = logit + noise;
        }
        largest_open(sums.get(..logits.len()).unwrap_or(&[]), open_tasks)
    }

    /// Without branches that nobody could predict, and in vectors: noise is worth some additions.
    #[inline(always)]
    fn draw_together(
        &mut self,
        proposals: Range<usize>,
        agent: usize,
        logits: &[[f32; TOGETHER]],
        open_tasks: u32,
    ) -> [usize; TOGETHER] {
        let mut largest = [f32::NEG_INFINITY; TOGETHER];
        let mut choices = [u32::MAX; TOGETHER];
        for (task, logits) in (0..limits::TASKS as u32).zip(logits) {
            if open_tasks >> task & 1 == 0 {
                continue;
            }
            let lanes = largest.iter_mut().zip(&mut choices).zip(logits).zip(LANES);
            for (((largest, choice), logit), lane) in lanes {
                let proposal = proposals.start as u32 + lane;
                let noise = gumbel(self.seed, proposal << 16 | (agent as u32) << 8 | task);
                let sum = logit + if proposal == 0 { 0.0 } else { noise };
                *choice = if sum > *largest { task } else { *choice };
                *largest = if sum > *largest { sum } else { *largest };
            }
        }
        choices.map(|choice| choice as usize)
    }

    /// Compiled here once, as runs of [`AllOperators`](crate::operators::AllOperators) are.
    #[cfg_attr(feature = "std", inline(never))]
    fn propose(
        &mut self,
        plan: &Plan<'_>,
        scene: Scene<'_>,
        memory: &mut Memory<'_>,
    ) -> Result<(), AllocateError> {
        plan.arithmetic().run(Proposing { scene, memory, draw: self })
    }
}

/// The open subtask of the largest number, the first of several. A number that is none never wins.
pub fn largest_open(numbers: &[f32], open_tasks: u32) -> usize {
    let mut best = (f32::NEG_INFINITY, usize::MAX);
    for (task, number) in numbers.iter().enumerate().take(limits::TASKS) {
        if open_tasks >> task & 1 == 1 && *number > best.0 {
            best = (*number, task);
        }
    }
    best.1
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
    fn draws_the_same_alone_and_together() {
        let mut draw = GumbelDraw { seed: 0x1234_5678_9abc };
        let logits = [0.1, -0.7, 0.4, 0.35, f32::NAN, 0.9, 0.0];
        for (first, open) in [(0, 0b111_1111), (16, 0b010_1010), (32, 0b001_0000)] {
            let all = logits.map(|logit| [logit; TOGETHER]);
            let together = draw.draw_together(first..first + TOGETHER, 5, &all, open);
            for (proposal, choice) in (first..).zip(together) {
                let alone = draw.draw(proposal, 5, &logits, open);
                assert_eq!(
                    choice.min(logits.len()),
                    alone.min(logits.len()),
                    "proposal {proposal}"
                );
            }
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
