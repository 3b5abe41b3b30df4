//! The tick of a team of eight agents: our messages with the doorbell and with events, and one
//! runner for all agents, beside what others would do it with: raw shared memory and futexes, plain
//! iceoryx2, Unix sockets. Rounds alternate; ratios are paired.
//!
//! `cargo bench -p sortie-ipc --bench tick [-- ROUNDS TICKS [CASE...]]`
//! `cargo bench -p sortie-ipc --bench tick -- soak SECONDS`
#![allow(clippy::print_stdout, reason = "a program of its own")]

mod cpu_time;
mod floor;
mod plain;
mod soak;
mod sockets;
mod spread;

use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use sortie_core::roles::{Counters, TickReport, WorldObserver};
use sortie_core::wire::FrameMut;
use sortie_core::{
    DecideError, Decision, EntityMask, Observation, Policy, Shape, StepOutcome, UnavailableAction,
    World,
};
use sortie_ipc::{
    BellKind, Children, Domain, DomainContract, ProcessSettings, Stop, WorldSettings,
    runner_process, world_process,
};

use cpu_time::cpu_time_ns;
use floor::Waiting;
use plain::PlainWorld;
use spread::{median, ratios, spread};

const AGENTS: usize = 8;
const SHAPE: Shape = Shape { agents: AGENTS, entities: 16, tasks: 4, actions: 14, features: 58 };
/// Words of a frame of that shape, for those who know no frames.
const FRAME_WORDS: usize = 564;
/// Time of one decision.
const DECISION: Duration = Duration::from_micros(2);
/// How long waits linger that do.
const LINGER: Duration = Duration::from_micros(100);
/// Ticks of a round before the first that counts.
const WARM_UP: usize = 100;
const ROLE: &str = "SORTIE_BENCH_ROLE";
const PLACE: &str = "SORTIE_BENCH_PLACE";

const FLOOR: &str = "raw floor";
const PATIENT: &str = "raw, one wake-up";
const LINGERING: &str = "raw, lingering";
const DOORBELL: &str = "doorbell";
const ASLEEP: &str = "doorbell, asleep";
const EVENTS: &str = "events";
const PLAIN: &str = "plain iceoryx2";
const SOCKETS: &str = "unix sockets";
const RUNNER: &str = "one runner";
const RUNNER_ASLEEP: &str = "one runner, asleep";
const RAW_RUNNER: &str = "raw, one runner";
const CASES: [&str; 11] = [
    FLOOR,
    PATIENT,
    LINGERING,
    DOORBELL,
    ASLEEP,
    EVENTS,
    PLAIN,
    SOCKETS,
    RUNNER,
    RUNNER_ASLEEP,
    RAW_RUNNER,
];

/// What rounds of one case measured, in nanoseconds.
struct Case {
    name: &'static str,
    /// Median tick of each round.
    ticks: Vec<f64>,
    /// Median of what ticks took beyond their decisions.
    beyond: Vec<f64>,
    /// Processor time of all processes for each tick, their start included.
    cpu_times: Vec<f64>,
}

impl Case {
    fn new(name: &'static str) -> Self {
        Self { name, ticks: Vec::new(), beyond: Vec::new(), cpu_times: Vec::new() }
    }
}

/// One tick, in nanoseconds.
struct Tick {
    took: u64,
    /// Of it in decisions, where they are one after the other; else 0.
    decisions: u64,
}

fn main() {
    if let Ok(role) = std::env::var(ROLE) {
        return act(&role, &std::env::var(PLACE).unwrap());
    }
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let mut numbers = arguments.iter().filter_map(|argument| argument.parse::<usize>().ok());
    let rounds = numbers.next().unwrap_or(15);
    let ticks = numbers.next().unwrap_or(2_000);
    if arguments.iter().any(|argument| argument == "soak") {
        return soak::soak(rounds);
    }
    let is_named = |name: &str| arguments.iter().any(|argument| argument == name);
    let mut cases: Vec<Case> = CASES
        .into_iter()
        .filter(|name| is_named(name) || !CASES.into_iter().any(is_named))
        .map(Case::new)
        .collect();
    for round in 0..rounds {
        for case in &mut cases {
            case.run(round, ticks);
        }
    }
    println!("tick of {AGENTS} agents that decide in {DECISION:?}, {rounds} rounds of {ticks}:");
    for case in &cases {
        let [tick, cpu] = [&case.ticks, &case.cpu_times].map(|times| spread(times, 1e-3, " us"));
        println!("  {:18} p50 {tick:30} processors {cpu}", case.name);
    }
    let find = |name| cases.iter().find(|case| case.name == name);
    for (above, below) in [
        (DOORBELL, FLOOR),
        (DOORBELL, LINGERING),
        (ASLEEP, FLOOR),
        (ASLEEP, PATIENT),
        (EVENTS, DOORBELL),
        (EVENTS, ASLEEP),
        (SOCKETS, DOORBELL),
    ] {
        if let (Some(above), Some(below)) = (find(above), find(below)) {
            let ratios = spread(&ratios(&above.ticks, &below.ticks), 1.0, "");
            println!("  {:30} {ratios}", format!("{} / {}", above.name, below.name));
        }
    }
    if let Some(raw) = find(RAW_RUNNER) {
        let decisions = DECISION.as_nanos() as f64 * AGENTS as f64;
        let beyond: Vec<f64> = raw.ticks.iter().map(|tick| tick - decisions).collect();
        println!("  {:30} {}", "raw, one runner - decisions", spread(&beyond, 1e-3, " us"));
    }
    for runner in [RUNNER, RUNNER_ASLEEP].into_iter().filter_map(find) {
        let beyond = spread(&runner.beyond, 1e-3, " us");
        println!("  {:30} {beyond}", format!("{} - decisions", runner.name));
    }
}

