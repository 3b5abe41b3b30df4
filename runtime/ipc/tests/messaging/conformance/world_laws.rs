//! What a world does with what its link brings. No law waits: a deadline that has to pass is one
//! nanosecond after its frame.

use std::borrow::BorrowMut;

use sortie_core::link::ActionTx;
use sortie_core::roles::{
    AllocatorOptions, AllocatorRole, Identity, Poll, TickReport, WorldError, WorldObserver,
    WorldOptions, WorldRole,
};
use sortie_core::wire::{ActionMsg, AllocMsg, FrameFormat};
use sortie_core::{AllocateError, AllocationState, Allocator, NO_ACTION, UNASSIGNED, World};

use super::Transport;
use super::stage::*;
use crate::toy::{SHAPE, ToyAllocator, ToyWorld};

pub(super) fn foreign_messages_are_dropped<T: Transport>() {
    let mut team = T::new();
    let (mut role, mut probe) = (runner(&mut team, 0, 0b1, true), Probe::default());
    let mut world = joined_world(&mut team, options(0, LONG));
    let mut other_schema = frame(9);
    other_schema.header.schema = 1;
    other_schema.send(&mut team);
    let mut other_abi = frame(9);
    other_abi.header.abi = 1;
    other_abi.send(&mut team);
    let foreign = AllocMsg { schema: 1, ..allocation(&team, 1, 1, 1) };
    allocate(&mut team, 0, foreign);
    assert_eq!(poll(&mut team, 0, &mut role, &mut probe), idle());
    // A link may let a newer message overtake, but never one that nobody took.
    assert!((2..=3).contains(&role.counters().schema_rejects), "{:?}", role.counters());
    let good = answer(&team, 0, 1);
    for foreign in [ActionMsg { schema: 1, ..good }, ActionMsg { abi: 1, ..good }] {
        team.agent(0).borrow_mut().send_action(&foreign).unwrap();
    }
    step(&mut team, &mut world);
    // The allocation reaches the world as well.
    assert_eq!(world.counters().schema_rejects, 3);
}

/// Notes what a world reports.
#[derive(Default)]
struct Watch {
    ticks: Vec<(u32, Vec<u16>, u64)>,
}

impl WorldObserver for Watch {
    fn tick(&mut self, report: &TickReport<'_>) {
        self.ticks.push((report.step, report.actions.to_vec(), report.answered));
    }
}

fn idle() -> Poll {
    Poll::Wait { until_ns: u64::MAX }
}

fn options(required: u64, patience_ns: u64) -> impl Fn(FrameFormat) -> WorldOptions {
    move |format| WorldOptions {
        identity: Identity::new(1, "world"),
        format,
        term: 7,
        required,
        allocator: false,
        strict: true,
        pipelined: false,
        period_ns: 0,
        absent_after: 3,
        absent: 0,
        join_patience_ns: LONG,
        patience_ns,
        decision_interval: 4,
        safe_action: Some(1),
        episodes: Some(1),
        tick_interval_ns: 0,
    }
}

/// A world that awaits the actions of its first tick, with runners 0 to 2 in their seats.
fn joined_world<T: Transport>(
    team: &mut T,
    options: impl Fn(FrameFormat) -> WorldOptions,
) -> WorldRole {
    let mut world = WorldRole::new(options(team.format()));
    drop(team.world());
    for agent in 0..SHAPE.agents {
        let mut seat = runner(team, agent, 1 << agent, false);
        seat.join(team.agent(agent).borrow_mut()).unwrap();
    }
    while world.counters().ticks == 0 && poll_world(team, &mut world) == Ok(Poll::Again) {}
    assert_eq!(world.joined(), ALL);
    world
}

fn poll_world<T: Transport>(team: &mut T, world: &mut WorldRole) -> Result<Poll, WorldError> {
    world.poll(team.world().borrow_mut(), &mut toy_world(), &mut ())
}

fn step<T: Transport>(team: &mut T, world: &mut WorldRole) -> Watch {
    let mut watch = Watch::default();
    world.poll(team.world().borrow_mut(), &mut toy_world(), &mut watch).unwrap();
    watch
}

/// The toy world in its first step.
fn toy_world() -> ToyWorld {
    let mut world = ToyWorld::new();
    world.reset();
    world
}

/// Agent `agent`'s answer to the world's first tick.
fn answer<T: Transport>(team: &T, agent: u16, action: u16) -> ActionMsg {
    ActionMsg {
        schema: team.format().schema,
        seq: 0,
        tick: TERM + 1,
        t_ns: 0,
        model: 0,
        alloc_epoch: 0,
        agent,
        action,
        flags: 0,
        task: UNASSIGNED,
        abi: 3,
        q: 0.0,
        decide_ns: 0,
        alloc_term: 0,
        runner: 100 + u32::from(agent),
    }
}

