//! A plan on a Cortex-M4F, and a loop that decides: no heap, no operating system.
//!
//! The four agents stand on a line; each sees all others and itself. `cargo run --release` plays five steps in QEMU.
#![no_std]
#![no_main]

use cortex_m::singleton;
use cortex_m_rt::entry;
use cortex_m_semihosting::{debug, hprintln};
use panic_halt as _;
use sortie_core::operators::{Needed, OpKind, OperatorSet};
use sortie_core::plan::{Aligned, Plan, PlanError, arena_bytes};
use sortie_core::{EntityMask, NO_ACTION, Observation, PlanPolicy, Policy, include_plan};

/// Your own comes from `sortie compile agent.onnx -o agent.plan`.
const PLAN: &[u8] = include_plan!("../../../tests/golden/plans/agent-2.0.plan");

const AGENTS: usize = 4;
const FEATURES: usize = 6;

/// The operators of the plan: no others are linked.
#[derive(Clone, Copy, Debug)]
struct OfPlan;

impl OperatorSet for OfPlan {
    const OPERATORS: &[OpKind] = const { &Needed::by(PLAN) }.kinds();
}

#[entry]
fn main() -> ! {
    // In static memory, as large as this plan needs: a constant. There is one `main`, so that nobody else has it.
    let arena = singleton!(: Aligned<[u8; arena_bytes(PLAN)]> = Aligned([0; _]));
    let end = match arena.map(|arena| run(&mut arena.0)) {
        Some(Err(error)) => {
            hprintln!("{}", error);
            debug::EXIT_FAILURE
        }
        _ => debug::EXIT_SUCCESS,
    };
    debug::exit(end);
    // Behind a debugger or an emulator nobody comes here; a board waits for its next interrupt.
    loop {
        cortex_m::asm::wfi();
    }
}

fn run(arena: &mut [u8]) -> Result<(), PlanError> {
    let mut policy = PlanPolicy::new(Plan::<OfPlan>::load_with(PLAN)?, arena)?;
    let mut rows = [[0.0_f32; FEATURES]; AGENTS];
    let mut last_actions = [NO_ACTION; AGENTS];
    for step in 0..5_u8 {
        // Here your sensors are read.
        for (agent, row) in rows.iter_mut().enumerate() {
            *row = [agent as f32 / 4.0, 0.1 * f32::from(step), 1.0, 0.0, 0.0, 0.0];
        }
        let before = last_actions;
        for (agent, last_action) in last_actions.iter_mut().enumerate() {
            let decision = policy.decide(&Observation {
                rows: rows.as_flattened(),
                stride: FEATURES,
                last_actions: &before,
                visible: EntityMask::first(AGENTS),
                self_index: agent,
                available: &[1, 1, 1, u16::from(step > 0)],
            });
            match decision {
                Ok(decision) => {
                    // And here your motors are told.
                    hprintln!("step {} agent {} action {}", step, agent, decision.action);
                    *last_action = decision.action;
                }
                Err(error) => hprintln!("step {} agent {}: {}", step, agent, error),
            }
        }
    }
    Ok(())
}
