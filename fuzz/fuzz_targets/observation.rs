//! Any observation for good plans: an answer or an error, never a panic; what is behind the mask never matters.
#![no_main]

mod input;

use std::sync::LazyLock;

use input::Input;
use libfuzzer_sys::fuzz_target;
use sortie_core::internal::kernels::build::Build;
use sortie_core::plan::{AlignedBytes, Plan};
use sortie_core::{EntityMask, Observation, include_plan};

const AGENT: &[u8] = include_plan!("../../tests/golden/plans/agent-2.0.plan");
const ODD_SIZES: &[u8] = include_plan!("../../tests/golden/plans/agent-odd-sizes-2.0.plan");

static PLANS: LazyLock<[Plan<'static>; 2]> =
    LazyLock::new(|| [AGENT, ODD_SIZES].map(|plan| Plan::load(plan).expect("a golden plan")));

fuzz_target!(|bytes: &[u8]| {
    let mut input = Input(bytes);
    let plan = &PLANS[input.up_to(1)];
    let features = plan.header().features as usize;
    let (entities, stride) = (input.up_to(7), features.saturating_sub(1) + input.up_to(3));
    let last_actions: Vec<u16> =
        (0..input.up_to(5)).map(|_| u16::from(input.byte()) * 257 % 6).collect();
    let available: Vec<u16> =
        (0..plan.actions() + input.up_to(8) / 8).map(|_| u16::from(input.byte() % 2)).collect();
    let observation = Observation {
        rows: &(0..entities * stride).map(|_| input.float()).collect::<Vec<_>>(),
        stride,
        last_actions: &last_actions,
        visible: EntityMask::from_words(&[
            input.word() & input.word() % 512,
            input.word() & input.word() % 3,
        ]),
        self_index: input.up_to(9),
        available: &available,
    };
    let first = answer(plan.clone(), 0x00, &observation);
    assert_eq!(first, answer(plan.clone().on(Build::PORTABLE), 0xFF, &observation));
    // NaN in every row that is neither visible nor the agent's own.
    let mut hidden = observation.rows.to_vec();
    for (entity, row) in hidden.chunks_exact_mut(stride.max(1)).enumerate() {
        if entity != observation.self_index && !observation.visible.contains(entity) {
            row.fill(f32::NAN);
        }
    }
    assert_eq!(first, answer(plan.clone(), 0x7F, &Observation { rows: &hidden, ..observation }));
});

/// The bits of the answer, with an arena full of `old`.
fn answer(plan: Plan<'_>, old: u8, observation: &Observation<'_>) -> String {
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    arena.as_mut_slice().fill(old);
    let mut utilities = vec![0.0; plan.actions()];
    let computed = plan.utilities(arena.as_mut_slice(), observation, None, &mut utilities);
    let decided = plan.decide(arena.as_mut_slice(), observation, None);
    let bits: Vec<u32> = utilities.iter().map(|utility| utility.to_bits()).collect();
    format!("{computed:?} {bits:?} {decided:?}")
}
