//! Returns beside naive lists.

use super::super::replay::Finished;
use super::*;
use crate::options::tests::{Moment, at, kept};

#[test]
fn returns_end_where_a_naive_list_says() {
    let mut moments = [Moment::default(); 12];
    (moments[4].reached, moments[4].ends_option) = (1, true);
    moments[7].changed_nothing = true;
    moments[9].ends_option = true;
    moments[11].terminated = true;
    let replay = kept(&moments);
    let rules = ReturnRules { steps: 3, discount: 0.5, no_operations: true, time_outs: true };
    let pay = |note: &Note, _| {
        let is_over = note.reached != NONE;
        Paid { reward: if is_over { 1.0 } else { 0.0 }, is_last: note.ends_option, is_over }
    };
    let next = |number, discount| next(number, discount, u32::MAX);
    for (start, want) in [
        (0, Some((0.0, next(3, 0.125)))),
        (2, Some((0.25, None))),
        (4, Some((1.0, None))),
        (5, Some((0.0, next(7, 0.25)))),
        (7, Some((0.0, None))),
        (8, Some((0.0, next(10, 0.25)))),
        (10, Some((0.0, None))),
        (13, None),
    ] {
        assert_eq!(returns(&replay, at(start), rules, pay), want, "{start}");
    }
    let published = ReturnRules { no_operations: false, ..rules };
    assert_eq!(returns(&replay, at(7), published, pay), Some((0.0, next(10, 0.125))));
    // What follows the last step is not known yet.
    let short = kept(&moments[..9]);
    assert_eq!(returns(&short, at(8), published, pay), None);
}

fn next(number: usize, discount: f32, mask: u32) -> Option<Next> {
    Some(Next { place: at(number), discount, mask })
}

#[test]
fn options_are_followed_to_the_end_of_their_episode() {
    let mut replay = kept(&[Moment::default(); 40]);
    let mut option =
        Finished { start: at(0), steps: 4, goal: 0, reached: NONE, mask: 0b101, end: End::Open };
    for (reached, end) in
        [(0, End::Open), (NONE, End::Open), (2, End::Over), (1, End::Open), (NONE, End::TimedOut)]
    {
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
        Some((course.goal, course.reward, course.next))
    };
    assert_eq!(found(0, true), Some((0, 0.0, next(8, 0.25, 0b101))));
    assert_eq!(found(1, true), Some((0, 0.5, None)));
    assert_eq!(found(2, true), Some((2, 1.0, None)));
    assert_eq!(found(2, false), Some((0, 1.0, None)));
    assert_eq!(found(3, true), Some((0, 0.0, next(20, 0.25, 0b111))));
    assert_eq!(found(4, true), Some((0, 0.0, next(20, 0.5, 0b111))));
    assert_eq!(found(5, true), None);
    // Solved are the options from the start of the episode on.
    let mut random = sortie_envs::random::generator(1);
    let draw = |_| replay.draw_option(1.0, &mut random).unwrap().0.1;
    let drawn: std::collections::BTreeSet<u32> = (0..50).map(draw).collect();
    assert_eq!(drawn.into_iter().collect::<Vec<_>>(), [0, 1, 2]);
}

#[test]
fn published_courses_pay_for_steps_that_reach_and_end_before_the_time_is_over() {
    let mut replay = kept(&[Moment::default(); 40]);
    let mut start = at(0);
    for (reached, end) in [
        (0, End::Open),
        (NONE, End::Open),
        (1, End::Over),
        (1, End::Open),
        (0, End::Open),
        (2, End::Over),
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
        Some((course.goal, course.reward, course.next))
    };
    assert_eq!(found(0), Some((1, -0.25, next(8, 0.25, 0b11))));
    assert_eq!(found(1), Some((1, 0.0, next(8, 0.5, 0b11))));
    assert_eq!(found(2), None);
    assert_eq!(found(3), Some((1, -0.25 - 0.125 + 0.1875, None)));
    assert_eq!(found(5), Some((2, 0.75, None)));
}

#[test]
fn a_course_is_discounted_for_every_option_and_every_step() {
    let mut replay = kept(&[Moment::default(); 40]);
    let mut start = at(0);
    for (steps, reached) in [(3, NONE), (5, 0), (2, NONE), (4, 2)] {
        let end = if reached == 2 { End::Over } else { End::Open };
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
        Some((course.reward, course.next))
    };
    // So much is worth what comes behind options of so many steps in all.
    let worth = |options: i32, steps: i32| 0.75_f32.powi(options) * 0.5_f32.powi(steps);
    assert_eq!(found(0), Some((-0.25 * worth(1, 3), next(8, worth(2, 8), 0b11))));
    assert_eq!(found(1), Some((-0.25, next(10, worth(2, 7), 0b11))));
    assert_eq!(found(2), Some((worth(1, 2), None)));
}
