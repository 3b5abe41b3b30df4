//! An agent by rules alone: networks that are tables.

use std::vec;
use std::vec::Vec;

use super::*;
use crate::entity_mask::EntityMask;

/// A picture of one cell and one channel, and two counts.
const PICTURE: PictureShape =
    PictureShape { channels: 1, size: 1, counts: 2, crop: 1, nearest: false };

/// What the networks answer, whatever they are shown.
#[derive(Clone, Copy)]
struct Fixed {
    likelihoods: [f32; 3],
    goals: [f32; 3],
    /// By goals.
    actions: [[f32; 4]; 3],
}

impl OptionNetworks for Fixed {
    fn actions(&mut self, _: &[f32], goal: usize, to: &mut [f32]) -> Result<(), DecideError> {
        to.copy_from_slice(&self.actions[goal]);
        Ok(())
    }

    fn goals(&mut self, _: &[f32], to: &mut [f32]) -> Result<(), DecideError> {
        to.copy_from_slice(&self.goals);
        Ok(())
    }

    fn affordances(&mut self, _: &[f32], to: &mut [f32]) -> Result<(), DecideError> {
        to.copy_from_slice(&self.likelihoods);
        Ok(())
    }
}

const NETWORKS: Fixed = Fixed {
    likelihoods: [0.9, 0.2, 0.7],
    goals: [0.1, 5.0, 0.3],
    actions: [[4.0, 3.0, 2.0, 1.0], [0.0, 9.0, 0.0, 0.0], [1.0, 2.0, 3.0, 4.0]],
};

fn rules() -> OptionRules {
    let learned = |carried, change| Milestone { carried, change, affordance: Affordance::Learned };
    let milestones = [learned(0, 1), learned(1, 1), learned(0, -2)];
    OptionRules::new(PICTURE, 4, 5, &milestones).unwrap()
}

fn policy(rules: OptionRules, networks: Fixed) -> OptionPolicy<Fixed, [f32; 13]> {
    OptionPolicy::new(rules, networks, [0.0; 13]).unwrap()
}

/// Decides for a cell and counts; the action, the goal and the steps.
fn decide(
    policy: &mut OptionPolicy<Fixed, [f32; 13]>,
    memory: &mut [f32],
    row: [f32; 3],
    available: [u16; 4],
) -> (u16, usize, usize) {
    let visible = EntityMask::first(1);
    let (rows, available) = (&row[..], &available[..]);
    let seen =
        Observation { rows, stride: 3, last_actions: &[], visible, self_index: 0, available };
    let decision = policy.decide_with(&seen, memory).unwrap();
    let Pursuit { goal, steps } = Pursuit::of(memory).unwrap();
    (decision.action, goal, steps)
}

#[test]
fn options_end_with_milestones_and_with_their_time_and_what_was_missed_waits() {
    let mut rules = rules();
    rules.varied = false;
    let mut policy = policy(rules, NETWORKS);
    let mut memory = vec![0.0; policy.hidden()];
    let mut tick = |row| decide(&mut policy, &mut memory, row, [1; 4]);
    // Goal 1 is worth most, and masked.
    for step in 1..=5 {
        assert_eq!(tick([1.0, 0.0, 0.0]), (3, 2, step));
    }
    assert_eq!(tick([1.0, 0.0, 0.0]), (3, 2, 1));
    assert_eq!(tick([1.0, 0.0, 1.0]), (3, 2, 1));
    assert_eq!(tick([1.0, 0.0, 1.0]), (3, 2, 2));
    // One more is a milestone, two less is one, one less is none.
    assert_eq!(tick([1.0, 3.0, 1.0]).2, 1);
    assert_eq!(tick([1.0, 2.0, 1.0]).2, 2);
    assert_eq!(tick([1.0, 0.0, 1.0]).2, 1);
}

#[test]
fn of_several_milestones_what_rises_counts() {
    let reached = |before: [f32; 2], now: [f32; 2]| rules().reached(&before, &now);
    assert_eq!(reached([2.0, 0.0], [0.0, 1.0]), Some(1));
    assert_eq!(reached([0.0, 0.0], [1.0, 1.0]), Some(0));
    assert_eq!(reached([2.0, 1.0], [0.0, 1.0]), Some(2));
    assert_eq!(reached([2.0, 1.0], [1.0, 0.0]), None);
}

