//! The tick of a team of eight processes: raw shared memory and futexes, our messages with the
//! doorbell, and with events; and one runner for all agents. Rounds alternate; ratios are paired.
//!
//! `cargo bench -p sortie-ipc --bench tick [-- ROUNDS TICKS]`

mod floor;

use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use sortie_core::roles::{TickReport, WorldObserver};
use sortie_core::wire::FrameMut;
use sortie_core::{
    DecideError, Decision, EntityMask, Observation, Policy, Shape, StepOutcome, UnavailableAction,
    World,
};
use sortie_ipc::{
    BellKind, Children, Domain, DomainContract, ProcessSettings, Stop, WorldSettings,
    runner_process, world_process,
};

const AGENTS: usize = 8;
const SHAPE: Shape = Shape { agents: AGENTS, entities: 16, tasks: 4, actions: 14, features: 58 };
/// Time of one decision.
const DECISION: Duration = Duration::from_micros(2);
/// Ticks of a round before the first that counts.
const WARM_UP: usize = 100;
const ROLE: &str = "SORTIE_BENCH_ROLE";
const PLACE: &str = "SORTIE_BENCH_PLACE";

fn main() {
    if let Ok(role) = std::env::var(ROLE) {
        return act(&role, &std::env::var(PLACE).unwrap());
    }
    let mut numbers = std::env::args().filter_map(|argument| argument.parse::<usize>().ok());
    let rounds = numbers.next().unwrap_or(15);
    let ticks = numbers.next().unwrap_or(2_000);
    let cases = ["raw floor", "doorbell", "events", "one runner"];
    let mut medians = [const { Vec::new() }; 4];
    for round in 0..rounds {
        for (case, medians) in medians.iter_mut().enumerate() {
            medians.push(median(&run(case, round, ticks)));
        }
    }
    println!("tick of {AGENTS} agents that decide in {DECISION:?}, {rounds} rounds of {ticks}:");
    for (case, medians) in cases.iter().zip(&medians) {
        println!("  {case:11} p50 {}", spread(medians, 1e-3, " us"));
    }
    let [floor, doorbell, events, runner] = &medians;
    println!("  doorbell / raw floor   {}", spread(&ratios(doorbell, floor), 1.0, ""));
    println!("  events / doorbell      {}", spread(&ratios(events, doorbell), 1.0, ""));
    let decisions = AGENTS as f64 * DECISION.as_nanos() as f64;
    let beyond: Vec<f64> = runner.iter().map(|tick| tick - decisions).collect();
    println!("  one runner - decisions {}", spread(&beyond, 1e-3, " us"));
}

/// Runs one case and returns its tick times in nanoseconds.
fn run(case: usize, round: usize, ticks: usize) -> Vec<f64> {
    let name = format!("bench{}-{case}{round}", std::process::id());
    let alone: Vec<String> = (0..AGENTS).map(|agent| agent.to_string()).collect();
    let times = match case {
        0 => raw(&name, ticks),
        1 => team(&name, &alone, BellKind::Doorbell, ticks),
        2 => team(&name, &alone, BellKind::Event, ticks),
        _ => team(&name, &[alone.join(",")], BellKind::Doorbell, ticks),
    };
    times.iter().skip(WARM_UP).map(|&time| time as f64).collect()
}

fn process(role: &str, place: &str) -> Command {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.env(ROLE, role).env(PLACE, place).stdout(Stdio::null());
    command
}

fn raw(name: &str, ticks: usize) -> Vec<u64> {
    let path = PathBuf::from("/dev/shm").join(name);
    let place = path.to_str().unwrap();
    let agents: Vec<Child> =
        (0..AGENTS).map(|agent| process(&format!("raw {agent}"), place).spawn().unwrap()).collect();
    let times = floor::world(&path, ticks);
    for mut agent in agents {
        agent.wait().unwrap();
    }
    std::fs::remove_file(&path).unwrap();
    times
}

fn team(name: &str, runners: &[String], bell: BellKind, ticks: usize) -> Vec<u64> {
    let domain = Domain::new(name).unwrap();
    let settings = WorldSettings { episodes: Some(1), bell, ..WorldSettings::default() };
    let start_team = |children: &mut Children| {
        runners.iter().try_for_each(|runner| children.spawn("runner", &mut process(runner, name)))
    };
    let mut world = Idle { left: ticks };
    let mut times = Times(Vec::with_capacity(ticks));
    let (contract, stop) = (contract(), Stop::new());
    world_process(&domain, &contract, &mut world, &settings, start_team, &mut times, &stop)
        .unwrap();
    times.0
}

/// What the processes do that the bench starts.
fn act(role: &str, place: &str) {
    if let Some(agent) = role.strip_prefix("raw ") {
        return floor::agent(&PathBuf::from(place), agent.parse().unwrap());
    }
    let agents: Vec<u16> = role.split(',').map(|agent| agent.parse().unwrap()).collect();
    let domain = Domain::new(place).unwrap();
    let (settings, stop) = (ProcessSettings::default(), Stop::new());
    runner_process(&domain, &contract(), &agents, &mut Slow, &settings, &stop).unwrap();
}

fn contract() -> DomainContract {
    DomainContract { hash: 1, decision_interval: 10, safe_action: Some(0), ..Default::default() }
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

struct Times(Vec<u64>);

impl WorldObserver for Times {
    fn tick(&mut self, report: &TickReport<'_>) {
        self.0.push(report.tick_ns);
    }
}

fn quantile(sorted: &[f64], q: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * q).round() as usize]
}

fn sorted(values: &[f64]) -> Vec<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted
}

fn median(values: &[f64]) -> f64 {
    quantile(&sorted(values), 0.5)
}

fn ratios(values: &[f64], of: &[f64]) -> Vec<f64> {
    values.iter().zip(of).map(|(value, of)| value / of).collect()
}

/// Median and interquartile range.
fn spread(values: &[f64], scale: f64, unit: &str) -> String {
    let sorted = sorted(values);
    let [low, middle, high] = [0.25, 0.5, 0.75].map(|q| quantile(&sorted, q) * scale);
    format!("{middle:.2}{unit} ({low:.2} to {high:.2})")
}
