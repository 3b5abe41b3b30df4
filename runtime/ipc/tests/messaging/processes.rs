//! Whole teams: in one thread, and as processes. A child is this test binary again, running the
//! test `child_process` with its role in the environment.

use std::error::Error as _;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process, kill_process_group};
use sortie_core::link::LinkError;
use sortie_core::roles::{Counters, TickReport, WorldError, WorldObserver};
use sortie_core::wire::{AllocMsg, Role, StatMsg};
use sortie_ipc::{
    BellKind, Children, Domain, DomainContract, Error, InProcess, ProcessSettings, Stop,
    WorldSettings, allocator_process, run_in_process, runner_process, world_process,
};

use crate::own_world;
use crate::policy;
use crate::private;

use crate::swap;
use crate::toy::{self, DecisionLog, ToyAllocator, ToyPolicy, ToyWorld, Watchdog};
use crate::unallocated;

const ROLE: &str = "SORTIE_TEST_ROLE";
const DOMAIN: &str = "SORTIE_TEST_DOMAIN";
const PARENT: &str = "SORTIE_TEST_PARENT";
/// Before the role of a process that ends as soon as it finds its world gone.
pub(crate) const IMPATIENT: &str = "impatient ";
/// What a world process prints when its first tick is done.
const RUNNING: &str = "the team acts";

pub(crate) fn settings(episodes: u32) -> WorldSettings {
    WorldSettings { allocator: true, episodes: Some(episodes), ..WorldSettings::default() }
}

/// A process of the domain: a world with its team or without, an `allocator`, or the agents of a runner as
/// `0,2`.
pub(crate) fn child(domain: &Domain, role: &str) -> Command {
    // This program, even where its folder is closed to the process.
    let mut command = Command::new("/proc/self/exe");
    command
        .args(["processes::child_process", "--exact", "--nocapture"])
        .env(ROLE, role)
        .env(DOMAIN, domain.id())
        .env(PARENT, std::process::id().to_string())
        .stdout(Stdio::null());
    command
}

/// Not a test of its own: what the processes of the other tests do.
#[test]
fn child_process() {
    let Ok(role) = std::env::var(ROLE) else { return };
    let domain = Domain::new(&std::env::var(DOMAIN).unwrap()).unwrap();
    let parent = std::env::var(PARENT).unwrap().parse().unwrap();
    let (role, world_patience) = match role.strip_prefix(IMPATIENT) {
        Some(role) => (role.to_owned(), Some(Duration::ZERO)),
        None => (role, None),
    };
    let parent = Some(parent);
    let settings = ProcessSettings { parent, world_patience, ..ProcessSettings::default() };
    let stop = Stop::on_signals().unwrap();
    if [policy::SERVER, policy::CLIENT].contains(&role.as_str()) {
        policy::play(&role, &domain, &stop);
        return;
    }
    if [own_world::WORLD, own_world::RUNNER].contains(&role.as_str()) {
        own_world::play(&role, &domain).unwrap();
        return;
    }
    let contract = toy::contract();
    let ended = match role.as_str() {
        "world" => play(&domain, ToyWorld::new(), &["allocator", "0,2", "1"], None, &stop),
        "world without team" => play(&domain, ToyWorld::new(), &[], None, &stop),
        "world of eight" => play(&domain, ToyWorld::of(8), &[], None, &stop),
        "one episode" => play(&domain, ToyWorld::new(), &["allocator", "0,1,2"], Some(1), &stop),
        "allocator" => allocator_process(&domain, &contract, &mut ToyAllocator, &settings, &stop),
        role if role.starts_with(swap::SWAPS) => swap::act(role, &domain, &settings, &stop),
        agents if agents.starts_with(private::PRIVATE) => {
            private::act(agents, &domain, &settings, &stop)
        }
        agents => {
            let by_cost = agents.strip_prefix(unallocated::HEURISTIC);
            let list = by_cost.unwrap_or(agents).split(',');
            let agents: Vec<u16> = list.map(|agent| agent.parse().unwrap()).collect();
            if by_cost.is_some() {
                unallocated::act_by_cost(&domain, &agents, &settings, &stop).unwrap();
                return;
            }
            runner_process(&domain, &contract, &agents, &mut ToyPolicy, &settings, &stop)
        }
    };
    if let Err(error) = &ended
        && !matches!(error, Error::Interrupted)
    {
        eprintln!("{error}: {:?}", error.source());
    }
    // At once: nobody may read any more what the test harness would print.
    std::process::exit(ended.map_or_else(|error| error.exit_code().into(), |_| 0));
}

