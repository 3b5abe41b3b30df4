//! A plan inside a program, and a loop that decides: no file, no heap, no thread.
//!
//! The four agents stand on a line; each sees all others and itself. Only printing needs `std`: the same loop runs
//! on a microcontroller.

use sortie_core::plan::{Aligned, Plan, PlanError, arena_bytes};
use sortie_core::{EntityMask, NO_ACTION, Observation, PlanPolicy, Policy, include_plan};

/// Your own comes from `sortie compile agent.onnx -o agent.plan`.
const PLAN: &[u8] = include_plan!("../../../tests/golden/plans/agent-2.0.plan");

const AGENTS: usize = 4;
const FEATURES: usize = 6;

fn main() -> Result<(), PlanError> {
    // As large as this plan needs: a constant.
    let mut arena = Aligned([0; arena_bytes(PLAN)]);
    let mut policy = PlanPolicy::new(Plan::load(PLAN)?, &mut arena.0)?;
    let mut rows = [[0.0_f32; FEATURES]; AGENTS];
    let mut last_actions = [NO_ACTION; AGENTS];
    for step in 0..5 {
        for (agent, row) in rows.iter_mut().enumerate() {
            *row = [agent as f32 / 4.0, 0.1 * step as f32, 1.0, 0.0, 0.0, 0.0];
        }
        // All agents decide from the same state before any of them acts.
        let before = last_actions;
        for (agent, last_action) in last_actions.iter_mut().enumerate() {
            let decision = policy.decide(&Observation {
                rows: rows.as_flattened(),
                stride: FEATURES,
                last_actions: &before,
                visible: EntityMask::first(AGENTS),
                self_index: agent,
                // The last action is not available in the first step.
                available: &[1, 1, 1, u16::from(step > 0)],
            });
            match decision {
                Ok(decision) => {
                    println!("step {step} agent {agent} action {}", decision.action);
                    *last_action = decision.action;
                }
                Err(error) => println!("step {step} agent {agent}: {error}"),
            }
        }
    }
    Ok(())
}
