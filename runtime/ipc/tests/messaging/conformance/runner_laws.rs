//! What a runner does with what its link brings. No law waits: a deadline that has to pass is one
//! nanosecond after its frame.

use std::borrow::BorrowMut;

use sortie_core::link::{AllocRx, Clock};
use sortie_core::roles::Poll;
use sortie_core::wire::{ActionMsg, AllocMsg, FrameHeader, FrameKind};
use sortie_core::{DecideError, UNASSIGNED};

use super::Transport;
use super::stage::*;
use crate::toy::SHAPE;

pub(super) fn the_newest_frame_wins_and_gaps_are_counted<T: Transport>() {
    let mut team = T::new();
    let (mut role, mut probe) = (runner(&mut team, 0, 0b1, false), Probe::default());
    let first = answers(&mut team, &mut role, &mut probe, frame(1));
    assert_eq!((first.len(), first[0].tick, first[0].flags), (1, TERM + 1, 0));
    (2..6).for_each(|count| frame(count).send(&mut team));
    let newest = answers(&mut team, &mut role, &mut probe, frame(6));
    assert_eq!((newest.len(), newest[0].tick), (1, TERM + 6));
    assert_eq!(newest[0].flags, ActionMsg::TICK_GAP);
    assert_eq!(role.counters().frame_gaps, 4);
    let next = answers(&mut team, &mut role, &mut probe, frame(7));
    assert_eq!(next[0].flags, 0);
    // Another episode begins elsewhere: what lay between is not missed.
    let mut restart = frame(20);
    restart.header.episode = 1;
    let other = answers(&mut team, &mut role, &mut probe, restart);
    assert_eq!((other[0].flags, role.counters().frame_gaps), (0, 4));
}

pub(super) fn a_late_joiner_gets_the_allocation<T: Transport>() {
    let mut team = T::new();
    let sent = allocation(&team, 1, 1, 1);
    allocate(&mut team, 0, sent);
    drop(team.agent(2));
    team.housekeep();
    let mut got = Vec::new();
    team.agent(2).borrow_mut().receive_allocations(&mut |one| got.push(*one)).unwrap();
    // Where there is no common clock, it is told when it came.
    got.iter_mut().for_each(|one| one.t_ns = sent.t_ns);
    assert_eq!(got, [sent]);
}

pub(super) fn frames_of_an_earlier_world_are_dropped<T: Transport>() {
    let mut team = T::new();
    let (mut role, mut probe) = (runner(&mut team, 0, 0b1, false), Probe::default());
    assert_eq!(answers(&mut team, &mut role, &mut probe, frame(1)).len(), 1);
    let mut restarted = frame(1);
    restarted.tick += 1 << 32;
    assert_eq!(answers(&mut team, &mut role, &mut probe, restarted).len(), 1);
    assert_eq!(answers(&mut team, &mut role, &mut probe, frame(2)).len(), 0);
    assert_eq!(role.counters().old_term_rejects, 1);
}

pub(super) fn allocations_are_ordered_by_term_and_epoch<T: Transport>() {
    let mut team = T::new();
    let (mut role, mut probe) = (runner(&mut team, 0, 0b101, true), Probe::default());
    let orders = [(1, 5), (2, 1), (1, 6), (2, 1), (2, 2)];
    let kept = [(1, 5), (2, 1), (2, 1), (2, 1), (2, 2)];
    for (count, (order, kept)) in (1..).zip(orders.into_iter().zip(kept)) {
        let sent = allocation(&team, 1, order.0, order.1);
        allocate(&mut team, order.0 as usize - 1, sent);
        let got = answers(&mut team, &mut role, &mut probe, frame(count));
        assert_eq!((got[0].alloc_term, got[0].alloc_epoch), kept);
    }
    assert_eq!(role.counters().old_term_rejects, 2);
}

pub(super) fn an_allocation_of_another_shape_is_dropped<T: Transport>() {
    let mut team = T::new();
    let (mut role, mut probe) = (runner(&mut team, 0, 0b1, true), Probe::default());
    let mut beyond = allocation(&team, 1, 1, 1);
    beyond.task[0] = SHAPE.tasks as u8;
    allocate(&mut team, 0, beyond);
    poll(&mut team, 0, &mut role, &mut probe);
    let other = AllocMsg { n_agents: 4, ..allocation(&team, 1, 1, 2) };
    allocate(&mut team, 0, other);
    let late = Sent { patience: OVER, ..frame(1) };
    let got = answers(&mut team, &mut role, &mut probe, late);
    assert_eq!((tasks(&got), role.counters().bad_messages), (vec![UNASSIGNED], 2));
}

pub(super) fn a_fresh_allocation_is_acted_on<T: Transport>() {
    let mut team = T::new();
    let (mut role, mut probe) = (runner(&mut team, 0, ALL, true), Probe::default());
    let sent = allocation(&team, 1, 1, 1);
    allocate(&mut team, 0, sent);
    let asking = Sent { decision_tick: TERM + 1, ..frame(1) };
    let got = answers(&mut team, &mut role, &mut probe, asking);
    assert_eq!(tasks(&got), [1, UNASSIGNED, 0]);
    // Agent 1 is unassigned on purpose: the safe action, without a decision.
    let actions: Vec<u16> = got.iter().map(|answer| answer.action).collect();
    assert_eq!(actions, [2, 3, 2]);
    assert!(got.iter().all(|answer| answer.flags == 0));
    // Agent 0 sees itself and the entities of subtask 1, agent 2 itself and those of subtask 0.
    assert_eq!(probe.shown, [(0, vec![0, 3, 5]), (2, vec![2, 4])]);
}

