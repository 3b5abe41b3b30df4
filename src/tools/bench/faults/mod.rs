//! `sortie bench faults`: a storm of kills over a team under load.
//!
//! The processes of a supervised team are killed at random times, again and again, while everything that passes is checked.

mod blows;
mod team;

use std::process::{Command, Stdio};
use std::time::Duration;

use clap::Args;
use serde::Serialize;
use sortie_cli::failure::{Exit, Failure, Outcome};
use sortie_cli::latency::{Latency, Percentiles};
use sortie_cli::output::{Common, Table, print_json, say};
use sortie_cli::terminal::stop_on_signals;
use sortie_core::wire::Role;
use sortie_ipc::{
    Charge, Domain, Error, ProcessSettings, RestartPolicy, Stop, WorldSettings, allocator_process,
    runner_process, supervise, world_process,
};

use blows::Blows;
use team::{Checks, StormAllocator, StormPolicy, StormWorld};

/// Kill runners and leading allocators of a team under load, at random times
///
/// Prints how long it takes until somebody has taken their place, and whether anything was torn, wrong or left
/// behind, which is a failure.
#[derive(Debug, Args)]
pub(super) struct FaultsArguments {
    /// Runners to kill
    #[arg(long, default_value_t = 1_000)]
    runner_kills: u32,
    /// Leading allocators to kill
    #[arg(long, default_value_t = 200)]
    allocator_kills: u32,
    /// Ticks a second
    #[arg(long, default_value_t = 500.0, value_name = "HZ")]
    rate: f64,
    /// Process of the team that this one is
    #[arg(long, hide = true)]
    role: Option<String>,
    /// Domain of the team
    #[arg(long, hide = true)]
    domain: Option<String>,
    #[command(flatten)]
    common: Common,
}

/// What a storm found, for scripts.
#[derive(Debug, Serialize)]
struct Found {
    takeovers: usize,
    takeover_us: Percentiles,
    rejoins: usize,
    rejoin_us: Percentiles,
    ticks: u64,
    ticks_with_fallback: u64,
    torn_frames: u64,
    wrong_assignments: u64,
    old_terms: u64,
    leaked_segments: u64,
}

pub(super) fn run(arguments: &FaultsArguments) -> Outcome {
    let stop = stop_on_signals()?;
    let id = format!("faults-{}", std::process::id());
    let domain = Domain::new(arguments.domain.as_deref().unwrap_or(&id))?;
    if let Some(role) = &arguments.role {
        return Ok(storm_process(&domain, role, &stop)?);
    }
    if arguments.runner_kills == 0 && arguments.allocator_kills == 0 {
        let message = "nothing to kill: `--runner-kills` and `--allocator-kills` are both 0";
        return Err(Failure::new(Exit::Usage, message));
    }
    let settings = StormSettings {
        runner_kills: arguments.runner_kills,
        allocator_kills: arguments.allocator_kills,
        period: Duration::from_secs_f64(1.0 / arguments.rate.clamp(1.0, 1e5)),
        seed: arguments.common.seed,
    };
    let child = |role: &str| {
        let mut command = Command::new("/proc/self/exe");
        command.args(["bench", "faults", "--role", role, "--domain", &id]);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        command
    };
    let found = Found::new(&raise_storm(&domain, &settings, &child, &stop)?);
    if arguments.common.json {
        print_json(&found);
    } else {
        found.print();
    }
    found.judge()
}

fn latency(times_ns: &[u64]) -> Latency {
    let mut latency = Latency::default();
    times_ns.iter().for_each(|&time| latency.record_ns(time));
    latency
}

impl Found {
    fn new(report: &StormReport) -> Self {
        Self {
            takeovers: report.takeover_ns.len(),
            takeover_us: latency(&report.takeover_ns).percentiles(),
            rejoins: report.rejoin_ns.len(),
            rejoin_us: latency(&report.rejoin_ns).percentiles(),
            ticks: report.ticks,
            ticks_with_fallback: report.ticks_with_fallback,
            torn_frames: report.torn_frames,
            wrong_assignments: report.wrong_assignments,
            old_terms: report.old_terms,
            leaked_segments: report.leaked + report.left_behind,
        }
    }