/// A world that starts its team and plays so many episodes, or until it is stopped.
fn play(
    domain: &Domain,
    mut world: ToyWorld,
    team: &[&str],
    episodes: Option<u32>,
    stop: &Stop,
) -> Result<Counters, Error> {
    struct Announce;
    impl WorldObserver for Announce {
        fn tick(&mut self, report: &TickReport<'_>) {
            if (report.episode, report.step) == (0, 0) {
                println!("{RUNNING}");
            }
        }
    }
    let settings = WorldSettings { episodes, ..settings(0) };
    let start_team = |children: &mut Children| start(children, domain, team);
    let contract = toy::contract();
    world_process(domain, &contract, &mut world, &settings, start_team, &mut Announce, stop)
}

fn start(children: &mut Children, domain: &Domain, roles: &[&str]) -> Result<(), Error> {
    roles.iter().try_for_each(|role| children.spawn(*role, &mut child(domain, role)))
}

pub(crate) fn run_processes(
    domain: &Domain,
    roles: &[&str],
    settings: &WorldSettings,
    observer: &mut dyn WorldObserver,
    stop: &Stop,
) -> Result<Counters, Error> {
    let start_team = |children: &mut Children| start(children, domain, roles);
    let contract = toy::contract();
    let mut world = ToyWorld::new();
    world_process(domain, &contract, &mut world, settings, start_team, observer, stop)
}

pub(crate) fn run_in_one_thread(episodes: u32) -> DecisionLog {
    let mut log = DecisionLog::default();
    let team = InProcess {
        world: &mut ToyWorld::new(),
        policy: &mut ToyPolicy,
        allocator: Some(&mut ToyAllocator),
    };
    run_in_process(team, &toy::contract(), &settings(episodes), &mut log, &Stop::new()).unwrap();
    log
}

#[test]
fn processes_decide_exactly_as_one_thread_does() {
    let _watchdog = Watchdog::new();
    // 1,000 ticks, or as many as somebody asks for.
    let asked = std::env::var("SORTIE_REPLAY_EPISODES");
    let episodes = asked.map_or(40, |episodes| episodes.parse().unwrap());
    let alone = run_in_one_thread(episodes);
    let ticks = (episodes * toy::EPISODE) as usize;
    assert_eq!((alone.episodes, alone.tick_ns.len()), (episodes, ticks));
    let teams = [
        (&["allocator", "0,1,2"][..], BellKind::Doorbell),
        (&["0", "1", "2", "allocator"], BellKind::Doorbell),
        (&["0", "1", "2", "allocator"], BellKind::Event),
    ];
    for (roles, bell) in teams {
        let domain = toy::domain();
        let mut log = DecisionLog::default();
        let settings = WorldSettings { bell, ..settings(episodes) };
        let counters = run_processes(&domain, roles, &settings, &mut log, &Stop::new()).unwrap();
        assert_eq!(counters.missed_wake_ups, 0);
        toy::assert_same_log(&log, &alone);
        assert_eq!(toy::leftovers(&domain), [""; 0]);
    }
}

#[test]
fn a_team_in_one_thread_without_its_allocator_stands_still() {
    let team = InProcess { world: &mut ToyWorld::new(), policy: &mut ToyPolicy, allocator: None };
    let ended = run_in_process(team, &toy::contract(), &settings(1), &mut (), &Stop::new());
    assert!(matches!(ended, Err(Error::Stalled)));
}

#[test]
fn a_runner_that_never_comes_is_named() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let impatient = WorldSettings { join_patience: Duration::from_millis(300), ..settings(1) };
    let roles = ["allocator", "0,2"];
    let error = run_processes(&domain, &roles, &impatient, &mut (), &Stop::new()).unwrap_err();
    assert_eq!(error.to_string(), "nobody has joined for agent 1");
    assert_eq!(error.exit_code(), 69);
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}

/// Sends a signal to a process of the team, or to the own stop flag, once the team acts.
struct Strike {
    at_step: u32,
    /// Its role, and an agent that it acts for.
    victim: Option<(Role, u64)>,
    signal: Signal,
    pid: Option<Pid>,
    stop: Stop,
}