impl Case {
    fn run(&mut self, round: usize, ticks: usize) {
        let index = CASES.iter().position(|name| *name == self.name).unwrap();
        let name = format!("bench{}-{index}{round}", std::process::id());
        let alone: Vec<String> = (0..AGENTS).map(|agent| agent.to_string()).collect();
        let together = [alone.join(",")];
        let began_ns = cpu_time_ns();
        let times = match self.name {
            FLOOR => raw(&name, ticks, 1, Waiting::Sleep),
            PATIENT => raw(&name, ticks, 1, Waiting::Patience),
            LINGERING => raw(&name, ticks, 1, Waiting::Linger),
            RAW_RUNNER => raw(&name, ticks, AGENTS, Waiting::Sleep),
            PLAIN => plain(&name, ticks),
            SOCKETS => sockets(&name, ticks),
            DOORBELL => team(&name, &alone, BellKind::Doorbell, LINGER, ticks),
            ASLEEP => team(&name, &alone, BellKind::Doorbell, Duration::ZERO, ticks),
            EVENTS => team(&name, &alone, BellKind::Event, LINGER, ticks),
            RUNNER => team(&name, &together, BellKind::Doorbell, LINGER, ticks),
            _ => team(&name, &together, BellKind::Doorbell, Duration::ZERO, ticks),
        };
        self.cpu_times.push((cpu_time_ns() - began_ns) / ticks as f64);
        let times = times.get(WARM_UP..).unwrap_or_default();
        let of = |value: fn(&Tick) -> u64| {
            median(&times.iter().map(|tick| value(tick) as f64).collect::<Vec<_>>())
        };
        self.ticks.push(of(|tick| tick.took));
        self.beyond.push(of(|tick| tick.took.saturating_sub(tick.decisions)));
    }
}

fn process(role: &str, place: &str) -> Command {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.env(ROLE, role).env(PLACE, place).stdout(Stdio::null());
    command
}

/// Runs `world` among so many processes of a kind that knows nothing of us.
fn among(kind: &str, processes: usize, place: &str, world: impl FnOnce() -> Vec<u64>) -> Vec<Tick> {
    let start = |index| process(&format!("{kind} {index}"), place).spawn().unwrap();
    let agents: Vec<Child> = (0..processes).map(start).collect();
    let times = world();
    for mut agent in agents {
        agent.wait().unwrap();
    }
    times.into_iter().map(|took| Tick { took, decisions: 0 }).collect()
}

/// Each process decides for so many agents.
fn raw(name: &str, ticks: usize, agents: usize, waiting: Waiting) -> Vec<Tick> {
    let path = PathBuf::from("/dev/shm").join(name);
    let (place, kind) = (path.to_str().unwrap(), format!("raw {agents} {}", waiting.lingers()));
    let processes = AGENTS / agents;
    let times = among(&kind, processes, place, || floor::world(&path, ticks, processes, waiting));
    std::fs::remove_file(&path).unwrap();
    times
}

fn plain(name: &str, ticks: usize) -> Vec<Tick> {
    let world = PlainWorld::open(name);
    let times = among("plain", AGENTS, name, || world.run(ticks));
    drop(world);
    plain::clean_up(name);
    times
}

fn sockets(name: &str, ticks: usize) -> Vec<Tick> {
    let path = PathBuf::from("/dev/shm").join(name);
    let socket = sockets::world_socket(&path);
    let times =
        among("sockets", AGENTS, path.to_str().unwrap(), || sockets::world(&socket, &path, ticks));
    std::fs::remove_dir_all(&path).unwrap();
    times
}

