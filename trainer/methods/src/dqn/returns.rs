//! What an agent without goals is paid, step by step, and where a value is looked up behind it.

use crate::options::{NONE, Next, Place, Replay};

/// How steps become returns.
#[derive(Clone, Copy, Debug)]
pub(super) struct PayRules {
    /// Steps before a value is looked up.
    pub(super) steps: u8,
    /// Discount per step.
    pub(super) discount: f32,
    /// Whether actions that change nothing are worth nothing.
    pub(super) no_operations: bool,
    /// Whether steps behind which time was over, or nothing could be reached any more, are learned from; else what comes
    /// before them ends where they begin.
    pub(super) time_outs: bool,
    /// What a step earns that is paid for, and what every other costs.
    pub(super) paid: f32,
    pub(super) cost: f32,
    /// The milestone that is the task, and whether it alone is paid for.
    pub(super) task: u8,
    pub(super) task_alone: bool,
}

impl PayRules {
    /// What a step earns; nothing where the beginning of its episode is not kept, which tells what it was paid for.
    fn pay(&self, replay: &Replay, place: Place) -> Option<f32> {
        let reached = replay.moment(place).reached;
        let is_paid = if self.task_alone {
            reached == self.task
        } else {
            reached != NONE && is_first(replay, place)?
        };
        Some(if is_paid { self.paid } else { -self.cost })
    }
}

/// Whether an episode had not reached before what a step reached.
fn is_first(replay: &Replay, place: Place) -> Option<bool> {
    let reached = replay.moment(place).reached;
    for before in (0..place.time).rev().map(|time| Place { time, ..place }) {
        if !replay.has(before) {
            return None;
        }
        let moment = replay.moment(before);
        if moment.is_last || moment.reached == reached {
            return Some(moment.is_last);
        }
    }
    Some(true)
}

/// What steps from one on earned, and where a value is looked up behind them; nothing where that is not known yet, or is
/// not learned from.
pub(super) fn returns(
    replay: &Replay,
    start: Place,
    rules: PayRules,
) -> Option<(f32, Option<Next>)> {
    let (mut discount, mut earned) = (1.0, 0.0);
    for step in 0..u32::from(rules.steps) {
        let (place, next) = (start.after(step), start.after(step + 1));
        if !replay.has(place) || !replay.has(next) {
            return None;
        }
        let moment = replay.moment(place);
        let before = Next { place, discount, mask: u32::MAX };
        if rules.no_operations && moment.changed_nothing {
            // What changes nothing is worth nothing as a start; behind other steps it is not followed.
            return Some(if step == 0 { (0.0, None) } else { (earned, Some(before)) });
        }
        let is_over = replay.moment(next).is_last;
        if is_over && moment.reached != rules.task && !rules.time_outs {
            return (step > 0).then_some((earned, Some(before)));
        }
        earned += discount * rules.pay(replay, place)?;
        if moment.terminated {
            return Some((earned, None));
        }
        discount *= rules.discount;
        if is_over || step + 1 == u32::from(rules.steps) {
            return Some((earned, Some(Next { place: next, discount, ..before })));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::options::Moment;

    /// Two episodes, one that is solved and one that ends by its time, and the first steps of a third.
    fn kept() -> (Vec<Moment>, Replay) {
        let step = Moment { reached: NONE, option_reached: NONE, ..Moment::default() };
        let mut moments = vec![step; 40];
        for (at, reached) in [(3, 0), (5, 0), (8, 1), (13, 2), (17, 1), (35, 0), (37, 1), (38, 1)] {
            moments[at] = Moment { reached, ends_option: true, ..step };
        }
        moments[13].terminated = true;
        moments[14].is_last = true;
        moments[20].changed_nothing = true;
        moments[29].ends_option = true;
        moments[30].is_last = true;
        // Nothing can be reached any more.
        moments[35].terminated = true;
        moments[36].is_last = true;
        let mut replay = Replay::new(1, 100, 1, 3);
        for (index, moment) in moments.iter().enumerate() {
            replay.push(0, &[index as u8], *moment);
        }
        (moments, replay)
    }

    /// Rewards summed up from the front, and what a value behind them counts, where it is looked up.
    fn naive(
        moments: &[Moment],
        start: usize,
        rules: PayRules,
    ) -> Option<(f32, f32, Option<usize>)> {
        let end = (start..moments.len()).find(|at| moments[*at].is_last).unwrap_or(moments.len());
        let solved = end > 0 && moments[end - 1].reached == rules.task;
        // The last step of an episode that was not solved may not count.
        let unknown = end < moments.len() && !solved && !rules.time_outs;
        let known = if unknown { end - 1 } else { end };
        let idle = (start..known).find(|at| rules.no_operations && moments[*at].changed_nothing);
        let last = (start + usize::from(rules.steps)).min(known).min(idle.unwrap_or(known));
        if idle == Some(start) {
            return Some((0.0, 0.0, None));
        }
        if start >= known || last == moments.len() {
            return None;
        }
        let begin = (0..start).rfind(|at| moments[*at].is_last).map_or(0, |last| last + 1);
        let met = |at: usize| (begin..at).any(|it| moments[it].reached == moments[at].reached);
        let is_paid = |at: usize| match moments[at].reached {
            NONE => false,
            reached if rules.task_alone => reached == rules.task,
            _ => !met(at),
        };
        let pay = |at: usize| if is_paid(at) { rules.paid } else { -rules.cost };
        let sum = (start..last).map(|at| rules.discount.powi((at - start) as i32) * pay(at)).sum();
        if moments[last - 1].terminated {
            return Some((sum, 0.0, None));
        }
        Some((sum, rules.discount.powi((last - start) as i32), Some(last)))
    }

    #[test]
    fn returns_are_those_of_a_naive_list() {
        let (moments, replay) = kept();
        for number in 0..24 {
            let is = |bit: u32| number >> bit & 1 == 1;
            let rules = PayRules {
                steps: [1, 3, 10][number / 8],
                discount: 0.9,
                no_operations: is(0),
                time_outs: is(1),
                paid: 0.75,
                cost: 0.25,
                task: 2,
                task_alone: is(2),
            };
            for (start, _) in moments.iter().enumerate().filter(|(_, moment)| !moment.is_last) {
                let found = returns(&replay, Place { instance: 0, time: start as u32 }, rules);
                let found = found.map(|(earned, next)| {
                    (
                        earned,
                        next.map_or(0.0, |it| it.discount),
                        next.map(|it| it.place.time as usize),
                    )
                });
                let close = match (found, naive(&moments, start, rules)) {
                    (Some(found), Some(want)) => {
                        let differences = [found.0 - want.0, found.1 - want.1];
                        found.2 == want.2 && differences.iter().all(|it| it.abs() < 1e-5)
                    }
                    (found, want) => found == want,
                };
                assert!(close, "{start} {rules:?}: {found:?} {:?}", naive(&moments, start, rules));
            }
        }
    }

    #[test]
    fn what_an_episode_reached_before_it_was_kept_is_not_known() {
        let mut replay = Replay::new(1, 10, 1, 3);
        for time in 0..26 {
            let reached = if time % 5 == 0 { 1 } else { NONE };
            let moment = Moment { reached, is_last: time == 17, ..Moment::default() };
            replay.push(0, &[0], moment);
        }
        // Of the ten that are kept the first two are of an episode that began before.
        let found = |time| is_first(&replay, Place { instance: 0, time });
        assert_eq!([16, 20, 25].map(found), [None, Some(true), Some(false)]);
    }
}
