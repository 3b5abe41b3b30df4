//! What steps and options led to: returns, and where values are looked up behind them.

use sortie_learn::trajectory::{End, Place};

use super::replay::{NONE, Note, OptionPlace, Replay};

/// How steps become returns.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReturnRules {
    /// Steps before a value is looked up.
    pub(crate) steps: u8,
    /// Discount per step.
    pub(crate) discount: f32,
    /// Whether actions that change nothing are worth nothing.
    pub(crate) no_operations: bool,
    /// Whether steps behind which time was over, or nothing could be reached any more, are learned from; else what comes
    /// before them ends where they begin.
    pub(crate) time_outs: bool,
}

/// What a step is to who learns from it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Paid {
    pub(crate) reward: f32,
    /// Whether no later step belongs to the return.
    pub(crate) is_last: bool,
    /// Whether it has come to what it was for, behind which nothing is worth anything.
    pub(crate) is_over: bool,
}

/// A value that belongs to what was earned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Next {
    pub(crate) place: Place,
    /// What it counts.
    pub(crate) discount: f32,
    /// The actions that could be chosen there, as bits.
    pub(crate) mask: u32,
}

/// What steps from one on earned, and where a value is looked up behind them, if anywhere; none where that is not known
/// yet, or is not learned from.
pub(crate) fn returns(
    replay: &Replay,
    start: Place,
    rules: ReturnRules,
    pay: impl Fn(&Note, End) -> Paid,
) -> Option<(f32, Option<Next>)> {
    let (mut discount, mut earned, steps) = (1.0, 0.0, usize::from(rules.steps));
    for step in 0..steps {
        let place = start.after(step);
        if !replay.steps.has(place) {
            return None;
        }
        let (note, end) = (replay.steps.note(place), replay.steps.end(place));
        let before = Next { place, discount, mask: u32::MAX };
        if rules.no_operations && note.changed_nothing {
            // What changes nothing is worth nothing as a start; behind other steps it is not followed.
            return Some(if step == 0 { (0.0, None) } else { (earned, Some(before)) });
        }
        let Paid { reward, is_last, is_over } = pay(note, end);
        if is_last && !is_over && !rules.time_outs {
            return (step > 0).then_some((earned, Some(before)));
        }
        earned += discount * reward;
        if is_over || end == End::Over {
            return Some((earned, None));
        }
        discount *= rules.discount;
        if is_last || step + 1 == steps {
            let next = Next { place: place.after(1), discount, ..before };
            return replay.steps.has(next.place).then_some((earned, Some(next)));
        }
    }
    None
}

/// How options become returns.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CourseRules {
    /// Options before a value is looked up.
    pub(crate) options: usize,
    /// Discount per option.
    pub(crate) discount: f32,
    /// Discount per environment step of an option, besides.
    pub(crate) step_discount: f32,
    /// Whether options behind which time was over, or nothing could be reached any more, are learned from; else what comes
    /// before them ends where they begin.
    pub(crate) time_outs: bool,
    /// What the task is worth, and what a step that reached something else costs.
    pub(crate) worth: f32,
    pub(crate) cost: f32,
    /// Whether an option that fulfilled the task counts as meant to.
    pub(crate) relabel: bool,
    /// How many there are; the last is the task.
    pub(crate) milestones: usize,
}

/// What some options from one on led to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Course {
    pub(crate) start: Place,
    /// The goal that counts as chosen.
    pub(crate) goal: u8,
    /// What was earned.
    pub(crate) reward: f32,
    /// Where a value is looked up, and the milestones that could be chosen there.
    pub(crate) next: Option<Next>,
}

/// What the options of an episode from one on led to; none where that is not known yet.
pub(crate) fn course(
    replay: &Replay,
    (instance, number): OptionPlace,
    rules: CourseRules,
) -> Option<Course> {
    let CourseRules { milestones, relabel, .. } = rules;
    let task = milestones as u8 - 1;
    let first = *replay.option((instance, number))?;
    let goal = if relabel && first.reached == task { task } else { first.goal };
    let all = u32::MAX >> (32 - milestones);
    let (mut reward, mut discount, mut next) = (0.0, 1.0, None);
    for ahead in 0..rules.options as u32 {
        let Some(option) = replay.option((instance, number + ahead)) else { break };
        let over = |reward| Course { start: first.start, goal, reward, next: None };
        if option.reached == task {
            return Some(over(reward + discount * rules.worth));
        }
        if option.end != End::Open && !rules.time_outs {
            if ahead == 0 {
                return None;
            }
            next = Some((option.start, option.mask));
            break;
        }
        if option.reached != NONE {
            reward -= discount * rules.cost;
        }
        if option.end == End::Over {
            return Some(over(reward));
        }
        discount *= rules.discount * rules.step_discount.powi(option.steps.into());
        // The mask of an option that still runs is not known yet, nor one behind the last.
        next = Some((option.start.after(option.steps.into()), all));
        if option.end == End::TimedOut {
            break;
        }
    }
    let (place, mask) = next?;
    let following = replay.option((instance, number + rules.options as u32));
    let mask = following.filter(|option| option.start == place).map_or(mask, |option| option.mask);
    let next = Some(Next { place, discount, mask });
    replay.steps.has(place).then_some(Course { start: first.start, goal, reward, next })
}

#[cfg(test)]
mod tests;