    fn faults(&self) -> [(&'static str, u64); 4] {
        [
            ("torn frames", self.torn_frames),
            ("wrong assignments", self.wrong_assignments),
            ("old terms", self.old_terms),
            ("leaked segments", self.leaked_segments),
        ]
    }

    fn print(&self) {
        let mut table = Table::new(&["milliseconds after the kill", "p50", "p99", "max", "kills"]);
        let rows = [
            ("the next leader's first allocation", self.takeover_us, self.takeovers),
            ("the next runner's first action", self.rejoin_us, self.rejoins),
        ];
        for (name, us, kills) in rows {
            let ms = |us: f64| match kills {
                0 => "-".to_owned(),
                _ => format!("{:.2}", us / 1e3),
            };
            table.row([name.to_string(), ms(us.p50), ms(us.p99), ms(us.max), kills.to_string()]);
        }
        table.print();
        say!("\n{} ticks, {} with a fallback action", self.ticks, self.ticks_with_fallback);
        let faults = self.faults().map(|(name, count)| format!("{count} {name}"));
        say!("{}", faults.join(", "));
    }

    fn judge(&self) -> Outcome {
        match self.faults().into_iter().find(|(_, count)| *count > 0) {
            Some((name, count)) => {
                Err(Failure::difference(format!("{count} {name}, none allowed")))
            }
            None => Ok(()),
        }
    }
}

/// How long and how hard.
#[derive(Clone, Copy, Debug)]
struct StormSettings {
    runner_kills: u32,
    allocator_kills: u32,
    /// Time from frame to frame.
    period: Duration,
    /// Decides who is killed, and when.
    seed: u64,
}

/// What a storm found. All but the times and the first three numbers are to be 0.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct StormReport {
    /// From the kill of a leading allocator to the first allocation of the next, in nanoseconds, sorted.
    takeover_ns: Vec<u64>,
    /// From the kill of a runner to the first action of its successor, in nanoseconds, sorted.
    rejoin_ns: Vec<u64>,
    ticks: u64,
    /// Ticks in which an agent played the fallback action.
    ticks_with_fallback: u64,
    /// Decisions on a frame that was not whole, or not the one answered.
    torn_frames: u64,
    /// Subtasks that are not those of the allocation stated, or of the frame that it was made from.
    wrong_assignments: u64,
    /// Allocations of an older term or epoch than the same process had acted on.
    old_terms: u64,
    /// Objects in shared memory that the dead left behind, while the others live.
    leaked: u64,
    /// Objects in shared memory after the end.
    left_behind: u64,
}

/// Raises a storm over `domain`, with the world in this process. `child` starts a process that calls
/// [`storm_process`] with the role given.
///
/// # Errors
/// A process fails other than by being killed, or a signal came.
fn raise_storm(
    domain: &Domain,
    settings: &StormSettings,
    child: &(dyn Fn(&str) -> Command + Sync),
    stop: &Stop,
) -> Result<StormReport, Error> {
    let over = Stop::new();
    let mut world = StormWorld::default();
    let checks = Checks::new(world.number.clone());
    let mut blows = Blows::new(domain, settings, checks, [stop.clone(), over.clone()]);
    let world_settings = WorldSettings {
        allocator: true,
        strict: false,
        period: settings.period,
        ..WorldSettings::default()
    };
    // Those that are killed are to come back at once.
    let policy = RestartPolicy { immediate: Duration::ZERO, ..RestartPolicy::default() };
    let ended = std::thread::scope(|scope| {
        let (over, world_over) = (over.clone(), blows.stop());
        let supervisor = scope.spawn(move || {
            let ended = supervise(domain, charges(child), &policy, &mut |_| {}, &over);
            world_over.stop();
            ended
        });
        let contract = team::contract();
        let stop = blows.stop();
        let start = |_: &mut _| Ok(());
        let played =
            world_process(domain, &contract, &mut world, &world_settings, start, &mut blows, &stop);
        blows.end();
        let kept = supervisor.join().unwrap_or(Err(Error::Stalled));
        first_failure(played.map(drop), kept.map(drop))
    });
    if !blows.is_done() {
        return Err(ended.err().unwrap_or(Error::Interrupted));
    }
    ended?;
    let left_behind = domain.shared_memory()?.len() as u64;
    Ok(StormReport { left_behind, ..blows.report() })
}

/// What both ended with, where being told to end counts as success.
fn first_failure(played: Result<(), Error>, kept: Result<(), Error>) -> Result<(), Error> {
    for ended in [kept, played] {
        match ended {
            Ok(()) | Err(Error::Interrupted) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// Two runners, a leading allocator and a standby.
fn charges(child: &dyn Fn(&str) -> Command) -> Vec<Charge> {
    let charge = |name: &str, role, agents: &[usize]| Charge {
        name: name.to_string(),
        role,
        agents: agents.iter().fold(0, |seats, agent| seats | 1 << agent),
        command: child(name),
    };
    vec![
        charge("runner 0,2", Role::Runner, &[0, 2]),
        charge("runner 1,3", Role::Runner, &[1, 3]),
        charge("allocator 0", Role::Allocator, &[]),
        charge("allocator 1", Role::Allocator, &[]),
    ]
}

/// A process of a storm, by the name that [`raise_storm`] gives it.
///
/// # Errors
/// As [`runner_process`] and [`allocator_process`]; an unknown name.
fn storm_process(domain: &Domain, name: &str, stop: &Stop) -> Result<(), Error> {
    let (contract, settings) = (team::contract(), ProcessSettings::default());
    let Some(("runner", agents)) = name.split_once(' ') else {
        let ended = allocator_process(domain, &contract, &mut StormAllocator, &settings, stop);
        return ended.map(drop);
    };
    let agents: Vec<u16> = agents.split(',').filter_map(|agent| agent.parse().ok()).collect();
    runner_process(domain, &contract, &agents, &mut StormPolicy, &settings, stop).map(drop)
}
