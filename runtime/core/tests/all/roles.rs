//! What the roles do where something is missing, late or new, case by case; the fleet of `sortie-line` mixes the cases.

use std::cell::Cell;

use sortie_core::link::{
    ActionRx, ActionTx, AllocRx, AllocTx, Clock, Direct, DirectCursor, FrameBlock, FrameTx, StatRx,
};
use sortie_core::roles::{
    AllocatorError, AllocatorOptions, AllocatorRole, Identity, Poll, RunnerOptions, RunnerRole,
    TickReport, WorldError, WorldObserver, WorldOptions, WorldRole,
};
use sortie_core::wire::{
    ActionMsg, AllocMsg, FrameFormat, FrameHeader, FrameKind, FrameLayout, FrameMut, StatMsg,
};
use sortie_core::{
    AllocateError, AllocationState, Allocator, DecideError, Decision, EntityMask, NO_ACTION,
    Observation, Policy, Shape, StepOutcome, UNASSIGNED, UnavailableAction, World,
};
use zerocopy::FromZeros;

const SHAPE: Shape = Shape { agents: 2, entities: 4, tasks: 2, actions: 3, features: 1 };
const TERM: u64 = 7 << 32;
const INTERVAL: u32 = 4;

/// A clock that is set by hand.
struct Hand(Cell<u64>);

impl Clock for Hand {
    fn now_ns(&self) -> u64 {
        self.0.get()
    }
}

/// Nothing happens in it; the sets are what the tests make them.
struct Still {
    open: u32,
    present: u64,
    absent: u64,
    available: [u16; SHAPE.actions],
}

impl World for Still {
    fn shape(&self) -> Shape {
        SHAPE
    }

    fn reset(&mut self) {}

    fn observe(&self, frame: &mut FrameMut<'_>) {
        frame.set_present(&EntityMask::from_words(&[self.present]));
        frame.set_open_tasks(self.open);
        for agent in 0..SHAPE.agents {
            frame.available_mut(agent).copy_from_slice(&self.available);
        }
    }

    fn step(&mut self, _: &[u16]) -> Result<StepOutcome, UnavailableAction> {
        Ok(StepOutcome::default())
    }
}

/// Always takes action 2; remembers as many episodes as it saw.
struct Two {
    remembers: bool,
}

impl Policy for Two {
    fn actions(&self) -> usize {
        SHAPE.actions
    }

    fn utilities(&mut self, _: &Observation<'_>, _: &mut [f32]) -> Result<(), DecideError> {
        Ok(())
    }

    fn decide(&mut self, _: &Observation<'_>) -> Result<Decision, DecideError> {
        Ok(Decision { action: 2, utility: 0.5 })
    }

    fn begin_episode(&mut self) -> bool {
        self.remembers
    }
}

/// Gives everybody this subtask, or refuses.
struct Gives(Option<u8>);

impl Allocator for Gives {
    fn allocate(&mut self, _: &AllocationState<'_>, tasks: &mut [u8]) -> Result<(), AllocateError> {
        tasks.fill(self.0.ok_or(AllocateError::NonFinite)?);
        Ok(())
    }
}

/// A team in one thread, whose messages the tests write and read.
struct Stage {
    team: Direct<'static>,
    clock: &'static Hand,
    format: FrameFormat,
    world: DirectCursor,
    runner: DirectCursor,
    allocator: DirectCursor,
    still: Still,
}

impl Stage {
    fn new() -> Self {
        let layout = FrameLayout::new(SHAPE).unwrap();
        let memory = vec![FrameBlock::zeroed(); layout.payload_bytes() / 64].leak();
        let clock: &'static Hand = Box::leak(Box::new(Hand(Cell::new(1_000))));
        let [world, runner, allocator] = [DirectCursor::default(); 3];
        let team = Direct::new(memory, clock);
        let (format, still) = (
            FrameFormat { schema: 5, layout },
            Still { open: 0b11, present: 0b1111, absent: 0, available: [1; 3] },
        );
        Self { team, clock, format, world, runner, allocator, still }
    }

