//! A world whose link, time and team are in the hands of a test.

use sortie_core::link::{
    ActionRx, AllocRx, Bell, Clock, FrameBlock, FrameTx, LinkError, StatRx, StatTx, Wake,
};
use sortie_core::roles::{
    Identity, Poll, TickReport, Timing, WorldError, WorldObserver, WorldOptions, WorldRole,
};
use sortie_core::wire::{
    ActionMsg, AllocMsg, FrameFormat, FrameHeader, FrameLayout, FrameMut, Role, StatMsg,
};
use sortie_core::{EntityMask, Shape, StepOutcome, UnavailableAction, World};
use zerocopy::{FromZeros, IntoBytes};

pub(crate) const SHAPE: Shape = Shape { agents: 2, entities: 3, tasks: 1, actions: 2, features: 1 };
pub(crate) const SCHEMA: u64 = 5;
pub(crate) const TERM: u64 = 7 << 32;
pub(crate) const PERIOD: u64 = 1_000;
pub(crate) const START: u64 = 10_000;
pub(crate) const WORLD: u32 = 7;
pub(crate) const RUNNERS: [u32; 2] = [20, 21];
pub(crate) const ALLOCATOR: u32 = 30;

/// A world's end of the link: the tests write what it receives, and read what it sends.
pub(crate) struct Table {
    pub(crate) now_ns: u64,
    pub(crate) payload: Vec<FrameBlock>,
    pub(crate) frames: Vec<FrameHeader>,
    pub(crate) told: Vec<StatMsg>,
    pub(crate) rings: Vec<Role>,
    pub(crate) awaited_rings: u32,
    pub(crate) statuses: Vec<StatMsg>,
    pub(crate) actions: Vec<ActionMsg>,
    pub(crate) allocations: Vec<AllocMsg>,
}

impl Clock for Table {
    fn now_ns(&self) -> u64 {
        self.now_ns
    }
}

impl FrameTx for Table {
    fn send_frame(
        &mut self,
        fill: &mut dyn FnMut(&mut [u8]) -> Result<FrameHeader, LinkError>,
    ) -> Result<(), LinkError> {
        self.frames.push(fill(self.payload.as_mut_slice().as_mut_bytes())?);
        Ok(())
    }
}

impl StatRx for Table {
    fn receive_statuses(&mut self, take: &mut dyn FnMut(&StatMsg)) -> Result<(), LinkError> {
        self.statuses.drain(..).for_each(|status| take(&status));
        Ok(())
    }
}

impl ActionRx for Table {
    fn receive_actions(&mut self, take: &mut dyn FnMut(&ActionMsg)) -> Result<(), LinkError> {
        self.actions.drain(..).for_each(|action| take(&action));
        Ok(())
    }
}

impl AllocRx for Table {
    fn receive_allocations(&mut self, take: &mut dyn FnMut(&AllocMsg)) -> Result<(), LinkError> {
        self.allocations.drain(..).for_each(|allocation| take(&allocation));
        Ok(())
    }
}

impl StatTx for Table {
    fn send_status(&mut self, status: &StatMsg) -> Result<(), LinkError> {
        self.told.push(*status);
        Ok(())
    }
}

impl Bell for Table {
    fn token(&self) -> u32 {
        0
    }

    fn wait_until(&mut self, _: u32, _: u64) -> Wake {
        Wake::Timeout
    }

    fn await_rings(&mut self, rings: u32) {
        self.awaited_rings = rings;
    }

    fn ring(&mut self, role: Role) -> Result<(), LinkError> {
        self.rings.push(role);
        Ok(())
    }
}

/// Its episodes end after so many steps, and its subtasks change with one of them.
pub(crate) struct Rounds {
    pub(crate) steps: u32,
    pub(crate) length: u32,
    pub(crate) tasks_change_at: u32,
    /// How many of its entities exist.
    pub(crate) present: usize,
}

impl World for Rounds {
    fn shape(&self) -> Shape {
        SHAPE
    }

    fn reset(&mut self) {
        self.steps = 0;
    }

    fn observe(&self, frame: &mut FrameMut<'_>) {
        frame.set_present(&EntityMask::first(self.present));
        frame.set_open_tasks(1);
        (0..SHAPE.agents).for_each(|agent| frame.available_mut(agent).fill(1));
    }

    fn step(&mut self, _: &[u16]) -> Result<StepOutcome, UnavailableAction> {
        self.steps += 1;
        let episode_ended = self.steps == self.length;
        let tasks_changed = self.steps == self.tasks_change_at;
        Ok(StepOutcome { episode_ended, tasks_changed })
    }
}

/// What the world reports.
#[derive(Default)]
pub(crate) struct Watch {
    pub(crate) actions: Vec<Vec<u16>>,
    pub(crate) answered: Vec<u64>,
    pub(crate) degraded: Vec<bool>,
    /// Ticks of the allocations that are reported.
    pub(crate) allocated: Vec<Option<u64>>,
    pub(crate) absent: Vec<u64>,
    pub(crate) ended: Vec<(u32, u32)>,
    pub(crate) timings: Vec<Timing>,
}

impl WorldObserver for Watch {
    fn tick(&mut self, report: &TickReport<'_>) {
        self.actions.push(report.actions.to_vec());
        self.answered.push(report.answered);
        self.degraded.push(report.degraded);
        self.timings.push(report.timing);
        self.allocated.push(report.allocation.map(|allocation| allocation.tick));
        self.absent.push(report.absent);
    }

