//! Decides by a plan that it reads when it starts, as `main.rs` and `policy.rs` do by the one inside them: one program for all plans.
//!
//! The plan is the file `SORTIE_PLAN` of the machine that runs the emulator, beside the cases. All operators are linked. That there
//! is no path to a panic is shown of programs with one plan inside: here the optimiser does not see it, and a panic is a failure.
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
mod numbers;
mod observations;
mod stack;

use core::array::from_fn;
use core::panic::PanicInfo;

use file::File;
use measure::{Deciding, Needs, Reason};
use numbers::Numbers;
use observations::{Recording, Room};
use sortie_core::choose::masked_argmax;
use sortie_core::limits;
use sortie_core::plan::{Aligned, Header, Plan, PlanError, arena_bytes};
use sortie_core::{DecideError, Decision, Observation};

/// Bytes of the largest plan and arena, numbers of the largest case and answer, most inputs and outputs.
const PLAN: usize = 512 * 1024;
const ARENA: usize = 64 * 1024;
const NUMBERS: usize = 8 * 1024;
const PLACES: usize = 16;

/// Room for the plan.
static mut ROOM: Aligned<[u8; PLAN]> = Aligned([0; _]);

/// All other memory besides the stack.
struct Memory {
    arena: Aligned<[u8; ARENA]>,
    states: [f32; NUMBERS],
    given: [f32; NUMBERS],
    wanted: [f32; NUMBERS],
    room: Room<NUMBERS, { limits::ENTITIES }, { limits::ACTIONS }>,
}

static mut MEMORY: Memory = Memory {
    arena: Aligned([0; _]),
    states: [0.0; _],
    given: [0.0; _],
    wanted: [0.0; _],
    room: Room::EMPTY,
};

const NO_ROOM: Reason = b"the plan needs more room than this program has\n\0";

/// Where every machine comes to.
#[unsafe(link_section = ".harness")]
#[inline(never)]
fn start() -> ! {
    let Some(plan) = read_plan() else { console::fail(b"there is no plan, or no room for it\n\0") };
    let Ok((header, _)) = Header::read(plan) else { console::fail(b"this is no plan\n\0") };
    let needs = Needs {
        // In flash there is none.
        plan: 0,
        arena: arena_bytes(plan),
        states: 4 * header.hidden as usize,
        loaded: size_of::<Plan<'_>>(),
    };
    // A policy over inputs of fixed sizes may be an agent of a team, too: the cases say what it is here.
    let (features, actions) = (header.features as usize, header.actions as usize);
    let cases = File::open(b"cases.bin\0");
    match cases.and_then(|cases| Recording::open(cases, features, actions)) {
        Some(_) => measure::run(&needs, |cases| agent(plan, cases)),
        None => measure::run(&needs, |cases| controller(plan, cases)),
    }
}

#[unsafe(link_section = ".harness")]
fn read_plan() -> Option<&'static [u8]> {
    let file = File::open(b"SORTIE_PLAN\0")?;
    // SAFETY: nobody else has it: this runs once, and there is no interrupt.
    let room = unsafe { &mut *(&raw mut ROOM) };
    let plan = room.0.get_mut(..file.length()?)?;
    file.read(plan)?;
    Some(plan)
}

/// The plan, loaded, and memory for it.
#[inline(always)]
fn loaded(plan: &'static [u8]) -> Result<(Plan<'static>, &'static mut Memory), Reason> {
    // SAFETY: nobody else has it: one of both callers runs, once, and there is no interrupt.
    let memory = unsafe { &mut *(&raw mut MEMORY) };
    Ok((load(plan).map_err(|_| &b"the plan is refused\n\0"[..])?, memory))
}

/// A function of its own, whose code and stack are those of any program that does it.
#[inline(never)]
fn load(plan: &[u8]) -> Result<Plan<'_>, PlanError> {
    Plan::load(plan)
}

/// One agent, whose memory goes on from observation to observation.
struct Agent {
    plan: Plan<'static>,
    recording: Recording,
    arena: &'static mut [u8],
    states: &'static mut [f32],
    utilities: &'static mut [f32],
    room: &'static mut Room<NUMBERS, { limits::ENTITIES }, { limits::ACTIONS }>,
}

