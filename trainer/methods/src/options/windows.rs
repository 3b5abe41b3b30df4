//! What steps and options led to: returns, and where values are looked up behind them.

use super::replay::{End, NONE, Place, Replay};

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
    /// What the goal is worth, and what every other step costs.
    pub(crate) worth: f32,
    pub(crate) cost: f32,
    /// Whether a step that reached something else costs nothing.
    pub(crate) forgives: bool,
}

/// How options do.
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

/// What some steps from one on led to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Window {
    /// The milestone that was reached, or none.
    pub(crate) reached: u8,
    /// What the steps before it earned.
    pub(crate) earned: f32,
    /// What a value behind it counts; where a milestone was reached, what that counts.
    pub(crate) discount: f32,
    /// Where a value is looked up; nowhere where nothing can follow.
    pub(crate) next: Option<Place>,
}

impl Window {
    /// What was earned on the way to a goal, without what follows.
    pub(crate) fn earned(&self, goal: u8, rules: ReturnRules) -> f32 {
        let last = match self.reached {
            NONE => 0.0,
            reached if reached == goal => rules.worth,
            _ if rules.forgives => 0.0,
            _ => -rules.cost,
        };
        self.earned + self.discount * last
    }
}

/// What the steps of an option from one on led to; none where that is not known yet, or is not learned from.
pub(crate) fn window(replay: &Replay, start: Place, rules: ReturnRules) -> Option<Window> {
    let (mut discount, mut earned) = (1.0, 0.0);
    for step in 0..u32::from(rules.steps) {
        let place = start.after(step);
        if !replay.has(place) {
            return None;
        }
        let moment = replay.moment(place);
        let window = Window { reached: moment.reached, earned, discount, next: None };
        let nothing = Window { reached: NONE, discount: 0.0, ..window };
        if rules.no_operations && moment.changed_nothing {
            // What changes nothing is worth nothing as a start; behind other steps it is not followed.
            let before = Window { next: Some(place), discount, ..nothing };
            return Some(if step == 0 { nothing } else { before });
        }
        if moment.reached != NONE {
            return Some(window);
        }
        if moment.ends_option && !rules.time_outs {
            return (step > 0).then_some(Window { next: Some(place), ..window });
        }
        earned -= discount * rules.cost;
        if moment.terminated {
            return Some(Window { earned, ..nothing });
        }
        discount *= rules.discount;
        if moment.ends_option || step + 1 == u32::from(rules.steps) {
            let next = place.after(1);
            let window = Window { reached: NONE, earned, discount, next: Some(next) };
            return replay.has(next).then_some(window);
        }
    }
    None
}

/// What some options from one on led to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Course {
    pub(crate) start: Place,
    /// The goal that counts as chosen.
    pub(crate) goal: u8,
    /// What was earned.
    pub(crate) reward: f32,
    pub(crate) discount: f32,
    /// Where a value is looked up, and the milestones that could be chosen there.
    pub(crate) next: Option<(Place, u32)>,
}

