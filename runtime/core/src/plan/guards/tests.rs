use std::string::{String, ToString};
use std::vec::Vec;

use super::*;
use crate::plan::{
    Beyond, GuardFacts, GuardedBy, GuardedOutputs, GuardedSizes, InputGuards, OutputGuards,
    RobotFacts,
};

/// A plan that has an annex.
const PLAN: &[u8] = include_bytes!("../../../../../tests/golden/plans/policy-2.0.plan");
const SIZES: GuardedSizes = GuardedSizes { inputs: 3, outputs: 2, chooses: false };

fn facts() -> GuardFacts {
    GuardFacts {
        hold: 2,
        fallback: Some(GuardedOutputs::Numbers(Vec::from([0.25, -0.25]))),
        age_ms: Some(20.0),
        inputs: InputGuards {
            lowest: Vec::from([-1.0, -2.0, 0.0]),
            highest: Vec::from([1.0, 2.0, 0.5]),
        },
        outputs: OutputGuards {
            lowest: Vec::from([-1.0]),
            highest: Vec::from([1.0, 2.0]),
            change: Vec::from([0.5]),
            beyond: Beyond::Fallback,
        },
    }
}

fn plan(facts: &GuardFacts) -> Vec<u8> {
    let mut plan = PLAN.to_vec();
    facts.append_to(&mut plan, &SIZES).unwrap();
    plan
}

/// What is tried on the guards of changed facts.
fn with(change: impl FnOnce(&mut GuardFacts), try_out: impl FnOnce(&Guards<'_>)) {
    let mut facts = facts();
    change(&mut facts);
    let plan = plan(&facts);
    try_out(&Guards::of_plan(&plan).unwrap().unwrap());
}

fn state() -> GuardState<[f32; 2]> {
    GuardState::new([9.0; 2])
}

#[test]
fn what_is_written_behind_a_plan_is_read_again() {
    assert!(Guards::of_plan(PLAN).unwrap().is_none());
    assert_eq!(GuardFacts::of_plan(&plan(&facts())), Ok(Some(facts())));
    let few = GuardFacts { age_ms: Some(0.000_001), ..GuardFacts::default() };
    assert_eq!(GuardFacts::of_plan(&plan(&few)), Ok(Some(few)));
    for by in [GuardedBy::Hold, GuardedBy::Zero] {
        let fallback = Some(GuardedOutputs::Named(by));
        let outputs = OutputGuards {
            change: Vec::from([f32::INFINITY, 0.0]),
            beyond: Beyond::Clamp,
            ..OutputGuards::default()
        };
        let some = GuardFacts { fallback, outputs, ..GuardFacts::default() };
        assert_eq!(GuardFacts::of_plan(&plan(&some)), Ok(Some(some)));
    }
}

#[test]
fn robots_and_guards_stand_behind_one_another_in_any_order() {
    let robot = RobotFacts { joint_names: Vec::from(["hip".to_string()]), ..Default::default() };
    for robot_first in [false, true] {
        let mut plan = PLAN.to_vec();
        if robot_first {
            robot.append_to(&mut plan);
        }
        facts().append_to(&mut plan, &SIZES).unwrap();
        if !robot_first {
            robot.append_to(&mut plan);
        }
        assert_eq!(RobotFacts::of_plan(&plan).as_ref(), Some(&robot));
        assert_eq!(GuardFacts::of_plan(&plan), Ok(Some(facts())));
    }
}

#[test]
fn a_plan_that_is_cut_off_or_changed_behind_its_weights_is_refused() {
    let mut plan = PLAN.to_vec();
    RobotFacts::default().append_to(&mut plan);
    let end = plan.len();
    facts().append_to(&mut plan, &SIZES).unwrap();
    for length in end + 1..plan.len() {
        assert_eq!(Guards::of_plan(&plan[..length]).err(), Some(GuardError::Damaged), "{length}");
    }
    let (header, _) = crate::plan::Header::read(&plan).unwrap();
    let weights_end = (header.weights_offset + header.weights_len) as usize;
    assert!(weights_end < end);
    for place in weights_end..plan.len() {
        for bit in 0..8 {
            let mut changed = plan.clone();
            changed[place] ^= 1 << bit;
            let found = GuardFacts::of_plan(&changed);
            // Another section may have another name, but nothing makes it a plan without guards.
            let is_renamed = place < end && found == Ok(Some(facts()));
            assert!(is_renamed || found == Err(GuardError::Damaged), "bit {bit} of {place}");
        }
    }
    let mut more = plan.clone();
    more.push(0);
    assert_eq!(Guards::of_plan(&more).err(), Some(GuardError::Damaged));
    facts().append_to(&mut plan, &SIZES).unwrap();
    assert_eq!(Guards::of_plan(&plan).err(), Some(GuardError::Damaged), "two of them");
    let no_plan = GuardError::Plan(crate::plan::PlanError::BadMagic);
    assert_eq!(Guards::of_plan(b"no plan at all").err(), Some(no_plan));
}

/// Guards that a writer of another version, or somebody who means harm, has sealed rightly.
#[test]
fn sealed_bytes_that_are_no_guards_are_refused() {
    let sealed = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut plan = plan(&facts());
        let mut body = plan.split_off(PLAN.len()).split_off(16);
        change(&mut body);
        let length = (body.len() as u32).to_le_bytes();
        plan.extend(MAGIC);
        plan.extend(length);
        plan.extend(checksum(&MAGIC, &length, &body).to_le_bytes());
        plan.extend(body);
        Guards::of_plan(&plan).err()
    };
    assert_eq!(sealed(&|_| ()), None);
    assert_eq!(sealed(&|body| body[0] = 2), Some(GuardError::Version { got: 2 }));
    assert_eq!(sealed(&|body| body[1] = 9), Some(GuardError::Damaged));
    assert_eq!(sealed(&|body| body[2] = 2), Some(GuardError::Contradiction));
    // Numbers that nobody gives out.
    assert_eq!(sealed(&|body| body[1] = 1), Some(GuardError::Contradiction));
    for inputs in [2, 4, u8::MAX] {
        assert!(sealed(&|body| body[16] = inputs).is_some(), "{inputs}");
    }
    assert_eq!(sealed(&|body| body.truncate(9)), Some(GuardError::Damaged));
    let numbers = size_of::<Head>()..size_of::<Head>() + 3 * 8 + 2 * 12 + 2 * 4;
    for at in numbers.step_by(4) {
        let nan = sealed(&|body| body[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes()));
        assert_eq!(nan, Some(GuardError::Contradiction), "{at}");
    }
}

