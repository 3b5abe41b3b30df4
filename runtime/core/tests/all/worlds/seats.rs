//! Who acts for which agent, and who allocates.

use sortie_core::roles::{Poll, WorldError};
use sortie_core::wire::{ActionMsg, FrameView, Role, StatMsg};
use zerocopy::IntoBytes;

use super::stage::{ALLOCATOR, RUNNERS, START, Stage, TERM, WORLD, format, wait};

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
fn the_first_answer_of_an_agent_counts() {
    let mut stage = Stage::acting(|_| ());
    let second = |answer| ActionMsg { action: 1, ..answer };
    let (first, other) = (stage.answer(1), stage.answer(0));
    stage.table.actions.extend([first, second(first), second(other), other]);
    stage.poll().unwrap();
    assert_eq!(stage.watch.actions, [[1, 0]]);
}

#[test]
fn an_agent_that_does_not_exist_keeps_its_seat() {
    let mut stage = Stage::acting(|_| ());
    stage.rounds.present = 1;
    stage.tick(&[stage.answer(0), stage.answer(1)]);
    for _ in 0..5 {
        stage.tick(&[stage.answer(0)]);
    }
    assert_eq!(stage.role.joined(), 0b11);
}

#[test]
fn an_agent_keeps_its_seat_unless_it_is_silent_for_three_ticks_in_a_row() {
    let mut stage = Stage::acting(|_| ());
    for silent in [true, true, false, true, true, false, true, true] {
        let answers = [stage.answer(0), stage.answer(1)];
        stage.tick(if silent { &answers[..1] } else { &answers });
    }
    assert_eq!(stage.role.joined(), 0b11);
    stage.tick(&[stage.answer(0)]);
    assert_eq!(stage.role.joined(), 0b01);
}

#[test]
fn an_agent_is_absent_after_three_silent_ticks_until_its_place_is_taken() {
    let mut stage = Stage::acting(|options| options.decision_interval = u32::MAX);
    let goodbye = ActionMsg { flags: ActionMsg::BYE, ..stage.answer(1) };
    stage.table.actions.push(goodbye);
    for _ in 0..5 {
        stage.tick(&[stage.answer(0)]);
    }
    assert_eq!((stage.role.absent(), stage.role.joined()), (0b10, 0b01));
    assert_eq!([0, 1].map(|agent| stage.role.absent_since(agent)), [None, Some(TERM + 3)]);
    stage.tell(Role::Runner, 40, 0b10, StatMsg::HELLO);
    for agents in [1, 2, 2, 2] {
        let answers = [stage.answer(0), ActionMsg { runner: 40, ..stage.answer(1) }];
        stage.tick(&answers[..agents]);
    }
    assert_eq!(stage.watch.absent, [0, 0, 0, 0b10, 0b10, 0b10, 0, 0, 0]);
    // At the beginning, without the one that left, and once its place is taken.
    assert_eq!(stage.asked(), [1, 4, 7]);
}

/// Both say that they work on subtask 0, and agent 1 falls silent.
#[test]
fn what_an_absent_agent_worked_on_is_nobodys() {
    let mut stage = Stage::acting(|_| ());
    stage.tick(&[stage.answer(0), stage.answer(1)]);
    let shown: Vec<_> = (0..4)
        .map(|_| {
            stage.tick(&[stage.answer(0)]);
            let header = stage.table.frames.last().unwrap();
            let payload = stage.table.payload.as_slice().as_bytes();
            let frame = FrameView::new(header, payload, &format()).unwrap();
            (frame.absent(), frame.entity_task()[..2].to_vec())
        })
        .collect();
    let (there, gone) = ((0, vec![1, 1]), (0b10, vec![1, 0]));
    assert_eq!(shown, [there.clone(), there, gone.clone(), gone]);
}