    /// Sends frame `count`, whose allocation is asked for at `decision`.
    fn send(&mut self, count: u32, decision: u32, flags: u16, patience_ns: u64) {
        let t_ns = self.clock.now_ns();
        let header = FrameHeader {
            magic: FrameHeader::MAGIC,
            abi: 3,
            kind: FrameKind::World as u16,
            schema: self.format.schema,
            seq: u64::from(count),
            tick: TERM + u64::from(count),
            t_ns,
            deadline_ns: t_ns + patience_ns,
            len: self.format.layout.payload_bytes() as u32,
            flags,
            generation: 0,
            world_term: 7,
            episode: 0,
        };
        let Self { team, format, world, still, .. } = self;
        let mut link = team.world(world);
        link.send_frame(&mut |payload| {
            let mut frame = FrameMut::new(payload, format.layout).unwrap();
            still.observe(&mut frame);
            frame.set_progress(count - 1, TERM + u64::from(decision), still.absent);
            Ok(header)
        })
        .unwrap();
    }

    fn allocate(&mut self, count: u32, task: u8, valid_for: u64) {
        let tick = TERM + u64::from(count);
        let allocation = AllocMsg {
            schema: 5,
            seq: 1,
            tick,
            t_ns: 0,
            valid_until: tick + valid_for,
            term: 1,
            epoch: count,
            model: 0,
            decide_ns: 0,
            n_agents: 2,
            n_tasks: 2,
            abi: 3,
            flags: 0,
            task: [task; 64],
        };
        self.team.allocator(&mut self.allocator).send_allocation(&allocation).unwrap();
    }

    fn allocation(&mut self) -> Option<AllocMsg> {
        let mut newest = None;
        let mut link = self.team.world(&mut self.world);
        link.receive_allocations(&mut |allocation| newest = Some(*allocation)).unwrap();
        newest
    }

    fn answers(&mut self) -> Vec<ActionMsg> {
        let mut answers = Vec::new();
        let mut link = self.team.world(&mut self.world);
        link.receive_actions(&mut |action| answers.push(*action)).unwrap();
        answers
    }

    fn statuses(&mut self) -> Vec<StatMsg> {
        let mut statuses = Vec::new();
        let mut link = self.team.world(&mut self.world);
        link.receive_statuses(&mut |status| statuses.push(*status)).unwrap();
        statuses
    }

    fn poll_allocator(&mut self, role: &mut AllocatorRole, rules: &mut dyn Allocator) -> Poll {
        role.poll(&mut self.team.allocator(&mut self.allocator), rules).unwrap()
    }

    fn poll_runner(&mut self, role: &mut RunnerRole) -> Poll {
        let mut link = self.team.agent(&mut self.runner);
        role.poll(&mut link, &mut Two { remembers: false }).unwrap()
    }

    fn poll_world(&mut self, role: &mut WorldRole, watch: &mut Watch) -> Result<Poll, WorldError> {
        role.poll(&mut self.team.world(&mut self.world), &mut self.still, watch)
    }

    fn allocator_role(&self) -> AllocatorRole {
        AllocatorRole::new(AllocatorOptions {
            format: self.format,
            identity: Identity::new(9, "allocator"),
            decision_interval: INTERVAL,
        })
    }

    fn runner_role(&self, period_ns: u64) -> RunnerRole {
        RunnerRole::new(RunnerOptions {
            format: self.format,
            identity: Identity::new(8, "runner"),
            agents: 0b11,
            subtasks: true,
            decision_interval: INTERVAL,
            period_ns,
            safe_action: Some(1),
        })
    }

    fn world_options(&self) -> WorldOptions {
        WorldOptions {
            format: self.format,
            identity: Identity::new(7, "world"),
            term: 7,
            required: 0b11,
            allocator: true,
            strict: false,
            pipelined: false,
            join_patience_ns: 500,
            period_ns: 1_000,
            patience_ns: 0,
            absent_after: 3,
            absent: 0,
            decision_interval: INTERVAL,
            safe_action: Some(1),
            episodes: None,
            tick_interval_ns: 0,
        }
    }
}

fn idle() -> Poll {
    Poll::Wait { until_ns: u64::MAX }
}

fn orders(answers: &[ActionMsg]) -> Vec<(u8, u16)> {
    answers.iter().map(|answer| (answer.task, answer.flags & !ActionMsg::TICK_GAP)).collect()
}