impl Strike {
    fn new(at_step: u32, victim: Option<(Role, u64)>, signal: Signal) -> Self {
        Self { at_step, victim, signal, pid: None, stop: Stop::new() }
    }
}

impl WorldObserver for Strike {
    fn status(&mut self, status: &StatMsg) {
        if let Some((role, agents)) = self.victim
            && status.role == role as u8
            && status.agents & agents == agents
        {
            self.pid = Pid::from_raw(status.pid as i32);
        }
    }

    fn tick(&mut self, report: &TickReport<'_>) {
        if (report.episode, report.step) == (0, self.at_step) {
            match self.pid {
                Some(pid) => kill_process(pid, self.signal).unwrap(),
                None => self.stop.stop(),
            }
        }
    }
}

fn run_struck(mut strike: Strike, patience: Duration) -> Error {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let endless = WorldSettings { episodes: None, patience, ..settings(0) };
    let stop = strike.stop.clone();
    let roles = ["0,2", "1", "allocator"];
    let error = run_processes(&domain, &roles, &endless, &mut strike, &stop).unwrap_err();
    assert_eq!(toy::leftovers(&domain), [""; 0]);
    error
}

#[test]
fn a_stopped_world_ends_its_team() {
    let error = run_struck(Strike::new(9, None, Signal::INT), Duration::from_secs(10));
    assert_eq!((error.to_string().as_str(), error.exit_code()), ("interrupted", 130));
}

#[test]
fn a_killed_runner_is_named_at_once() {
    let strike = Strike::new(9, Some((Role::Runner, 0b101)), Signal::KILL);
    // Long before the world's patience is over: the kernel says that it died.
    let error = run_struck(strike, Duration::from_secs(1_000));
    assert_eq!(error.to_string(), "0,2 was killed by signal 9");
    assert_eq!(error.exit_code(), 69);
}

#[test]
fn a_killed_allocator_is_named_at_once() {
    let strike = Strike::new(9, Some((Role::Allocator, 0)), Signal::KILL);
    let error = run_struck(strike, Duration::from_secs(1_000));
    assert_eq!(error.to_string(), "allocator was killed by signal 9");
}

#[test]
fn a_runner_that_hangs_is_named_when_patience_is_over() {
    let strike = Strike::new(9, Some((Role::Runner, 0b010)), Signal::STOP);
    let error = run_struck(strike, Duration::from_millis(300));
    // The signal takes effect some ticks later.
    assert!(error.to_string().starts_with("agent 1 did not act in time at step "), "{error}");
    assert_eq!(error.exit_code(), 69);
}

#[test]
fn an_allocator_that_hangs_is_named_when_patience_is_over() {
    let strike = Strike::new(9, Some((Role::Allocator, 0)), Signal::STOP);
    let error = run_struck(strike, Duration::from_millis(600));
    let start = "the allocator did not allocate in time at step ";
    assert!(error.to_string().starts_with(start), "{error}");
}

#[test]
fn a_runner_that_leaves_is_named() {
    let strike = Strike::new(9, Some((Role::Runner, 0b101)), Signal::TERM);
    let error = run_struck(strike, Duration::from_secs(10));
    // Its goodbye and its exit code race; both name it.
    assert!(
        ["the runner of agents 0, 2 left", "0,2 ended with exit code 130"]
            .contains(&error.to_string().as_str()),
        "{error}"
    );
    assert_eq!(error.exit_code(), 69);
}

/// Starts a world process with its team, in a process group of their own, and waits until it acts.
pub(crate) fn running_world(domain: &Domain) -> Child {
    let mut world = child(domain, "world");
    running(world.process_group(0).stdout(Stdio::piped()).spawn().unwrap())
}

/// Waits until the team of a world acts, which it says on its standard output.
pub(crate) fn running(mut world: Child) -> Child {
    let lines = BufReader::new(world.stdout.take().unwrap()).lines();
    assert!(lines.map_while(Result::ok).any(|line| line.ends_with(RUNNING)));
    world
}

fn pid(child: &Child) -> Pid {
    Pid::from_child(child)
}

