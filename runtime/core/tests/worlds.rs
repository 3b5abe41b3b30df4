//! What a world says, counts and waits for, case by case.

use sortie_core::link::{
    ActionRx, AllocRx, Bell, Clock, FrameBlock, FrameTx, LinkError, StatRx, StatTx, Wake,
};
use sortie_core::roles::{
    Identity, Poll, TickReport, WorldError, WorldObserver, WorldOptions, WorldRole,
};
use sortie_core::wire::{
    ActionMsg, AllocMsg, FrameFormat, FrameHeader, FrameKind, FrameLayout, FrameMut, Role, StatMsg,
};
use sortie_core::{EntityMask, Shape, StepOutcome, UnavailableAction, World};
use zerocopy::{FromZeros, IntoBytes};

const SHAPE: Shape = Shape { agents: 2, entities: 3, tasks: 1, actions: 2, features: 1 };
const SCHEMA: u64 = 5;
const TERM: u64 = 7 << 32;
const PERIOD: u64 = 1_000;
const START: u64 = 10_000;
const WORLD: u32 = 7;
const RUNNERS: [u32; 2] = [20, 21];
const ALLOCATOR: u32 = 30;

/// A world's end of the link: the tests write what it receives, and read what it sends.
struct Table {
    now_ns: u64,
    payload: Vec<FrameBlock>,
    frames: Vec<FrameHeader>,
    told: Vec<StatMsg>,
    rings: Vec<Role>,
    awaited_rings: u32,
    statuses: Vec<StatMsg>,
    actions: Vec<ActionMsg>,
    allocations: Vec<AllocMsg>,
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

/// Its episodes end after so many steps.
struct Rounds {
    steps: u32,
    length: u32,
}

impl World for Rounds {
    fn shape(&self) -> Shape {
        SHAPE
    }

    fn reset(&mut self) {
        self.steps = 0;
    }

    fn observe(&self, frame: &mut FrameMut<'_>) {
        frame.set_present(&EntityMask::first(SHAPE.entities));
        frame.set_open_tasks(1);
        (0..SHAPE.agents).for_each(|agent| frame.available_mut(agent).fill(1));
    }

    fn step(&mut self, _: &[u16]) -> Result<StepOutcome, UnavailableAction> {
        self.steps += 1;
        Ok(StepOutcome { episode_ended: self.steps == self.length, ..StepOutcome::default() })
    }
}

/// What the world reports.
#[derive(Default)]
struct Watch {
    actions: Vec<Vec<u16>>,
    answered: Vec<u64>,
    degraded: Vec<bool>,
    ended: Vec<(u32, u32)>,
}

impl WorldObserver for Watch {
    fn tick(&mut self, report: &TickReport<'_>) {
        self.actions.push(report.actions.to_vec());
        self.answered.push(report.answered);
        self.degraded.push(report.degraded);
    }

    fn episode_ended(&mut self, episode: u32, steps: u32) {
        self.ended.push((episode, steps));
    }
}

struct Stage {
    table: Table,
    role: WorldRole,
    rounds: Rounds,
    watch: Watch,
}

impl Stage {
    fn new(change: impl FnOnce(&mut WorldOptions)) -> Self {
        let layout = FrameLayout::new(SHAPE).unwrap();
        let mut options = WorldOptions {
            format: FrameFormat { schema: SCHEMA, layout },
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
            decision_interval: 4,
            safe_action: Some(0),
            episodes: None,
            tick_interval_ns: 0,
        };
        change(&mut options);
        let table = Table {
            now_ns: START,
            payload: vec![FrameBlock::zeroed(); layout.payload_bytes() / 64],
            frames: Vec::new(),
            told: Vec::new(),
            rings: Vec::new(),
            awaited_rings: 0,
            statuses: Vec::new(),
            actions: Vec::new(),
            allocations: Vec::new(),
        };
        let rounds = Rounds { steps: 0, length: u32::MAX };
        Self { table, role: WorldRole::new(options), rounds, watch: Watch::default() }
    }

    /// A world with its whole team, in its first tick.
    fn acting(change: impl FnOnce(&mut WorldOptions)) -> Self {
        let mut stage = Self::new(change);
        stage.poll().unwrap();
        stage.join(0b11, true);
        while stage.role.tick() == TERM {
            assert_eq!(stage.poll(), Ok(Poll::Again));
        }
        stage.table.rings.clear();
        stage
    }

    fn poll(&mut self) -> Result<Poll, WorldError> {
        self.role.poll(&mut self.table, &mut self.rounds, &mut self.watch)
    }

