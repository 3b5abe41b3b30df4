//! Any bytes as a plan, and plans forged with right checksums, through the C interface: arrays have exactly the sizes that
//! the library names, or others. What lies around the policy's memory stays as it is, and so do the plan and what a
//! failed call was to replace.
#![no_main]
#![allow(unsafe_code, reason = "calls functions for C, with arrays that are as long as it says")]

mod forged;
mod input;

use std::ptr;

use forged::MOST_BYTES;
use input::Input;
use libfuzzer_sys::fuzz_target;
use sortie_capi::*;

/// Bytes before and after the memory that must stay as they are.
const GUARD: usize = 64;

fuzz_target!(|bytes: &[u8]| {
    let Some((plan, bytes)) = forged::plan(bytes) else { return };
    let plan = plan.as_slice();
    let before = plan.to_vec();
    let mut input = Input(bytes.get(bytes.len() / 2..).unwrap_or_default());
    let mut needed = 0;
    // SAFETY: a slice, and a number to be written.
    let told = unsafe { sortie_memory_bytes(plan.as_ptr().cast(), plan.len(), &mut needed) };
    if needed > MOST_BYTES {
        return;
    }
    let start = GUARD + input.up_to(63);
    let mut memory = vec![0xA5; start + needed + GUARD];
    let mut policy = ptr::null_mut();
    // SAFETY: a slice, memory that lasts as long as the policy, and a pointer to be written.
    let loaded = unsafe {
        let memory = memory[start..].as_mut_ptr().cast();
        sortie_load(plan.as_ptr().cast(), plan.len(), memory, needed, &mut policy)
    };
    assert_eq!((loaded, policy.is_null()), (told, told != SortieError::None));
    let calls = input.up_to(3);
    for _ in 0..calls {
        call(policy, &mut input);
    }
    guard(policy, &mut input);
    let guards = memory[..start].iter().chain(&memory[start + needed..]);
    assert!(guards.copied().all(|byte| byte == 0xA5), "left its memory");
    assert!(plan == before, "wrote to the plan");
});

/// The guards of a policy that may be null, in memory that may be too small, around numbers that may be anything.
fn guard(policy: *mut SortiePolicy, input: &mut Input<'_>) {
    // SAFETY: null or loaded.
    let count = |one: unsafe extern "C" fn(*const SortiePolicy) -> usize| unsafe { one(policy) };
    // SAFETY: null or loaded.
    let of_input = |index| unsafe { sortie_input_length(policy, index) };
    // SAFETY: null or loaded.
    let of_output = |index| unsafe { sortie_output_length(policy, index) };
    let inputs = (0..count(sortie_input_count)).map(of_input).sum();
    let outputs = (0..count(sortie_output_count)).map(of_output).sum();
    let (mut memory, mut guards) = (vec![0xA5_u8; input.up_to(512)], ptr::null_mut());
    let room = memory.as_mut_ptr().cast();
    // SAFETY: null or loaded; a slice that lasts as long as the guards, and a pointer to be written.
    let placed = unsafe { sortie_guard(policy, room, memory.len(), &mut guards) };
    assert_eq!(placed == SortieError::None, !guards.is_null());
    let (seen, mut given) = (floats(input, inputs, true), floats(input, outputs, true));
    let mut trip = SortieTrip { guard: 0, index: 0, clamped: false };
    let age_ns = u64::from(input.byte()) << 30;
    // SAFETY: null or placed; slices, and a trip to be written.
    let checked = unsafe {
        [
            sortie_check_inputs(guards, seen.as_ptr(), seen.len(), age_ns, &mut trip),
            sortie_check_outputs(guards, given.as_mut_ptr(), given.len(), &mut trip),
            sortie_fall_back(guards, i32::from(input.byte()), given.as_mut_ptr(), given.len()),
        ]
    };
    let is_known = |error| matches!(error, SortieError::None | SortieError::NoTrip);
    assert!(guards.is_null() || checked.into_iter().all(is_known), "{checked:?}");
}

/// One call, of a policy that may be null.
fn call(policy: *mut SortiePolicy, input: &mut Input<'_>) {
    // SAFETY: null or loaded.
    let numbers = unsafe { sortie_state_numbers(policy) };
    let is_exact = !input.byte().is_multiple_of(8);
    let mut states = floats(input, numbers, is_exact);
    let kept = bits(&states);
    // SAFETY: null or loaded.
    let error = match unsafe { sortie_kind(policy) } {
        SortieKind::Agent => decide(policy, input, &mut states, is_exact),
        _ => respond(policy, input, &mut states, is_exact),
    };
    if error != SortieError::None {
        assert_eq!(bits(&states), kept, "{error:?} has changed the states");
    }
    let is_of_sizes = matches!(error, SortieError::WrongCount | SortieError::WrongLength);
    // An agent's observation has sizes of its own.
    // SAFETY: null or loaded.
    let is_policy = unsafe { sortie_kind(policy) } == SortieKind::Policy;
    assert!(!(is_exact && is_policy && is_of_sizes), "{error:?}");
    assert!(error != SortieError::Overlap && error != SortieError::Misaligned);
}

