//! Any bytes as a plan, and plans forged with right checksums: load, decide, stay inside the arena.
#![no_main]

mod forged;
mod input;

use forged::MOST_BYTES;
use input::Input;
use libfuzzer_sys::fuzz_target;
use sortie_core::internal::kernels::build::Build;
use sortie_core::plan::{AlignedBytes, Guards, Plan};
use sortie_core::{EntityMask, NO_ACTION, Observation};

/// Bytes before and after the arena that must stay as they are.
const GUARD: usize = 64;

fuzz_target!(|bytes: &[u8]| {
    let Some((plan, bytes)) = forged::plan(bytes) else { return };
    let _ = Guards::of_plan(plan.as_slice()).map(|found| found.map(|guards| guards.check_fits(1, 1)));
    if let Ok(plan) = Plan::load(plan.as_slice()) {
        decide(&plan, bytes);
        respond(&plan, bytes);
    }
});

/// A policy's outputs, which no other plan gives.
fn respond(plan: &Plan<'_>, bytes: &[u8]) {
    let mut input = Input(bytes.get(bytes.len() / 2..).unwrap_or_default());
    let lengths = || plan.inputs();
    if lengths().chain([plan.hidden()]).any(|length| length > MOST_BYTES) {
        return;
    }
    let given: Vec<Vec<f32>> =
        lengths().map(|length| (0..length).map(|_| input.float()).collect()).collect();
    let given: Vec<&[f32]> = given.iter().map(Vec::as_slice).collect();
    let answers = [plan.clone(), plan.clone().on(Build::PORTABLE)].map(|plan| {
        let mut memory = AlignedBytes::zeroed(plan.arena_bytes() + 2 * GUARD);
        memory.as_mut_slice().fill(0xA5);
        let end = GUARD + plan.arena_bytes();
        let mut states = vec![0.5; plan.hidden()];
        let widths = plan.outputs();
        let mut outputs: Vec<Vec<f32>> = widths.map(|width| vec![0.0; width]).collect();
        let mut places: Vec<&mut [f32]> = outputs.iter_mut().map(Vec::as_mut_slice).collect();
        let arena = &mut memory.as_mut_slice()[GUARD..end];
        let answer = plan.respond(arena, &given, &mut states, &mut places);
        let (before, rest) = memory.as_slice().split_at(GUARD);
        let after = &rest[plan.arena_bytes()..];
        assert!(before.iter().chain(after).all(|byte| *byte == 0xA5), "left its arena");
        let bits = |numbers: &[f32]| numbers.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        let outputs: Vec<Vec<u32>> = outputs.iter().map(|output| bits(output)).collect();
        answer.map(|()| (outputs, bits(&states)))
    });
    assert_eq!(answers[0], answers[1], "the builds of the kernels differ");
}

fn decide(plan: &Plan<'_>, bytes: &[u8]) {
    let mut input = Input(bytes.get(bytes.len() / 2..).unwrap_or_default());
    let (features, entities) = (plan.header().features as usize, 1 + input.up_to(12));
    let rows: Vec<f32> = (0..entities * features).map(|_| input.float()).collect();
    let observation = Observation {
        rows: &rows,
        stride: features,
        last_actions: &[0, NO_ACTION],
        visible: EntityMask::from_words(&[input.word() % (1 << entities)]),
        self_index: input.up_to(entities - 1),
        available: &vec![1; plan.actions()],
    };
    let answers = [plan.clone(), plan.clone().on(Build::PORTABLE)].map(|plan| {
        let mut memory = AlignedBytes::zeroed(plan.arena_bytes() + 2 * GUARD);
        memory.as_mut_slice().fill(0xA5);
        let end = GUARD + plan.arena_bytes();
        let answer = plan.decide(&mut memory.as_mut_slice()[GUARD..end], &observation, None);
        let (before, rest) = memory.as_slice().split_at(GUARD);
        let after = &rest[plan.arena_bytes()..];
        assert!(before.iter().chain(after).all(|byte| *byte == 0xA5), "left its arena");
        answer.map(|decision| (decision.action, decision.utility.to_bits()))
    });
    assert_eq!(answers[0], answers[1], "the builds of the kernels differ");
}