fn send<T: Transport>(team: &mut T, action: ActionMsg) {
    team.agent(usize::from(action.agent.min(2))).borrow_mut().send_action(&action).unwrap();
}

pub(super) fn the_world_waits_for_its_seats_and_names_who_is_missing<T: Transport>() {
    let mut team = T::new();
    let patient = options(ALL, LONG)(team.format());
    let hasty = WorldOptions { allocator: true, join_patience_ns: 0, ..patient };
    for (options, seats, allocator) in [(patient, 0, false), (hasty, 0b101, true)] {
        let mut world = WorldRole::new(options);
        assert_eq!(poll_world(&mut team, &mut world), Ok(Poll::Again));
        let mut seat = runner(&mut team, 1, 0b10, false);
        seat.join(team.agent(1).borrow_mut()).unwrap();
        match poll_world(&mut team, &mut world) {
            Ok(waits) => assert!(matches!(waits, Poll::Wait { .. }) && seats == 0),
            Err(error) => assert_eq!(error, WorldError::NotJoined { seats, allocator }),
        }
        assert_eq!(world.joined(), 0b10);
    }
}

pub(super) fn a_seat_that_does_not_act_is_named<T: Transport>() {
    let mut team = T::new();
    let mut world = joined_world(&mut team, options(ALL, OVER));
    let acted = answer(&team, 1, 1);
    send(&mut team, acted);
    let missed = Err(WorldError::SeatsMissed { step: 0, seats: 0b101 });
    assert_eq!(poll_world(&mut team, &mut world), missed);
}

pub(super) fn an_allocator_that_does_not_allocate_is_named<T: Transport>() {
    let mut team = T::new();
    let mut asks = options(ALL, OVER)(team.format());
    asks.allocator = true;
    let mut allocator = AllocatorRole::new(AllocatorOptions {
        format: asks.format,
        identity: Identity::new(200, "allocator"),
        decision_interval: 4,
    });
    drop(team.world());
    allocator.lead(1);
    allocator.join(team.allocator(0).borrow_mut()).unwrap();
    let mut world = joined_world(&mut team, |_| asks);
    for agent in 0..3 {
        let acted = answer(&team, agent, 1);
        if agent > 0 {
            send(&mut team, acted);
        }
    }
    let missed = Err(WorldError::AllocatorMissed { step: 0 });
    assert_eq!(poll_world(&mut team, &mut world), missed);
    // In time, it is the seat that is missed.
    allocator.poll(team.allocator(0).borrow_mut(), &mut ToyAllocator).unwrap();
    let missed = Err(WorldError::SeatsMissed { step: 0, seats: 0b1 });
    assert_eq!(poll_world(&mut team, &mut world), missed);
}

pub(super) fn a_goodbye_frees_the_seat<T: Transport>() {
    let mut team = T::new();
    let mut world = joined_world(&mut team, options(0b011, LONG));
    let mut leaver = runner(&mut team, 2, 0b100, false);
    leaver.leave(team.agent(2).borrow_mut()).unwrap();
    assert!(matches!(poll_world(&mut team, &mut world), Ok(Poll::Wait { .. })));
    assert_eq!(world.joined(), 0b011);
    let mut leaver = runner(&mut team, 1, 0b010, false);
    leaver.leave(team.agent(1).borrow_mut()).unwrap();
    let left = Err(WorldError::SeatsLeft { seats: 0b010 });
    assert_eq!(poll_world(&mut team, &mut world), left);
}

pub(super) fn the_goodbye_of_an_earlier_holder_frees_nothing<T: Transport>() {
    let mut team = T::new();
    let mut world = joined_world(&mut team, options(ALL, LONG));
    let goodbye = ActionMsg { flags: ActionMsg::BYE, runner: 99, ..answer(&team, 0, NO_ACTION) };
    send(&mut team, goodbye);
    assert!(matches!(poll_world(&mut team, &mut world), Ok(Poll::Wait { .. })));
    assert_eq!(world.joined(), ALL);
}

pub(super) fn nobody_acts_for_a_free_seat_but_the_fallback<T: Transport>() {
    let mut team = T::new();
    let mut world = joined_world(&mut team, options(0, LONG));
    let mut leaver = runner(&mut team, 2, 0b100, false);
    leaver.leave(team.agent(2).borrow_mut()).unwrap();
    for agent in 0..2 {
        let acted = answer(&team, agent, 1);
        send(&mut team, acted);
    }
    // Nothing to repeat: the safe action, 1.
    assert_eq!(step(&mut team, &mut world).ticks, [(0, vec![1, 1, 1], 0b011)]);
    assert_eq!(world.counters().fallbacks, 1);
}