#[test]
fn what_guards_are_about_is_compared_with_the_plan() {
    with(
        |_| (),
        |guards| {
            assert_eq!(guards.check_fits(3, 2), Ok(()));
            let inputs = GuardError::Inputs { want: 4, got: 3 };
            assert_eq!(guards.check_fits(4, 2), Err(inputs));
            let outputs = GuardError::Outputs { want: 1, got: 2 };
            assert_eq!(guards.check_fits(3, 1), Err(outputs));
            let mut room = GuardState::new([0.0; 3]);
            assert_eq!(guards.check_inputs(&room, &[0.0; 2], None), Err(Trip::Length));
            assert_eq!(guards.check_outputs(&mut room, &mut [0.0; 3]), Err(Trip::Length));
            assert_eq!(guards.check_outputs(&mut room, &mut [0.0; 2]), Err(Trip::Length));
        },
    );
    let only_safe = |facts: &mut GuardFacts| facts.outputs = OutputGuards::default();
    with(only_safe, |guards| {
        assert_eq!(guards.check_fits(3, 1), Err(GuardError::Outputs { want: 1, got: 2 }));
    });
}

#[test]
fn inputs_at_their_limits_pass_and_the_next_number_does_not() {
    with(
        |_| (),
        |guards| {
            let check = |inputs: [f32; 3]| guards.check_inputs(&state(), &inputs, Some(20_000_000));
            let trip = |index| Err(Trip::InputRange { index });
            assert_eq!(check([-1.0, -2.0, 0.0]), Ok(()));
            assert_eq!(check([1.0, 2.0, 0.5]), Ok(()));
            assert_eq!(check([1.0_f32.next_up(), 0.0, 0.0]), trip(0));
            assert_eq!(check([0.0, (-2.0_f32).next_down(), 0.0]), trip(1));
            assert_eq!(check([0.0, 0.0, (-0.0_f32).next_down()]), trip(2));
            assert_eq!(check([0.0, 3.0, -3.0]), trip(1), "the first is named");
            for odd in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                assert_eq!(check([0.0, 0.0, odd]), trip(2));
            }
        },
    );
    // Where one side is left open, what is infinite is no number of it.
    with(
        |facts| facts.inputs.highest.clear(),
        |guards| {
            let check = |input| guards.check_inputs(&state(), &[input, 0.0, 0.0], None);
            assert_eq!(check(f32::MAX), Ok(()));
            assert_eq!(check(f32::INFINITY), Err(Trip::InputRange { index: 0 }));
        },
    );
}

