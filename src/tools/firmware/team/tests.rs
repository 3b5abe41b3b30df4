//! A team over damaged lines, its device a runner in this process.

use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use sortie_core::link::{Bell, Clock, FrameBlock, Processor, Serial, packet_bytes};
use sortie_core::roles::{Poll, RunnerOptions, RunnerRole};
use sortie_core::{DecideError, Decision, Observation, Policy};

use super::device::Counted;
use super::line::{Channel, Pieces, Port, packets};
use super::play::{Played, runner_options};
use super::*;

/// Time that passes while somebody waits.
struct Passing(AtomicU64);

impl Clock for Passing {
    fn now_ns(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

impl Processor for Passing {
    fn rest(&self) {
        self.0.fetch_add(1_000_000, Ordering::Relaxed);
    }
}

/// A device in this process.
struct Board {
    policy: Box<dyn Policy>,
    options: RunnerOptions,
    port: Port,
    link: Serial<'static, Port>,
    role: RunnerRole,
    sent: u64,
}

impl Board {
    fn new(options: RunnerOptions, policy: Box<dyn Policy>) -> Self {
        let (port, link, role) = Self::begun(options);
        Self { policy, options, port, link, role, sent: 0 }
    }

    fn begun(options: RunnerOptions) -> (Port, Serial<'static, Port>, RunnerRole) {
        let (port, shape) = (Port::default(), options.format.layout.shape());
        let clock = Box::leak(Box::new(Passing(AtomicU64::new(1))));
        let memory = vec![FrameBlock::zeroed(); FrameBlock::for_serial(shape)].leak();
        let packet = vec![0; packet_bytes(shape)].leak();
        let mut link = Serial::new(port.clone(), clock, options.format, memory, packet).unwrap();
        let mut role = RunnerRole::new(options);
        role.join(&mut link).unwrap();
        (port, link, role)
    }
}

impl Device for Board {
    fn exchange(&mut self, bytes: &[u8]) -> Result<(Vec<u8>, Counted), Failure> {
        self.port.bring(bytes);
        loop {
            let token = self.link.token();
            match self.role.poll(&mut self.link, &mut self.policy).unwrap() {
                Poll::Wait { until_ns: u64::MAX } => break,
                Poll::Wait { until_ns } => drop(self.link.wait_until(token, until_ns)),
                _ => {}
            }
        }
        let sent = self.port.take().concat();
        self.sent += sent.len() as u64;
        let (line, runner) = (self.link.counters(), self.role.counters());
        let counted = Counted {
            packets: line.packets,
            torn: line.torn,
            corrupt: line.corrupt,
            too_long: line.too_long,
            refused: line.refused,
            overtaken: line.overtaken,
            foreign: runner.schema_rejects,
            bad: runner.bad_messages,
            old: runner.old_term_rejects,
            decided: runner.ticks,
            stale: runner.stale_allocations,
            unallocated: runner.no_allocations,
            fallbacks: runner.fallbacks,
            sent: self.sent,
            rest: 0,
        };
        Ok((sent, counted))
    }

    fn restart(&mut self, _bytes: &[u8]) -> Result<(Vec<u8>, Counted), Failure> {
        (self.port, self.link, self.role) = Self::begun(self.options);
        self.exchange(&[])
    }
}

/// Takes the last available action instead of the best.
struct Contrary(Box<dyn Policy>);

impl Policy for Contrary {
    fn actions(&self) -> usize {
        self.0.actions()
    }

    fn utilities(&mut self, seen: &Observation<'_>, to: &mut [f32]) -> Result<(), DecideError> {
        self.0.utilities(seen, to)
    }

    fn decide(&mut self, seen: &Observation<'_>) -> Result<Decision, DecideError> {
        let decision = self.0.decide(seen)?;
        let last = seen.available.iter().rposition(|code| *code != 0).unwrap_or_default();
        Ok(Decision { action: last as u16, ..decision })
    }
}

/// How a team of `save-the-city` plays.
struct Asked {
    episodes: u32,
    damage: u32,
    disorder: u32,
    resets: BTreeSet<(u32, u32)>,
    is_contrary: bool,
}

const CALM: Asked =
    Asked { episodes: 4, damage: 0, disorder: 0, resets: BTreeSet::new(), is_contrary: false };

fn played(asked: Asked) -> (Played, usize) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/save-the-city");
    let bundle = sortie_cli::deployment::open_bundle(&folder).unwrap();
    let mut world = open_world(&bundle, None, 3).unwrap();
    let allocation = AllocatorChoice::of_bundle(&bundle, None).unwrap();
    let contract = domain_contract(&bundle, allocation);
    let format = DomainFacts::new(&contract, world.shape()).format().unwrap();
    let setup = Setup { contract: &contract, format, agent: 1, episodes: asked.episodes };
    let policy = || {
        let policy = DeployedPolicy::open(&bundle, Backend::Plan).unwrap();
        Box::leak(Box::new(policy)).policy().unwrap()
    };
    let device: Box<dyn Policy> =
        if asked.is_contrary { Box::new(Contrary(policy())) } else { policy() };
    let mut board = Board::new(runner_options(&setup, 0b10), device);
    let draws = (3, ProposalArguments::default());
    let mut allocator =
        DeployedAllocator::open_for(&bundle, allocation, Backend::Plan, draws).unwrap().unwrap();
    let mut allocator = allocator.allocator().unwrap();
    let (mut others, mut own, tally) = (policy(), policy(), Rc::clone(&world.tally));
    let mut cast = Cast {
        world: &mut world,
        others: others.as_mut(),
        own: own.as_mut(),
        allocator: Some(allocator.as_mut()),
    };
    let noise = Noise { seed: 5, bytes: asked.damage, packets: asked.disorder };
    let line = Line::new(&mut board, noise, asked.resets).unwrap();
    let played = play(&setup, &mut cast, line).unwrap();
    let solved = tally.borrow().solved;
    (played, solved)
}

/// Everything that came was counted, and nothing wrong was done.
fn assert_sound(played: &Played) {
    assert_eq!((played.turns.wrong, played.line.uncounted), (0, 0));
    let (line, relay) = (&played.line, &played.relay);
    assert_eq!([line.device.bad, line.device.foreign, relay.refused], [0; 3]);
    assert!(played.turns.executed <= line.device.decided);
    assert!(line.device.decided <= played.turns.asked);
}

#[test]
fn over_a_calm_line_a_team_plays_as_beside_its_world() {
    let (played, solved) = played(CALM);
    assert_sound(&played);
    let turns = played.turns;
    assert!(turns.asked > 100);
    assert_eq!([turns.executed, played.line.device.decided], [turns.asked; 2]);
    assert_eq!(played.line.device.pieces(), played.line.down.packets);
    // The same world, all agents in one runner.
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/save-the-city");
    let bundle = sortie_cli::deployment::open_bundle(&folder).unwrap();
    let mut world = open_world(&bundle, None, 3).unwrap();
    let allocation = AllocatorChoice::of_bundle(&bundle, None).unwrap();
    let draws = (3, ProposalArguments::default());
    let mut allocator =
        DeployedAllocator::open_for(&bundle, allocation, Backend::Plan, draws).unwrap().unwrap();
    let mut policy = DeployedPolicy::open(&bundle, Backend::Plan).unwrap();
    let (mut policy, mut allocator) = (policy.team().unwrap(), allocator.allocator().unwrap());
    let tally = Rc::clone(&world.tally);
    let team = sortie_ipc::InProcess {
        world: &mut world,
        policy: policy.as_mut(),
        allocator: Some(allocator.as_mut()),
    };
    let settings = sortie_ipc::WorldSettings { episodes: Some(4), ..Default::default() };
    let contract = domain_contract(&bundle, allocation);
    let stop = sortie_ipc::Stop::default();
    sortie_ipc::run_in_process(team, &contract, &settings, &mut (), &stop).unwrap();
    assert_eq!(solved, tally.borrow().solved);
}

#[test]
fn damage_is_refused_and_counted_by_its_kind() {
    let noisy = || played(Asked { episodes: 8, damage: 2_000, disorder: 20, ..CALM });
    let (played, solved) = noisy();
    assert_sound(&played);
    let (down, device) = (played.line.down, played.line.device);
    assert!([down.changed, down.lost, down.doubled].iter().all(|count| *count > 0), "{down:?}");
    assert!([down.torn, down.repeated, down.overtaken].iter().all(|count| *count > 0), "{down:?}");
    assert!(device.torn > 0 && device.corrupt > 0, "{device:?}");
    assert!(device.old > 0 && device.overtaken > 0, "{device:?}");
    assert!(played.relay.damaged() > 0 && played.world.late > 0);
    assert!(2 * device.decided >= played.turns.asked, "at least half of the frames arrive");
    let (again, solved_again) = noisy();
    assert_eq!((played.turns, solved), (again.turns, solved_again), "a seed repeats");
}

#[test]
fn heavy_damage_hangs_nobody() {
    let (played, _) = played(Asked { damage: 100, ..CALM });
    assert_sound(&played);
    assert!(played.line.device.corrupt + played.line.device.torn > 100);
    assert!(played.turns.executed > 0, "some get through");
}

#[test]
fn a_device_that_is_reset_loses_its_turn() {
    let resets = BTreeSet::from([(0, 3), (1, 7), (3, 2)]);
    let (played, _) = played(Asked { resets, ..CALM });
    assert_sound(&played);
    assert_eq!(played.line.resets, 3);
    assert_eq!(played.turns.executed, played.turns.asked - 3);
    assert_eq!(played.line.device.unallocated, 0, "it is shown the newest allocation");
}

#[test]
fn an_action_that_is_another_is_found() {
    let (played, _) = played(Asked { episodes: 1, is_contrary: true, ..CALM });
    assert!(played.turns.wrong > 0);
}

#[test]
fn every_packet_has_draws_of_its_own() {
    let noise = Noise { seed: 1, bytes: 10, packets: 0 };
    let packet: Vec<u8> = (1..=200).collect();
    let (mut one, mut other) = (Channel::new(noise, 0), Channel::new(noise, 1));
    let first = one.carry(&packet, (1, 0));
    assert_ne!(first, packet);
    assert_ne!(one.carry(&packet, (1, 1)), first, "of the next");
    assert_ne!(one.carry(&packet, (2, 0)), first, "of the next turn");
    assert_ne!(other.carry(&packet, (1, 0)), first, "of the other direction");
    assert_eq!(Channel::new(noise, 0).carry(&packet, (1, 0)), first);
    let counts = one.carried;
    assert_eq!((counts.packets, counts.bytes), (3, 600));
    let damaged = counts.changed + counts.lost + counts.doubled;
    assert!((30..=100).contains(&damaged), "{damaged}");
}

#[test]
fn a_packet_is_torn_repeated_or_overtaken() {
    let mut channel = Channel::new(Noise { seed: 1, bytes: 0, packets: 2 }, 0);
    let sent: Vec<[u8; 3]> = (1..=60).map(|number| [0, number, 0]).collect();
    let arrived: Vec<u8> =
        (0..).zip(&sent).flat_map(|(turn, packet)| channel.carry(packet, (turn, 0))).collect();
    let arrived: Vec<u8> =
        packets(&arrived).filter_map(|piece| piece.iter().copied().max()).collect();
    let counts = channel.carried;
    assert!(counts.torn > 0 && counts.repeated > 1 && counts.overtaken > 0, "{counts:?}");
    let late = arrived.windows(2).filter(|pair| pair[0] > pair[1]).count() as u64;
    assert!(late >= counts.overtaken.min(2), "{arrived:?}");
}

#[test]
fn pieces_are_what_stands_between_zeros() {
    let mut pieces = Pieces::default();
    pieces.add(&[0, 0, 3, 4, 0, 5]);
    assert_eq!(pieces.ended, 1);
    pieces.add(&[0, 0, 7]);
    assert_eq!(pieces.ended, 2);
    let found: Vec<&[u8]> = packets(&[0, 1, 0, 0, 2, 3, 0, 4]).collect();
    assert_eq!(found, [&[0, 1, 0][..], &[0, 2, 3, 0], &[4]]);
    assert_eq!(packets(&[0, 0]).count(), 0);
}

/// An emulator that is a line of a shell.
fn shell(line: &'static str, limit: Duration) -> Emulator {
    let command = move || {
        let mut shell = Command::new("sh");
        shell.args(["-c", line]);
        shell
    };
    Emulator::start(command, limit).unwrap()
}

#[test]
fn an_emulator_is_heard_when_it_rests() {
    let rests = "printf ab; echo packets 0000000000000007 >&2; echo sent 0000000000000002 >&2; \
                 echo rest 0000000000000000 >&2; head -c 3; echo rest 0000000000000001 >&2; \
                 echo sent 0000000000000005 >&2; echo rest 0000000000000003 >&2; cat";
    let mut emulator = shell(rests, Duration::from_secs(60));
    let (bytes, counted) = emulator.exchange(&[]).unwrap();
    assert_eq!((bytes.as_slice(), counted.packets), (&b"ab"[..], 7));
    // It has not read everything at its first rest.
    assert_eq!(emulator.exchange(b"xyz").unwrap().0, b"xyz");
    assert_eq!(emulator.exchange(&[]).unwrap().0, b"", "it has nothing to say");
    let (bytes, _) = emulator.restart(b"lost").unwrap();
    assert_eq!(bytes, b"ab", "it begins anew");
}

#[test]
fn an_emulator_that_ends_or_hangs_is_given_up() {
    let ends = shell("echo a fault of the processor >&2", Duration::from_secs(60)).exchange(&[]);
    let failed = ends.map(drop).unwrap_err();
    assert_eq!(failed.exit, Exit::Difference);
    assert!(failed.message.ends_with(": a fault of the processor"), "{}", failed.message);
    let hangs = shell("exec sleep 600", Duration::from_millis(50)).exchange(&[]);
    assert_eq!(hangs.map(drop).unwrap_err().exit, Exit::NotRunning);
}

#[test]
fn boards_and_agents_that_cannot_act_in_a_team_are_refused() {
    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        arguments: FirmwareArguments,
    }
    let refused = |board: &str, agent, hidden| {
        let words = ["sortie", "models/save-the-city", "--board", board, "--team"];
        let line = <Line as clap::Parser>::try_parse_from(words).unwrap();
        let refused = check(&line.arguments, agent, 5, hidden).err();
        refused.map(|failure| failure.message).unwrap_or_default()
    };
    assert_eq!(refused("cortex-m3", 4, 0), "");
    for (board, agent, hidden, words) in [
        ("cortex-m0", 0, 0, "micro:bit"),
        ("cortex-m3", 5, 0, "agents 0 to 4"),
        ("rv32imc", 0, 8, "remember"),
    ] {
        let message = refused(board, agent, hidden);
        assert!(message.contains(words), "{message}");
    }
}
