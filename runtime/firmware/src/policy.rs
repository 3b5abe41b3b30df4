//! Responds to recorded inputs by a policy over inputs of fixed sizes, as `main.rs` decides on observations.
//!
//! What it remembers goes on from case to case.
#![no_std]
#![no_main]

mod console;
mod file;
mod known;
mod loaded;
#[cfg_attr(target_arch = "aarch64", path = "aarch64.rs")]
#[cfg_attr(target_arch = "arm", path = "cortex_m.rs")]
#[cfg_attr(target_arch = "riscv32", path = "riscv.rs")]
mod machine;
mod measure;
mod no_panic;
mod numbers;
mod plan;
mod stack;
mod words;

use core::array::from_fn;
use core::hint::black_box;

use file::File;
use loaded::{HIDDEN, NEEDS, load};
use measure::{Deciding, Reason};
use numbers::Numbers;
use plan::{OfPlan, PLAN};
use sortie_core::DecideError;
use sortie_core::plan::{Aligned, Plan, arena_bytes};
use words::word;

/// How many inputs and outputs there are, and how many numbers all of them have together.
const SIZES: &[u8] = include_bytes!(env!("SORTIE_SIZES"));
const INPUTS: usize = word(SIZES, 0) as usize;
const OUTPUTS: usize = word(SIZES, 1) as usize;
const GIVEN: usize = word(SIZES, 2) as usize;
const WANTED: usize = word(SIZES, 3) as usize;

/// All memory that decisions need besides the stack, and what goes in and comes out.
struct Memory {
    arena: Aligned<[u8; arena_bytes(PLAN)]>,
    states: [f32; HIDDEN],
    given: [f32; GIVEN],
    wanted: [f32; WANTED],
}

static mut MEMORY: Memory =
    Memory { arena: Aligned([0; _]), states: [0.0; _], given: [0.0; _], wanted: [0.0; _] };

struct Controller {
    plan: Plan<'static, OfPlan>,
    cases: Numbers,
    memory: &'static mut Memory,
}

/// Where every machine comes to.
#[unsafe(link_section = ".harness")]
#[inline(never)]
fn start() -> ! {
    measure::run(&NEEDS, controller)
}

#[inline(always)]
fn controller(cases: File) -> Result<Controller, Reason> {
    // SAFETY: nobody else has it: this runs once, and there is no interrupt.
    let memory = unsafe { &mut *(&raw mut MEMORY) };
    let plan = load(black_box(PLAN)).map_err(|_| &b"the plan is refused\n\0"[..])?;
    let cases = Numbers::open(cases).ok_or(&b"there are no inputs\n\0"[..])?;
    Ok(Controller { plan, cases, memory })
}

impl Deciding for Controller {
    #[inline(always)]
    fn read(&mut self) -> Option<bool> {
        self.cases.next(&mut self.memory.given, &mut self.memory.states)
    }

    #[inline(always)]
    fn decide(&mut self) -> Result<(), DecideError> {
        respond(&self.plan, self.memory)
    }

    #[inline(always)]
    fn answer(&self, number: impl FnMut(f32)) {
        self.memory.wanted.iter().copied().for_each(number);
    }
}

/// What comes out; a function of its own, as that which loads the plan.
#[inline(never)]
fn respond(plan: &Plan<'_, OfPlan>, memory: &mut Memory) -> Result<(), DecideError> {
    let Memory { arena, states, given, wanted } = memory;
    let mut inputs: [&[f32]; INPUTS] = [&[]; _];
    let mut rest = given.as_slice();
    for (input, length) in inputs.iter_mut().zip(plan.inputs()) {
        *input = rest.split_off(..length).ok_or(DecideError::BadLength)?;
    }
    let mut outputs: [&mut [f32]; OUTPUTS] = from_fn(|_| Default::default());
    let mut rest = wanted.as_mut_slice();
    for (output, length) in outputs.iter_mut().zip(plan.outputs()) {
        *output = rest.split_off_mut(..length).ok_or(DecideError::BadLength)?;
    }
    plan.respond(&mut arena.0, &inputs, states, &mut outputs)
}