/// What the options of an episode from one on led to; none where that is not known yet.
pub(crate) fn course(
    replay: &Replay,
    (instance, number): (u32, u32),
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
        let over = |reward| Course { start: first.start, goal, reward, discount: 0.0, next: None };
        if option.reached == task {
            return Some(over(reward + discount * rules.worth));
        }
        if option.end != End::GoesOn && !rules.time_outs {
            if ahead == 0 {
                return None;
            }
            next = Some((option.start, option.mask));
            break;
        }
        if option.reached != NONE {
            reward -= discount * rules.cost;
        }
        if option.end == End::Terminated {
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
    let course = Course { start: first.start, goal, reward, discount, next: Some((place, mask)) };
    replay.has(place).then_some(course)
}

#[cfg(test)]
mod tests {
    use super::super::replay::{Finished, Moment};
    use super::*;

    /// An instance whose states are their numbers.
    fn kept(moments: &[Moment]) -> Replay {
        let mut replay = Replay::new(1, 100, 1, 3);
        for (index, moment) in moments.iter().enumerate() {
            replay.push(0, &[index as u8], *moment);
        }
        replay
    }

    fn at(time: u32) -> Place {
        Place { instance: 0, time }
    }

    #[test]
    fn returns_end_where_a_naive_list_says() {
        let step = Moment { reached: NONE, option_reached: NONE, ..Moment::default() };
        let mut moments = vec![step; 12];
        moments[4].reached = 1;
        moments[4].ends_option = true;
        moments[7].changed_nothing = true;
        moments[9].ends_option = true;
        moments[11].terminated = true;
        let replay = kept(&moments);
        let rules = ReturnRules {
            steps: 3,
            discount: 0.5,
            no_operations: true,
            time_outs: true,
            worth: 1.0,
            cost: 0.0,
            forgives: false,
        };
        let found = |time| {
            let window = window(&replay, at(time), rules)?;
            Some((window.reached, window.discount, window.next.map(|place| place.time)))
        };
        for (time, want) in [
            (0, Some((NONE, 0.125, Some(3)))),
            (2, Some((1, 0.25, None))),
            (4, Some((1, 1.0, None))),
            (5, Some((NONE, 0.25, Some(7)))),
            (7, Some((NONE, 0.0, None))),
            (8, Some((NONE, 0.25, Some(10)))),
            (10, Some((NONE, 0.0, None))),
            (12, None),
        ] {
            assert_eq!(found(time), want, "{time}");
        }
        let published = ReturnRules { no_operations: false, ..rules };
        let window = window(&replay, at(7), published).unwrap();
        assert_eq!(window.next, Some(at(10)));
        // What follows the last step is not known yet.
        let short = kept(&moments[..9]);
        assert_eq!(super::window(&short, at(8), published), None);
    }

    #[test]
    fn options_are_followed_to_the_end_of_their_episode() {
        let mut replay = kept(&[Moment::default(); 40]);
        let mut option = Finished {
            start: at(0),
            steps: 4,
            goal: 0,
            reached: NONE,
            mask: 0b101,
            end: End::GoesOn,
        };
        for (reached, end) in [
            (0, End::GoesOn),
            (NONE, End::GoesOn),
            (2, End::Terminated),
            (1, End::GoesOn),
            (NONE, End::TimedOut),
        ] {
            (option.reached, option.end) = (reached, end);
            replay.finish(option);
            option.start = option.start.after(4);
        }
        let rules = CourseRules {
            options: 2,
            discount: 0.5,
            step_discount: 1.0,
            time_outs: true,
            worth: 1.0,
            cost: 0.0,
            relabel: true,
            milestones: 3,
        };
        let found = |number, relabel| {
            let course = course(&replay, (0, number), CourseRules { relabel, ..rules })?;
            Some((course.goal, course.reward, course.discount, course.next))
        };
        assert_eq!(found(0, true), Some((0, 0.0, 0.25, Some((at(8), 0b101)))));
        assert_eq!(found(1, true), Some((0, 0.5, 0.0, None)));
        assert_eq!(found(2, true), Some((2, 1.0, 0.0, None)));
        assert_eq!(found(2, false), Some((0, 1.0, 0.0, None)));
        assert_eq!(found(3, true), Some((0, 0.0, 0.25, Some((at(20), 0b111)))));
        assert_eq!(found(4, true), Some((0, 0.0, 0.5, Some((at(20), 0b111)))));
        assert_eq!(found(5, true), None);
        // Solved are the options from the start of the episode on.
        let mut random = sortie_envs::random::generator(1);
        let draw = |_| replay.draw_option(true, &mut random).unwrap().1;
        let drawn: std::collections::BTreeSet<u32> = (0..50).map(draw).collect();
        assert_eq!(drawn.into_iter().collect::<Vec<_>>(), [0, 1, 2]);
    }

    /// The published returns of a list of rewards, step by step from the front.
    fn naive(
        moments: &[Moment],
        start: usize,
        goal: u8,
        rules: ReturnRules,
    ) -> Option<(f32, f32, Option<u32>)> {
        let is_time_out = |at: usize| moments[at].ends_option && moments[at].reached == NONE;
        if is_time_out(start) {
            return None;
        }
        let (mut sum, mut at) = (0.0, start);
        loop {
            let ahead = (at - start) as i32;
            let reached = moments[at].reached;
            let reward = match reached {
                _ if reached != NONE && reached == goal => rules.worth,
                _ if reached != NONE && rules.forgives => 0.0,
                _ => -rules.cost,
            };
            sum += rules.discount.powi(ahead) * reward;
            at += 1;
            if reached != NONE {
                return Some((sum, 0.0, None));
            }
            if at - start == usize::from(rules.steps) || is_time_out(at) {
                return Some((sum, rules.discount.powi(ahead + 1), Some(at as u32)));
            }
        }
    }

    #[test]
    fn published_returns_are_those_of_a_naive_list() {
        let step = Moment { reached: NONE, option_reached: NONE, ..Moment::default() };
        let mut moments = vec![step; 40];
        // Options end by a milestone, by their time, where nothing can be reached, and with the episode's time.
        for (at, reached) in [(5, 1), (13, NONE), (14, 2), (20, NONE), (31, NONE), (39, 0)] {
            moments[at] = Moment { reached, ends_option: true, ..step };
        }
        (moments[20].terminated, moments[21].is_last) = (true, true);
        (moments[31].ends_option, moments[32].is_last) = (true, true);
        let replay = kept(&moments);
        for (steps, forgives) in [(10, false), (3, true), (1, false)] {
            let rules = ReturnRules {
                steps,
                discount: 0.99,
                no_operations: false,
                time_outs: false,
                worth: 0.75,
                cost: 0.25,
                forgives,
            };
            for (start, goal) in (0..40).flat_map(|start| (0..3).map(move |goal| (start, goal))) {
                if moments[start].is_last {
                    continue;
                }
                let found = window(&replay, at(start as u32), rules);
                let found = found.map(|window| {
                    let next = window.next.map(|place| place.time);
                    (window.earned(goal, rules), next.map_or(0.0, |_| window.discount), next)
                });
                let want = naive(&moments, start, goal, rules);
                let close = match (found, want) {
                    (Some(found), Some(want)) => {
                        let differences = [found.0 - want.0, found.1 - want.1];
                        found.2 == want.2 && differences.iter().all(|it| it.abs() < 1e-5)
                    }
                    (found, want) => found == want,
                };
                assert!(close, "{start} {goal} {steps}: {found:?} {want:?}");
            }
        }
    }

    #[test]
    fn published_courses_pay_for_steps_that_reach_and_end_before_the_time_is_over() {
        let mut replay = kept(&[Moment::default(); 40]);
        let mut start = at(0);
        for (reached, end) in [
            (0, End::GoesOn),
            (NONE, End::GoesOn),
            (1, End::Terminated),
            (1, End::GoesOn),
            (0, End::GoesOn),
            (2, End::Terminated),
        ] {
            let mask = 0b11;
            replay.finish(Finished { start, steps: 4, goal: 1, reached, mask, end });
            start = start.after(4);
        }
        let rules = CourseRules {
            options: 10,
            discount: 0.5,
            step_discount: 1.0,
            time_outs: false,
            worth: 0.75,
            cost: 0.25,
            relabel: true,
            milestones: 3,
        };
        let found = |number| {
            let course = course(&replay, (0, number), rules)?;
            Some((course.goal, course.reward, course.discount, course.next))
        };
        let before = Some((at(8), 0b11));
        assert_eq!(found(0), Some((1, -0.25, 0.25, before)));
        assert_eq!(found(1), Some((1, 0.0, 0.5, before)));
        assert_eq!(found(2), None);
        assert_eq!(found(3), Some((1, -0.25 - 0.125 + 0.1875, 0.0, None)));
        assert_eq!(found(5), Some((2, 0.75, 0.0, None)));
    }
    #[test]
    fn a_course_is_discounted_for_every_option_and_every_step() {
        let mut replay = kept(&[Moment::default(); 40]);
        let mut start = at(0);
        for (steps, reached) in [(3, NONE), (5, 0), (2, NONE), (4, 2)] {
            let end = if reached == 2 { End::Terminated } else { End::GoesOn };
            replay.finish(Finished { start, steps, goal: 1, reached, mask: 0b11, end });
            start = start.after(steps.into());
        }
        let rules = CourseRules {
            options: 2,
            discount: 0.75,
            step_discount: 0.5,
            time_outs: true,
            worth: 1.0,
            cost: 0.25,
            relabel: true,
            milestones: 3,
        };
        let found = |number| {
            let course = course(&replay, (0, number), rules)?;
            Some((course.reward, course.discount, course.next))
        };
        // So much is worth what comes behind options of so many steps in all.
        let worth = |options: i32, steps: i32| 0.75_f32.powi(options) * 0.5_f32.powi(steps);
        assert_eq!(found(0), Some((-0.25 * worth(1, 3), worth(2, 8), Some((at(8), 0b11)))));
        assert_eq!(found(1), Some((-0.25, worth(2, 7), Some((at(10), 0b11)))));
        assert_eq!(found(2), Some((worth(1, 2), 0.0, None)));
    }
}