    fn episode_ended(&mut self, episode: u32, steps: u32) {
        self.ended.push((episode, steps));
    }
}

pub(crate) struct Stage {
    pub(crate) table: Table,
    pub(crate) role: WorldRole,
    pub(crate) rounds: Rounds,
    pub(crate) watch: Watch,
}

impl Stage {
    pub(crate) fn new(change: impl FnOnce(&mut WorldOptions)) -> Self {
        let mut options = WorldOptions {
            format: format(),
            identity: Identity::new(WORLD, "world"),
            term: 7,
            required: 0b11,
            allocator: true,
            strict: false,
            pipelined: false,
            join_patience_ns: 500,
            period_ns: PERIOD,
            patience_ns: 0,
            absent_after: 3,
            absent: 0,
            decision_interval: 4,
            safe_action: Some(0),
            episodes: None,
            tick_interval_ns: 0,
        };
        change(&mut options);
        let table = Table {
            now_ns: START,
            payload: vec![FrameBlock::zeroed(); format().layout.payload_bytes() / 64],
            frames: Vec::new(),
            told: Vec::new(),
            rings: Vec::new(),
            awaited_rings: 0,
            statuses: Vec::new(),
            actions: Vec::new(),
            allocations: Vec::new(),
        };
        let rounds = Rounds {
            steps: 0,
            length: u32::MAX,
            tasks_change_at: u32::MAX,
            present: SHAPE.entities,
        };
        Self { table, role: WorldRole::new(options), rounds, watch: Watch::default() }
    }

    /// A world with its whole team, in its first tick.
    pub(crate) fn acting(change: impl FnOnce(&mut WorldOptions)) -> Self {
        let mut stage = Self::new(change);
        stage.poll().unwrap();
        stage.join(0b11, true);
        while stage.role.tick() == TERM {
            assert_eq!(stage.poll(), Ok(Poll::Again));
        }
        stage.table.rings.clear();
        stage
    }

    pub(crate) fn poll(&mut self) -> Result<Poll, WorldError> {
        self.role.poll(&mut self.table, &mut self.rounds, &mut self.watch)
    }

    /// Lets time pass until the world has nothing to wait for but others, or has done so many ticks.
    pub(crate) fn play(&mut self, ticks: usize) -> Poll {
        loop {
            match self.poll().unwrap() {
                Poll::Wait { until_ns } if self.watch.answered.len() < ticks => {
                    self.table.now_ns = until_ns;
                }
                Poll::Again | Poll::Answered => {}
                polled => return polled,
            }
        }
    }

    /// The current tick is over with these answers, and the next begins.
    pub(crate) fn tick(&mut self, answers: &[ActionMsg]) {
        self.table.actions.extend(answers);
        self.table.now_ns += PERIOD;
        let tick = self.role.tick();
        while self.role.tick() == tick {
            assert_eq!(self.poll(), Ok(Poll::Again));
        }
    }

    pub(crate) fn tell(&mut self, role: Role, pid: u32, agents: u64, flags: u32) {
        let (schema, role) = (SCHEMA, role as u8);
        let status = StatMsg { schema, abi: 3, role, pid, agents, flags, ..StatMsg::new_zeroed() };
        self.table.statuses.push(status);
    }

    /// Runners of these agents say that they are there, and an allocator that leads.
    pub(crate) fn join(&mut self, agents: u64, allocator: bool) {
        for agent in (0..SHAPE.agents).filter(|agent| agents >> agent & 1 == 1) {
            self.tell(Role::Runner, RUNNERS[agent], 1 << agent, StatMsg::HELLO);
        }
        if allocator {
            self.tell(Role::Allocator, ALLOCATOR, 0, StatMsg::LEADER);
        }
    }

    pub(crate) fn answer(&self, agent: u16) -> ActionMsg {
        let runner = RUNNERS[usize::from(agent)];
        let (tick, t_ns) = (self.role.tick(), self.table.now_ns);
        ActionMsg { schema: SCHEMA, abi: 3, tick, t_ns, agent, runner, ..ActionMsg::new_zeroed() }
    }

    pub(crate) fn allocate(&mut self, epoch: u32) {
        let tick = self.role.tick();
        let valid_until = tick + 4;
        let allocation = AllocMsg {
            schema: SCHEMA,
            abi: 3,
            tick,
            valid_until,
            term: 1,
            epoch,
            n_agents: 2,
            n_tasks: 1,
            ..AllocMsg::new_zeroed()
        };
        self.table.allocations.push(allocation);
    }

    /// Counts of the ticks whose frames ask for an allocation.
    pub(crate) fn asked(&self) -> Vec<u64> {
        let frames = self.table.frames.iter();
        let asking = frames.filter(|frame| frame.flags & FrameHeader::REALLOC != 0);
        asking.map(|frame| frame.tick - TERM).collect()
    }

    /// Flags of the statuses sent since the last call.
    pub(crate) fn told(&mut self) -> Vec<u32> {
        self.table.told.drain(..).map(|status| status.flags).collect()
    }

    pub(crate) fn counts(&self) -> [u64; 3] {
        let counters = self.role.counters();
        [counters.schema_rejects, counters.bad_messages, counters.late]
    }
}

pub(crate) fn format() -> FrameFormat {
    FrameFormat { schema: SCHEMA, layout: FrameLayout::new(SHAPE).unwrap() }
}

pub(crate) fn wait(until_ns: u64) -> Result<Poll, WorldError> {
    Ok(Poll::Wait { until_ns })
}
