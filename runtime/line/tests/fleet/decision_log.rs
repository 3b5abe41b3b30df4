//! The same team decides the same, byte for byte: in one runner or one each, whatever the clock says.

use std::cell::Cell;

use sortie_core::link::{Clock, Direct, DirectCursor, FrameBlock};
use sortie_core::roles::{TickReport, WorldObserver, WorldOptions, WorldRole};
use sortie_core::wire::FrameLayout;

use super::process;
use super::setup::Setup;
use super::toy::{self, ToyAllocator, ToyPolicy, ToyWorld};

/// Ticks of a run.
const TICKS: u64 = 100_000;
/// Bytes of an entry of the log.
const ENTRY: usize = 8 + 2 + 2 + 4 + 1 + 4 + 4;

/// Tick, agent, action, bits of q, subtask, term and epoch of every decision. Times, process ids and
/// durations are not in it.
#[derive(Default)]
struct DecisionLog {
    bytes: Vec<u8>,
    ticks: u64,
}

impl WorldObserver for DecisionLog {
    fn tick(&mut self, report: &TickReport<'_>) {
        self.ticks += 1;
        for answer in report.answers() {
            self.bytes.extend(report.tick.to_le_bytes());
            self.bytes.extend(answer.agent.to_le_bytes());
            self.bytes.extend(answer.action.to_le_bytes());
            self.bytes.extend(answer.q.to_bits().to_le_bytes());
            self.bytes.push(answer.task);
            self.bytes.extend(answer.alloc_term.to_le_bytes());
            self.bytes.extend(answer.alloc_epoch.to_le_bytes());
        }
    }
}

/// Goes on by `step_ns` whenever somebody looks.
struct Ticking {
    now_ns: Cell<u64>,
    step_ns: u64,
}

impl Clock for Ticking {
    fn now_ns(&self) -> u64 {
        self.now_ns.set(self.now_ns.get() + self.step_ns);
        self.now_ns.get()
    }
}

/// The log of a team of four in lock-step, `groups` of which share a runner.
fn record(seed: u64, groups: &[u64], step_ns: u64) -> DecisionLog {
    let mut setup = Setup::new(seed, None);
    (setup.agents, setup.runners) = (4, groups.to_vec());
    let layout = FrameLayout::new(toy::shape(setup.agents));
    setup.format.layout = layout.expect("the toy is small");
    (setup.period_ns, setup.patience_ns, setup.tick_interval_ns) = (0, 0, 0);
    setup.pipelined = false;
    let clock = Ticking { now_ns: Cell::new(0), step_ns };
    let mut memory = vec![FrameBlock::zeroed(); setup.format.layout.payload_bytes() / 64];
    let mut team = Direct::new(&mut memory, &clock);
    let mut world = WorldRole::new(WorldOptions {
        join_patience_ns: u64::MAX,
        strict: true,
        ..process::world_options(&setup, 1)
    });
    let mut environment = ToyWorld::new(setup.agents, seed);
    let mut world_cursor = DirectCursor::default();
    let mut runners: Vec<_> = groups
        .iter()
        .zip(100..)
        .map(|(&agents, pid)| (process::runner(&setup, pid, agents), DirectCursor::default()))
        .collect();
    let mut allocator = process::allocator(&setup, 99);
    let mut allocator_cursor = DirectCursor::default();
    for (role, cursor) in &mut runners {
        role.join(&mut team.agent(cursor)).expect("a direct link");
    }
    allocator.lead(1);
    allocator.join(&mut team.allocator(&mut allocator_cursor)).expect("a direct link");
    let mut log = DecisionLog::default();
    while log.ticks < TICKS {
        let polled = world.poll(&mut team.world(&mut world_cursor), &mut environment, &mut log);
        let mut moves = polled.expect("a strict world of a whole team").is_progress();
        let mut rules = ToyAllocator { refuses: false };
        let polled = allocator.poll(&mut team.allocator(&mut allocator_cursor), &mut rules);
        moves |= polled.expect("the toy refuses nothing").is_progress();
        for (role, cursor) in &mut runners {
            let polled = role.poll(&mut team.agent(cursor), &mut ToyPolicy);
            moves |= polled.expect("a direct link").is_progress();
        }
        assert!(moves, "the team stands still at tick {}", log.ticks);
    }
    log
}

#[test]
fn a_team_decides_the_same_byte_for_byte() {
    let one = record(7, &[0b1111], 0);
    let other = record(7, &[0b1000, 0b0010, 0b0101], 977);
    assert!(one.bytes.len() > 3 * TICKS as usize * ENTRY, "absent agents are few");
    let differs = one.bytes.iter().zip(&other.bytes).position(|(one, other)| one != other);
    assert_eq!(differs.map(|byte| byte / ENTRY), None, "entry of the log");
    assert_eq!(one.bytes.len(), other.bytes.len());
    let another = record(8, &[0b1111], 0);
    assert!(another.bytes != one.bytes);
}