#[inline(always)]
fn agent(plan: &'static [u8], cases: File) -> Result<Agent, Reason> {
    let (plan, Memory { arena, states, wanted, room, .. }) = loaded(plan)?;
    let recording = Recording::open(cases, plan.header().features as usize, plan.actions());
    let recording = recording.ok_or(&b"the observations are of another policy\n\0"[..])?;
    let states = states.get_mut(..plan.hidden()).ok_or(NO_ROOM)?;
    let utilities = wanted.get_mut(..plan.actions()).ok_or(NO_ROOM)?;
    Ok(Agent { plan, recording, arena: &mut arena.0, states, utilities, room })
}

impl Deciding for Agent {
    #[inline(always)]
    fn read(&mut self) -> Option<bool> {
        self.recording.next(self.room)
    }

    #[inline(always)]
    fn decide(&mut self) -> Result<(), DecideError> {
        let Self { plan, recording, arena, states, utilities, room } = self;
        let seen = recording.observation(room).ok_or(DecideError::BadLength)?;
        let available = seen.available.get(..utilities.len()).ok_or(DecideError::BadLength)?;
        decide(plan, arena, &Observation { available, ..seen }, states, utilities).map(drop)
    }

    #[inline(always)]
    fn answer(&self, number: impl FnMut(f32)) {
        self.utilities.iter().copied().for_each(number);
    }

    #[inline(always)]
    fn visible(&self) -> usize {
        self.room.visible()
    }
}

/// Utilities and the greedy action, as `main.rs` decides.
#[inline(never)]
fn decide(
    plan: &Plan<'_>,
    arena: &mut [u8],
    observation: &Observation<'_>,
    states: &mut [f32],
    utilities: &mut [f32],
) -> Result<Decision, DecideError> {
    plan.utilities(arena, observation, Some(states), utilities)?;
    masked_argmax(utilities, observation.available)
}

/// A policy over inputs of fixed sizes.
struct Controller {
    plan: Plan<'static>,
    cases: Numbers,
    arena: &'static mut [u8],
    states: &'static mut [f32],
    given: &'static mut [f32],
    wanted: &'static mut [f32],
}

#[inline(always)]
fn controller(plan: &'static [u8], cases: File) -> Result<Controller, Reason> {
    let (plan, Memory { arena, states, given, wanted, .. }) = loaded(plan)?;
    let cases = Numbers::open(cases).ok_or(&b"there are no inputs\n\0"[..])?;
    let states = states.get_mut(..plan.hidden()).ok_or(NO_ROOM)?;
    let given = given.get_mut(..plan.inputs().sum()).ok_or(NO_ROOM)?;
    let wanted = wanted.get_mut(..plan.outputs().sum()).ok_or(NO_ROOM)?;
    Ok(Controller { plan, cases, arena: &mut arena.0, states, given, wanted })
}

impl Deciding for Controller {
    #[inline(always)]
    fn read(&mut self) -> Option<bool> {
        self.cases.next(self.given, self.states)
    }

    #[inline(always)]
    fn decide(&mut self) -> Result<(), DecideError> {
        let Self { plan, arena, states, given, wanted, .. } = self;
        respond(plan, arena, states, given, wanted)
    }

    #[inline(always)]
    fn answer(&self, number: impl FnMut(f32)) {
        self.wanted.iter().copied().for_each(number);
    }
}

/// What comes out, as `policy.rs` responds.
#[inline(never)]
fn respond(
    plan: &Plan<'_>,
    arena: &mut [u8],
    states: &mut [f32],
    mut given: &[f32],
    mut wanted: &mut [f32],
) -> Result<(), DecideError> {
    let mut inputs: [&[f32]; PLACES] = [&[]; _];
    for (input, length) in inputs.iter_mut().zip(plan.inputs()) {
        *input = given.split_off(..length).ok_or(DecideError::BadLength)?;
    }
    let mut outputs: [&mut [f32]; PLACES] = from_fn(|_| Default::default());
    for (output, length) in outputs.iter_mut().zip(plan.outputs()) {
        *output = wanted.split_off_mut(..length).ok_or(DecideError::BadLength)?;
    }
    let inputs = inputs.get(..plan.inputs().count()).ok_or(DecideError::BadLength)?;
    let outputs = outputs.get_mut(..plan.outputs().count()).ok_or(DecideError::BadLength)?;
    plan.respond(arena, inputs, states, outputs)
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    console::fail(b"a panic\n\0")
}