#[test]
fn a_standby_reads_along_and_answers_at_once_when_it_leads() {
    let mut stage = Stage::new();
    let (mut role, mut rules) = (stage.allocator_role(), Gives(Some(1)));
    role.join(&mut stage.team.allocator(&mut stage.allocator)).unwrap();
    stage.send(1, 1, FrameHeader::REALLOC, 100);
    assert_eq!(stage.poll_allocator(&mut role, &mut rules), idle());
    assert_eq!((stage.allocation(), role.term()), (None, None));
    // The frame asks for nothing new, and is answered all the same.
    stage.send(2, 1, 0, 100);
    stage.poll_allocator(&mut role, &mut rules);
    role.lead(3);
    assert_eq!(stage.poll_allocator(&mut role, &mut rules), Poll::Again);
    let first = stage.allocation().unwrap();
    assert_eq!(
        (first.order(), first.tick, first.flags),
        ((3, 1), TERM + 2, AllocMsg::FIRST_OF_TERM)
    );
    assert_eq!(first.valid_until, TERM + 2 + u64::from(INTERVAL));
    assert_eq!(stage.poll_allocator(&mut role, &mut rules), idle());
    let flags: Vec<u32> = stage.statuses().iter().map(|status| status.flags).collect();
    assert_eq!(flags, [StatMsg::HELLO, StatMsg::LEADER]);
    stage.send(3, 3, FrameHeader::REALLOC, 100);
    stage.poll_allocator(&mut role, &mut rules);
    assert_eq!(stage.allocation().map(|next| (next.order(), next.flags)), Some(((3, 2), 0)));
    // It steps down.
    role.stand_by();
    stage.send(4, 4, FrameHeader::REALLOC, 100);
    assert_eq!(stage.poll_allocator(&mut role, &mut rules), idle());
    assert_eq!(stage.allocation(), None);
}

#[test]
fn a_leader_without_a_frame_waits_for_the_first() {
    let mut stage = Stage::new();
    let (mut role, mut rules) = (stage.allocator_role(), Gives(Some(1)));
    role.lead(1);
    assert_eq!(stage.poll_allocator(&mut role, &mut rules), idle());
    stage.still.present = 0b1110;
    stage.send(1, 0, FrameHeader::PIPELINED_ALLOC, 100);
    stage.poll_allocator(&mut role, &mut rules);
    let first = stage.allocation().unwrap();
    assert_eq!(first.flags, AllocMsg::FIRST_OF_TERM | AllocMsg::PARTIAL);
    assert_eq!(first.valid_until, TERM + 1 + 2 * u64::from(INTERVAL));
    assert_eq!(first.task[..2], [UNASSIGNED, 1], "agent 0 is absent");
}

#[test]
fn an_agent_for_which_nobody_acts_is_given_nothing_and_no_rule_is_asked_about_nobody() {
    struct Seen(Vec<usize>);
    impl Allocator for Seen {
        fn allocate(
            &mut self,
            state: &AllocationState<'_>,
            tasks: &mut [u8],
        ) -> Result<(), AllocateError> {
            self.0 = state.present.iter().collect();
            Gives(Some(1)).allocate(state, tasks)
        }
    }
    let mut stage = Stage::new();
    let (mut role, mut rules) = (stage.allocator_role(), Seen(Vec::new()));
    role.lead(1);
    for (count, absent, seen, task, flags) in [
        (1, 0b10, vec![0, 2, 3], [1, UNASSIGNED], AllocMsg::FIRST_OF_TERM | AllocMsg::PARTIAL),
        (2, 0b11, vec![], [UNASSIGNED; 2], AllocMsg::PARTIAL),
        (3, 0, vec![0, 1, 2, 3], [1; 2], 0),
    ] {
        (stage.still.absent, rules.0) = (absent, Vec::new());
        stage.send(count, count, FrameHeader::REALLOC, 100);
        stage.poll_allocator(&mut role, &mut rules);
        let allocation = stage.allocation().unwrap();
        assert_eq!((&allocation.task[..2], allocation.flags), (&task[..], flags));
        assert_eq!(rules.0, seen);
    }
    // Its body stays where it is: whoever acts sees it.
    stage.still.absent = 0b10;
    stage.send(4, 0, 0, 100);
    let mut runner = stage.runner_role(0);
    stage.poll_runner(&mut runner);
    assert_eq!(stage.answers().len(), 2, "a process that is back answers, absent or not");
}

