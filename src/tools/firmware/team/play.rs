//! World, allocator and the other agents in one thread, a device at the end of a line: a tick at a time.
//!
//! Time passes only where everybody rests, the device among them: what is played depends on no clock of this machine.

use std::cell::Cell;
use std::collections::BTreeMap;

use sortie_cli::failure::{Exit, Failure};
use sortie_core::link::{
    ActionTx, AllocRx, Bell, Clock, Direct, DirectAgent, DirectCursor, Frame, FrameBlock, FrameRx,
    LineCounters, LinkError, Relay, StatTx, Wake, packet_bytes,
};
use sortie_core::roles::{
    AllocatorOptions, AllocatorRole, Counters, Identity, Poll, RunnerOptions, RunnerRole,
    TickReport, WorldObserver, WorldOptions, WorldRole,
};
use sortie_core::wire::{ActionMsg, AllocMsg, FrameFormat, Role, StatMsg};
use sortie_core::{Allocator, Policy, World};
use sortie_ipc::DomainContract;

use super::line::{Line, LineReport};

/// How long the world waits for actions; for allocations half of it.
const PATIENCE_NS: u64 = 100_000_000;

/// Time that passes only where everybody waits.
#[derive(Default)]
struct StandingClock(Cell<u64>);

impl Clock for StandingClock {
    fn now_ns(&self) -> u64 {
        self.0.get()
    }
}

/// What a team with a device is started with.
pub(crate) struct Setup<'a> {
    pub(crate) contract: &'a DomainContract,
    pub(crate) format: FrameFormat,
    /// The agent for which the device acts.
    pub(crate) agent: usize,
    pub(crate) episodes: u32,
}

/// Who acts on this machine.
pub(crate) struct Cast<'a> {
    pub(crate) world: &'a mut dyn World,
    /// Acts for the other agents.
    pub(crate) others: &'a mut dyn Policy,
    /// Decides once more what the device has decided.
    pub(crate) own: &'a mut dyn Policy,
    pub(crate) allocator: Option<&'a mut dyn Allocator>,
}

pub(crate) struct Played {
    pub(crate) line: LineReport,
    pub(crate) relay: LineCounters,
    pub(crate) world: Counters,
    pub(crate) turns: Turns,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Turns {
    /// Frames that asked the device for an action.
    pub(crate) asked: u64,
    /// Actions of the device that the world executed.
    pub(crate) executed: u64,
    /// Actions for a frame that are not those of this machine's runtime.
    pub(crate) wrong: u64,
}

/// What the world told.
#[derive(Default)]
struct Watch {
    agent: usize,
    episode: u32,
    step: u32,
    ended: u32,
    executed: u64,
}

impl WorldObserver for Watch {
    fn episode_started(&mut self, episode: u32) {
        (self.episode, self.step) = (episode, 0);
    }

    fn episode_ended(&mut self, _episode: u32, _steps: u32) {
        self.ended += 1;
    }

    fn tick(&mut self, report: &TickReport<'_>) {
        self.step = report.step + 1;
        self.executed += report.answered >> self.agent & 1;
    }
}

pub(crate) fn play(
    setup: &Setup<'_>,
    cast: &mut Cast<'_>,
    mut line: Line<'_>,
) -> Result<Played, Failure> {
    let (clock, format) = (StandingClock::default(), setup.format);
    let mut memory = vec![FrameBlock::zeroed(); format.layout.payload_bytes() / 64];
    let mut team = Direct::new(&mut memory, &clock);
    let mut packet = vec![0; packet_bytes(format.layout.shape())];
    let mut relay = Relay::new(line.port(), format, 1 << setup.agent, &mut packet);
    let mut roles = Roles::new(setup, &mut team, cast.allocator.is_some())?;
    let mut judge = Judge::new(setup);
    let mut watch = Watch { agent: setup.agent, ..Watch::default() };
    let mut relay_cursor = DirectCursor::default();
    loop {
        let polled = roles.poll_world(&mut team, cast, &mut watch)?;
        // What the world says of its end does not go over the line: the device is asked what it has counted.
        if watch.ended == setup.episodes {
            break;
        }
        // Everybody else works first: frame and allocation go over the line together.
        let is_moving = roles.settle(&mut team, cast)? || polled.is_progress();
        judge.look(&mut team)?;
        let mut link = Noted::new(team.agent(&mut relay_cursor));
        relay.turn(&mut link)?;
        let passed_on = link.actions;
        judge.judge(&mut team, cast.own, &passed_on)?;
        let is_heard = relay.take_heard();
        if !line.turn(watch.episode, watch.step)? && !is_heard && !is_moving {
            pass_time(&clock, polled)?;
        }
    }
    let turns = Turns { executed: watch.executed, ..judge.turns };
    let relay = *relay.counters();
    Ok(Played { line: line.close(&relay), relay, world: *roles.world.counters(), turns })
}

/// Nobody has anything left to do.
fn pass_time(clock: &StandingClock, polled: Poll) -> Result<(), Failure> {
    match polled {
        Poll::Wait { until_ns } if until_ns < u64::MAX => {
            clock.0.set(clock.now_ns().max(until_ns));
            Ok(())
        }
        _ => Err(Failure::new(Exit::Bug, "everybody waits for somebody else; please report this")),
    }
}

/// The roles on this machine.
struct Roles {
    world: WorldRole,
    allocator: AllocatorRole,
    others: RunnerRole,
    cursors: [DirectCursor; 3],
}

impl Roles {
    fn new(setup: &Setup<'_>, team: &mut Direct<'_>, has_allocator: bool) -> Result<Self, Failure> {
        let Setup { contract, format, agent, .. } = *setup;
        let every = format.layout.every_agent();
        let allocator = AllocatorOptions {
            format,
            identity: Identity::new(1, "allocator"),
            decision_interval: contract.decision_interval,
        };
        let mut roles = Self {
            world: WorldRole::new(world_options(setup, has_allocator)),
            allocator: AllocatorRole::new(allocator),
            others: RunnerRole::new(runner_options(setup, every & !(1 << agent))),
            cursors: [DirectCursor::default(); 3],
        };
        let [_, runner, allocator] = &mut roles.cursors;
        roles.others.join(&mut team.agent(runner))?;
        if has_allocator {
            roles.allocator.lead(1);
            roles.allocator.join(&mut team.allocator(allocator))?;
        }
        Ok(roles)
    }