pub(super) fn a_stale_allocation_is_kept_for_its_grace<T: Transport>() {
    let mut team = T::new();
    let (mut role, mut probe) = (runner(&mut team, 0, 0b1, true), Probe::default());
    let sent = allocation(&team, 1, 1, 1);
    allocate(&mut team, 0, sent);
    // Valid until tick 5, and twice the decision interval of 4 more.
    for (count, task, flags) in [
        (6, 1, ActionMsg::STALE_ALLOC),
        (13, 1, ActionMsg::STALE_ALLOC),
        (14, UNASSIGNED, ActionMsg::NO_ALLOC),
    ] {
        let unanswered = Sent { decision_tick: TERM + 5, patience: OVER, ..frame(count) };
        let got = answers(&mut team, &mut role, &mut probe, unanswered);
        let late = ActionMsg::LATE | ActionMsg::TICK_GAP;
        assert_eq!((tasks(&got), got[0].flags & !late), (vec![task], flags), "tick {count}");
    }
    assert_eq!(role.counters().stale_allocations, 2);
    assert_eq!(role.counters().no_allocations, 1);
}

pub(super) fn an_allocation_of_an_earlier_episode_counts_as_none<T: Transport>() {
    let mut team = T::new();
    let (mut role, mut probe) = (runner(&mut team, 0, 0b1, true), Probe::default());
    let sent = allocation(&team, 1, 1, 1);
    allocate(&mut team, 0, sent);
    let start = Sent { step: 0, decision_tick: TERM + 2, patience: OVER, ..frame(2) };
    let got = answers(&mut team, &mut role, &mut probe, start);
    assert_eq!((tasks(&got), got[0].action), (vec![UNASSIGNED], 3));
    assert!(got[0].has(ActionMsg::NO_ALLOC));
    assert_eq!(probe.shown, []);
}

pub(super) fn agents_wait_for_the_allocation_until_its_deadline<T: Transport>() {
    let mut team = T::new();
    let (mut role, mut probe) = (runner(&mut team, 0, 0b1, true), Probe::default());
    let asking = Sent { decision_tick: TERM + 1, ..frame(1) };
    asking.send(&mut team);
    let Poll::Wait { until_ns } = poll(&mut team, 0, &mut role, &mut probe) else {
        panic!("acted without its allocation")
    };
    let now = team.world().borrow_mut().now_ns();
    assert!(until_ns < now + LONG / 2 && until_ns > now + LONG / 4);
    assert_eq!(received(&mut team), []);
    let sent = allocation(&team, 1, 1, 1);
    allocate(&mut team, 0, sent);
    assert_eq!(poll(&mut team, 0, &mut role, &mut probe), Poll::Answered);
    assert_eq!(tasks(&received(&mut team)), [1]);
}

pub(super) fn a_policy_that_refuses_falls_back<T: Transport>() {
    let mut team = T::new();
    let mut role = runner(&mut team, 0, 0b1, false);
    let beyond = DecideError::BeyondGuards { entity: 0, feature: 0 };
    for (tick, error, flags) in [
        (1, DecideError::NonFinite, ActionMsg::FALLBACK),
        (2, beyond, ActionMsg::FALLBACK | ActionMsg::GUARD),
    ] {
        let mut probe = Probe { refuses: Some(error), ..Probe::default() };
        let got = answers(&mut team, &mut role, &mut probe, frame(tick));
        assert_eq!((got[0].action, got[0].flags), (3, flags));
        assert_eq!(role.counters().fallbacks, tick);
    }
}

pub(super) fn absent_agents_do_not_act<T: Transport>() {
    let mut team = T::new();
    let (mut role, mut probe) = (runner(&mut team, 0, ALL, false), Probe::default());
    let without_1 = Sent { present: 0b11_1101, ..frame(1) };
    let got = answers(&mut team, &mut role, &mut probe, without_1);
    assert_eq!(got.iter().map(|answer| answer.agent).collect::<Vec<_>>(), [0, 2]);
    assert_eq!(probe.shown[0], (0, vec![0, 2, 3, 4, 5]));
}

pub(super) fn a_pausing_world_asks_for_nothing<T: Transport>() {
    let mut team = T::new();
    let (mut role, mut probe) = (runner(&mut team, 0, ALL, false), Probe::default());
    for (count, flags) in (1..).zip([FrameHeader::PAUSED, FrameHeader::EPISODE_END]) {
        let silent = Sent { flags, ..frame(count) };
        assert_eq!(answers(&mut team, &mut role, &mut probe, silent), []);
    }
    assert_eq!(probe.shown, []);
}

pub(super) fn warm_up_frames_are_decided_on_once_and_not_answered<T: Transport>() {
    let mut team = T::new();
    let (mut role, mut probe) = (runner(&mut team, 0, 0b11, false), Probe::default());
    for _ in 0..3 {
        let warm_up = Sent { kind: FrameKind::WarmUp, ..frame(0) };
        assert_eq!(answers(&mut team, &mut role, &mut probe, warm_up), []);
    }
    assert_eq!(probe.shown.len(), 2);
    assert_eq!(answers(&mut team, &mut role, &mut probe, frame(1)).len(), 2);
    assert_eq!(role.counters().frame_gaps, 0);
}