#[test]
fn what_the_rules_refuse_or_get_wrong_is_left_to_the_heuristic() {
    let mut stage = Stage::new();
    stage.still.open = 0b01;
    stage.send(1, 1, FrameHeader::REALLOC, 100);
    for (rules, reason) in
        [(Gives(Some(1)), AllocateError::Infeasible), (Gives(None), AllocateError::NonFinite)]
    {
        let mut alone = stage.allocator_role();
        alone.lead(1);
        let mut cursor = DirectCursor::default();
        let mut rules = rules;
        let refused = alone.poll(&mut stage.team.allocator(&mut cursor), &mut rules);
        assert_eq!(refused, Err(AllocatorError::Refused { tick: TERM + 1, reason }));
        let mut helped = stage.allocator_role();
        helped.lead(2);
        let mut cursor = DirectCursor::default();
        let mut link = stage.team.allocator(&mut cursor);
        helped.poll_with_heuristic(&mut link, &mut rules, &mut Gives(Some(0))).unwrap();
        let allocation = stage.allocation().unwrap();
        assert_eq!(allocation.flags, AllocMsg::FIRST_OF_TERM | AllocMsg::HEURISTIC);
        assert_eq!(allocation.task[..2], [0, 0]);
    }
}

#[test]
fn an_allocation_that_does_not_come_is_waited_for_once() {
    let mut stage = Stage::new();
    let mut role = stage.runner_role(1_000);
    stage.allocate(1, 1, 4);
    stage.send(5, 5, FrameHeader::REALLOC, 800);
    // 35 % of the period.
    assert_eq!(stage.poll_runner(&mut role), Poll::Wait { until_ns: 1_350 });
    stage.clock.0.set(1_350);
    assert_eq!(stage.poll_runner(&mut role), Poll::Answered);
    assert_eq!(orders(&stage.answers()), [(1, ActionMsg::STALE_ALLOC); 2]);
    stage.send(6, 5, 0, 800);
    assert_eq!(stage.poll_runner(&mut role), Poll::Answered);
    assert_eq!(orders(&stage.answers()), [(1, ActionMsg::STALE_ALLOC); 2]);
    stage.send(7, 7, FrameHeader::REALLOC, 800);
    assert_eq!(stage.poll_runner(&mut role), Poll::Wait { until_ns: 1_700 });
}

#[test]
fn pipelined_agents_wait_for_nothing_and_act_while_the_allocation_is_valid() {
    let mut stage = Stage::new();
    let mut role = stage.runner_role(0);
    stage.allocate(1, 1, 2);
    for (count, flags) in [(3, 0), (4, ActionMsg::STALE_ALLOC)] {
        stage.send(count, count, FrameHeader::PIPELINED_ALLOC, 1_000);
        assert_eq!(stage.poll_runner(&mut role), Poll::Answered);
        assert_eq!(orders(&stage.answers()), [(1, flags); 2], "tick {count}");
    }
    // Its subtask is finished, and kept.
    stage.allocate(5, 1, 2);
    stage.still.open = 0b01;
    stage.send(5, 5, FrameHeader::PIPELINED_ALLOC, 1_000);
    stage.poll_runner(&mut role);
    assert_eq!(orders(&stage.answers()), [(1, ActionMsg::STALE_ALLOC); 2]);
}

#[test]
fn without_an_allocation_agents_act_on_the_heuristic_or_safely() {
    let mut stage = Stage::new();
    let mut role = stage.runner_role(0);
    for (count, heuristic, task, action) in
        [(1, Gives(Some(1)), 1, 2), (2, Gives(None), UNASSIGNED, 1)]
    {
        let mut heuristic = heuristic;
        stage.send(count, count, FrameHeader::PIPELINED_ALLOC, 1_000);
        let mut link = stage.team.agent(&mut stage.runner);
        let mut policy = Two { remembers: false };
        role.poll_with_heuristic(&mut link, &mut policy, &mut heuristic).unwrap();
        let answers = stage.answers();
        assert_eq!(orders(&answers), [(task, ActionMsg::NO_ALLOC); 2]);
        let answer = answers[0];
        assert_eq!((answer.action, answer.alloc_term, answer.alloc_epoch), (action, 0, 0));
    }
    assert_eq!(role.counters().no_allocations, 2);
}