#[test]
fn observations_that_are_too_old_trip_where_their_age_is_known() {
    with(
        |_| (),
        |guards| {
            let check = |age_ns| guards.check_inputs(&state(), &[0.0; 3], age_ns);
            assert_eq!(check(Some(20_000_000)), Ok(()));
            assert_eq!(check(Some(20_000_001)), Err(Trip::Age));
            assert_eq!(check(None), Ok(()));
        },
    );
    with(
        |facts| facts.age_ms = None,
        |guards| assert_eq!(guards.check_inputs(&state(), &[0.0; 3], Some(u64::MAX)), Ok(())),
    );
}

#[test]
fn outputs_at_their_limits_pass_and_the_next_number_does_not() {
    with(
        |facts| facts.outputs.change.clear(),
        |guards| {
            let check = |mut outputs: [f32; 2]| {
                let tripped = guards.check_outputs(&mut state(), &mut outputs);
                tripped.map_err(|trip| trip.to_string())
            };
            let range = |index: u32| Err(Trip::OutputRange { index }.to_string());
            assert_eq!(check([-1.0, -1.0]), Ok(None));
            assert_eq!(check([1.0, 2.0]), Ok(None));
            assert_eq!(check([1.0_f32.next_up(), 0.0]), range(0));
            assert_eq!(check([0.0, (-1.0_f32).next_down()]), range(1));
            for odd in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                let named = Trip::OutputNotFinite { index: 1 }.to_string();
                assert_eq!(check([0.0, odd]), Err(named), "{odd}");
            }
        },
    );
}

#[test]
fn outputs_change_by_no_more_than_they_may_from_what_was_given_out() {
    with(
        |_| (),
        |guards| {
            let mut state = state();
            let mut check = |mut outputs: [f32; 2]| guards.check_outputs(&mut state, &mut outputs);
            let rate = |index| Err(Trip::OutputRate { index });
            // The first may be anything in the range, near zero or not.
            assert_eq!(check([1.0, 2.0]), Ok(None));
            assert_eq!(check([0.5, 1.5]), Ok(None));
            assert_eq!(check([0.5, 2.0_f32.next_up()]), Err(Trip::OutputRange { index: 1 }));
            assert_eq!(check([-1.0e-7, 1.5]), rate(0));
            assert_eq!(check([0.5, 0.999]), rate(1));
            // Nothing of what was refused is remembered.
            assert_eq!(check([1.0, 2.0]), Ok(None));
            assert_eq!(check([f32::NAN, 0.0]), Err(Trip::OutputNotFinite { index: 0 }));
            guards.fall_back(&mut state, Trip::OutputNotFinite { index: 0 }, &mut [0.0; 2]);
            assert_eq!(state.previous(), [0.25, -0.25]);
            let mut check = |mut outputs: [f32; 2]| guards.check_outputs(&mut state, &mut outputs);
            // From the safe outputs on, not from what the network said last.
            assert_eq!(check([1.0, 2.0]), rate(0));
            assert_eq!(check([0.75, 0.25]), Ok(None));
        },
    );
}