    /// What the world waits for.
    fn poll_world(
        &mut self,
        team: &mut Direct<'_>,
        cast: &mut Cast<'_>,
        watch: &mut Watch,
    ) -> Result<Poll, Failure> {
        let [world, ..] = &mut self.cursors;
        let polled = self.world.poll(&mut team.world(world), cast.world, watch);
        polled.map_err(Failure::bug)
    }

    /// Allocator and runners of this machine work until they rest. Returns whether they did anything.
    fn settle(&mut self, team: &mut Direct<'_>, cast: &mut Cast<'_>) -> Result<bool, Failure> {
        let [_, runner, allocator] = &mut self.cursors;
        for turn in 0.. {
            let mut is_moving = false;
            if let Some(policy) = cast.allocator.as_deref_mut() {
                let polled = self.allocator.poll(&mut team.allocator(allocator), policy);
                is_moving |= polled.map_err(Failure::bug)?.is_progress();
            }
            let others = self.others.poll(&mut team.agent(runner), cast.others)?;
            if !is_moving && !others.is_progress() {
                return Ok(turn > 0);
            }
        }
        Ok(true)
    }
}

/// Compares what the device decides with what this machine's runtime does.
struct Judge {
    options: RunnerOptions,
    cursor: DirectCursor,
    allocations: BTreeMap<(u32, u32), AllocMsg>,
    seen_tick: u64,
    turns: Turns,
}

impl Judge {
    fn new(setup: &Setup<'_>) -> Self {
        Self {
            options: runner_options(setup, 1 << setup.agent),
            cursor: DirectCursor::default(),
            allocations: BTreeMap::new(),
            seen_tick: 0,
            turns: Turns::default(),
        }
    }

    /// Sees what the relay is about to send.
    fn look(&mut self, team: &mut Direct<'_>) -> Result<(), Failure> {
        let mut end = team.agent(&mut self.cursor);
        let mut tick = 0;
        if end.receive_frames(&mut |frame| {
            tick = frame.header.tick;
            frame.header.asks_for_actions()
        })? {
            self.turns.asked += u64::from(tick > self.seen_tick);
            self.seen_tick = tick;
        }
        let allocations = &mut self.allocations;
        Ok(end.receive_allocations(&mut |allocation| {
            allocations.insert(allocation.order(), *allocation);
        })?)
    }

    /// Decides on the frame by the allocation that the device names.
    fn judge(
        &mut self,
        team: &mut Direct<'_>,
        policy: &mut dyn Policy,
        actions: &[ActionMsg],
    ) -> Result<(), Failure> {
        let end = team.agent(&mut self.cursor);
        let Some(frame) = end.frame() else { return Ok(()) };
        for action in actions.iter().filter(|action| action.tick == frame.header.tick) {
            let order = (action.alloc_term, action.alloc_epoch);
            let allocation = self.allocations.get(&order).copied();
            let own = answer(self.options, policy, frame, allocation)?;
            let said = |answer: &ActionMsg| (answer.action, answer.q.to_bits(), answer.task);
            self.turns.wrong += u64::from(own.as_ref().map(said) != Some(said(action)));
        }
        Ok(())
    }
}

pub(super) fn runner_options(setup: &Setup<'_>, agents: u64) -> RunnerOptions {
    RunnerOptions {
        format: setup.format,
        identity: Identity::new(1, "runner"),
        agents,
        subtasks: setup.contract.subtasks,
        decision_interval: setup.contract.decision_interval,
        period_ns: 0,
        safe_action: setup.contract.safe_action,
    }
}

fn world_options(setup: &Setup<'_>, allocator: bool) -> WorldOptions {
    WorldOptions {
        format: setup.format,
        identity: Identity::new(1, "world"),
        term: 1,
        required: setup.format.layout.every_agent(),
        allocator,
        strict: false,
        pipelined: false,
        join_patience_ns: PATIENCE_NS,
        period_ns: 0,
        patience_ns: PATIENCE_NS,
        // A device whose frames are lost is not given up: nobody else acts for its agent.
        absent_after: u32::MAX,
        absent: 0,
        decision_interval: setup.contract.decision_interval,
        safe_action: setup.contract.safe_action,
        episodes: Some(setup.episodes),
        tick_interval_ns: 0,
    }
}

/// A link that shows one frame and one allocation, and keeps the answer.
struct Alone<'f> {
    frame: Frame<'f>,
    is_shown: bool,
    allocation: Option<AllocMsg>,
    answer: Option<ActionMsg>,
}

