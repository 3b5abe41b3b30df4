//! Bells under stress: six ringers, some of them killed; a message that is found only after a
//! time-out was rung for in vain.

use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use sortie_core::UNASSIGNED;
use sortie_core::link::{ActionRx, ActionTx, Bell, Clock, FrameRx, FrameTx, LinkError, Wake};
use sortie_core::wire::{ActionMsg, FrameFormat, FrameHeader, Role};
use sortie_ipc::{BellKind, Domain, DomainFacts, IoxAgent, IoxWorld, LinkSetup};

use crate::toy::{self, Watchdog};

const RINGERS: usize = 6;
/// A ringer is killed in every so many rounds.
const KILL_EVERY: u64 = 400;
/// Long against any delay of a loaded machine; a lost ring costs as much.
const TIMEOUT_NS: u64 = 500_000_000;
/// How long a ring may be late that is not lost: its ringer may be held up between message and ring.
const LATEST_NS: u64 = 10_000_000_000;
const RINGER: &str = "SORTIE_TEST_RINGER";
const DOMAIN: &str = "SORTIE_TEST_DOMAIN";
const BELL: &str = "SORTIE_TEST_BELL";
/// So short that many waits sleep after it.
const LINGER: Duration = Duration::from_micros(20);
/// Seconds of the stress; a longer one is for a quiet hour.
const SECONDS: &str = "SORTIE_STRESS_SECONDS";
/// Exit code of a ringer that lost a ring.
const LOST: i32 = 3;

fn setup<'a>(domain: &'a Domain, bell: BellKind, name: &'a str) -> LinkSetup<'a> {
    LinkSetup { domain, format: format(), name, bell, linger: LINGER }
}

fn format() -> FrameFormat {
    DomainFacts::new(&toy::contract(), toy::SHAPE).format().unwrap()
}

fn start(domain: &Domain, bell: BellKind, ringer: usize) -> Child {
    Command::new(std::env::current_exe().unwrap())
        .args(["stress::ringer", "--exact", "--nocapture"])
        .env(RINGER, ringer.to_string())
        .env(DOMAIN, domain.id())
        .env(BELL, if bell == BellKind::Event { "event" } else { "doorbell" })
        .stdout(Stdio::null())
        .spawn()
        .unwrap()
}

/// Not a test of its own: answers every round, until the round 0.
#[test]
fn ringer() {
    let Ok(ringer) = std::env::var(RINGER) else { return };
    let bell = match std::env::var(BELL).unwrap().as_str() {
        "event" => BellKind::Event,
        _ => BellKind::Doorbell,
    };
    let domain = Domain::new(&std::env::var(DOMAIN).unwrap()).unwrap();
    let membership = domain.enter().unwrap();
    let mut link: IoxAgent = {
        let _starting = membership.lock_start().unwrap();
        IoxAgent::open(&setup(&domain, bell, "ringer")).unwrap()
    };
    let answer = ActionMsg { agent: ringer.parse().unwrap(), ..message() };
    let (mut last, mut timed_out, mut waited) = (u64::MAX, false, link.token());
    loop {
        let token = link.token();
        let mut round = last;
        link.receive_frames(&mut |frame| {
            round = frame.header.tick;
            false
        })
        .unwrap();
        if round == 0 {
            return;
        }
        if round != last {
            // The first frame comes by history, without a ring.
            let is_late = timed_out && last != u64::MAX;
            if is_late && is_lost(&mut link, waited) {
                std::process::exit(LOST);
            }
            last = round;
            link.send_action(&ActionMsg { tick: round, ..answer }).unwrap();
            link.ring(Role::World).unwrap();
            // The ring that was found may have been one for the next round.
            if is_late {
                timed_out = false;
                continue;
            }
        }
        waited = token;
        timed_out = link.wait_until(token, link.now_ns() + TIMEOUT_NS) == Wake::Timeout;
    }
}

