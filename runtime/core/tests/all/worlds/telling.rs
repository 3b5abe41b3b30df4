//! What a world says, counts and reports.

use sortie_core::UNASSIGNED;
use sortie_core::roles::Poll;
use sortie_core::wire::{ActionMsg, FrameHeader, Role, StatMsg, SwapMoment};

use super::stage::{PERIOD, START, Stage, TERM};

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
fn answers_with_an_action_or_a_subtask_that_does_not_exist_are_counted() {
    for strict in [false, true] {
        let mut stage = Stage::acting(|options| options.strict = strict);
        let (first, second) = (stage.answer(0), stage.answer(1));
        stage.table.actions.push(ActionMsg { action: 2, ..first });
        stage.table.actions.push(ActionMsg { task: 1, ..first });
        stage.poll().unwrap();
        assert_eq!(stage.counts(), [0, 2, 0], "strict: {strict}");
        stage.table.actions.extend([first, ActionMsg { task: UNASSIGNED, ..second }]);
        stage.poll().unwrap();
        assert_eq!(stage.watch.answered, [0b11], "strict: {strict}");
    }
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
fn one_agent_without_an_allocation_is_enough_for_a_degraded_world() {
    for agent in [0, 1] {
        let mut stage = Stage::acting(|options| options.absent_after = u32::MAX);
        for _ in 0..10 {
            let without = ActionMsg { flags: ActionMsg::NO_ALLOC, ..stage.answer(agent) };
            stage.tick(&[without, stage.answer(1 - agent)]);
        }
        assert!(stage.role.is_degraded(), "agent {agent}");
        // What it answered earlier does not count.
        stage.tick(&[stage.answer(1 - agent)]);
        assert!(!stage.role.is_degraded(), "agent {agent}");
    }
}

#[test]
fn the_allocation_of_a_tick_is_reported_with_that_tick() {
    let mut stage = Stage::acting(|_| ());
    stage.allocate(1);
    for _ in 0..2 {
        stage.tick(&[stage.answer(0), stage.answer(1)]);
    }
    stage.allocate(2);
    stage.tick(&[stage.answer(0), stage.answer(1)]);
    assert_eq!(stage.watch.allocated, [Some(TERM + 1), None, Some(TERM + 3)]);
}

#[test]
fn subtasks_that_change_are_allocated_anew() {
    let mut stage = Stage::acting(|_| ());
    stage.rounds.tasks_change_at = 2;
    for _ in 0..7 {
        stage.tick(&[stage.answer(0), stage.answer(1)]);
    }
    // Otherwise once in four ticks.
    assert_eq!(stage.asked(), [1, 3, 7]);
}

#[test]
fn the_time_from_the_last_answer_to_the_world_is_noted() {
    for [first, second] in [[300, 100], [100, 300]] {
        let mut stage = Stage::acting(|_| ());
        let at = |t_ns, answer: ActionMsg| ActionMsg { t_ns: START + t_ns, ..answer };
        let answers = [at(first, stage.answer(0)), at(second, stage.answer(1))];
        stage.table.actions.extend(answers);
        stage.table.now_ns += 300 + 4 * 16;
        assert_eq!(stage.poll(), Ok(Poll::Again));
        stage.told();
        stage.role.shut_down(&mut stage.table, &stage.rounds).unwrap();
        let told = stage.table.told[0];
        assert_eq!((told.hist_wake[2], told.hist_wake.iter().sum::<u32>()), (1, 1));
        assert_eq!(told.hist_work.iter().sum::<u32>(), 1);
    }
}

#[test]
fn another_bundle_is_asked_for_from_one_tick_on_which_asks_for_an_allocation_as_well() {
    let mut stage = Stage::new(|options| (options.required, options.episodes) = (0, Some(3)));
    stage.rounds.length = 3;
    stage.role.begin_with_generation(6);
    stage.play(2);
    stage.role.change_generation(7, SwapMoment::NextTick);
    stage.play(3);
    assert_eq!(stage.role.generation(), 7);
    stage.role.change_generation(8, SwapMoment::NextEpisode);
    stage.play(usize::MAX);
    let asks = |frame: &FrameHeader| frame.asks_for_actions();
    let frames = stage.table.frames.iter().filter(|frame| asks(frame));
    let frames: Vec<_> = frames
        .map(|frame| (frame.episode, frame.generation, frame.has(FrameHeader::REALLOC)))
        .collect();
    let generations: Vec<u16> = frames.iter().map(|(_, generation, _)| *generation).collect();
    assert_eq!(generations[0], 6);
    assert!(generations.is_sorted() && generations.last() == Some(&8), "{frames:?}");
    for (before, after) in frames.iter().zip(frames.iter().skip(1)) {
        if before.1 != after.1 {
            assert!(after.2, "{frames:?}");
        }
        if after.1 == 8 {
            assert!(before.1 == 8 || before.0 != after.0, "{frames:?}");
        }
    }
    assert!(frames.iter().any(|(episode, generation, _)| (*episode, *generation) == (0, 6)));
}