#[test]
fn the_first_outputs_are_limited_by_their_range_alone_and_leave_no_trace_where_they_are_refused() {
    with(
        |facts| facts.fallback = Some(GuardedOutputs::Named(GuardedBy::Hold)),
        |guards| {
            let mut state = state();
            let mut outputs = [7.0, 7.0];
            let tripped = guards.check_outputs(&mut state, &mut outputs);
            assert_eq!(tripped, Err(Trip::OutputRange { index: 0 }));
            guards.fall_back(&mut state, Trip::OutputRange { index: 0 }, &mut outputs);
            assert_eq!(outputs, [0.0; 2]);
            // Zeros were given out: from now on there is something to change from.
            let tripped = guards.check_outputs(&mut state, &mut [0.75, 0.0]);
            assert_eq!(tripped, Err(Trip::OutputRate { index: 0 }));
            state.begin();
            assert_eq!(guards.check_outputs(&mut state, &mut [0.75, 0.0]), Ok(None));
        },
    );
}

#[test]
fn what_is_beyond_is_clamped_to_range_and_change_and_told() {
    with(
        |facts| facts.outputs.beyond = Beyond::Clamp,
        |guards| {
            let mut state = state();
            let mut clamp = |mut outputs: [f32; 2]| {
                let told = guards.check_outputs(&mut state, &mut outputs);
                (told, outputs, state.previous().to_vec())
            };
            let range = Ok(Some(Trip::OutputRange { index: 0 }));
            let rate = |index| Ok(Some(Trip::OutputRate { index }));
            assert_eq!(clamp([5.0, 1.0]), (range, [1.0, 1.0], Vec::from([1.0, 1.0])));
            assert_eq!(clamp([-0.9, 2.0]), (rate(0), [0.5, 1.5], Vec::from([0.5, 1.5])));
            assert_eq!(clamp([0.5, 1.5]), (Ok(None), [0.5, 1.5], Vec::from([0.5, 1.5])));
            assert_eq!(clamp([0.5, -9.0]).1, [0.5, 1.0]);
            // Both: it is out of its range, and comes no nearer to it than it may change by.
            let both = Ok(Some(Trip::OutputRange { index: 0 }));
            assert_eq!(clamp([-9.0, 1.0]), (both, [0.0, 1.0], Vec::from([0.0, 1.0])));
            // What is no number has no neighbour within limits, and is not remembered.
            let odd = Err(Trip::OutputNotFinite { index: 1 });
            let (told, _, previous) = clamp([-9.0, f32::INFINITY]);
            assert_eq!((told, previous), (odd, Vec::from([0.0, 1.0])));
        },
    );
    // A fallback of the caller's that is outside of the range: the range counts, whatever the change.
    with(
        |facts| facts.outputs.beyond = Beyond::Clamp,
        |guards| {
            let mut state = state();
            guards.fell_back(&mut state, Trip::Age, &[-5.0, f32::NAN]);
            let mut outputs = [0.0, 0.0];
            let told = guards.check_outputs(&mut state, &mut outputs);
            assert_eq!(told, Err(Trip::OutputRate { index: 1 }));
            guards.fell_back(&mut state, Trip::Age, &[-5.0, 0.0]);
            assert_eq!(
                guards.check_outputs(&mut state, &mut outputs),
                Ok(Some(Trip::OutputRate { index: 0 }))
            );
            assert_eq!(outputs, [-1.0, 0.0]);
        },
    );
}