/// Waits until nothing is left of the domain.
pub(crate) fn await_nothing_left(domain: &Domain) {
    let until = Instant::now() + Duration::from_secs(20);
    while toy::leftovers(domain) != [""; 0] && Instant::now() < until {
        std::thread::yield_now();
    }
    assert_eq!(toy::leftovers(domain), [""; 0]);
}

#[test]
fn an_interrupt_from_the_terminal_ends_all_processes() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let mut world = running_world(&domain);
    kill_process_group(pid(&world), Signal::INT).unwrap();
    assert_eq!(world.wait().unwrap().code(), Some(130));
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}

#[test]
fn the_team_ends_with_its_killed_world_and_cleans_up() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let mut world = running_world(&domain);
    world.kill().unwrap();
    world.wait().unwrap();
    await_nothing_left(&domain);
}

#[test]
fn what_a_killed_domain_leaves_is_removed_by_the_next() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let mut world = running_world(&domain);
    kill_process_group(pid(&world), Signal::KILL).unwrap();
    world.wait().unwrap();
    // Held by every process of the domain until it is dead.
    File::open(domain.base().join("alive.lock")).unwrap().lock().unwrap();
    assert_ne!(toy::leftovers(&domain), [""; 0]);
    let mut log = DecisionLog::default();
    run_processes(&domain, &["0,1,2", "allocator"], &settings(1), &mut log, &Stop::new()).unwrap();
    toy::assert_same_log(&log, &run_in_one_thread(1));
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}

#[test]
fn runners_may_come_before_their_world() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let mut team = Children::default();
    start(&mut team, &domain, &["1", "allocator", "0,2"]).unwrap();
    let mut log = DecisionLog::default();
    run_processes(&domain, &[], &settings(1), &mut log, &Stop::new()).unwrap();
    team.finish(Duration::from_secs(10));
    team.check().unwrap();
    toy::assert_same_log(&log, &run_in_one_thread(1));
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}

#[test]
fn a_team_goes_on_with_the_next_world_where_one_was_killed() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let mut team = Children::default();
    start(&mut team, &domain, &["1", "allocator", "0,2"]).unwrap();
    let mut world = child(&domain, "world without team");
    let mut world = running(world.stdout(Stdio::piped()).spawn().unwrap());
    world.kill().unwrap();
    world.wait().unwrap();
    let mut log = DecisionLog::default();
    run_processes(&domain, &[], &settings(2), &mut log, &Stop::new()).unwrap();
    team.finish(Duration::from_secs(10));
    team.check().unwrap();
    assert_eq!((log.episodes, log.tick_ns.len()), (2, 50));
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}

/// Notes who allocates, and kills every leader but the last after some of its allocations.
struct KillLeaders {
    log: DecisionLog,
    pids: Vec<Pid>,
    kills: usize,
    /// Terms, and how many allocations of each were seen.
    terms: Vec<(u32, usize)>,
}

impl WorldObserver for KillLeaders {
    fn status(&mut self, status: &StatMsg) {
        if status.role == Role::Allocator as u8 && status.has(StatMsg::LEADER) {
            self.pids.push(Pid::from_raw(status.pid as i32).unwrap());
            self.pids.dedup();
        }
    }

    fn allocated(&mut self, allocation: &AllocMsg) {
        match self.terms.last_mut() {
            Some((term, number)) if *term == allocation.term => *number += 1,
            _ => self.terms.push((allocation.term, 1)),
        }
    }

    fn tick(&mut self, report: &TickReport<'_>) {
        self.log.tick(report);
        let is_due = self.terms.last().is_some_and(|(_, number)| *number >= 3);
        if is_due && self.terms.len() <= self.kills && self.pids.len() == self.terms.len() {
            kill_process(*self.pids.last().unwrap(), Signal::KILL).unwrap();
        }
    }

    fn episode_ended(&mut self, episode: u32, steps: u32) {
        self.log.episode_ended(episode, steps);
    }
}