fn respond(
    policy: *mut SortiePolicy,
    input: &mut Input<'_>,
    states: &mut [f32],
    is_exact: bool,
) -> SortieError {
    // SAFETY: null or loaded.
    let (inputs, outputs) = unsafe { (sortie_input_count(policy), sortie_output_count(policy)) };
    // SAFETY: null or loaded.
    let input_length = |index| unsafe { sortie_input_length(policy, index) };
    // SAFETY: null or loaded.
    let output_length = |index| unsafe { sortie_output_length(policy, index) };
    let given: Vec<_> =
        (0..inputs).map(|index| floats(input, input_length(index), is_exact)).collect();
    let mut written: Vec<_> =
        (0..outputs).map(|index| floats(input, output_length(index), is_exact)).collect();
    let inputs: Vec<_> = given
        .iter()
        .map(|values| SortieInput { values: values.as_ptr(), length: values.len() })
        .collect();
    let outputs: Vec<_> = written
        .iter_mut()
        .map(|values| SortieOutput { values: values.as_mut_ptr(), length: values.len() })
        .collect();
    let available = available(policy, input, is_exact);
    let (to, random) = (&mut SortieDecision { action: 0, utility: 0.0 }, input.word() as u32);
    let (count, state_numbers) = (inputs.len(), states.len());
    let (inputs, states) = (inputs.as_ptr(), states.as_mut_ptr());
    let (mask, actions) = (available.as_ptr(), available.len());
    let (to_outputs, written) = (outputs.as_ptr(), outputs.len());
    let call = input.up_to(2);
    // SAFETY: everything is as long as it says, and apart.
    unsafe {
        match call {
            0 => sortie_respond(policy, inputs, count, states, state_numbers, to_outputs, written),
            1 => sortie_choose(policy, inputs, count, mask, actions, states, state_numbers, to),
            _ => {
                sortie_draw(policy, inputs, count, mask, actions, states, state_numbers, random, to)
            }
        }
    }
}

fn decide(
    policy: *mut SortiePolicy,
    input: &mut Input<'_>,
    states: &mut [f32],
    is_exact: bool,
) -> SortieError {
    // SAFETY: loaded.
    let (features, most) = unsafe { (sortie_features(policy), sortie_most_entities(policy)) };
    let (entities, stride) = (input.up_to(most.min(12)), features + input.up_to(2));
    let rows = floats(input, entities * stride, true);
    let last_actions: Box<[u16]> = (0..input.up_to(3)).map(|_| input.word() as u16 % 5).collect();
    let visible: Box<[u8]> = (0..entities).map(|_| input.byte() % 2).collect();
    let available = available(policy, input, is_exact);
    let seen = SortieObservation {
        rows: rows.as_ptr(),
        entities,
        stride,
        last_actions: last_actions.as_ptr(),
        agents: last_actions.len(),
        visible: if input.byte() < 32 { ptr::null() } else { visible.as_ptr() },
        own: input.up_to(13),
        available: available.as_ptr(),
        actions: available.len(),
    };
    let (to, random) = (&mut SortieDecision { action: 0, utility: 0.0 }, input.word() as u32);
    let (states, numbers) = (states.as_mut_ptr(), states.len());
    let draws = input.byte().is_multiple_of(2);
    // SAFETY: everything is as long as it says, and apart.
    unsafe {
        match draws {
            false => sortie_decide(policy, &seen, states, numbers, to),
            true => sortie_sample(policy, &seen, states, numbers, random, to),
        }
    }
}

/// A byte for every action.
fn available(policy: *mut SortiePolicy, input: &mut Input<'_>, is_exact: bool) -> Box<[u8]> {
    // SAFETY: null or loaded.
    let actions = unsafe { sortie_actions(policy) };
    (0..length(input, actions, is_exact)).map(|_| input.byte() / 64).collect()
}

/// So many numbers, or some more or fewer; without room behind them.
fn floats(input: &mut Input<'_>, wanted: usize, is_exact: bool) -> Box<[f32]> {
    (0..length(input, wanted, is_exact)).map(|_| input.float()).collect()
}

fn length(input: &mut Input<'_>, wanted: usize, is_exact: bool) -> usize {
    if is_exact { wanted } else { (wanted + input.up_to(2)).saturating_sub(1) }
}

fn bits(numbers: &[f32]) -> Vec<u32> {
    numbers.iter().map(|number| number.to_bits()).collect()
}
