//! A served policy whose plan has guards.

use sortie_core::plan::{
    AlignedBytes, Beyond, GuardFacts, GuardedBy, GuardedOutputs, GuardedSizes, Guards, InputGuards,
    OutputGuards, Trip,
};
use sortie_core::wire::{AnswerStatus, Reason};
use sortie_ipc::{
    ClientCounters, Error, Fallback, PolicyClient, PolicyServer, ServeCounters, Stop,
};

use super::{CART, CART_SHAPE, Direct, PATIENT, Plan, Serving, bits, schema, settings};
use crate::toy::{self, Watchdog};

const SIZES: GuardedSizes = GuardedSizes { inputs: 1, outputs: 1, chooses: false };

/// The cart's plan with guards behind it, as long as the program runs.
fn guarded(facts: &GuardFacts) -> &'static [u8] {
    let mut plan = CART.to_vec();
    facts.append_to(&mut plan, &SIZES).unwrap();
    Box::leak(Box::new(AlignedBytes::copy_of(&plan))).as_slice()
}

/// What a robot is told.
#[derive(Debug, PartialEq)]
struct Told {
    status: AnswerStatus,
    reason: Reason,
    guard: Option<Trip>,
    outputs: Vec<u32>,
}

impl Told {
    fn answered(outputs: &[u32]) -> Self {
        let (status, reason, guard) = (AnswerStatus::Answered, Reason::None, None);
        Self { status, reason, guard, outputs: outputs.to_vec() }
    }

    fn tripped(trip: Trip, output: f32) -> Self {
        let (status, reason) = (AnswerStatus::Fallback, Reason::Guard);
        Self { status, reason, guard: Some(trip), outputs: bits(&[output]) }
    }
}

fn decide(client: &mut PolicyClient, position: f32) -> Told {
    let action = client.decide(&[&[position]], &[]).unwrap();
    let (status, reason, guard) = (action.status, action.reason, action.guard);
    Told { status, reason, guard, outputs: bits(action.outputs) }
}

/// Serves the cart's plan with these guards to what asks; the counters of both ends.
fn serve(
    facts: &GuardFacts,
    ask: impl FnOnce(&mut PolicyClient),
) -> (ServeCounters, ClientCounters) {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let serving = Serving::start(&domain, guarded(facts), &settings(Fallback::Hold));
    let mut client = PolicyClient::connect(&domain, &CART_SHAPE, &PATIENT).unwrap();
    ask(&mut client);
    let met = client.counters();
    drop(client);
    (serving.end(), met)
}

#[test]
fn an_input_outside_of_its_range_is_answered_by_the_plans_fallback_in_the_same_tick_and_held() {
    let facts = GuardFacts {
        hold: 2,
        fallback: Some(GuardedOutputs::Numbers(vec![0.125])),
        inputs: InputGuards { lowest: vec![-1.0], highest: vec![1.0] },
        ..GuardFacts::default()
    };
    let mut direct = Direct::new(CART);
    let (served, met) = serve(&facts, |client| {
        let trip = Trip::InputRange { index: 0 };
        assert_eq!(decide(client, 1.0), Told::answered(&direct.bits(&[&[1.0]], 1)));
        for odd in [1.0_f32.next_up(), f32::NAN] {
            assert_eq!(decide(client, odd), Told::tripped(trip, 0.125), "{odd}");
        }
        for _ in 0..2 {
            assert_eq!(decide(client, 0.5), Told::tripped(Trip::Held, 0.125));
        }
        // The network has not seen what was refused or held.
        assert_eq!(decide(client, 0.5), Told::answered(&direct.bits(&[&[0.5]], 1)));
    });
    assert_eq!((served.answered, served.fallbacks, served.guarded), (2, 4, 4));
    assert_eq!((met.answered, met.fallbacks, met.guarded), (2, 4, 4));
}