#[test]
fn memory_is_cleared_where_an_episode_begins() {
    let mut stage = Stage::new();
    let mut role = stage.runner_role(0);
    for (count, flags) in [(1, ActionMsg::STATE_RESET), (2, 0)] {
        stage.send(count, 0, FrameHeader::PIPELINED_ALLOC, 1_000);
        let mut link = stage.team.agent(&mut stage.runner);
        role.poll(&mut link, &mut Two { remembers: true }).unwrap();
        assert_eq!(stage.answers()[0].flags & ActionMsg::STATE_RESET, flags);
    }
}

#[test]
fn memory_that_another_model_emptied_is_announced_once() {
    let mut stage = Stage::new();
    let mut role = stage.runner_role(0);
    let mut flags = |count: u32, remembers: bool, is_another: bool| {
        if is_another {
            role.change_model([7; 16]);
        }
        stage.send(count, 0, FrameHeader::PIPELINED_ALLOC, 1_000);
        let mut link = stage.team.agent(&mut stage.runner);
        role.poll(&mut link, &mut Two { remembers }).unwrap();
        stage.answers()[0].flags & ActionMsg::STATE_RESET
    };
    flags(1, true, false);
    assert_eq!(flags(2, true, true), ActionMsg::STATE_RESET);
    assert_eq!(flags(3, true, false), 0);
    assert_eq!(flags(4, false, true), 0, "nothing to forget");
}

#[test]
fn a_runner_that_is_there_says_so_ten_times_a_second() {
    let mut stage = Stage::new();
    let mut role = stage.runner_role(0);
    stage.poll_runner(&mut role);
    role.join(&mut stage.team.agent(&mut stage.runner)).unwrap();
    stage.poll_runner(&mut role);
    stage.clock.0.set(100_001_000);
    stage.poll_runner(&mut role);
    let told: Vec<(u32, u64)> =
        stage.statuses().iter().map(|status| (status.flags, status.agents)).collect();
    assert_eq!(told, [(StatMsg::HELLO, 0b11), (0, 0b11)]);
}

/// Notes what a world reports.
#[derive(Default)]
struct Watch {
    ticks: Vec<(Vec<u16>, u64)>,
    missed: u32,
    degraded: bool,
}

impl WorldObserver for Watch {
    fn tick(&mut self, report: &TickReport<'_>) {
        self.ticks.push((report.actions.to_vec(), report.answered));
        (self.missed, self.degraded) = (report.allocations_missed, report.degraded);
    }
}

/// Lets a world and a runner act for a time.
fn act(
    stage: &mut Stage,
    world: &mut WorldRole,
    runner: Option<&mut RunnerRole>,
    until_ns: u64,
) -> Watch {
    let (mut watch, mut runner) = (Watch::default(), runner);
    loop {
        let mut next = match stage.poll_world(world, &mut watch).unwrap() {
            Poll::Wait { until_ns } => until_ns,
            Poll::Again | Poll::Answered => continue,
            Poll::Ended => return watch,
        };
        if let Some(role) = runner.as_deref_mut() {
            match stage.poll_runner(role) {
                Poll::Wait { until_ns } => next = next.min(until_ns),
                _ => continue,
            }
        }
        if next > until_ns {
            return watch;
        }
        stage.clock.0.set(next);
    }
}

#[test]
fn a_world_that_is_not_strict_goes_on_with_whoever_is_there() {
    let mut stage = Stage::new();
    let mut world = WorldRole::new(stage.world_options());
    // Nobody has come when its patience is over: it starts, and plays the safe action.
    let alone = act(&mut stage, &mut world, None, 4_000);
    assert!(alone.ticks.len() >= 2);
    assert!(alone.ticks.iter().all(|tick| *tick == (vec![1, 1], 0)), "{:?}", alone.ticks);
    let mut runner = stage.runner_role(1_000);
    runner.join(&mut stage.team.agent(&mut stage.runner)).unwrap();
    let joined = act(&mut stage, &mut world, Some(&mut runner), 9_500);
    assert_eq!(joined.ticks.last(), Some(&(vec![1, 1], 0b11)));
    // It falls silent: three more ticks are waited for, until 80 % of the period.
    let before = world.counters().ticks;
    act(&mut stage, &mut world, None, 13_400);
    assert_eq!((world.counters().ticks - before, world.joined()), (3, 0));
    // And is heard of again.
    stage.clock.0.set(stage.clock.0.get().max(100_010_000));
    let back = act(&mut stage, &mut world, Some(&mut runner), 100_030_000);
    assert_eq!(back.ticks.last(), Some(&(vec![1, 1], 0b11)));
    // No allocator was there for all that time.
    assert!(back.missed > 2 && back.degraded && world.is_degraded());
}