fn team(
    name: &str,
    runners: &[String],
    bell: BellKind,
    linger: Duration,
    ticks: usize,
) -> Vec<Tick> {
    let linger = Some(linger);
    let settings = WorldSettings { episodes: Some(1), bell, linger, ..WorldSettings::default() };
    let mut times = Times(Vec::with_capacity(ticks));
    run_team(name, runners, &settings, ticks, &mut times);
    times.0
}

/// Runs one episode of so many ticks in this process, with these runners as others.
fn run_team(
    name: &str,
    runners: &[String],
    settings: &WorldSettings,
    ticks: usize,
    observer: &mut dyn WorldObserver,
) -> Counters {
    let domain = Domain::new(name).unwrap();
    let start = |children: &mut Children, agents: &String| {
        let linger =
            settings.linger.map_or("unstated".into(), |linger| linger.as_nanos().to_string());
        let role = format!("runner {linger} {agents}");
        children.spawn("runner", &mut process(&role, name))
    };
    let start_team =
        |children: &mut Children| runners.iter().try_for_each(|agents| start(children, agents));
    let mut world = Idle { left: ticks };
    let (contract, stop) = (contract(), Stop::new());
    world_process(&domain, &contract, &mut world, settings, start_team, observer, &stop).unwrap()
}

/// What the processes do that the bench starts.
fn act(role: &str, place: &str) {
    let path = PathBuf::from(place);
    match *role.split(' ').collect::<Vec<_>>() {
        ["raw", agents, lingers, index] => {
            let [agents, index] = [agents, index].map(|number| number.parse().unwrap());
            floor::process(&path, agents, index, lingers.parse().unwrap());
        }
        ["plain", agent] => plain::agent(place, agent.parse().unwrap()),
        ["sockets", agent] => sockets::agent(&path, agent.parse().unwrap()),
        ["runner", linger_ns, agents] => {
            run_agents(agents, place, linger_ns.parse().ok().map(Duration::from_nanos));
        }
        _ => panic!("no role of this bench: {role}"),
    }
}

fn run_agents(agents: &str, domain: &str, linger: Option<Duration>) {
    let agents: Vec<u16> = agents.split(',').map(|agent| agent.parse().unwrap()).collect();
    let domain = Domain::new(domain).unwrap();
    let settings = ProcessSettings { linger, ..ProcessSettings::default() };
    let stop = Stop::new();
    runner_process(&domain, &contract(), &agents, &mut Slow, &settings, &stop).unwrap();
}

fn contract() -> DomainContract {
    DomainContract { hash: 1, decision_interval: 10, safe_action: Some(0), ..Default::default() }
}

/// Reads a frame: every word, at the speed of memory.
fn read(frame: &[u64; FRAME_WORDS]) {
    std::hint::black_box(frame.iter().fold(0, |sum, word| sum ^ word));
}

/// Spends the time of so many decisions.
fn decide(decisions: u32) {
    let started = Instant::now();
    while started.elapsed() < DECISION * decisions {
        std::hint::spin_loop();
    }
}

/// Everybody sees everything, nothing ever happens.
struct Idle {
    left: usize,
}

impl World for Idle {
    fn shape(&self) -> Shape {
        SHAPE
    }

    fn reset(&mut self) {}

    fn observe(&self, frame: &mut FrameMut<'_>) {
        let all = EntityMask::first(SHAPE.entities);
        frame.set_present(&all);
        for entity in 0..SHAPE.entities {
            frame.row_mut(entity).fill(self.left as f32);
        }
        for agent in 0..AGENTS {
            frame.set_observable(agent, &all);
            frame.available_mut(agent).fill(1);
        }
    }

    fn step(&mut self, _: &[u16]) -> Result<StepOutcome, UnavailableAction> {
        self.left -= 1;
        Ok(StepOutcome { episode_ended: self.left == 0, tasks_changed: false })
    }
}

/// Decides in the stated time.
struct Slow;

impl Policy for Slow {
    fn actions(&self) -> usize {
        SHAPE.actions
    }

    fn utilities(&mut self, _: &Observation<'_>, _: &mut [f32]) -> Result<(), DecideError> {
        Ok(())
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        // Reads the frame as the floor does: every word, at the speed of memory.
        let read = observation.rows.iter().fold(0, |bits, feature| bits ^ feature.to_bits());
        decide(1);
        Ok(Decision { action: 0, utility: f32::from_bits(read) })
    }
}

struct Times(Vec<Tick>);

impl WorldObserver for Times {
    fn tick(&mut self, report: &TickReport<'_>) {
        let decisions = report.answers().map(|answer| u64::from(answer.decide_ns)).sum();
        self.0.push(Tick { took: report.tick_ns, decisions });
    }
}