/// Whether the ring for a message that was found after a time-out never comes: it may be late, or have come
/// between the time-out and the look, which the token of the wait that timed out tells.
fn is_lost(link: &mut (impl Bell + Clock), token: u32) -> bool {
    let until_ns = link.now_ns() + LATEST_NS;
    while link.now_ns() < until_ns {
        if link.wait_until(token, until_ns) == Wake::Rung {
            return false;
        }
    }
    true
}

fn message() -> ActionMsg {
    ActionMsg {
        schema: format().schema,
        seq: 0,
        tick: 0,
        t_ns: 0,
        model: 0,
        alloc_epoch: 0,
        agent: 0,
        action: 0,
        flags: 0,
        task: UNASSIGNED,
        abi: 3,
        q: 0.0,
        decide_ns: 0,
        alloc_term: 0,
        runner: 0,
    }
}

fn send(link: &mut IoxWorld, round: u64) {
    link.send_frame(&mut |_| -> Result<FrameHeader, LinkError> {
        Ok(FrameHeader { tick: round, ..FrameHeader::default() })
    })
    .unwrap();
    link.ring(Role::Runner).unwrap();
}

/// Collects the answers to a round; counts those that only a time-out brought to light.
fn collect(link: &mut IoxWorld, ringers: &mut [Child], round: u64) -> u64 {
    let (mut answered, mut timed_out, mut lost) = (0_u64, false, 0);
    let mut waited = link.token();
    loop {
        let token = link.token();
        let before = answered;
        link.receive_actions(&mut |action| {
            if action.tick == round {
                answered |= 1 << action.agent;
            }
        })
        .unwrap();
        let is_late = timed_out && answered != before;
        lost += u64::from(is_late && is_lost(link, waited));
        if answered.count_ones() as usize == RINGERS {
            return lost;
        }
        // The ring that was found may have been that of another answer.
        if is_late {
            timed_out = false;
            continue;
        }
        waited = token;
        timed_out = link.wait_until(token, link.now_ns() + TIMEOUT_NS) == Wake::Timeout;
        if timed_out {
            let ended = ringers.iter_mut().find_map(|ringer| ringer.try_wait().unwrap());
            assert_eq!(ended, None, "a ringer ended; {LOST} means that a ring was lost");
            // Somebody who was started again may have missed the round.
            send(link, round);
        }
    }
}

fn stress(bell: BellKind) {
    let _watchdog = Watchdog::new();
    let seconds = std::env::var(SECONDS).map_or(2, |seconds| seconds.parse().unwrap());
    let domain = toy::domain();
    let membership = domain.enter().unwrap();
    let mut link: IoxWorld = IoxWorld::open(&setup(&domain, bell, "world")).unwrap();
    let mut ringers: Vec<Child> = (0..RINGERS).map(|ringer| start(&domain, bell, ringer)).collect();
    let (mut round, mut lost, mut kills) = (1, 0, 0);
    send(&mut link, round);
    collect(&mut link, &mut ringers, round);
    let until = Instant::now() + Duration::from_secs(seconds);
    while Instant::now() < until {
        round += 1;
        send(&mut link, round);
        let is_kill = round % KILL_EVERY == 0;
        if is_kill {
            let victim = kills % RINGERS;
            ringers[victim].kill().unwrap();
            ringers[victim].wait().unwrap();
            ringers[victim] = start(&domain, bell, victim);
            kills += 1;
            round += 1;
            send(&mut link, round);
        }
        let late = collect(&mut link, &mut ringers, round);
        // A killed ringer takes its own ring with it.
        lost += if is_kill { 0 } else { late };
    }
    send(&mut link, 0);
    for mut ringer in ringers {
        assert!(ringer.wait().unwrap().success());
    }
    drop((link, membership));
    println!("{bell:?}: {round} rounds, {kills} kills, {lost} lost");
    assert_eq!(lost, 0, "of {round} rounds, {kills} with a killed ringer");
    assert!(kills > 0, "{round} rounds");
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}

#[test]
fn no_ring_of_the_doorbell_is_lost() {
    stress(BellKind::Doorbell);
}

#[test]
fn no_ring_of_events_is_lost() {
    stress(BellKind::Event);
}
