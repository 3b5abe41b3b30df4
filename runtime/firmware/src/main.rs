//! Decides on recorded observations on a bare machine, and tells what it came to and what that needed.
//!
//! The plan is that of the variable `SORTIE_PLAN` when this is built, and only its operators are linked. The observations
//! are the file `cases.bin` of the machine that runs the emulator. There is no path to a panic, or the program
//! would not link: the panic handler calls a function that exists nowhere.
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
mod observations;
mod plan;
mod stack;
mod words;

use core::hint::black_box;

use file::File;
use loaded::{HIDDEN, NEEDS, load};
use measure::{Deciding, Reason};
use observations::{Recording, Room};
use plan::{OfPlan, PLAN};
use sortie_core::choose::masked_argmax;
use sortie_core::plan::{Aligned, Plan, arena_bytes};
use sortie_core::{DecideError, Decision, Observation};
use words::word;

// Of the plan's header.
const N_MAX: usize = word(PLAN, 7) as usize;
const FEATURES: usize = word(PLAN, 8) as usize;
const ACTIONS: usize = word(PLAN, 9) as usize;

/// All memory that decisions need besides the stack, and the room that observations are read into.
struct Memory {
    arena: Aligned<[u8; arena_bytes(PLAN)]>,
    states: [f32; HIDDEN],
    utilities: [f32; ACTIONS],
    room: Room<{ N_MAX * FEATURES }, N_MAX, ACTIONS>,
}

static mut MEMORY: Memory =
    Memory { arena: Aligned([0; _]), states: [0.0; _], utilities: [0.0; _], room: Room::EMPTY };

/// One agent, whose memory goes on from observation to observation.
struct Agent {
    plan: Plan<'static, OfPlan>,
    recording: Recording,
    memory: &'static mut Memory,
}

/// Where every machine comes to.
#[unsafe(link_section = ".harness")]
#[inline(never)]
fn start() -> ! {
    measure::run(&NEEDS, agent)
}

#[inline(always)]
fn agent(cases: File) -> Result<Agent, Reason> {
    #[cfg(feature = "control")]
    if black_box(PLAN)[black_box(0)] == 0 {
        return Err(b"no plan begins so\n\0");
    }
    // SAFETY: nobody else has it: this runs once, and there is no interrupt.
    let memory = unsafe { &mut *(&raw mut MEMORY) };
    let plan = load(black_box(PLAN)).map_err(|_| &b"the plan is refused\n\0"[..])?;
    let recording = Recording::open(cases, FEATURES, ACTIONS);
    let recording = recording.ok_or(&b"the observations are of another policy\n\0"[..])?;
    Ok(Agent { plan, recording, memory })
}

impl Deciding for Agent {
    #[inline(always)]
    fn read(&mut self) -> Option<bool> {
        self.recording.next(&mut self.memory.room)
    }

    #[inline(always)]
    fn decide(&mut self) -> Result<(), DecideError> {
        let Memory { arena, states, utilities, room } = &mut *self.memory;
        let observation = self.recording.observation(room).ok_or(DecideError::BadLength)?;
        decide(&self.plan, &mut arena.0, &observation, states, utilities).map(drop)
    }

    #[inline(always)]
    fn answer(&self, number: impl FnMut(f32)) {
        self.memory.utilities.iter().copied().for_each(number);
    }

    #[inline(always)]
    fn visible(&self) -> usize {
        self.memory.room.visible()
    }
}

/// Utilities and the greedy action; a function of its own, as that which loads the plan.
#[inline(never)]
fn decide(
    plan: &Plan<'_, OfPlan>,
    arena: &mut [u8],
    observation: &Observation<'_>,
    states: &mut [f32],
    utilities: &mut [f32],
) -> Result<Decision, DecideError> {
    plan.utilities(arena, observation, Some(states), utilities)?;
    masked_argmax(utilities, observation.available)
}
