//! Policies over inputs of fixed sizes that act for agents of a team: what they observe, and whose state they keep.

use std::vec;
use std::vec::Vec;

use super::drafts::Draft;
use super::policy::counting;
use super::with_header;
use crate::ops::{MaskedArgmax, Meaning, Op, Place};
use crate::plan::{AlignedBytes, Plan, PlanError};
use crate::policy::NO_ACTION;
use crate::{DecideError, EntityMask, Observation, PlanPolicy, Policy, Remembering};

/// Features d and most entities N of a plan, for a draft that has U.
fn sized(draft: &Draft, [features, n_max]: [u32; 2]) -> AlignedBytes {
    with_header(draft.bytes().as_slice(), |header| {
        (header.features, header.n_max) = (features, n_max);
    })
}

/// A policy whose utilities are the numbers of its only input, from `start` on.
fn mirror(meaning: Meaning, len: usize, start: u32, sizes: [u32; 2]) -> AlignedBytes {
    let actions = len as u32 - start;
    let mut draft = Draft { actions, ..Draft::default() };
    let to = draft.observed(meaning, len);
    let from = Place { offset: to.offset + start, len: actions };
    draft.push(Op::MaskedArgmax(MaskedArgmax { from }));
    sized(&draft, sizes)
}

/// Three entities of two features and a column that nobody reads; agents are the first two.
const ROWS: [f32; 9] = [1.0, 2.0, 9.0, 3.0, 4.0, 9.0, 5.0, 6.0, 9.0];

fn seen(self_index: usize, visible: u64, available: &[u16]) -> Observation<'_> {
    Observation {
        rows: &ROWS,
        stride: 3,
        last_actions: &[1, NO_ACTION],
        visible: EntityMask::from_words(&[visible]),
        self_index,
        available,
    }
}

fn observed(bytes: &AlignedBytes, seen: &Observation<'_>) -> Result<Vec<f32>, DecideError> {
    let plan = Plan::load(bytes.as_slice()).unwrap();
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    arena.as_mut_slice().fill(0xFF);
    let mut utilities = vec![f32::NAN; plan.actions()];
    let mut policy = PlanPolicy::new(plan, arena.as_mut_slice()).unwrap();
    policy.utilities(seen, &mut utilities).map(|()| utilities)
}

#[test]
fn an_agent_observes_its_own_row_and_its_own_last_action() {
    let row = mirror(Meaning::OwnRow, 2, 0, [2, 5]);
    assert_eq!(observed(&row, &seen(0, 0, &[])), Ok(vec![1.0, 2.0]));
    assert_eq!(observed(&row, &seen(1, 0b1, &[])), Ok(vec![3.0, 4.0]));
    assert_eq!(observed(&row, &seen(3, 0, &[])), Err(DecideError::BadLength));
    // Behind two features the one-hot of three actions; the others have no last action.
    let last = mirror(Meaning::OwnRow, 5, 2, [2, 5]);
    assert_eq!(observed(&last, &seen(0, 0, &[])), Ok(vec![0.0, 1.0, 0.0]));
    assert_eq!(observed(&last, &seen(1, 0, &[])), Ok(vec![0.0; 3]));
    assert_eq!(observed(&last, &seen(2, 0, &[])), Ok(vec![0.0; 3]));
}

#[test]
fn availability_is_observed_as_yes_and_no() {
    let available = mirror(Meaning::Available, 3, 0, [2, 5]);
    assert_eq!(observed(&available, &seen(0, 0, &[0, 1, 4])), Ok(vec![0.0, 1.0, 1.0]));
    assert_eq!(observed(&available, &seen(0, 0, &[1])), Err(DecideError::BadLength));
}

#[test]
fn rows_are_padded_and_show_only_what_is_visible_and_the_agent_itself() {
    let rows = |own_first| {
        let meaning = if own_first { Meaning::RowsOwnFirst } else { Meaning::Rows };
        mirror(meaning, 8, 0, [2, 4])
    };
    let [padding, hidden] = [[0.0; 2]; 2];
    let shown = |rows: [[f32; 2]; 4]| Ok(rows.concat());
    let [a, b, c] = [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]];
    assert_eq!(observed(&rows(false), &seen(1, 0b101, &[])), shown([a, b, c, padding]));
    assert_eq!(observed(&rows(false), &seen(0, 0b010, &[])), shown([a, b, hidden, padding]));
    assert_eq!(observed(&rows(true), &seen(1, 0b101, &[])), shown([b, a, c, padding]));
    assert_eq!(observed(&rows(true), &seen(0, 0b111, &[])), shown([a, b, c, padding]));
    assert_eq!(observed(&rows(true), &seen(2, 0b011, &[])), shown([c, a, b, padding]));
    // What is not visible may be anything.
    let mut strange = ROWS;
    strange[6] = f32::NAN;
    let behind = Observation { rows: &strange, ..seen(0, 0b011, &[]) };
    assert_eq!(observed(&rows(false), &behind), shown([a, b, hidden, padding]));
    let before = Observation { visible: EntityMask::first(3), ..behind };
    assert_eq!(observed(&rows(false), &before), Err(DecideError::NonFinite));
}

#[test]
fn rows_have_their_own_last_actions() {
    // Two entities of one feature and two actions.
    let rows = mirror(Meaning::RowsOwnFirst, 6, 4, [1, 2]);
    assert_eq!(observed(&rows, &seen(1, 0b11, &[])), Ok(vec![0.0, 1.0]));
    assert_eq!(observed(&rows, &seen(0, 0b11, &[])), Ok(vec![0.0, 0.0]));
}