/// Gives everybody the first subtask.
struct First;

impl Allocator for First {
    fn allocate(&mut self, _: &AllocationState<'_>, tasks: &mut [u8]) -> Result<(), AllocateError> {
        tasks.fill(0);
        Ok(())
    }
}

/// Notes the subtasks of allocations.
#[derive(Default)]
struct Allocations(Vec<Vec<u8>>);

impl WorldObserver for Allocations {
    fn allocated(&mut self, allocation: &AllocMsg) {
        self.0.push(allocation.task[..SHAPE.agents].to_vec());
    }
}

pub(super) fn a_silent_agent_is_left_out_of_allocations_until_it_acts_again<T: Transport>() {
    let mut team = T::new();
    let mut allocator = AllocatorRole::new(AllocatorOptions {
        format: team.format(),
        identity: Identity::new(200, "allocator"),
        decision_interval: 100,
    });
    drop(team.world());
    allocator.lead(1);
    allocator.join(team.allocator(0).borrow_mut()).unwrap();
    let mut world = joined_world(&mut team, |format| WorldOptions {
        allocator: true,
        strict: false,
        decision_interval: 100,
        ..options(0, OVER)(format)
    });
    let mut seen = Allocations::default();
    // Agent 2 is silent for five ticks, takes its seat again, and acts.
    for acting in [2, 2, 2, 2, 2, 3, 3, 3] {
        allocator.poll(team.allocator(0).borrow_mut(), &mut First).unwrap();
        let tick = world.tick();
        for agent in 0..acting {
            let answer = ActionMsg { tick, ..answer(&team, agent, 1) };
            send(&mut team, answer);
        }
        if acting == 3 && world.joined() != ALL {
            let mut back = runner(&mut team, 2, 0b100, false);
            back.join(team.agent(2).borrow_mut()).unwrap();
        }
        while world.tick() == tick {
            world.poll(team.world().borrow_mut(), &mut toy_world(), &mut seen).unwrap();
        }
    }
    let (all, two) = (vec![0; 3], vec![0, 0, UNASSIGNED]);
    // At first, without agent 2, as its seat is taken, and as it acts.
    assert_eq!(seen.0, [all.clone(), two.clone(), two, all]);
}

pub(super) fn late_and_impossible_actions_are_counted_not_applied<T: Transport>() {
    let mut team = T::new();
    let mut world = joined_world(&mut team, options(ALL, LONG));
    let good = answer(&team, 0, 1);
    for bad in [
        ActionMsg { tick: TERM, ..good },
        ActionMsg { tick: TERM + 2, ..good },
        ActionMsg { action: SHAPE.actions as u16, ..good },
        ActionMsg { task: SHAPE.tasks as u8, ..good },
        ActionMsg { agent: SHAPE.agents as u16, ..good },
    ] {
        send(&mut team, bad);
        assert!(matches!(poll_world(&mut team, &mut world), Ok(Poll::Wait { .. })));
    }
    assert_eq!((world.counters().late, world.counters().bad_messages), (1, 4));
    for agent in 0..3 {
        let acted = answer(&team, agent, 1);
        send(&mut team, acted);
        // A second answer changes nothing.
        send(&mut team, ActionMsg { action: NO_ACTION, ..acted });
    }
    assert_eq!(step(&mut team, &mut world).ticks, [(0, vec![1, 1, 1], ALL)]);
}

pub(super) fn shutting_down_ends_everyone<T: Transport>() {
    let mut team = T::new();
    let (mut role, mut probe) = (runner(&mut team, 0, ALL, true), Probe::default());
    let mut allocator = AllocatorRole::new(AllocatorOptions {
        format: team.format(),
        identity: Identity::new(200, "allocator"),
        decision_interval: 4,
    });
    drop(team.allocator(0));
    let mut world = WorldRole::new(options(ALL, LONG)(team.format()));
    world.shut_down(team.world().borrow_mut(), &toy_world()).unwrap();
    assert_eq!(poll_world(&mut team, &mut world), Ok(Poll::Ended));
    assert_eq!(poll(&mut team, 0, &mut role, &mut probe), Poll::Ended);
    let ended = allocator.poll(team.allocator(0).borrow_mut(), &mut ToyAllocator).unwrap();
    assert_eq!(ended, Poll::Ended);
}
