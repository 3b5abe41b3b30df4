//! One agent of a team: frames and allocations come over a UART, it decides by the plan, and its actions go back.
//!
//! The plan is that of the variable `SORTIE_PLAN` when this is built, the team that of `SORTIE_DOMAIN`. Nothing else
//! is known here: the same program runs beside a real UART. For the emulator it says on the console what came over
//! the line, whenever the line has been quiet for a while; what a panic is to this program, `main.rs` says.
#![no_std]
#![no_main]

mod clock;
mod console;
mod domain;
#[cfg_attr(target_arch = "aarch64", path = "aarch64.rs")]
#[cfg_attr(target_arch = "arm", path = "cortex_m.rs")]
#[cfg_attr(target_arch = "riscv32", path = "riscv.rs")]
mod machine;
mod no_panic;
mod plan;
#[cfg_attr(target_arch = "aarch64", path = "port_pl011.rs")]
#[cfg_attr(target_arch = "arm", path = "port_cmsdk.rs")]
#[cfg_attr(target_arch = "riscv32", path = "port_16550.rs")]
mod port;
mod uart;
mod words;

use core::hint::black_box;
use core::mem::MaybeUninit;

use clock::CLOCK;
use domain::SHAPE;
use plan::{OfPlan, PLAN};
use sortie_core::link::{Bell, Clock, FrameBlock, Serial, Wake, packet_bytes};
use sortie_core::plan::{Aligned, Plan, arena_bytes};
use sortie_core::roles::{Poll, RunnerRole};
use sortie_core::{PlanPolicy, PolicyByAgent};
use uart::{Traffic, Uart};

/// After so long without a byte the line is quiet.
const QUIET_NS: u64 = 200_000;

/// All memory besides the stack.
struct Memory {
    arena: Aligned<[u8; arena_bytes(PLAN)]>,
    frames: MaybeUninit<[FrameBlock; FrameBlock::for_serial(SHAPE)]>,
    packet: [u8; packet_bytes(SHAPE)],
}

static mut MEMORY: Memory =
    Memory { arena: Aligned([0; _]), frames: MaybeUninit::zeroed(), packet: [0; _] };

/// Where every machine comes to.
fn start() -> ! {
    match run() {
        Ok(()) => console::end(0),
        Err(why) => console::fail(why),
    }
}

fn run() -> Result<(), &'static [u8]> {
    machine::start_counter();
    // SAFETY: nobody else has it: this runs once, and there is no interrupt.
    let Memory { arena, frames, packet } = unsafe { &mut *(&raw mut MEMORY) };
    // SAFETY: zeros are blocks of frames.
    let frames = unsafe { frames.assume_init_mut() };
    let plan = Plan::<OfPlan>::load_with(black_box(PLAN));
    let policy = plan.and_then(|plan| PlanPolicy::new(plan, &mut arena.0));
    let mut policies = [policy.map_err(|_| &b"the plan is refused\n\0"[..])?];
    // It may choose among fewer actions than others of the team.
    let mut policy = PolicyByAgent::new(&mut policies[..], &[0; SHAPE.agents][..], SHAPE.actions);
    let format = domain::format().ok_or(&b"there are no such frames\n\0"[..])?;
    let traffic = Traffic::default();
    let link = Serial::new(Uart::new(&traffic), &CLOCK, format, frames, packet);
    let mut link = link.map_err(|_| &b"there is no room for frames\n\0"[..])?;
    let mut role = RunnerRole::new(domain::runner(format));
    let broken = |_| &b"the line is broken\n\0"[..];
    role.join(&mut link).map_err(broken)?;
    loop {
        let token = link.token();
        match role.poll(&mut link, &mut policy).map_err(broken)? {
            Poll::Again | Poll::Answered => {}
            Poll::Ended => return Ok(()),
            Poll::Wait { until_ns: u64::MAX } => rest(&mut link, token, &role, &traffic),
            Poll::Wait { until_ns } => {
                link.wait_until(token, until_ns);
            }
        }
    }
}

/// Waits for a packet, and tells what came when none does.
fn rest(link: &mut Serial<'_, Uart<'_>>, token: u32, role: &RunnerRole, traffic: &Traffic) {
    let mut told = None;
    while link.wait_until(token, CLOCK.now_ns().saturating_add(QUIET_NS)) == Wake::Timeout {
        let read = traffic.read.get();
        if told.replace(read) != Some(read) {
            tell(link, role, traffic);
        }
    }
}

/// What came over the line, and what became of it. The last line says that the program is at rest.
fn tell(link: &Serial<'_, Uart<'_>>, role: &RunnerRole, traffic: &Traffic) {
    let (line, runner) = (link.counters(), role.counters());
    let counted: [(&[u8], u64); 14] = [
        (b"packets", line.packets),
        (b"torn", line.torn),
        (b"corrupt", line.corrupt),
        (b"too-long", line.too_long),
        (b"refused", line.refused),
        (b"overtaken", line.overtaken),
        (b"foreign", runner.schema_rejects),
        (b"bad", runner.bad_messages),
        (b"old", runner.old_term_rejects),
        (b"decided", runner.ticks),
        (b"stale", runner.stale_allocations),
        (b"unallocated", runner.no_allocations),
        (b"fallbacks", runner.fallbacks),
        (b"sent", traffic.sent.get().into()),
    ];
    counted.iter().for_each(|(name, number)| console::tell(name, *number));
    console::tell(b"rest", traffic.read.get().into());
}
