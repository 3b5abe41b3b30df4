//! What worlds do when they are told to, and what they ask of allocators that do not answer.

use std::cell::Cell;

use sortie_core::link::{
    ActionTx, AllocTx, Clock, Direct, DirectCursor, Frame, FrameBlock, FrameRx, StatTx,
};
use sortie_core::roles::{
    Identity, Poll, RunnerOptions, RunnerRole, TickReport, WorldObserver, WorldOptions, WorldRole,
};
use sortie_core::wire::{
    ActionMsg, AllocMsg, FrameFormat, FrameHeader, FrameLayout, FrameMut, Role, StatMsg,
};
use sortie_core::{
    DecideError, Decision, EntityMask, Observation, Policy, Shape, StepOutcome, UnavailableAction,
    World,
};
use zerocopy::FromZeros;

const SHAPE: Shape = Shape { agents: 1, entities: 2, tasks: 1, actions: 2, features: 1 };
const SCHEMA: u64 = 5;
const PERIOD: u64 = 1_000;
const RUNNER: u32 = 8;

struct Hand(Cell<u64>);

impl Clock for Hand {
    fn now_ns(&self) -> u64 {
        self.0.get()
    }
}

/// Nothing happens in it.
struct Still;

impl World for Still {
    fn shape(&self) -> Shape {
        SHAPE
    }

    fn reset(&mut self) {}

    fn observe(&self, frame: &mut FrameMut<'_>) {
        frame.set_present(&EntityMask::first(SHAPE.entities));
        frame.set_open_tasks(1);
        frame.available_mut(0).fill(1);
    }

    fn step(&mut self, _: &[u16]) -> Result<StepOutcome, UnavailableAction> {
        Ok(StepOutcome::default())
    }
}

impl Policy for Still {
    fn actions(&self) -> usize {
        SHAPE.actions
    }

    fn utilities(&mut self, _: &Observation<'_>, _: &mut [f32]) -> Result<(), DecideError> {
        Ok(())
    }

    fn decide(&mut self, _: &Observation<'_>) -> Result<Decision, DecideError> {
        Ok(Decision { action: 0, utility: 0.0 })
    }
}

/// What the world told.
#[derive(Default)]
struct Watch {
    /// Episode and step of every tick.
    ticks: Vec<(u32, u32)>,
    started: Vec<u32>,
    ended: u32,
    /// Agents that answered in the last tick, as bits.
    answered: u64,
}

impl WorldObserver for Watch {
    fn episode_started(&mut self, episode: u32) {
        self.started.push(episode);
    }

    fn tick(&mut self, report: &TickReport<'_>) {
        self.ticks.push((report.episode, report.step));
        self.answered = report.answered;
    }

    fn episode_ended(&mut self, _: u32, _: u32) {
        self.ended += 1;
    }
}

/// A world whose one agent and allocator the tests play.
struct Stage {
    team: Direct<'static>,
    clock: &'static Hand,
    format: FrameFormat,
    world: WorldRole,
    cursors: [DirectCursor; 3],
    watch: Watch,
    /// Headers of all frames sent.
    frames: Vec<FrameHeader>,
}

impl Stage {
    fn new() -> Self {
        let format = FrameFormat { schema: SCHEMA, layout: FrameLayout::new(SHAPE).unwrap() };
        let memory = vec![FrameBlock::zeroed(); format.layout.payload_bytes() / 64].leak();
        let clock: &'static Hand = Box::leak(Box::new(Hand(Cell::new(1_000))));
        let world = WorldRole::new(WorldOptions {
            format,
            identity: Identity::new(7, "world"),
            term: 1,
            required: 0,
            allocator: true,
            strict: false,
            pipelined: false,
            join_patience_ns: 0,
            period_ns: PERIOD,
            patience_ns: 0,
            absent_after: u32::MAX,
            absent: 0,
            decision_interval: 2,
            safe_action: Some(1),
            episodes: None,
            tick_interval_ns: 0,
        });
        let mut stage = Self {
            team: Direct::new(memory, clock),
            clock,
            format,
            world,
            cursors: [DirectCursor::default(); 3],
            watch: Watch::default(),
            frames: Vec::new(),
        };
        stage.seat(Role::Runner, RUNNER, 0);
        stage
    }

