//! What `embed_cortex_m`, `embed_riscv` and `embed_embassy` have in common: a plan, its memory, and a step in which four
//! agents decide. Nothing here knows a board.
//!
//! The four agents stand on a line; each sees all others and itself.
#![no_std]

use core::fmt::{self, Display, Formatter};

use sortie_core::operators::{Needed, OpKind, OperatorSet};
use sortie_core::plan::{Aligned, Plan, PlanError, arena_bytes};
use sortie_core::{
    DecideError, Decision, EntityMask, NO_ACTION, Observation, PlanPolicy, Policy, include_plan,
};

/// Your own comes from `sortie compile agent.onnx -o agent.plan`.
const PLAN: &[u8] = include_plan!("../../../tests/golden/plans/agent-2.0.plan");

const AGENTS: usize = 4;
const FEATURES: usize = 6;

/// Memory as large as this plan needs: a constant.
pub type Arena = Aligned<[u8; arena_bytes(PLAN)]>;

/// Memory to begin with.
pub const ARENA: Arena = Aligned([0; _]);

/// The operators of the plan: no others are linked.
#[derive(Clone, Copy, Debug)]
struct OfPlan;

impl OperatorSet for OfPlan {
    const OPERATORS: &[OpKind] = const { &Needed::by(PLAN) }.kinds();
}

/// Five steps, every decision told to `act`; false where the plan is refused, or the memory is somebody else's.
pub fn run(arena: Option<&mut Arena>, mut act: impl FnMut(Decided)) -> bool {
    let Some(Ok(mut steps)) = arena.map(Steps::new) else { return false };
    (0..5).for_each(|_| steps.next(&mut act));
    true
}

/// Agents that decide step by step.
pub struct Steps<'a> {
    policy: PlanPolicy<'a, OfPlan>,
    step: u8,
    last_actions: [u16; AGENTS],
}

/// What an agent decided in a step, or why it did not.
pub struct Decided {
    step: u8,
    agent: usize,
    /// `action` goes to your motors. An error is answered by what is safe there.
    pub decision: Result<Decision, DecideError>,
}

impl<'a> Steps<'a> {
    /// Checks the plan once.
    pub fn new(arena: &'a mut Arena) -> Result<Self, PlanError> {
        let policy = PlanPolicy::new(Plan::<OfPlan>::load_with(PLAN)?, &mut arena.0)?;
        Ok(Self { policy, step: 0, last_actions: [NO_ACTION; AGENTS] })
    }

    /// All agents decide once, each of them told to `act`.
    pub fn next(&mut self, mut act: impl FnMut(Decided)) {
        let (step, before) = (self.step, self.last_actions);
        self.step += 1;
        // Here your sensors are read.
        let mut rows = [[0.0_f32; FEATURES]; AGENTS];
        for (agent, row) in rows.iter_mut().enumerate() {
            *row = [agent as f32 / 4.0, 0.1 * f32::from(step), 1.0, 0.0, 0.0, 0.0];
        }
        for (agent, last_action) in self.last_actions.iter_mut().enumerate() {
            let decision = self.policy.decide(&Observation {
                rows: rows.as_flattened(),
                stride: FEATURES,
                last_actions: &before,
                visible: EntityMask::first(AGENTS),
                self_index: agent,
                // The last action is not available in the first step.
                available: &[1, 1, 1, u16::from(step > 0)],
            });
            if let Ok(decision) = decision {
                *last_action = decision.action;
            }
            act(Decided { step, agent, decision });
        }
    }
}

impl Display for Decided {
    fn fmt(&self, to: &mut Formatter<'_>) -> fmt::Result {
        let Self { step, agent, decision } = self;
        match decision {
            Ok(decision) => write!(to, "step {step} agent {agent} action {}", decision.action),
            Err(error) => write!(to, "step {step} agent {agent}: {error}"),
        }
    }
}
