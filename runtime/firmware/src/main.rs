//! Decides on recorded observations on a bare machine, and tells what it came to and what that needed.
//!
//! The plan is that of the variable `SORTIE_PLAN` when this is built, and only its operators are linked. The observations
//! are the file `observations.bin` of the machine that runs the emulator. There is no path to a panic, or the program
//! would not link: the panic handler calls a function that exists nowhere.
#![no_std]
#![no_main]

mod console;
mod file;
mod known;
#[cfg_attr(target_arch = "arm", path = "cortex_m.rs")]
#[cfg_attr(target_arch = "riscv32", path = "riscv.rs")]
mod machine;
mod observations;
mod plan;
mod stack;

use core::hint::black_box;

use observations::{Recording, Room};
use plan::{OfPlan, PLAN};
use sortie_core::choose::masked_argmax;
use sortie_core::plan::{Aligned, Plan, PlanError, arena_bytes};
use sortie_core::{DecideError, Decision, Observation};

const N_MAX: usize = header_field(28);
const FEATURES: usize = header_field(32);
const ACTIONS: usize = header_field(36);
const HIDDEN: usize = header_field(40);

/// All memory that decisions need besides the stack, and the room that observations are read into.
struct Memory {
    arena: Aligned<[u8; arena_bytes(PLAN)]>,
    states: [f32; HIDDEN],
    utilities: [f32; ACTIONS],
    room: Room<{ N_MAX * FEATURES }, N_MAX, ACTIONS>,
}

static mut MEMORY: Memory =
    Memory { arena: Aligned([0; _]), states: [0.0; _], utilities: [0.0; _], room: Room::EMPTY };

unsafe extern "C" {
    static __flash_bytes: u8;
    static __harness_bytes: u8;
}

/// A field of the plan's header.
const fn header_field(offset: usize) -> usize {
    let Some((_, rest)) = PLAN.split_at_checked(offset) else { return 0 };
    let Some(field) = rest.first_chunk::<4>() else { return 0 };
    u32::from_le_bytes(*field) as usize
}

/// What all decisions came to, and what they needed.
struct Sums {
    decisions: u64,
    hash: u64,
    most_ticks: u32,
    /// Entities that were visible in the longest decision.
    most_visible: u64,
    ticks: u64,
    stack: usize,
}

/// Where both machines come to: everything is told, or why not.
#[unsafe(link_section = ".harness")]
#[inline(never)]
fn start() -> ! {
    match run() {
        Ok(()) => console::end(0),
        Err(why) => console::fail(why),
    }
}

#[inline(always)]
fn run() -> Result<(), &'static [u8]> {
    machine::start_counter();
    let start = machine::now();
    known::run_instructions();
    console::tell(b"ticks-of-100000", since(start).into());
    console::tell(b"flash", (&raw const __flash_bytes).addr() as u64);
    console::tell(b"harness", (&raw const __harness_bytes).addr() as u64);
    console::tell(b"plan", PLAN.len() as u64);
    console::tell(b"arena", arena_bytes(PLAN) as u64);
    console::tell(b"states", (4 * HIDDEN) as u64);
    console::tell(b"loaded", size_of::<Plan<'_, OfPlan>>() as u64);
    #[cfg(feature = "control")]
    if black_box(PLAN)[black_box(0)] == 0 {
        return Err(b"no plan begins so\n\0");
    }
    // SAFETY: nobody else has it: this runs once, and there is no interrupt.
    let memory = unsafe { &mut *(&raw mut MEMORY) };
    let base = stack::stack_pointer();
    stack::paint(base);
    let plan = load(black_box(PLAN)).map_err(|_| &b"the plan is refused\n\0"[..])?;
    console::tell(b"stack-of-loading", stack::used(base) as u64);
    let name = b"observations.bin\0";
    let recording = Recording::open(name, FEATURES, ACTIONS);
    let mut recording =
        recording.ok_or(&b"the observations are missing, or of another policy\n\0"[..])?;
    let (mut sums, mut refused) = (Sums::NONE, false);
    let Memory { arena, states, utilities, room } = memory;
    let read = recording.for_each(room, |observation| {
        // A recorded case begins an episode.
        states.fill(0.0);
        stack::paint(base);
        let start = machine::now();
        let decided = decide(&plan, &mut arena.0, observation, states, utilities);
        let ticks = since(start);
        refused |= decided.is_err();
        sums.add(observation, utilities, ticks, stack::used(base));
    });
    sums.tell();
    match (read, refused) {
        (None, _) => {
            Err(b"the observations end too early, or have more entities than the plan\n\0")
        }
        (_, true) => Err(b"an observation is refused\n\0"),
        _ => Ok(()),
    }
}

/// Loads the plan; a function of its own, whose code and stack are those of any program that does it.
#[inline(never)]
fn load(plan: &[u8]) -> Result<Plan<'_, OfPlan>, PlanError> {
    Plan::load_with(plan)
}

/// Utilities and the greedy action, likewise.
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

/// Ticks since `start`.
#[inline(always)]
fn since(start: u32) -> u32 {
    machine::now().wrapping_sub(start) & machine::MOST_TICKS
}

impl Sums {
    /// Of no decision; the hash is FNV-1a of 64 bits.
    const NONE: Self = Self {
        decisions: 0,
        hash: 0xcbf2_9ce4_8422_2325,
        most_ticks: 0,
        most_visible: 0,
        ticks: 0,
        stack: 0,
    };

    /// A decision more.
    #[unsafe(link_section = ".harness")]
    #[inline(never)]
    fn add(&mut self, observation: &Observation<'_>, utilities: &[f32], ticks: u32, stack: usize) {
        self.decisions += 1;
        for byte in utilities.iter().flat_map(|utility| utility.to_bits().to_le_bytes()) {
            self.hash = (self.hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
        if ticks > self.most_ticks {
            (self.most_ticks, self.most_visible) = (ticks, observation.visible.len() as u64);
        }
        self.ticks += u64::from(ticks);
        self.stack = self.stack.max(stack);
    }

    #[unsafe(link_section = ".harness")]
    #[inline(never)]
    fn tell(&self) {
        console::tell(b"decisions", self.decisions);
        console::tell(b"hash", self.hash);
        console::tell(b"most-ticks", self.most_ticks.into());
        console::tell(b"most-visible", self.most_visible);
        console::tell(b"ticks", self.ticks);
        console::tell(b"stack", self.stack as u64);
    }
}
