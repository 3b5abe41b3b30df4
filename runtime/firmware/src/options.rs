//! Plays recorded episodes of an agent that goes from milestone to milestone, as `main.rs` decides on observations.
//!
//! Its three networks are the plans of `SORTIE_PLAN`, which acts, `SORTIE_META` and `SORTIE_AFFORDANCE`, over one arena; its
//! rules those of `SORTIE_RULES`.
#![no_std]
#![no_main]

mod console;
mod file;
mod known;
#[cfg_attr(target_arch = "aarch64", path = "aarch64.rs")]
#[cfg_attr(target_arch = "arm", path = "cortex_m.rs")]
#[cfg_attr(target_arch = "riscv32", path = "riscv.rs")]
mod machine;
mod measure;
mod no_panic;
mod numbers;
mod rules;
mod stack;
mod words;

use core::hint::black_box;

use file::File;
use measure::{Deciding, Needs, Reason};
use numbers::Numbers;
use rules::{ACTIONS, COLUMNS, FEATURES, HIDDEN};
use sortie_core::operators::{Needed, OpKind, OperatorSet};
use sortie_core::options::{OptionPolicy, PlanNetworks, Pursuit};
use sortie_core::plan::{Aligned, Plan, arena_bytes};
use sortie_core::{DecideError, Decision, EntityMask, Observation, Policy, include_plan};

const CONTROLLER: &[u8] = include_plan!(env!("SORTIE_PLAN"));
const META: &[u8] = include_plan!(env!("SORTIE_META"));
const AFFORDANCE: &[u8] = include_plan!(env!("SORTIE_AFFORDANCE"));
const PLANS: [&[u8]; 3] = [CONTROLLER, META, AFFORDANCE];

/// The networks do not work at once.
const ARENA: usize = {
    let [controller, meta, affordance] =
        [arena_bytes(CONTROLLER), arena_bytes(META), arena_bytes(AFFORDANCE)];
    let most = if controller > meta { controller } else { meta };
    if most > affordance { most } else { affordance }
};

/// The operators of the plans.
#[derive(Clone, Copy, Debug)]
struct OfPlans;

impl OperatorSet for OfPlans {
    const OPERATORS: &[OpKind] = const { &Needed::by_all(&PLANS) }.kinds();
}

type Runner = OptionPolicy<PlanNetworks<'static, OfPlans>, &'static mut [f32]>;

/// All memory that decisions need besides the stack, and the room that a row is read into.
struct Memory {
    arena: Aligned<[u8; ARENA]>,
    shown: [f32; COLUMNS],
    remembered: [f32; HIDDEN],
    row: [f32; FEATURES],
}

static mut MEMORY: Memory =
    Memory { arena: Aligned([0; _]), shown: [0.0; _], remembered: [0.0; _], row: [0.0; _] };

struct Agent {
    policy: Runner,
    cases: Numbers,
    remembered: &'static mut [f32],
    row: &'static mut [f32],
    decision: Decision,
}

/// Where every machine comes to.
#[unsafe(link_section = ".harness")]
#[inline(never)]
fn start() -> ! {
    let needs = Needs {
        plan: CONTROLLER.len() + META.len() + AFFORDANCE.len(),
        arena: ARENA + 4 * COLUMNS,
        states: 4 * HIDDEN,
        loaded: size_of::<Runner>(),
    };
    measure::run(&needs, agent)
}

#[inline(always)]
fn agent(cases: File) -> Result<Agent, Reason> {
    // SAFETY: nobody else has it: this runs once, and there is no interrupt.
    let Memory { arena, shown, remembered, row } = unsafe { &mut *(&raw mut MEMORY) };
    let policy = load(black_box(PLANS), &mut arena.0, shown);
    let policy = policy.ok_or(&b"the plans or the rules are refused\n\0"[..])?;
    let cases = Numbers::open(cases).ok_or(&b"there are no episodes\n\0"[..])?;
    Ok(Agent { policy, cases, remembered, row, decision: Decision { action: 0, utility: 0.0 } })
}

impl Deciding for Agent {
    #[inline(always)]
    fn read(&mut self) -> Option<bool> {
        self.cases.next(self.row, self.remembered)
    }

    #[inline(always)]
    fn decide(&mut self) -> Result<(), DecideError> {
        self.decision = decide(&mut self.policy, self.row, self.remembered)?;
        Ok(())
    }

    /// The utility, the action, the goal, and how long the agent has gone for it.
    #[inline(always)]
    fn answer(&self, number: impl FnMut(f32)) {
        let Decision { action, utility } = self.decision;
        let Pursuit { goal, steps } =
            Pursuit::of(self.remembered).unwrap_or(Pursuit { goal: 0, steps: 0 });
        [utility, f32::from(action), goal as f32, steps as f32].into_iter().for_each(number);
    }
}

/// Loads plans and rules; a function of its own, whose code and stack are those of any program that does it.
#[inline(never)]
fn load(
    plans: [&'static [u8]; 3],
    arena: &'static mut [u8],
    shown: &'static mut [f32],
) -> Option<Runner> {
    let [controller, meta, affordance] = plans.map(Plan::load_with);
    let networks = PlanNetworks::new([controller.ok()?, meta.ok()?, affordance.ok()?], arena);
    OptionPolicy::new(rules::rules()?, networks.ok()?, shown)
}

/// A tick, likewise.
#[inline(never)]
fn decide(
    policy: &mut Runner,
    row: &[f32],
    remembered: &mut [f32],
) -> Result<Decision, DecideError> {
    let observation = Observation {
        rows: row,
        stride: FEATURES,
        last_actions: &[],
        visible: EntityMask::first(1),
        self_index: 0,
        available: &[1; ACTIONS],
    };
    policy.decide_with(&observation, remembered)
}