#[test]
fn masks_are_of_either_kind_and_never_show_padding() {
    let mask = |meaning| mirror(meaning, 4, 0, [2, 4]);
    let of = |meaning, agent, visible| observed(&mask(meaning), &seen(agent, visible, &[]));
    assert_eq!(of(Meaning::Visible, 1, 0b101), Ok(vec![1.0, 0.0, 1.0, 0.0]));
    assert_eq!(of(Meaning::Blocked, 1, 0b101), Ok(vec![0.0, 1.0, 0.0, 1.0]));
    assert_eq!(of(Meaning::VisibleOwnFirst, 2, 0b101), Ok(vec![1.0, 1.0, 0.0, 0.0]));
    assert_eq!(of(Meaning::BlockedOwnFirst, 2, 0b101), Ok(vec![0.0, 0.0, 1.0, 1.0]));
    assert_eq!(of(Meaning::Visible, 0, 0), Ok(vec![0.0; 4]));
    let beyond = Err(DecideError::TooManyEntities { max: 4, got: 5 });
    assert_eq!(of(Meaning::Visible, 0, 0b10001), beyond);
    assert_eq!(of(Meaning::Blocked, 4, 0b1), beyond);
    let index = mirror(Meaning::OwnIndex, 1, 0, [2, 4]);
    assert_eq!(observed(&index, &seen(3, 0, &[])), Ok(vec![3.0]));
}

/// The policy that counts what it is given, of two features and three actions.
fn counting_agent() -> AlignedBytes {
    let mut draft = counting();
    if let Some(Op::Input(input)) = draft.program.ops.first_mut() {
        input.meaning = Meaning::OwnRow;
    }
    sized(&draft, [2, 3])
}

#[test]
fn every_agent_keeps_its_own_state_until_its_episode_ends() {
    let bytes = counting_agent();
    let plan = Plan::load(bytes.as_slice()).unwrap();
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let policy = PlanPolicy::new(plan, arena.as_mut_slice()).unwrap();
    let mut memory = [f32::NAN; 4];
    let mut team = Remembering::new(policy, &mut memory);
    let agents = [seen(0, 0b111, &[1; 3]), seen(1, 0b111, &[1; 3])];
    let decide = |team: &mut Remembering<'_, PlanPolicy<'_>>, agent: usize| {
        team.decide(&agents[agent]).map(|decision| (decision.action, decision.utility))
    };
    assert_eq!(decide(&mut team, 0), Ok((1, 2.0)));
    assert_eq!(decide(&mut team, 0), Ok((1, 4.0)));
    assert_eq!(decide(&mut team, 1), Ok((1, 4.0)));
    // Together as one after the other.
    let mut together = [Err(DecideError::BadLength); 2];
    team.decide_batch(&agents, &mut together);
    assert_eq!(together.map(|decision| decision.map(|it| it.utility)), [Ok(6.0), Ok(8.0)]);
    assert!(team.begin_episode());
    assert_eq!(decide(&mut team, 0), Ok((1, 2.0)));
}

#[test]
fn a_state_is_of_the_plans_length_and_stays_where_something_fails() {
    let bytes = counting_agent();
    let plan = Plan::load(bytes.as_slice()).unwrap();
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let mut policy = PlanPolicy::new(plan, arena.as_mut_slice()).unwrap();
    let want = Err(DecideError::HiddenState { want: 2, got: 0 });
    assert_eq!(policy.decide(&seen(0, 0, &[1; 3])).map(|_| ()), want);
    let mut state = [1.0, 2.0];
    let rows = [f32::NAN; 3];
    let strange = Observation { rows: &rows, ..seen(0, 0, &[1; 3]) };
    let refused = policy.decide_with(&strange, &mut state).map(|_| ());
    assert_eq!((refused, state), (Err(DecideError::NonFinite), [1.0, 2.0]));
}

#[test]
fn agents_without_memory_decide_together_as_alone() {
    let bytes = mirror(Meaning::OwnRow, 2, 0, [2, 5]);
    let plan = Plan::load(bytes.as_slice()).unwrap();
    assert_eq!(plan.arena_bytes_per_agent(), 0);
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let agents = [seen(0, 0, &[1; 2]), seen(1, 0, &[1, 0]), seen(2, 0, &[0; 2])];
    let mut together = [Err(DecideError::BadLength); 3];
    plan.decide_batch(arena.as_mut_slice(), &agents, None, &mut together);
    let actions = together.map(|decision| decision.map(|decision| decision.action));
    assert_eq!(actions, [Ok(1), Ok(0), Err(DecideError::NoAvailableAction)]);
}

#[test]
fn what_an_agent_cannot_observe_is_no_agents() {
    let bytes = |meaning, len| mirror(meaning, len, 0, [2, 4]);
    for (meaning, len) in [
        (Meaning::OwnRow, 3),
        (Meaning::Rows, 7),
        (Meaning::RowsOwnFirst, 4),
        (Meaning::Visible, 3),
        (Meaning::BlockedOwnFirst, 5),
        (Meaning::OwnIndex, 2),
    ] {
        let refused = Plan::load(bytes(meaning, len).as_slice()).err();
        assert_eq!(refused, Some(PlanError::ShapeMismatch { op: 0 }), "{meaning:?}");
    }
    let mut other = Draft { actions: 2, ..Draft::default() };
    other.observed(Meaning::OwnRow, 2);
    let from = other.observed(Meaning::None, 2);
    other.push(Op::MaskedArgmax(MaskedArgmax { from }));
    let mut without_choice = Draft::default();
    let to = without_choice.observed(Meaning::OwnRow, 2);
    without_choice.output(to);
    for draft in [other, without_choice] {
        let bytes = sized(&draft, [2, 4]);
        let plan = Plan::load(bytes.as_slice()).unwrap();
        let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
        let refused = PlanPolicy::new(plan, arena.as_mut_slice()).err();
        assert_eq!(refused, Some(PlanError::WrongNetwork));
    }
}
