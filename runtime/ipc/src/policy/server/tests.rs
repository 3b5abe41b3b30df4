//! The server of a policy, by hand: what it takes, answers and refuses.

use std::cell::Cell;

use sortie_core::plan::{GuardFacts, GuardedSizes};
use sortie_core::wire::ABI;
use zerocopy::IntoBytes;

use super::super::Port;
use super::*;

/// A clock that stands still until somebody sets it.
#[derive(Default)]
struct Held(Cell<u64>);

impl Clock for &Held {
    fn now_ns(&self) -> u64 {
        self.0.get()
    }
}

/// Scores two actions by a number and by its negative; takes ten nanoseconds for it.
struct Slow<'c>(&'c Held);

impl Engine for Slow<'_> {
    fn respond(
        &mut self,
        inputs: &[&[f32]],
        _: &mut [f32],
        outputs: &mut [&mut [f32]],
    ) -> Result<(), Reason> {
        self.0.0.set(self.0.0.get() + 10);
        let number = inputs[0][0];
        outputs[0].copy_from_slice(&[number, -number]);
        if number.is_finite() { Ok(()) } else { Err(Reason::NonFinite) }
    }

    fn model(&self) -> [u8; 16] {
        [0; 16]
    }
}

fn schema() -> PolicySchema {
    let port = |length| Port { name: String::new(), length };
    let (inputs, outputs) = (vec![port(1)], vec![port(2)]);
    PolicySchema { actions: 2, inputs, outputs, states: Vec::new(), robot: None }
}

fn serving<'e>(engine: &'e mut Slow<'_>, clock: &'e Held) -> Serving<'e, &'e Held> {
    Serving {
        clock,
        decider: Decider::new(engine, &schema(), None),
        guarding: Guarding::new(None, &schema().format().unwrap()).unwrap(),
        format: schema().format().unwrap(),
        fallback: Fallback::Hold,
        client: None,
        outputs: vec![0.0; 2],
        action: None,
        next: vec![0.0; 2],
        counters: ServeCounters::default(),
    }
}

#[test]
fn what_is_decided_after_the_deadline_is_late() {
    let clock = Held::default();
    let mut engine = Slow(&clock);
    let mut serving = serving(&mut engine, &clock);
    for (seq, deadline_ns, number, status) in [
        (1, 110, 0.5, AnswerStatus::Answered),
        (2, 109, 0.5, AnswerStatus::Late),
        (3, 109, f32::NAN, AnswerStatus::Fallback),
        (4, 1_000, 0.5, AnswerStatus::Answered),
    ] {
        clock.0.set(100);
        let asked =
            ObservationHead { session: 1, seq, deadline_ns, t_ns: 60, ..Default::default() };
        let (inputs, available) = (&[number][..], &[1, 1][..]);
        let observation = ObservationView { head: &asked, inputs, available };
        let (answer, served) = serving.decide(&observation, 100);
        assert_eq!((answer.status, served.status), (status as u16, status), "{seq}");
        assert_eq!((served.wake_ns, served.decide_ns, answer.decide_ns), (40, 10, 10));
    }
    let ServeCounters { answered, late, fallbacks, .. } = serving.counters;
    assert_eq!((answered, late, fallbacks), (3, 1, 1));
}

#[test]
fn the_newest_observation_of_the_newest_client_comes_last() {
    let order = |session, seq| {
        let (magic, abi) = (ObservationHead::MAGIC, ABI);
        let head = ObservationHead { magic, abi, session, seq, ..Default::default() };
        order_of(head.as_bytes())
    };
    assert!(order(1, 2) > order(1, 1) && order(2, 1) > order(1, 9), "{:?}", order(2, 1));
    assert!(order_of(&[0; 64]).is_none() && order(0, 0) > order_of(&[]));
}