    fn seat(&mut self, role: Role, pid: u32, flags: u32) {
        let status = StatMsg {
            schema: SCHEMA,
            abi: 3,
            role: role as u8,
            pid,
            agents: 1,
            flags,
            ..StatMsg::new_zeroed()
        };
        self.team.allocator(&mut self.cursors[2]).send_status(&status).unwrap();
    }

    fn allocate(&mut self, term: u32, epoch: u32) {
        let allocation = AllocMsg {
            schema: SCHEMA,
            tick: self.world.tick(),
            valid_until: self.world.tick() + 2,
            term,
            epoch,
            n_agents: 1,
            n_tasks: 1,
            abi: 3,
            ..AllocMsg::new_zeroed()
        };
        self.team.allocator(&mut self.cursors[2]).send_allocation(&allocation).unwrap();
    }

    /// Polls until the world waits for something that time alone does not bring, or has ended.
    fn play(&mut self, ticks: usize) -> Poll {
        let enough = self.watch.ticks.len() + ticks;
        loop {
            let mut link = self.team.world(&mut self.cursors[0]);
            let polled = self.world.poll(&mut link, &mut Still, &mut self.watch).unwrap();
            let frames = &mut self.frames;
            let mut agent = self.team.agent(&mut self.cursors[1]);
            let mut note = |frame: Frame<'_>| {
                frames.push(*frame.header);
                true
            };
            agent.receive_frames(&mut note).unwrap();
            match polled {
                Poll::Wait { until_ns: u64::MAX } | Poll::Ended => return polled,
                _ if self.watch.ticks.len() >= enough => return polled,
                Poll::Wait { until_ns } => self.clock.0.set(until_ns),
                Poll::Again | Poll::Answered => {}
            }
        }
    }

    /// Polls until the world has sent a frame.
    fn publish(&mut self) {
        let frames = self.frames.len();
        while self.frames.len() == frames {
            let mut link = self.team.world(&mut self.cursors[0]);
            let polled = self.world.poll(&mut link, &mut Still, &mut self.watch).unwrap();
            let frames = &mut self.frames;
            let mut agent = self.team.agent(&mut self.cursors[1]);
            let mut note = |frame: Frame<'_>| {
                frames.push(*frame.header);
                true
            };
            agent.receive_frames(&mut note).unwrap();
            if let Poll::Wait { until_ns } = polled {
                self.clock.0.set(until_ns.min(self.clock.now_ns() + PERIOD / 10));
            }
        }
    }

    /// The agent answers a tick, its low 32 bits given.
    fn answer(&mut self, tick: u64) {
        let action = ActionMsg {
            schema: SCHEMA,
            tick: self.world.tick() & !u64::from(u32::MAX) | tick,
            task: sortie_core::UNASSIGNED,
            abi: 3,
            runner: RUNNER,
            ..ActionMsg::new_zeroed()
        };
        self.team.agent(&mut self.cursors[1]).send_action(&action).unwrap();
    }

    fn last(&self) -> (u32, u16, u64) {
        let header = self.frames.last().unwrap();
        (header.episode, header.flags, header.tick & u64::from(u32::MAX))
    }
}

fn paused() -> Poll {
    Poll::Wait { until_ns: u64::MAX }
}

#[test]
fn a_paused_world_says_so_and_waits_until_it_is_told_to_go_on() {
    let mut stage = Stage::new();
    stage.play(3);
    stage.world.pause();
    assert_eq!(stage.play(99), paused());
    assert_eq!(stage.last(), (0, FrameHeader::PAUSED, 4));
    assert!(!stage.frames.last().unwrap().asks_for_actions());
    // Heartbeats pass; nothing else does.
    stage.clock.0.set(1_000_000_000);
    let frames = stage.frames.len();
    assert_eq!((stage.play(99), stage.frames.len()), (paused(), frames));
    stage.world.resume();
    stage.play(2);
    assert_eq!(stage.watch.ticks[2..], [(0, 2), (0, 3), (0, 4)]);
    assert_eq!(stage.frames[frames].flags, FrameHeader::REALLOC);
}