    /// Lets time pass until the world has nothing to wait for but others, or has done so many ticks.
    fn play(&mut self, ticks: usize) -> Poll {
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

    fn tell(&mut self, role: Role, pid: u32, agents: u64, flags: u32) {
        let (schema, role) = (SCHEMA, role as u8);
        let status = StatMsg { schema, abi: 1, role, pid, agents, flags, ..StatMsg::new_zeroed() };
        self.table.statuses.push(status);
    }

    /// Runners of these agents say that they are there, and an allocator that leads.
    fn join(&mut self, agents: u64, allocator: bool) {
        for agent in (0..SHAPE.agents).filter(|agent| agents >> agent & 1 == 1) {
            self.tell(Role::Runner, RUNNERS[agent], 1 << agent, StatMsg::HELLO);
        }
        if allocator {
            self.tell(Role::Allocator, ALLOCATOR, 0, StatMsg::LEADER);
        }
    }

    fn answer(&self, agent: u16) -> ActionMsg {
        let runner = RUNNERS[usize::from(agent)];
        let (tick, t_ns) = (self.role.tick(), self.table.now_ns);
        ActionMsg { schema: SCHEMA, abi: 1, tick, t_ns, agent, runner, ..ActionMsg::new_zeroed() }
    }

    fn allocate(&mut self, epoch: u32) {
        let tick = self.role.tick();
        let valid_until = tick + 4;
        let allocation = AllocMsg {
            schema: SCHEMA,
            abi: 1,
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

    /// Flags of the statuses sent since the last call.
    fn told(&mut self) -> Vec<u32> {
        self.table.told.drain(..).map(|status| status.flags).collect()
    }

    fn counts(&self) -> [u64; 3] {
        let counters = self.role.counters();
        [counters.schema_rejects, counters.bad_messages, counters.late]
    }
}

fn wait(until_ns: u64) -> Result<Poll, WorldError> {
    Ok(Poll::Wait { until_ns })
}

#[test]
fn a_world_says_that_it_is_there_while_it_waits() {
    let mut stage = Stage::new(|options| options.join_patience_ns = u64::MAX);
    stage.poll().unwrap();
    assert_eq!(stage.table.told[0].last_tick, TERM);
    assert_eq!(stage.told(), [StatMsg::HELLO | StatMsg::LEADER]);
    stage.poll().unwrap();
    stage.table.now_ns += 99_999_999;
    stage.poll().unwrap();
    assert_eq!(stage.told(), []);
    stage.table.now_ns += 1;
    stage.poll().unwrap();
    stage.poll().unwrap();
    assert_eq!(stage.told(), [StatMsg::LEADER]);
    // It is due again, but the team is not to wait for it.
    stage.table.now_ns += 100_000_000;
    stage.join(0b11, true);
    while stage.poll().unwrap() == Poll::Again {
        assert!(stage.table.told.is_empty());
    }
    assert_eq!((stage.role.tick(), stage.told()), (TERM + 1, vec![StatMsg::LEADER]));
    assert_eq!(stage.role.joined(), 0b11);
}

#[test]
fn the_first_episode_waits_for_every_required_seat_and_the_allocator() {
    let late = START + 500;
    let missing = |seats, allocator| Err(WorldError::NotJoined { seats, allocator });
    for (agents, allocator, strict, now_ns, want) in [
        (0b11, true, true, START, Ok(Poll::Again)),
        (0b11, true, true, late, Ok(Poll::Again)),
        (0b01, true, true, START, wait(late)),
        (0b11, false, true, START, wait(late)),
        (0b01, true, true, late, missing(0b10, false)),
        (0b11, false, true, late, missing(0, true)),
        (0b01, false, false, late - 1, wait(late)),
        (0b01, false, false, late, Ok(Poll::Again)),
    ] {
        let mut stage = Stage::new(|options| options.strict = strict);
        stage.poll().unwrap();
        stage.join(agents, allocator);
        stage.table.now_ns = now_ns;
        assert_eq!(stage.poll(), want, "{agents:#b}, {allocator}, {strict}, {now_ns}");
        // Runners are warmed up before the first tick.
        let warm = if want == Ok(Poll::Again) { 8 } else { 0 };
        let frames = stage.table.frames.iter();
        assert_eq!(frames.filter(|frame| frame.kind == FrameKind::WarmUp as u16).count(), warm);
        assert_eq!(stage.table.rings, vec![Role::Runner; warm]);
    }
}

#[test]
fn a_world_plays_as_many_episodes_as_it_is_asked_for_and_tells_everybody() {
    let mut stage = Stage::new(|options| {
        (options.required, options.allocator, options.episodes) = (0, false, Some(2));
    });
    stage.rounds.length = 2;
    assert_eq!(stage.play(usize::MAX), Poll::Ended);
    assert_eq!(stage.watch.ended, [(0, 2), (1, 2)]);
    let frames = stage.table.frames.iter().skip(8);
    let frames: Vec<_> =
        frames.map(|frame| (frame.tick - TERM, frame.episode, frame.flags)).collect();
    let (start, end) = (FrameHeader::EPISODE_START, FrameHeader::EPISODE_END);
    assert_eq!(
        frames,
        [
            (1, 0, start),
            (2, 0, 0),
            (3, 0, end),
            (4, 1, start),
            (5, 1, 0),
            (6, 1, end),
            (7, 1, FrameHeader::SHUTDOWN)
        ]
    );
    assert!(stage.table.rings.ends_with(&[Role::Allocator, Role::Runner]));
    assert_eq!(stage.table.told.last().unwrap().last_tick, TERM + 7);
    assert_eq!(stage.told().last(), Some(&(StatMsg::BYE | StatMsg::LEADER)));
}

#[test]
fn messages_that_nobody_should_send_are_counted() {
    let mut stage = Stage::acting(|_| ());
    let good = stage.answer(0);
    let foreign = ActionMsg { schema: 6, ..good };
    let nobody = ActionMsg { agent: 2, ..good };
    let early = ActionMsg { tick: good.tick + 1, ..good };
    let late = ActionMsg { tick: good.tick - 1, ..good };
    for [schema_rejects, bad_messages, lates] in [[2, 4, 2], [4, 8, 4]] {
        for message in [foreign, nobody, early, late] {
            stage.table.actions.extend([message; 2]);
        }
        stage.poll().unwrap();
        assert_eq!(stage.counts(), [schema_rejects, bad_messages, lates]);
    }
    stage.tell(Role::Runner, 40, 0b11, 0);
    stage.table.statuses[0].schema = 6;
    stage.table.statuses.push(stage.table.statuses[0]);
    // Statuses wait for the end of the tick.
    stage.table.now_ns += PERIOD;
    while stage.poll() == Ok(Poll::Again) {}
    assert_eq!(stage.counts()[0], 6);
}

#[test]
fn the_first_answer_of_an_agent_counts() {
    let mut stage = Stage::acting(|_| ());
    let second = |answer| ActionMsg { action: 1, ..answer };
    let (first, other) = (stage.answer(1), stage.answer(0));
    stage.table.actions.extend([first, second(first), second(other), other]);
    stage.poll().unwrap();
    assert_eq!(stage.watch.actions, [[1, 0]]);
}

#[test]
fn a_tick_waits_for_those_who_are_there_and_no_others() {
    let mut stage = Stage::new(|options| options.required = 0b01);
    stage.poll().unwrap();
    stage.join(0b01, true);
    while stage.poll() == Ok(Poll::Again) {}
    let answer = stage.answer(0);
    stage.allocate(1);
    stage.poll().unwrap();
    assert_eq!(stage.watch.answered, []);
    stage.table.actions.push(answer);
    assert_eq!(stage.poll(), Ok(Poll::Again));
    assert_eq!((&stage.watch.answered[..], stage.role.joined()), (&[0b01][..], 0b01));
    assert_eq!(stage.role.counters().fallbacks, 1);
}

#[test]
fn a_world_acts_for_seats_that_are_free_when_a_tick_begins() {
    let mut stage = Stage::new(|_| ());
    stage.role.fill_free_seats();
    stage.poll().unwrap();
    stage.join(0b01, true);
    while stage.poll() == Ok(Poll::Again) {}
    assert_eq!((stage.role.joined(), stage.role.filled()), (0b01, 0b10));
    assert_eq!(stage.table.awaited_rings, 1, "its own process acts on any ring");
    let (other, own) = (stage.answer(0), ActionMsg { runner: WORLD, ..stage.answer(1) });
    stage.table.actions.extend([other, own]);
    stage.poll().unwrap();
    assert_eq!(stage.watch.answered, [0b11]);
}

#[test]
fn a_world_sleeps_through_all_rings_but_the_last_two() {
    let mut stage = Stage::acting(|_| ());
    assert_eq!(stage.poll(), wait(START + 350));
    assert_eq!(stage.table.awaited_rings, 2, "two runners and the allocator");
    stage.allocate(1);
    assert_eq!((stage.poll(), stage.table.awaited_rings), (wait(START + 800), 1));
    stage.table.actions.push(stage.answer(1));
    assert_eq!((stage.poll(), stage.table.awaited_rings), (wait(START + 800), 0));
}

#[test]
fn runners_are_woken_by_the_allocator_or_when_its_time_is_over() {
    let mut stage = Stage::new(|_| ());
    stage.poll().unwrap();
    stage.join(0b11, true);
    stage.poll().unwrap();
    stage.table.rings.clear();
    while stage.poll() == Ok(Poll::Again) {}
    assert_eq!(stage.table.rings, [Role::Allocator]);
    stage.table.now_ns += 349;
    stage.poll().unwrap();
    assert_eq!(stage.table.rings, [Role::Allocator]);
    stage.table.now_ns += 1;
    assert_eq!(stage.poll(), wait(START + 800));
    stage.poll().unwrap();
    assert_eq!(stage.table.rings, [Role::Allocator, Role::Runner]);
    // The next tick asks for no allocation.
    stage.table.rings.clear();
    stage.table.now_ns = START + PERIOD;
    while stage.poll() == Ok(Poll::Again) {}
    assert_eq!(stage.table.rings, [Role::Runner]);
}

#[test]
fn a_strict_world_names_who_is_missing() {
    let strict = || Stage::acting(|options| options.strict = true);
    let mut stage = strict();
    stage.table.now_ns += 350;
    assert_eq!(stage.poll(), Err(WorldError::AllocatorMissed { step: 0 }));

    let mut stage = strict();
    stage.allocate(1);
    stage.table.actions.push(stage.answer(0));
    stage.table.now_ns += 799;
    assert_eq!(stage.poll(), wait(START + 800));
    stage.table.now_ns += 1;
    assert_eq!(stage.poll(), Err(WorldError::SeatsMissed { step: 0, seats: 0b10 }));

    let mut stage = strict();
    stage.table.actions.push(ActionMsg { flags: ActionMsg::BYE, ..stage.answer(1) });
    assert_eq!(stage.poll(), Err(WorldError::SeatsLeft { seats: 0b10 }));

    let mut stage = strict();
    stage.allocate(1);
    stage.table.actions.extend([stage.answer(0), stage.answer(1)]);
    assert_eq!(stage.poll(), Ok(Poll::Again));
    stage.tell(Role::Allocator, ALLOCATOR, 0, StatMsg::BYE);
    assert_eq!(stage.poll(), Err(WorldError::AllocatorLeft));
}

#[test]
fn a_world_is_degraded_after_two_intervals_without_an_allocation() {
    let mut stage = Stage::acting(|options| options.absent_after = u32::MAX);
    for tick in 1..=12 {
        let answer = |agent| ActionMsg { flags: ActionMsg::NO_ALLOC, ..stage.answer(agent) };
        let answers = [answer(0), answer(1)];
        stage.table.actions.extend(answers);
        assert_eq!(stage.poll(), Ok(Poll::Again));
        // Two intervals of four ticks after the first.
        assert_eq!((stage.watch.degraded.len(), stage.role.is_degraded()), (tick, tick > 9));
        stage.told();
        stage.table.now_ns += 100_000_000;
        while stage.poll() == Ok(Poll::Again) {}
        let degraded = if tick > 8 { StatMsg::DEGRADED } else { 0 };
        assert_eq!(stage.told(), [StatMsg::LEADER | degraded], "tick {tick}");
    }
    let degraded: Vec<bool> = (1..=12).map(|tick| tick > 9).collect();
    assert_eq!(stage.watch.degraded, degraded);
}

#[test]
fn the_time_from_the_last_answer_to_the_world_is_noted() {
    let mut stage = Stage::acting(|_| ());
    let at = |t_ns, answer: ActionMsg| ActionMsg { t_ns, ..answer };
    let answers = [at(START + 300, stage.answer(0)), at(START + 100, stage.answer(1))];
    stage.table.actions.extend(answers);
    stage.table.now_ns += 300 + 4 * 16;
    assert_eq!(stage.poll(), Ok(Poll::Again));
    stage.told();
    stage.role.shut_down(&mut stage.table, &stage.rounds).unwrap();
    let told = stage.table.told[0];
    assert_eq!((told.hist_wake[2], told.hist_wake.iter().sum::<u32>()), (1, 1));
    assert_eq!(told.hist_work.iter().sum::<u32>(), 1);
}

#[test]
fn frames_keep_to_the_period_of_a_world_that_wakes_late() {
    let mut stage = Stage::new(|options| {
        (options.required, options.allocator) = (0, false);
    });
    let mut published = Vec::new();
    while published.len() < 6 {
        let before = stage.role.tick();
        if let Poll::Wait { until_ns } = stage.poll().unwrap() {
            // The third wake-up is a whole period late.
            let late = if published.len() == 3 { PERIOD } else { 100 };
            stage.table.now_ns = until_ns + late;
        }
        if stage.role.tick() > before {
            published.push(stage.table.now_ns - START);
        }
    }
    assert_eq!(published, [0, 1_100, 2_100, 4_000, 5_100, 6_100]);
}