#[test]
fn a_fallback_is_held_for_so_many_further_decisions() {
    with(
        |_| (),
        |guards| {
            let mut state = state();
            let mut decide = |input: f32| {
                let mut outputs = [0.5, 0.5];
                let checked = guards.check_inputs(&state, &[input; 3], None);
                if let Err(trip) = checked {
                    guards.fall_back(&mut state, trip, &mut outputs);
                    return (Some(trip), outputs);
                }
                (guards.check_outputs(&mut state, &mut outputs).unwrap(), outputs)
            };
            let (safe, trip) = ([0.25, -0.25], Some(Trip::InputRange { index: 0 }));
            assert_eq!(decide(0.25), (None, [0.5, 0.5]));
            assert_eq!(decide(f32::NAN), (trip, safe));
            assert_eq!(decide(0.25), (Some(Trip::Held), safe));
            // Another trip within the hold begins it anew.
            assert_eq!(decide(f32::NAN), (trip, safe));
            assert_eq!(decide(0.25), (Some(Trip::Held), safe));
            assert_eq!(decide(0.25), (Some(Trip::Held), safe));
            assert_eq!(state.held(), 0);
        },
    );
    with(
        |facts| facts.hold = 0,
        |guards| {
            let mut state = state();
            guards.fall_back(&mut state, Trip::Undecided, &mut [0.0; 2]);
            assert_eq!(guards.check_inputs(&state, &[0.0; 3], None), Ok(()));
        },
    );
}

#[test]
fn the_fallback_is_what_the_plan_says() {
    let given_out = |fallback: Option<GuardedOutputs>| {
        let mut outputs = [9.0, 9.0];
        with(
            |facts| facts.fallback = fallback,
            |guards| {
                let mut state = state();
                assert_eq!(guards.check_outputs(&mut state, &mut [0.5, 0.75]), Ok(None));
                guards.fall_back(&mut state, Trip::Age, &mut outputs);
                assert_eq!(state.previous(), outputs);
            },
        );
        outputs
    };
    let named = |by| Some(GuardedOutputs::Named(by));
    assert_eq!(given_out(None), [0.5, 0.75]);
    assert_eq!(given_out(named(GuardedBy::Hold)), [0.5, 0.75]);
    assert_eq!(given_out(named(GuardedBy::Zero)), [0.0; 2]);
    assert_eq!(given_out(Some(GuardedOutputs::Numbers(Vec::from([0.125])))), [0.125; 2]);
}

/// The same bits on every target: what these come to, computed apart from this code (each sum and product rounded to f32).
#[test]
fn a_recorded_walk_is_clamped_to_the_same_bits() {
    with(
        |facts| {
            facts.outputs.beyond = Beyond::Clamp;
            facts.outputs.change = Vec::from([0.1, 0.3]);
        },
        |guards| {
            let mut state = state();
            let mut sum = 0_u32;
            for step in 0_u16..200 {
                let wild = f32::from(step.wrapping_mul(7919) % 251) / 83.0 - 1.5;
                let mut outputs = [wild, 0.7 * wild];
                let _ = guards.check_outputs(&mut state, &mut outputs);
                for output in outputs {
                    sum = sum.rotate_left(5) ^ output.to_bits();
                }
            }
            assert_eq!(sum, 0x0055_8b83, "{sum:#010x}");
        },
    );
}