#[test]
fn what_is_not_available_is_not_chosen() {
    let clock = Held::default();
    let mut engine = Slow(&clock);
    let mut serving = serving(&mut engine, &clock);
    let mut decide = |available: [u16; 2]| {
        let asked = ObservationHead { deadline_ns: u64::MAX, ..Default::default() };
        let (inputs, available) = (&[0.5][..], &available[..]);
        let (answer, _) = serving.decide(&ObservationView { head: &asked, inputs, available }, 0);
        (answer.action, Reason::from_number(answer.reason))
    };
    assert_eq!(decide([1, 1]), (0, Some(Reason::None)));
    assert_eq!(decide([0, 1]), (1, Some(Reason::None)));
    assert_eq!(decide([0, 0]), (-1, Some(Reason::NoAvailableAction)));
}

/// Guards of the age alone, held for one further decision.
fn plan_of_fresh_observations() -> Vec<u8> {
    let mut plan = include_bytes!("../../../../../examples/embed_c/cart.plan").to_vec();
    let guards = GuardFacts { hold: 1, age_ms: Some(40.0e-6), ..Default::default() };
    let sizes = GuardedSizes { inputs: 1, outputs: 2, chooses: true };
    guards.append_to(&mut plan, &sizes).unwrap();
    plan
}

#[test]
fn an_observation_that_is_too_old_is_answered_by_the_fallback_in_the_same_tick() {
    let clock = Held::default();
    let mut engine = Slow(&clock);
    let plan = plan_of_fresh_observations();
    let guards = Guards::of_plan(&plan).unwrap();
    let mut serving = serving(&mut engine, &clock);
    serving.guarding = Guarding::new(guards, &serving.format).unwrap();
    let trip = |trip: Trip| (AnswerStatus::Fallback, Reason::Guard, trip.number());
    let answered = (AnswerStatus::Answered, Reason::None, 0);
    let refused = (AnswerStatus::Fallback, Reason::NonFinite, 0);
    for (seq, session, t_ns, number, told) in [
        (1, 1, 59, -0.5, trip(Trip::Age)),
        (2, 1, 60, -0.5, trip(Trip::Held)),
        (3, 1, 60, -0.5, answered),
        // What the policy itself refuses is held too.
        (4, 1, 60, f32::NAN, refused),
        (5, 1, 60, -0.5, trip(Trip::Held)),
        (6, 1, 60, f32::NAN, refused),
        // Another robot begins anew.
        (1, 2, 60, -0.5, answered),
    ] {
        clock.0.set(100);
        let deadline_ns = 110;
        let asked = ObservationHead { session, seq, t_ns, deadline_ns, ..Default::default() };
        let (inputs, available) = (&[number][..], &[1, 1][..]);
        let observation = ObservationView { head: &asked, inputs, available };
        let (answer, served) = serving.decide(&observation, 100);
        let reason = Reason::from_number(answer.reason).unwrap();
        assert_eq!((served.status, reason, answer.guard), told, "{session}, {seq}");
        assert_eq!(answer.trip(), served.trip);
    }
    let ServeCounters { answered, fallbacks, guarded, clamped, .. } = serving.counters;
    assert_eq!((answered, fallbacks, guarded, clamped), (2, 5, 3, 0));
}

#[test]
fn a_new_client_is_not_held_at_what_the_one_before_did() {
    let clock = Held::default();
    let mut engine = Slow(&clock);
    let mut serving = serving(&mut engine, &clock);
    let mut decide = |session, episode, seq, number| {
        let deadline_ns = u64::MAX;
        let asked = ObservationHead { session, episode, seq, deadline_ns, ..Default::default() };
        let (inputs, available) = (&[number][..], &[1, 1][..]);
        let observation = ObservationView { head: &asked, inputs, available };
        let action = serving.decide(&observation, 0).0.action;
        (action, serving.outputs.clone())
    };
    let done = (1, vec![-0.5, 0.5]);
    assert_eq!(decide(1, 0, 1, -0.5), done);
    assert_eq!(decide(1, 0, 2, f32::NAN), done);
    // Also over the end of an episode, but not of a session.
    assert_eq!(decide(1, 1, 3, f32::NAN), done);
    assert_eq!(decide(2, 0, 1, f32::NAN), (0, vec![0.0; 2]));
    let ServeCounters { sessions, resets, .. } = serving.counters;
    assert_eq!((sessions, resets), (2, 3));
}