#[test]
fn standbys_take_over_from_killed_allocators() {
    let _watchdog = Watchdog::new();
    for bell in [BellKind::Doorbell, BellKind::Event] {
        let domain = toy::domain();
        let mut allocators = Children::default();
        start(&mut allocators, &domain, &["allocator"; 3]).unwrap();
        let mut runners = Children::default();
        start(&mut runners, &domain, &["0,1,2"]).unwrap();
        let mut watch = KillLeaders {
            log: DecisionLog::default(),
            pids: Vec::new(),
            kills: 2,
            terms: Vec::new(),
        };
        let settings = WorldSettings { bell, ..settings(40) };
        run_processes(&domain, &[], &settings, &mut watch, &Stop::new()).unwrap();
        allocators.finish(Duration::from_secs(10));
        runners.finish(Duration::from_secs(10));
        runners.check().unwrap();
        assert_eq!((watch.log.episodes, watch.log.tick_ns.len()), (40, 1_000));
        let terms: Vec<u32> = watch.terms.iter().map(|(term, _)| *term).collect();
        assert_eq!(terms, [1, 2, 3]);
        assert_eq!(toy::leftovers(&domain), [""; 0]);
    }
}

#[test]
fn taken_roles_are_busy() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let mut world = running_world(&domain);
    let stop = Stop::new();
    let (contract, settings) = (toy::contract(), ProcessSettings::default());
    let second = run_processes(&domain, &[], &self::settings(1), &mut (), &stop).unwrap_err();
    let holder = format!("of domain `{}` is already taken by process ", domain.id());
    assert!(second.to_string().starts_with(&format!("the world {holder}{}", world.id())));
    let seat =
        runner_process(&domain, &contract, &[2], &mut ToyPolicy, &settings, &stop).unwrap_err();
    assert!(seat.to_string().starts_with(&format!("agent 2 {holder}")), "{seat}");
    assert_eq!([&second, &seat].map(Error::exit_code), [75; 2]);
    kill_process(pid(&world), Signal::TERM).unwrap();
    assert_eq!(world.wait().unwrap().code(), Some(130));
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}

#[test]
fn what_does_not_fit_the_domain_cannot_join() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let mut world = running_world(&domain);
    let stop = Stop::new();
    let join = |contract: &DomainContract, agents: &[u16], settings: &ProcessSettings| {
        runner_process(&domain, contract, agents, &mut ToyPolicy, settings, &stop).unwrap_err()
    };
    let (fits, free) = (toy::contract(), ProcessSettings::default());
    let mut other = toy::contract();
    other.hash += 1;
    other.fields.insert("environment".into(), "harbour".into());
    let foreign = join(&other, &[0], &free);
    assert!(foreign.to_string().ends_with("`environment` is \"harbour\" here, \"toy\" there"));
    let small = join(&fits, &[0], &ProcessSettings { entities_max: Some(5), ..free });
    assert_eq!(small.to_string(), "the domain has 6 entities, the model takes at most 5");
    let beyond = join(&fits, &[0, 3], &free);
    assert_eq!(beyond.to_string(), "no such agents: [0, 3]; the domain has 3, from 0");
    assert_eq!([foreign, small, beyond].map(|error| error.exit_code()), [78, 78, 2]);
    kill_process(pid(&world), Signal::TERM).unwrap();
    world.wait().unwrap();
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}

#[test]
fn builds_of_another_abi_are_refused() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let mut world = running_world(&domain);
    let (contract, settings, stop) = (toy::contract(), ProcessSettings::default(), Stop::new());
    let facts = domain.base().join("domain.toml");
    let ours = std::fs::read_to_string(&facts).unwrap();
    std::fs::write(&facts, ours.replace("abi = 3", "abi = 1")).unwrap();
    let refused =
        runner_process(&domain, &contract, &[1], &mut ToyPolicy, &settings, &stop).unwrap_err();
    assert!(refused.to_string().ends_with("messages are of ABI 3 here, 1 there"), "{refused}");
    assert_eq!(refused.exit_code(), 78);
    std::fs::write(&facts, ours).unwrap();
    kill_process(pid(&world), Signal::TERM).unwrap();
    world.wait().unwrap();
    await_nothing_left(&domain);
}

#[test]
fn exit_codes_are_those_that_scripts_rely_on() {
    let missed = Error::World(WorldError::SeatsMissed { step: 1, seats: 1 });
    let codes = [
        (Error::DomainId(String::new()), 2),
        (missed, 69),
        (Error::NoWorld { domain: String::new() }, 69),
        (Error::Link(LinkError::Frames), 74),
        (Error::SchemaInUse { domain: String::new(), schema: 1 }, 78),
        (Error::Interrupted, 130),
    ];
    for (error, code) in codes {
        assert_eq!(error.exit_code(), code, "{error}");
    }
}