#[test]
fn an_episode_that_is_reset_does_not_count() {
    let mut stage = Stage::new();
    stage.play(3);
    stage.world.reset_episode();
    stage.play(2);
    assert_eq!(stage.watch.ticks, [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1)]);
    assert_eq!((&stage.watch.started[..], stage.watch.ended), (&[0, 1][..], 0));
    let end = stage.frames.iter().rfind(|frame| frame.has(FrameHeader::EPISODE_END)).unwrap();
    assert_eq!(end.episode, 0);
    // An episode that has not begun is not given up.
    let mut stage = Stage::new();
    stage.world.reset_episode();
    stage.play(1);
    assert_eq!((&stage.watch.started[..], &stage.watch.ticks[..]), (&[0][..], &[(0, 0)][..]));
}

#[test]
fn a_world_is_reset_while_it_is_paused() {
    let mut stage = Stage::new();
    stage.play(2);
    stage.world.pause();
    stage.play(1);
    stage.world.reset_episode();
    assert_eq!(stage.play(1), paused());
    stage.world.resume();
    stage.play(1);
    assert_eq!(stage.watch.ticks, [(0, 0), (0, 1), (1, 0)]);
}

#[test]
fn a_world_that_was_changed_is_seen_anew_and_old_answers_are_void() {
    let mut stage = Stage::new();
    stage.play(2);
    stage.publish();
    let (before, frames) = (stage.last(), stage.frames.len());
    stage.answer(before.2);
    stage.world.observe_anew();
    stage.publish();
    // The next frame asks for an allocation; its tick is another, the episode's step is the same.
    assert_eq!(stage.frames.len(), frames + 1);
    assert_eq!(stage.last(), (0, FrameHeader::REALLOC, before.2 + 1));
    stage.play(1);
    assert_eq!(stage.watch.ticks, [(0, 0), (0, 1), (0, 2)]);
    assert_eq!(stage.watch.answered, 0, "what was decided on the frame before does not count");
    // Between two ticks there is nothing to take back.
    stage.world.observe_anew();
    let frames = stage.frames.len();
    stage.publish();
    assert_eq!(stage.frames.len(), frames + 1);
    stage.answer(stage.last().2);
    stage.play(1);
    assert_eq!((stage.watch.ticks.len(), stage.watch.answered), (4, 1));
}

#[test]
fn a_world_ends_when_it_is_told_to() {
    for is_paused in [false, true] {
        let mut stage = Stage::new();
        stage.play(2);
        if is_paused {
            stage.world.pause();
            stage.play(1);
        }
        stage.world.end();
        assert_eq!(stage.play(99), Poll::Ended);
        assert_eq!(stage.last().1, FrameHeader::SHUTDOWN);
    }
}

#[test]
fn every_three_allocations_missed_the_leader_is_to_step_down() {
    let mut stage = Stage::new();
    stage.seat(Role::Allocator, 20, StatMsg::LEADER);
    stage.play(1);
    let mut asked = Vec::new();
    for _ in 0..13 {
        stage.play(1);
        asked.extend(stage.world.take_silent_leader().map(|pid| (stage.watch.ticks.len(), pid)));
    }
    // One is asked for every two ticks.
    assert_eq!(asked, [(5, 20), (11, 20)]);
    // An allocation gives it three new chances; so has its successor.
    stage.allocate(1, 1);
    stage.seat(Role::Allocator, 21, StatMsg::LEADER);
    let before = stage.watch.ticks.len();
    while stage.watch.ticks.len() < before + 4 {
        stage.play(1);
        assert_eq!(stage.world.take_silent_leader(), None);
    }
    stage.play(2);
    assert_eq!(stage.world.take_silent_leader(), Some(21));
}

#[test]
fn a_pause_is_no_gap_for_those_who_saw_it() {
    let mut stage = Stage::new();
    let mut runner = RunnerRole::new(RunnerOptions {
        format: stage.format,
        identity: Identity::new(RUNNER, "runner"),
        agents: 1,
        subtasks: false,
        decision_interval: 2,
        period_ns: PERIOD,
        safe_action: None,
    });
    let mut cursor = DirectCursor::default();
    for pauses in 0..3 {
        stage.play(1);
        runner.poll(&mut stage.team.agent(&mut cursor), &mut Still).unwrap();
        stage.world.pause();
        stage.play(1);
        runner.poll(&mut stage.team.agent(&mut cursor), &mut Still).unwrap();
        stage.world.resume();
        assert_eq!(runner.counters().frame_gaps, 0, "after {pauses} pauses");
    }
    assert_eq!(runner.counters().ticks, 3);
}
