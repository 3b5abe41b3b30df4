//! Whom and what a world waits for.

use sortie_core::roles::{Poll, Timing, WorldError, WorldOptions};
use sortie_core::wire::{ActionMsg, FrameKind, Role, StatMsg};

use super::stage::{ALLOCATOR, PERIOD, START, Stage, wait};

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
    // The last frame is not answered yet.
    let timings = stage.watch.timings.iter();
    let delays: Vec<_> = timings.map(|timing| (timing.delay_ns, timing.skipped)).collect();
    assert_eq!(delays, [(0, 0), (100, 0), (100, 0), (1_000, 1), (100, 0)]);
    let counters = stage.role.counters();
    assert_eq!((counters.longest_delay_ns, counters.skipped_periods), (1_000, 1));
}

/// A world that is stopped while it waits, or while its team acts, for `stopped` of a period of a thousand.
fn stopped(acting: bool, stopped: u64, pace: fn(&mut WorldOptions)) -> Vec<Timing> {
    let mut stage = Stage::new(|options| {
        (options.required, options.allocator) = (0, false);
        (options.period_ns, options.tick_interval_ns) = (0, 0);
        pace(options);
    });
    stage.poll().unwrap();
    if acting {
        // Silent: the world waits for it.
        stage.join(0b01, false);
    }
    while stage.watch.timings.len() < 4 {
        let is_struck = stage.watch.timings.len() == 2;
        let is_acting = stage.role.tick() & 0xFFFF_FFFF == 3;
        if let Poll::Wait { until_ns } = stage.poll().unwrap() {
            let late = if is_struck && is_acting == acting { stopped } else { 0 };
            stage.table.now_ns = until_ns + late;
        }
    }
    stage.watch.timings
}

#[test]
fn a_world_that_was_stopped_says_for_how_long_and_which_periods_passed() {
    let on_time = Timing::default();
    let late = |delay_ns, skipped| Timing { delay_ns, skipped, overran: false };
    let overran = Timing { overran: true, ..on_time };
    let by_period: fn(&mut WorldOptions) = |options| options.period_ns = PERIOD;
    let by_interval: fn(&mut WorldOptions) = |options| options.tick_interval_ns = PERIOD;
    for pace in [by_period, by_interval] {
        let waiting = stopped(false, 5_400, pace);
        assert_eq!(waiting, [on_time, on_time, late(5_400, 5), on_time]);
    }
    // An agent does not answer: the world waits for 800 of the period.
    assert_eq!(stopped(true, 5_400, by_period), [on_time, on_time, overran, late(5_200, 5)]);
    assert_eq!(stopped(true, 5_400, |options| options.patience_ns = 10), [on_time; 4]);
}
