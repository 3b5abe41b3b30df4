//! Any bytes as a plan, and plans forged with right checksums: load, decide, stay inside the arena.
//!
//! The first byte says which; a forged plan is header and program, its weights are made up.
#![no_main]

mod input;

use input::Input;
use libfuzzer_sys::fuzz_target;
use sortie_core::kernels::build::Build;
use sortie_core::plan::{AlignedBytes, Checksums, Header, Plan, checksums};
use sortie_core::{EntityMask, NO_ACTION, Observation};

/// Weights and arenas beyond this only make the fuzzer slow.
const MOST_BYTES: usize = 1 << 16;
/// Bytes before and after the arena that must stay as they are.
const GUARD: usize = 64;

fuzz_target!(|bytes: &[u8]| {
    let Some((kind, bytes)) = bytes.split_first() else { return };
    let plan = if kind % 2 == 0 { forge(bytes) } else { Some(AlignedBytes::copy_of(bytes)) };
    let Some(plan) = plan else { return };
    if let Ok(plan) = Plan::load(plan.as_slice()) {
        decide(&plan, bytes);
        respond(&plan, bytes);
    }
});

/// A policy's outputs, which no other plan gives.
fn respond(plan: &Plan<'_>, bytes: &[u8]) {
    let mut input = Input(bytes.get(bytes.len() / 2..).unwrap_or_default());
    let lengths = || plan.program().inputs().map(|input| input.to.len as usize);
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
        let widths = plan.program().outputs().map(|output| output.width as usize);
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

/// Header and program with made-up weights and right checksums.
fn forge(bytes: &[u8]) -> Option<AlignedBytes> {
    let (mut header, _) = Header::read(bytes).ok()?;
    let (start, len) = (header.program_offset as usize, header.program_len as usize);
    let program = bytes.get(start..start.checked_add(len)?)?;
    header.weights_offset = start.saturating_add(len).next_multiple_of(64) as u32;
    let len = header.weights_len as usize;
    if len > MOST_BYTES || header.arena_bytes as usize > MOST_BYTES {
        return None;
    }
    let weight =
        |index: usize| (index.wrapping_mul(2_654_435_761) >> 8 & 0xFFFF) as f32 / 65_536.0 - 0.5;
    let weights: Vec<u8> = (0..len / 4).flat_map(|index| weight(index).to_le_bytes()).collect();
    let checksums: Checksums = checksums(&header, program, &weights);
    let mut plan = bytes.get(..start)?.to_vec();
    plan.get_mut(..128)?.copy_from_slice(&header.to_bytes(checksums));
    plan.extend(program);
    plan.resize(header.weights_offset as usize, 0);
    plan.extend(weights);
    Some(AlignedBytes::copy_of(&plan))
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