#[test]
fn flaws_are_named() {
    type Change = fn(&mut GuardFacts);
    let flaw = |change: Change| {
        let mut facts = facts();
        change(&mut facts);
        let mut plan = PLAN.to_vec();
        let refused = facts.append_to(&mut plan, &SIZES);
        assert_eq!(plan.len() == PLAN.len(), refused.is_err());
        assert_eq!(facts.flaw(&SIZES), refused.clone().err());
        refused.err().unwrap_or_default()
    };
    assert_eq!(flaw(|_| ()), "");
    let cases: [(Change, &str); 10] = [
        (
            |facts| *facts = GuardFacts::default(),
            "nothing is guarded: name `inputs`, `outputs` or `age_ms`",
        ),
        (|facts| facts.age_ms = Some(0.0), "`age_ms` is not above 0 and up to 1000000000"),
        (|facts| facts.age_ms = Some(f64::NAN), "`age_ms` is not above 0 and up to 1000000000"),
        (
            |facts| facts.inputs.lowest.truncate(2),
            "`inputs.lowest` has 2 numbers, needed are 1 or 3",
        ),
        (|facts| facts.outputs.highest[1] = f32::NAN, "`outputs.highest` is NaN at 1"),
        (|facts| facts.inputs.lowest[2] = 0.6, "`inputs.lowest` is above `inputs.highest` at 2"),
        (|facts| facts.outputs.lowest[0] = 1.5, "`outputs.lowest` is above `outputs.highest` at 0"),
        (|facts| facts.outputs.change[0] = -0.1, "`outputs.change` is negative at 0"),
        (
            |facts| facts.fallback = Some(GuardedOutputs::Numbers(Vec::from([0.0, 2.5]))),
            "`fallback` is above `outputs.highest` at 1",
        ),
        (
            |facts| facts.fallback = Some(GuardedOutputs::Numbers(Vec::from([f32::INFINITY]))),
            "`fallback` is no finite number at 0",
        ),
    ];
    for (change, words) in cases {
        assert_eq!(flaw(change), words);
    }
    let chooses = GuardedSizes { chooses: true, ..SIZES };
    assert!(facts().flaw(&chooses).is_some_and(|flaw| flaw.contains("chooses among actions")));
    let of_inputs = GuardFacts { outputs: OutputGuards::default(), fallback: None, ..facts() };
    assert_eq!(of_inputs.flaw(&chooses), None);
}

#[test]
fn ranges_of_inputs_hold_what_was_seen_and_a_margin() {
    let mut seen = InputGuards::unseen(2);
    for inputs in [[1.0, 5.0], [-1.0, 5.0], [3.0, 5.0]] {
        seen.see(&inputs);
    }
    assert_eq!((&seen.lowest[..], &seen.highest[..]), (&[-1.0, 5.0][..], &[3.0, 5.0][..]));
    seen.widen(0.25);
    assert_eq!((&seen.lowest[..], &seen.highest[..]), (&[-2.0, 5.0][..], &[4.0, 5.0][..]));
}

#[test]
fn trips_are_numbers_and_words() {
    let index = 0x00AB_CDEF;
    let all = [
        Trip::InputRange { index },
        Trip::Age,
        Trip::OutputNotFinite { index },
        Trip::OutputRange { index },
        Trip::OutputRate { index },
        Trip::Length,
        Trip::Undecided,
        Trip::Held,
    ];
    for (kind, trip) in (1..).zip(all) {
        assert_eq!(trip.number(), kind | trip.index().unwrap_or(0) << 8);
        assert_eq!(Trip::from_number(trip.number()), Some(trip));
        assert!(!trip.name().is_empty() && trip.to_string().len() > 10);
    }
    assert_eq!((Trip::from_number(0), Trip::from_number(9)), (None, None));
    let mut names: Vec<String> = all.iter().map(|trip| trip.name().to_string()).collect();
    names.sort();
    names.dedup();
    assert_eq!(names.len(), all.len());
}

/// Made by another program than this one.
#[test]
fn a_recorded_plan_has_the_guards_that_were_written_into_it() {
    let plan = include_bytes!("../../../../../tests/golden/plans/guarded-2.3.plan");
    let want = GuardFacts {
        hold: 2,
        fallback: Some(GuardedOutputs::Named(GuardedBy::Zero)),
        age_ms: Some(10_000.0),
        inputs: InputGuards { lowest: Vec::from([-1.5]), highest: Vec::from([1.5]) },
        outputs: OutputGuards {
            lowest: Vec::from([-1.0]),
            highest: Vec::from([1.0]),
            change: Vec::from([0.5]),
            beyond: Beyond::Fallback,
        },
    };
    assert_eq!(GuardFacts::of_plan(plan), Ok(Some(want.clone())));
    let mut written = include_bytes!("../../../../../examples/embed_c/cart.plan").to_vec();
    let sizes = GuardedSizes { inputs: 1, outputs: 1, chooses: false };
    want.append_to(&mut written, &sizes).unwrap();
    assert_eq!(written, plan);
}