#[test]
fn whoever_comes_back_before_three_silent_ticks_was_never_absent() {
    let mut stage = Stage::acting(|options| options.decision_interval = u32::MAX);
    for [pid, next] in [[RUNNERS[1], 40], [40, 41], [41, 42]] {
        let goodbye = ActionMsg { flags: ActionMsg::BYE, runner: pid, ..stage.answer(1) };
        stage.table.actions.push(goodbye);
        stage.tick(&[stage.answer(0)]);
        stage.tell(Role::Runner, next, 0b10, StatMsg::HELLO);
        stage.tick(&[stage.answer(0)]);
        stage.tick(&[stage.answer(0), ActionMsg { runner: next, ..stage.answer(1) }]);
    }
    assert_eq!((stage.role.absent(), &stage.watch.absent[..]), (0, &[0; 9][..]));
}

#[test]
fn an_agent_may_be_absent_from_the_beginning_and_is_not_waited_for() {
    let mut stage = Stage::new(|options| options.absent = 0b110);
    stage.poll().unwrap();
    stage.join(0b01, true);
    while stage.role.tick() == TERM {
        assert_eq!(stage.poll(), Ok(Poll::Again));
    }
    let frame = FrameView::new(
        stage.table.frames.last().unwrap(),
        stage.table.payload.as_slice().as_bytes(),
        &format(),
    );
    assert_eq!(frame.unwrap().absent(), 0b10, "there is no agent 2");
}

#[test]
fn a_world_that_fills_seats_has_nobody_absent() {
    let mut stage = Stage::new(|options| options.absent = 0b10);
    stage.role.fill_free_seats();
    stage.poll().unwrap();
    stage.join(0b01, true);
    while stage.poll() == Ok(Poll::Again) {}
    for _ in 0..8 {
        // A runner that is silent, and a filled seat whose answer is late.
        stage.tick(&[]);
    }
    assert_eq!((stage.role.filled(), stage.role.absent()), (0b11, 0));
    assert_eq!(stage.watch.absent, [0; 8]);
}

#[test]
fn processes_that_take_a_seat_from_another_are_counted() {
    let mut stage = Stage::acting(|options| options.absent_after = u32::MAX);
    let [first, second] = RUNNERS;
    for (pid, agents, flags, restarts) in [
        (first, 0b01, 0, 0),
        (second, 0b10, 0, 0),
        (40, 0b10, StatMsg::HELLO, 1),
        // The goodbye of the earlier one comes late.
        (second, 0b10, StatMsg::BYE, 1),
        (40, 0b10, StatMsg::BYE, 1),
        (41, 0b10, StatMsg::HELLO, 2),
    ] {
        stage.tell(Role::Runner, pid, agents, flags);
        stage.table.now_ns += 100_000_000;
        stage.tick(&[]);
        stage.poll().unwrap();
        assert_eq!(stage.role.counters().restarts_seen, restarts, "{pid}, {flags}");
    }
}

#[test]
fn a_new_process_asks_for_an_allocation_and_one_that_is_there_does_not() {
    let mut stage = Stage::acting(|_| ());
    for pid in [RUNNERS[1], RUNNERS[1], 40, 40, 40] {
        stage.tell(Role::Runner, pid, 0b10, 0);
        stage.tick(&[stage.answer(0), stage.answer(1)]);
    }
    assert_eq!(stage.asked(), [1, 4]);
}

#[test]
fn only_the_allocator_that_leads_is_waited_for_and_missed() {
    let mut stage = Stage::new(|options| options.strict = true);
    stage.poll().unwrap();
    stage.join(0b11, false);
    stage.tell(Role::Allocator, ALLOCATOR, 0, StatMsg::HELLO);
    assert_eq!(stage.poll(), wait(START + 500));
    let standby = ALLOCATOR + 1;
    for (pid, flags) in [(ALLOCATOR, StatMsg::LEADER), (standby, 0), (ALLOCATOR, StatMsg::LEADER)] {
        stage.tell(Role::Allocator, pid, 0, flags);
    }
    stage.tell(Role::Allocator, standby, 0, StatMsg::BYE);
    while stage.poll().unwrap() == Poll::Again {}
    stage.allocate(1);
    stage.table.actions.extend([stage.answer(0), stage.answer(1)]);
    assert_eq!(stage.poll(), Ok(Poll::Again));
    stage.tell(Role::Allocator, ALLOCATOR, 0, StatMsg::BYE | StatMsg::LEADER);
    assert_eq!(stage.poll(), Err(WorldError::AllocatorLeft));
}