/// What a runner of these options answers to a frame by an allocation; nothing where it does not.
pub(crate) fn answer(
    options: RunnerOptions,
    policy: &mut dyn Policy,
    frame: Frame<'_>,
    allocation: Option<AllocMsg>,
) -> Result<Option<ActionMsg>, LinkError> {
    let mut role = RunnerRole::new(options);
    let mut link = Alone { frame, is_shown: false, allocation, answer: None };
    while role.poll(&mut link, policy)? == Poll::Again {}
    Ok(link.answer)
}

impl FrameRx for Alone<'_> {
    fn receive_frames(
        &mut self,
        accept: &mut dyn FnMut(Frame<'_>) -> bool,
    ) -> Result<bool, LinkError> {
        Ok(!std::mem::replace(&mut self.is_shown, true) && accept(self.frame))
    }

    fn frame(&self) -> Option<Frame<'_>> {
        Some(self.frame)
    }
}

impl AllocRx for Alone<'_> {
    fn receive_allocations(&mut self, take: &mut dyn FnMut(&AllocMsg)) -> Result<(), LinkError> {
        if let Some(allocation) = self.allocation.take() {
            take(&allocation);
        }
        Ok(())
    }
}

impl ActionTx for Alone<'_> {
    fn send_action(&mut self, action: &ActionMsg) -> Result<(), LinkError> {
        self.answer = Some(*action);
        Ok(())
    }
}

impl StatTx for Alone<'_> {
    fn send_status(&mut self, _status: &StatMsg) -> Result<(), LinkError> {
        Ok(())
    }
}

impl Bell for Alone<'_> {
    fn token(&self) -> u32 {
        0
    }

    fn wait_until(&mut self, _token: u32, _until_ns: u64) -> Wake {
        Wake::Timeout
    }

    fn ring(&mut self, _role: Role) -> Result<(), LinkError> {
        Ok(())
    }
}

impl Clock for Alone<'_> {
    /// No allocation is waited for any more.
    fn now_ns(&self) -> u64 {
        self.frame.header.deadline_ns
    }
}

struct Noted<'a, 'b> {
    link: DirectAgent<'a, 'b>,
    actions: Vec<ActionMsg>,
}

impl<'a, 'b> Noted<'a, 'b> {
    fn new(link: DirectAgent<'a, 'b>) -> Self {
        Self { link, actions: Vec::new() }
    }
}

impl ActionTx for Noted<'_, '_> {
    fn send_action(&mut self, action: &ActionMsg) -> Result<(), LinkError> {
        self.actions.push(*action);
        self.link.send_action(action)
    }
}

impl FrameRx for Noted<'_, '_> {
    fn receive_frames(
        &mut self,
        accept: &mut dyn FnMut(Frame<'_>) -> bool,
    ) -> Result<bool, LinkError> {
        self.link.receive_frames(accept)
    }

    fn frame(&self) -> Option<Frame<'_>> {
        self.link.frame()
    }
}

impl AllocRx for Noted<'_, '_> {
    fn receive_allocations(&mut self, take: &mut dyn FnMut(&AllocMsg)) -> Result<(), LinkError> {
        self.link.receive_allocations(take)
    }
}

impl StatTx for Noted<'_, '_> {
    fn send_status(&mut self, status: &StatMsg) -> Result<(), LinkError> {
        self.link.send_status(status)
    }
}

impl Bell for Noted<'_, '_> {
    fn token(&self) -> u32 {
        self.link.token()
    }

    fn wait_until(&mut self, token: u32, until_ns: u64) -> Wake {
        self.link.wait_until(token, until_ns)
    }

    fn ring(&mut self, role: Role) -> Result<(), LinkError> {
        self.link.ring(role)
    }
}

impl Clock for Noted<'_, '_> {
    fn now_ns(&self) -> u64 {
        self.link.now_ns()
    }
}