#[test]
fn an_answer_that_cannot_be_given_is_not_applied() {
    let mut stage = Stage::new();
    stage.still.present = 0b1110;
    stage.still.available = [0, 1, 0];
    let mut world = WorldRole::new(stage.world_options());
    let mut runner = stage.runner_role(1_000);
    runner.join(&mut stage.team.agent(&mut stage.runner)).unwrap();
    let mut watch = Watch::default();
    // No allocator comes; the first frame is published once the patience to join is over.
    while stage.answers().is_empty() {
        match stage.poll_world(&mut world, &mut watch).unwrap() {
            Poll::Wait { until_ns } => stage.clock.0.set(until_ns),
            _ => continue,
        }
        stage.poll_runner(&mut runner);
    }
    let tick = TERM + 1;
    let mut sent = |agent, action| {
        let good = ActionMsg { schema: 5, abi: 3, tick, agent, action, ..ActionMsg::new_zeroed() };
        stage.team.agent(&mut stage.runner).send_action(&good).unwrap();
    };
    sent(0, 1);
    sent(1, 2);
    let bad = world.counters().bad_messages;
    stage.poll_world(&mut world, &mut watch).unwrap();
    assert_eq!(world.counters().bad_messages - bad, 2);
    stage.clock.0.set(10_000);
    stage.poll_world(&mut world, &mut watch).unwrap();
    assert_eq!(watch.ticks, [(vec![NO_ACTION, 1], 0)]);
}

#[test]
fn an_answer_without_a_seat_is_not_applied() {
    for fills in [false, true] {
        let mut stage = Stage::new();
        let options = stage.world_options();
        let mut world = WorldRole::new(options);
        if fills {
            world.fill_free_seats();
        }
        let mut watch = Watch::default();
        // Nobody joins; the first frame is published once the patience to join is over.
        while world.tick() < TERM + 1 {
            if let Poll::Wait { until_ns } = stage.poll_world(&mut world, &mut watch).unwrap() {
                stage.clock.0.set(until_ns);
            }
        }
        let mut send = |agent, runner| {
            let tick = world.tick();
            let answer =
                ActionMsg { schema: 5, abi: 3, tick, agent, runner, ..ActionMsg::new_zeroed() };
            stage
                .team
                .agent(&mut stage.runner)
                .send_action(&ActionMsg { action: 2, ..answer })
                .unwrap();
        };
        let (own, stranger) = (options.identity.pid, options.identity.pid + 1);
        send(0, stranger);
        // The world's own process acts for free seats where it fills them, and for no others.
        send(1, own);
        let bad = world.counters().bad_messages;
        stage.poll_world(&mut world, &mut watch).unwrap();
        stage.clock.0.set(stage.clock.0.get() + 100_000);
        stage.poll_world(&mut world, &mut watch).unwrap();
        let (actions, answered) = if fills { (vec![1, 2], 0b10) } else { (vec![1, 1], 0) };
        assert_eq!(watch.ticks.first(), Some(&(actions, answered)), "fills: {fills}");
        assert_eq!(world.counters().bad_messages, bad);
    }
}

#[test]
fn a_strict_world_ends_without_its_team() {
    let mut stage = Stage::new();
    let options = WorldOptions { strict: true, ..stage.world_options() };
    let mut world = WorldRole::new(options);
    stage.poll_world(&mut world, &mut Watch::default()).unwrap();
    stage.clock.0.set(2_000);
    let ended = stage.poll_world(&mut world, &mut Watch::default());
    assert_eq!(ended, Err(WorldError::NotJoined { seats: 0b11, allocator: true }));
}
