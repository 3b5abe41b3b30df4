//! `sortie control`: tells the processes of a running team, or the server of a policy, what to do.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};
use serde::Serialize;
use sortie_core::wire::{Command, ControlStatus};
use sortie_ipc::{Answer, Domain, Order, control, model_text};

use crate::failure::{Exit, Failure, Outcome};
use crate::foreign::ENGINE;
use crate::output::{print_json, say};
use crate::swap::{self, SwapArguments};

/// Tell the processes of a running team what to do: say who they are, pause, continue, end, change the leader
///
/// The server of a policy says who it is, and ends.
/// Prints a line for each process that the order concerns. Exit code 69 where none runs, or none can do it.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie control info
  sortie control pause --domain north
  sortie control step-down --json
  sortie control reload models/save-the-city-large
  sortie control swap models/save-the-city-large --shadow 30s --at next-episode --back-if fallbacks,disagreement=0.3
  sortie control log-level warn --process 4711")]
pub(crate) struct ControlArguments {
    #[command(subcommand)]
    order: OrderArgument,
    /// Domain of the team
    #[arg(long, env = "SORTIE_DOMAIN", default_value = "default", global = true)]
    domain: String,
    /// Process that is meant; default: every one that the order concerns
    #[arg(long, value_name = "PID", global = true)]
    process: Option<u32>,
    /// Print JSON for scripts instead of text
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Clone, Debug, Subcommand)]
enum OrderArgument {
    /// Who is there: role, process, tick, agents, model, who leads
    Info,
    /// The world stands still after its current tick
    Pause,
    /// A paused world goes on
    Resume,
    /// The world gives up its episode and begins the next
    ResetEpisode,
    /// The world ends, and its team with it; so does the server of a policy
    ShutDown,
    /// The leading allocator lets a standby lead
    StepDown,
    /// Runners and allocators go on with another bundle of the same contract, all at the next tick or none
    Reload {
        /// Folder of the bundle, beside that of the bundle in use: processes are told its name only
        bundle: PathBuf,
    },
    /// Reload with more say: watched first, from which tick on, and when to turn back
    Swap(SwapArguments),
    /// What the messaging library may say on standard error
    LogLevel {
        #[arg(value_enum)]
        level: Level,
    },
}

/// The levels of the log, with their numbers on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Level {
    Trace = 0,
    Debug = 1,
    Info = 2,
    Warn = 3,
    Error = 4,
    Fatal = 5,
}

impl OrderArgument {
    /// A change of bundle, which is more than one order.
    fn swap(&self) -> Option<SwapArguments> {
        match self {
            Self::Reload { bundle } => Some(SwapArguments::plain(bundle.clone())),
            Self::Swap(arguments) => Some(arguments.clone()),
            _ => None,
        }
    }

    fn order(&self, process: Option<u32>) -> Order {
        let (command, number) = match self {
            Self::Info => (Command::Info, 0),
            Self::Pause => (Command::Pause, 0),
            Self::Resume => (Command::Resume, 0),
            Self::ResetEpisode => (Command::ResetEpisode, 0),
            Self::ShutDown => (Command::ShutDown, 0),
            Self::StepDown => (Command::StepDown, 0),
            Self::Reload { .. } | Self::Swap(_) => (Command::SwapBundle, 0),
            Self::LogLevel { level } => (Command::SetLogLevel, *level as u64),
        };
        Order { process, number, ..Order::new(command) }
    }
}

pub(crate) fn run(arguments: &ControlArguments) -> Outcome {
    let domain = Domain::new(&arguments.domain)?;
    if let Some(swap) = arguments.order.swap() {
        if arguments.process.is_some() {
            let message = "a team changes its bundle as a whole: leave out --process";
            return Err(Failure::new(Exit::Usage, message));
        }
        return swap::run(&swap, &domain, arguments.json);
    }
    let order = arguments.order.order(arguments.process);
    let answers = control(&domain, &order)?;
    if arguments.json {
        let processes = answers.iter().map(ToldProcess::new).collect();
        print_json(&Told { domain: domain.id(), processes });
    } else {
        answers.iter().for_each(|answer| say!("{}", line(answer)));
    }
    judge(&answers)
}

/// Whether the order was carried out by somebody.
fn judge(answers: &[Answer]) -> Outcome {
    let has = |status| answers.iter().any(|answer| answer.status == Some(status));
    if has(ControlStatus::Done) {
        return Ok(());
    }
    Err(if has(ControlStatus::Foreign) {
        Failure::new(Exit::Mismatch, "version, contract or sizes do not fit")
    } else if has(ControlStatus::BadArgument) {
        Failure::new(Exit::Missing, "there is nothing of this name, or it cannot be read")
    } else {
        Failure::new(Exit::NotRunning, "no process that could do it has answered")
    })
}

fn line(answer: &Answer) -> String {
    let process = &answer.process;
    let mut line = format!("{} {}", process.role.name(), process.pid);
    let tick = answer.tick as u32;
    line += &match (process.serves, answer.tick) {
        (false, 0) => ", no tick yet".to_string(),
        (false, _) => format!(", tick {tick}"),
        (true, 0) => ", serves a policy, no observation yet".to_string(),
        (true, _) => format!(", serves a policy, observation {tick}"),
    };
    if process.agents != 0 {
        line += &format!(", agents {}", listed(process.agents));
    }
    if process.absent != 0 {
        let (absent, since) = (listed(process.absent), process.absent_since as u32);
        line += &format!(", absent {absent} since tick {since}");
    }
    if process.model != [0; 16] {
        line += &format!(", model {:.8}", model(answer));
    }
    if process.generation != 0 {
        line += &format!(", generation {}", process.generation);
    }
    if let Some(term) = process.term {
        line += &format!(", leads in term {term}");
    }
    for (word, is_so) in [("paused", process.is_paused), ("degraded", process.is_degraded)] {
        if is_so {
            line += &format!(", {word}");
        }
    }
    if process.is_graph {
        line += &format!(", by {ENGINE}");
    }
    match answer.status {
        Some(ControlStatus::Done) => line,
        other => line + ": " + outcome(other),
    }
}