#[test]
fn varied_play_answers_what_is_met_again_otherwise() {
    let mut policy = policy(rules(), NETWORKS);
    let mut memory = vec![0.0; policy.hidden()];
    let mut tick = |row, available| decide(&mut policy, &mut memory, row, available);
    let same = [1.0, 0.0, 0.0];
    assert_eq!(tick(same, [1; 4]), (3, 2, 1));
    assert_eq!(tick(same, [1; 4]), (2, 2, 2));
    assert_eq!(tick([0.0, 0.0, 0.0], [1; 4]), (3, 2, 3));
    assert_eq!(tick(same, [1; 4]), (1, 2, 4));
    // Three are open, and three times was it met.
    assert_eq!(tick(same, [1, 1, 0, 1]), (3, 2, 5));
    // What was missed waits until the other of the mask was missed as often.
    assert_eq!(tick(same, [1; 4]), (0, 0, 1));
    // Views of the option before are forgotten.
    assert_eq!(tick(same, [1; 4]), (1, 0, 2));
    for _ in 0..3 {
        tick(same, [1; 4]);
    }
    assert_eq!(tick(same, [1; 4]).1, 2);
    for _ in 0..4 {
        tick(same, [1; 4]);
    }
    assert_eq!(tick(same, [1; 4]).1, 0);
    // A milestone forgives.
    assert_eq!(tick([1.0, 0.0, 1.0], [1; 4]).1, 2);
}

#[test]
fn where_nothing_is_afforded_everything_is() {
    let nothing = Fixed { likelihoods: [0.5, 0.2, 0.2], ..NETWORKS };
    let mut memory = vec![0.0; policy(rules(), nothing).hidden()];
    assert_eq!(decide(&mut policy(rules(), nothing), &mut memory, [0.0; 3], [1; 4]).1, 1);
    assert_eq!(rules().mask(&[0.6, 0.4, 0.51]), 0b101);
    let kind = |affordance| Milestone { carried: 0, change: 1, affordance };
    let kinds = [Affordance::Always, Affordance::Never, Affordance::Learned].map(kind);
    let rules = OptionRules::new(PICTURE, 4, 5, &kinds).unwrap();
    assert_eq!(rules.mask(&[0.1, 0.9, 0.9]), 0b101);
}

#[test]
fn what_is_drawn_is_drawn_as_often_as_it_should_and_again_by_the_same_seed() {
    let mut rules = rules();
    (rules.action_chance, rules.goal_chance, rules.varied, rules.steps) = (0.4, 0.3, false, 1);
    let play = |seed| {
        let mut rules = rules.clone();
        rules.seed = seed;
        let mut policy = policy(rules, NETWORKS);
        let mut memory = vec![0.0; policy.hidden()];
        let mut tick = || decide(&mut policy, &mut memory, [0.0; 3], [0, 1, 1, 1]);
        (0..10_000).map(|_| tick()).collect::<Vec<_>>()
    };
    let (found, again, other) = (play(5), play(5), play(6));
    assert!(found == again && found != other);
    let share = |is: &dyn Fn(&(u16, usize, usize)) -> bool| {
        found.iter().filter(|tick| is(tick)).count() as f32 / found.len() as f32
    };
    // Of the mask {0, 2}, of which 2 is the best; of the actions 1 to 3, of which goal 2 takes 3.
    assert!((share(&|tick| tick.1 == 0) - 0.15).abs() < 0.02);
    assert_eq!(share(&|tick| tick.1 == 1), 0.0);
    let third = 0.4 / 3.0;
    assert!((share(&|tick| tick.1 == 2 && tick.0 == 3) - 0.85 * (0.6 + third)).abs() < 0.02);
    assert_eq!(share(&|tick| tick.0 == 0), 0.0);
}

#[test]
fn what_does_not_fit_is_refused() {
    let mut policy = policy(rules(), NETWORKS);
    let visible = EntityMask::first(1);
    let mut ask = |rows: &[f32], available: &[u16], memory: usize| {
        let seen = Observation {
            rows,
            stride: rows.len(),
            last_actions: &[],
            visible,
            self_index: 0,
            available,
        };
        policy.decide_with(&seen, &mut vec![0.0; memory]).unwrap_err()
    };
    let own = super::memory::floats(&rules());
    assert_eq!(ask(&[0.0; 2], &[1; 4], own), DecideError::BadLength);
    assert_eq!(ask(&[0.0; 3], &[1; 3], own), DecideError::BadLength);
    assert_eq!(ask(&[0.0; 3], &[0; 4], own), DecideError::NoAvailableAction);
    assert_eq!(ask(&[0.0, f32::NAN, 0.0], &[1; 4], own), DecideError::NonFinite);
    assert_eq!(ask(&[0.0; 3], &[1; 4], 3), DecideError::HiddenState { want: own, got: 3 });
    assert!(OptionPolicy::new(rules(), NETWORKS, [0.0; 12]).is_none());
    assert!(OptionRules::new(PICTURE, 4, 5, &[]).is_none());
    assert!(Shown::new(PictureShape { size: 4, ..PICTURE }).is_none());
}
