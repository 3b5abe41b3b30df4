//! `sortie bench faults`: a storm of kills over a team under load.

mod storm;

use std::process::{Command, Stdio};
use std::time::Duration;

use clap::Args;
use serde::Serialize;
use sortie_ipc::Domain;

use sortie_cli::failure::{Exit, Failure, Outcome};
use sortie_cli::latency::{Latency, Percentiles};
use sortie_cli::options::Common;
use sortie_cli::output::{Table, print_json, say};
use sortie_cli::signals::stop_on_signals;
use storm::{StormReport, StormSettings, raise_storm, storm_process};

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