fn outcome(status: Option<ControlStatus>) -> &'static str {
    match status {
        Some(ControlStatus::Done) => "done",
        Some(ControlStatus::NotMine) => "does not concern it",
        Some(ControlStatus::NotSupported) => "not supported",
        Some(ControlStatus::Foreign) => "of another version or contract, or too small",
        Some(ControlStatus::BadArgument) => "no such value",
        Some(ControlStatus::Outdated) => "another change of the bundle has come before",
        None => "answers what only a later version knows",
    }
}

/// The agents of these bits.
fn agents(seats: u64) -> Vec<u16> {
    (0..u64::BITS as u16).filter(|agent| seats >> agent & 1 == 1).collect()
}

fn listed(seats: u64) -> String {
    agents(seats).iter().map(u16::to_string).collect::<Vec<_>>().join(" ")
}

fn model(answer: &Answer) -> String {
    model_text(answer.process.model)
}

/// What was answered, for scripts.
#[derive(Serialize)]
struct Told<'a> {
    domain: &'a str,
    processes: Vec<ToldProcess>,
}

#[derive(Serialize)]
struct ToldProcess {
    role: &'static str,
    pid: u32,
    outcome: &'static str,
    /// The world's term in the upper half.
    tick: u64,
    agents: Vec<u16>,
    /// Agents of a world for which nobody acts, and the tick since when for the first of them.
    absent: Vec<u16>,
    absent_since: Option<u64>,
    model: String,
    /// How often the team has changed its bundle.
    generation: u16,
    term: Option<u32>,
    leads: bool,
    paused: bool,
    degraded: bool,
    /// Whether it serves a policy; its tick is then the number of an observation.
    serves: bool,
    /// What runs its network's graph, where that is no plan.
    engine: Option<&'static str>,
}

impl ToldProcess {
    fn new(answer: &Answer) -> Self {
        let process = &answer.process;
        Self {
            role: process.role.name(),
            pid: process.pid,
            outcome: outcome(answer.status),
            tick: answer.tick,
            agents: agents(process.agents),
            absent: agents(process.absent),
            absent_since: (process.absent != 0).then_some(process.absent_since),
            model: model(answer),
            generation: process.generation,
            term: process.term,
            leads: process.term.is_some(),
            paused: process.is_paused,
            degraded: process.is_degraded,
            serves: process.serves,
            engine: process.is_graph.then_some(ENGINE),
        }
    }
}

#[cfg(test)]
mod tests {
    use sortie_core::wire::Role;
    use sortie_ipc::ProcessInfo;

    use super::*;

    fn answer(status: ControlStatus) -> Answer {
        let process = ProcessInfo {
            role: Role::World,
            pid: 7,
            agents: 0b101,
            absent: 0,
            absent_since: 0,
            model: [0; 16],
            term: Some(2),
            is_paused: true,
            is_degraded: false,
            serves: false,
            is_graph: false,
            generation: 0,
            candidate: sortie_ipc::Candidate::None,
        };
        Answer { process, status: Some(status), tick: (2 << 32) + 30 }
    }

    #[test]
    fn a_line_says_who_answers_and_what_became_of_it() {
        let done = answer(ControlStatus::Done);
        assert_eq!(line(&done), "world 7, tick 30, agents 0 2, leads in term 2, paused");
        let (absent, absent_since) = (0b11_0000, (2 << 32) + 12);
        let without =
            Answer { process: ProcessInfo { absent, absent_since, ..done.process }, ..done };
        let told =
            "world 7, tick 30, agents 0 2, absent 4 5 since tick 12, leads in term 2, paused";
        assert_eq!(line(&without), told);
        let other = Answer { tick: 0, ..answer(ControlStatus::NotSupported) };
        let other = Answer {
            process: ProcessInfo { model: [0xAB; 16], term: None, ..other.process },
            ..other
        };
        let told = "world 7, no tick yet, agents 0 2, model abababab, paused: not supported";
        assert_eq!(line(&other), told);
        let process = ProcessInfo {
            role: Role::Runner,
            agents: 0,
            serves: true,
            is_graph: true,
            is_paused: false,
            ..other.process
        };
        let serves = Answer { process, tick: 9, status: Some(ControlStatus::Done) };
        let told = "runner 7, serves a policy, observation 9, model abababab, by tract: allocates, no promise about \
                    bits or time";
        assert_eq!(line(&serves), told);
    }

    #[test]
    fn somebody_has_to_do_it() {
        let [done, unable, foreign] =
            [ControlStatus::Done, ControlStatus::NotSupported, ControlStatus::Foreign].map(answer);
        assert!(judge(&[unable, done]).is_ok());
        let exit = |answers: &[Answer]| judge(answers).map_err(|failure| failure.exit);
        assert_eq!(exit(&[]), Err(Exit::NotRunning));
        assert_eq!(exit(&[unable]), Err(Exit::NotRunning));
        assert_eq!(exit(&[unable, foreign]), Err(Exit::Mismatch));
    }
}
