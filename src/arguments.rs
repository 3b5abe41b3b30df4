//! The grammar of the command line: `sortie VERB [SUBJECT] [--flags]`.

use clap::{Args, Parser, Subcommand, ValueEnum};
use sortie_envs::save_the_city::AllocationRule;

use crate::failure::Outcome;
use crate::{
    bench, compare, compile, compiler, control, doctor, eval, export, inspect, replay, run, train,
    verify, view,
};

const EXIT_CODES: &str = "\
Exit codes: 0 done, 1 a check found a difference, 2 wrong use, 3 training diverged, 65 bad data,
66 file missing, 69 something needed is not running, 70 a fault of this program,
74 input or output failed, 75 busy (another instance), 77 not permitted, 78 contract or version do not fit, 130 interrupted,
141 the reader of standard output has gone.";

/// Teams of learned agents, from training to deployment.
#[derive(Debug, Parser)]
#[command(name = "sortie", version, about, after_help = EXIT_CODES, max_term_width = 100)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    Run(run::RunArguments),
    Up(run::up::UpArguments),
    Control(control::ControlArguments),
    Doctor(doctor::DoctorArguments),
    Eval(eval::EvalArguments),
    Replay(replay::ReplayArguments),
    Train(train::TrainArguments),
    Compare(compare::CompareArguments),
    Export(export::ExportArguments),
    Compile(compile::CompileArguments),
    Inspect(inspect::InspectArguments),
    Verify(verify::VerifyArguments),
    Bench(bench::BenchArguments),
    View(view::ViewArguments),
    #[command(hide = true)]
    Compiler(compiler::CompilerArguments),
    #[command(hide = true)]
    Process(run::process::ProcessArguments),
}

/// What every verb takes.
#[derive(Clone, Copy, Debug, Args)]
pub(crate) struct Common {
    /// Print JSON for scripts instead of text
    #[arg(long)]
    pub(crate) json: bool,
    /// Seed of every random choice
    #[arg(long, default_value_t = 1)]
    pub(crate) seed: u64,
    /// No progress, no notes
    #[arg(short, long)]
    pub(crate) quiet: bool,
}

/// A hand-written rule that assigns agents to subtasks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Allocation {
    /// One agent after the other, by travel time, urgency and who is there already
    Coordinated,
    /// Every agent for itself, the nearest subtask of the kind it prefers
    Heuristic,
    /// Every agent an open subtask at random
    Random,
}

impl Allocation {
    pub(crate) fn rule(self) -> AllocationRule {
        match self {
            Self::Coordinated => AllocationRule::Coordinated,
            Self::Heuristic => AllocationRule::Heuristic,
            Self::Random => AllocationRule::Random,
        }
    }

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Coordinated => "coordinated",
            Self::Heuristic => "heuristic",
            Self::Random => "random",
        }
    }
}

/// Who assigns agents to subtasks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum AllocatorChoice {
    /// What the team has learned: the best allocation by a network that values teams
    Learned,
    /// One agent after the other, by travel time, urgency and who is there already
    Coordinated,
    /// Every agent for itself, the nearest subtask of the kind it prefers
    Heuristic,
    /// Every agent an open subtask at random
    Random,
}

impl AllocatorChoice {
    /// What was asked for, else the learned allocator where there is one.
    pub(crate) fn or_default(asked: Option<Self>, is_learned: bool) -> Self {
        asked.unwrap_or(if is_learned { Self::Learned } else { Self::Coordinated })
    }

    /// The rule, if it is one.
    pub(crate) fn rule(self) -> Option<AllocationRule> {
        match self {
            Self::Learned => None,
            Self::Coordinated => Some(AllocationRule::Coordinated),
            Self::Heuristic => Some(AllocationRule::Heuristic),
            Self::Random => Some(AllocationRule::Random),
        }
    }

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Learned => "learned",
            Self::Coordinated => "coordinated",
            Self::Heuristic => "heuristic",
            Self::Random => "random",
        }
    }
}

pub(crate) fn dispatch(arguments: Arguments) -> Outcome {
    match arguments.verb {
        Verb::Run(arguments) => run::run(&arguments),
        Verb::Up(arguments) => run::up::run(&arguments),
        Verb::Control(arguments) => control::run(&arguments),
        Verb::Doctor(arguments) => doctor::run(&arguments),
        Verb::Eval(arguments) => eval::run(&arguments),
        Verb::Replay(arguments) => replay::run(&arguments),
        Verb::Train(arguments) => train::run(&arguments),
        Verb::Compare(arguments) => compare::run(&arguments),
        Verb::Export(arguments) => export::run(&arguments),
        Verb::Compile(arguments) => compile::run(&arguments),
        Verb::Inspect(arguments) => inspect::run(&arguments),
        Verb::Verify(arguments) => verify::run(&arguments),
        Verb::Bench(arguments) => bench::run(&arguments),
        Verb::View(arguments) => view::run(&arguments),
        Verb::Compiler(arguments) => compiler::run(&arguments),
        Verb::Process(arguments) => run::process::run(&arguments),
    }
}