#[test]
fn an_output_that_changes_too_fast_is_compared_with_what_was_given_out() {
    let mut direct = Direct::new(CART);
    let forces = [0.9, -0.9].map(|position: f32| direct.bits(&[&[position]], 1));
    let numbers = forces.each_ref().map(|bits| f32::from_bits(bits[0]));
    let change = (numbers[1] - numbers[0]).abs();
    assert!(change > 0.01, "{numbers:?}");
    let facts = |change: f32, fallback| GuardFacts {
        fallback: Some(GuardedOutputs::Named(fallback)),
        outputs: OutputGuards { change: vec![change], ..OutputGuards::default() },
        ..GuardFacts::default()
    };
    // As much as it may is not too much.
    serve(&facts(change, GuardedBy::Hold), |client| {
        assert_eq!(decide(client, 0.9), Told::answered(&forces[0]));
        assert_eq!(decide(client, -0.9), Told::answered(&forces[1]));
    });
    let trip = Trip::OutputRate { index: 0 };
    let less = change.next_down().next_down();
    serve(&facts(less, GuardedBy::Hold), |client| {
        assert_eq!(decide(client, 0.9), Told::answered(&forces[0]));
        assert_eq!(decide(client, -0.9), Told::tripped(trip, numbers[0]));
    });
    // The next force is near the last one, and far from zeros that were given out meanwhile.
    let mut direct = Direct::new(CART);
    let near = [0.9, 0.9].map(|position: f32| direct.bits(&[&[position]], 1));
    let [first, second] = near.each_ref().map(|bits| f32::from_bits(bits[0]));
    let change = 0.5 * second.abs();
    assert!((second - first).abs() < change, "{first}, {second}");
    serve(&facts(change, GuardedBy::Zero), |client| {
        assert_eq!(decide(client, 0.9), Told::answered(&near[0]));
        let refused = Told { reason: Reason::NonFinite, guard: None, ..Told::tripped(trip, 0.0) };
        assert_eq!(decide(client, f32::NAN), refused);
        assert_eq!(decide(client, 0.9), Told::tripped(trip, 0.0));
    });
}

#[test]
fn outputs_that_are_clamped_are_answers_and_told() {
    let mut direct = Direct::new(CART);
    let force = f32::from_bits(direct.bits(&[&[0.9]], 1)[0]);
    let limit = 0.5 * force.abs();
    let facts = GuardFacts {
        outputs: OutputGuards {
            lowest: vec![-limit],
            highest: vec![limit],
            change: Vec::new(),
            beyond: Beyond::Clamp,
        },
        ..GuardFacts::default()
    };
    let (served, met) = serve(&facts, |client| {
        let clamped = Told {
            guard: Some(Trip::OutputRange { index: 0 }),
            ..Told::answered(&bits(&[limit.copysign(force)]))
        };
        assert_eq!(decide(client, 0.9), clamped);
    });
    assert_eq!((served.answered, served.clamped, served.fallbacks, served.guarded), (1, 1, 0, 0));
    assert_eq!((met.answered, met.clamped, met.fallbacks), (1, 1, 0));
}

#[test]
fn without_a_fallback_in_the_plan_the_servers_counts() {
    let facts = GuardFacts {
        inputs: InputGuards { lowest: vec![-1.0], highest: vec![1.0] },
        ..GuardFacts::default()
    };
    let mut direct = Direct::new(CART);
    serve(&facts, |client| {
        let last = direct.bits(&[&[0.5]], 1);
        assert_eq!(decide(client, 0.5), Told::answered(&last));
        let held = Told::tripped(Trip::InputRange { index: 0 }, f32::from_bits(last[0]));
        assert_eq!(decide(client, 2.0), held);
    });
}

#[test]
fn guards_of_other_inputs_are_refused_before_anything_is_answered() {
    let mut plan = CART.to_vec();
    let facts = GuardFacts {
        inputs: InputGuards { lowest: vec![-1.0], highest: vec![1.0] },
        ..GuardFacts::default()
    };
    facts.append_to(&mut plan, &GuardedSizes { inputs: 2, ..SIZES }).unwrap();
    let domain = toy::domain();
    let mut server = PolicyServer::open(&domain, schema(CART), &settings(Fallback::Hold)).unwrap();
    let guards = Guards::of_plan(&plan).unwrap();
    let served = server.serve(&Plan::load(CART).unwrap(), guards, &mut |_| (), &Stop::new());
    let Err(Error::NotServed { problem }) = served else { panic!("it is served") };
    assert!(problem.contains("1 numbers in all inputs, its guards are about 2"), "{problem}");
}
