//! The grammar of the command line: `sortie VERB [SUBJECT] [--flags]`, and what prints it for shells and readers.

use std::ffi::OsString;
use std::fs;
use std::path::PathBuf;

use clap::{
    ArgMatches, Args, ColorChoice, Command, CommandFactory, FromArgMatches, Parser, Subcommand,
    error,
};
use clap_complete::{Shell, generate};

use crate::failure::{Failure, Outcome};
use crate::output::say;
use crate::terminal::Color;
use crate::tools::{self, prefer_tools};
use crate::{
    Program, bridge, compare, control, doctor, eval, export, inspect, join, record, remake, replay,
    reproduce, run, serve, sign, top, train, view,
};

const EXIT_CODES: &str = "\
Exit codes: 0 done, 1 a check found a difference, 2 wrong use, 3 training diverged, 65 bad data,
66 file missing, 69 something needed is not running, 70 a fault of this program,
74 input or output failed, 75 busy (another instance), 77 not permitted, 78 contract or version do not fit, 130 interrupted,
141 the reader of standard output has gone.";

/// Where in the list of verbs stands what is seldom asked for.
const LAST: usize = 100;
const ABOUT: &str = "Teams of learned agents, from training to deployment";

/// The whole command line.
#[derive(Debug, Parser)]
#[command(name = "sortie", about = ABOUT, after_help = EXIT_CODES, max_term_width = 100)]
struct Arguments {
    #[command(subcommand)]
    verb: Verb,
    /// When to use colours
    #[arg(long, global = true, value_enum, value_name = "WHEN", default_value_t)]
    color: Color,
}

/// What is asked for.
pub(crate) enum Asked {
    /// A verb of this crate.
    Here(Box<Verb>),
    /// One of [`tools::VERBS`], and its words.
    Tool(String, ArgMatches),
}

/// Reads a command line, its program's name first.
///
/// # Errors
/// It is wrong, or asks for help or the version.
pub(crate) fn read(program: &Program, words: &[OsString]) -> Result<Asked, error::Error> {
    let mut matches = command(program).color(color(words)).try_get_matches_from(words)?;
    if let Some(color) = matches.get_one::<Color>("color") {
        color.apply();
    }
    let verb = matches.subcommand_name().unwrap_or_default();
    if tools::VERBS.iter().any(|(known, _)| *known == verb)
        && let Some((verb, matches)) = matches.remove_subcommand()
    {
        return Ok(Asked::Tool(verb, matches));
    }
    Ok(Asked::Here(Box::new(Arguments::from_arg_matches(&matches)?.verb)))
}

/// The grammar, as it is parsed, completed and printed.
fn command(program: &Program) -> Command {
    let own = Arguments::command().version(program.version).long_version(program.built);
    with_negative_numbers(own.subcommands(tools::VERBS.map(tools::grammar)))
}

/// A negative number is the value of the flag before it, so that the error speaks of that flag.
fn with_negative_numbers(command: Command) -> Command {
    let option = |argument: clap::Arg| match argument.get_long() {
        Some(_) if argument.get_action().takes_values() => argument.allow_negative_numbers(true),
        _ => argument,
    };
    command.mut_args(option).mut_subcommands(with_negative_numbers)
}

/// What `--color` says, for errors of the command line itself, which come before it is read.
fn color(words: &[OsString]) -> ColorChoice {
    let mut words = words.iter().map(|word| word.to_string_lossy());
    while let Some(word) = words.next() {
        let choice = match word.strip_prefix("--color") {
            Some("") => words.next(),
            Some(choice) => choice.strip_prefix('=').map(|choice| choice.to_owned().into()),
            None => None,
        };
        match choice.as_deref() {
            Some("always") => return ColorChoice::Always,
            Some("never") => return ColorChoice::Never,
            _ => {}
        }
    }
    ColorChoice::Auto
}

/// The verbs that both programs have.
#[derive(Debug, Subcommand)]
pub(crate) enum Verb {
    Run(run::RunArguments),
    Up(run::up::UpArguments),
    Join(join::JoinArguments),
    Serve(serve::ServeArguments),
    Control(control::ControlArguments),
    Doctor(doctor::DoctorArguments),
    Top(top::TopArguments),
    Record(record::RecordArguments),
    Bridge(bridge::BridgeArguments),
    Remake(remake::RemakeArguments),
    Why(remake::why::WhyArguments),
    Sign(sign::SignArguments),
    Eval(eval::EvalArguments),
    Replay(replay::ReplayArguments),
    Train(train::TrainArguments),
    Compare(compare::CompareArguments),
    Reproduce(reproduce::ReproduceArguments),
    Export(export::ExportArguments),
    Inspect(inspect::InspectArguments),
    View(view::ViewArguments),
    #[command(display_order = LAST)]
    Completions(CompletionsArguments),
    #[command(display_order = LAST)]
    Man(ManArguments),
    #[command(hide = true)]
    Compiler(tools::CompilerArguments),
    #[command(hide = true)]
    Process(run::process::ProcessArguments),
}

pub(crate) fn dispatch(program: &Program, asked: Asked) -> Outcome {
    let verb = match asked {
        Asked::Here(verb) => *verb,
        Asked::Tool(verb, matches) => return tools::run(&verb, &matches),
    };
    match verb {
        Verb::Run(arguments) => run::run(&arguments),
        Verb::Up(arguments) => run::up::run(&arguments),
        Verb::Join(arguments) => join::run(&arguments),
        Verb::Serve(arguments) => serve::run(&arguments),
        Verb::Control(arguments) => control::run(&arguments),
        Verb::Doctor(arguments) => doctor::run(&arguments),
        Verb::Top(arguments) => top::run(&arguments),
        Verb::Record(arguments) => record::run(&arguments),
        Verb::Bridge(arguments) => bridge::run(&arguments),
        Verb::Remake(arguments) => remake::run(&arguments),
        Verb::Why(arguments) => remake::why::run(&arguments),
        Verb::Sign(arguments) => sign::run(&arguments),
        Verb::Eval(arguments) => eval::run(&arguments),
        Verb::Replay(arguments) => replay::run(&arguments),
        Verb::Train(arguments) => train::run(&arguments),
        Verb::Compare(arguments) => compare::run(&arguments),
        Verb::Reproduce(arguments) => reproduce::run(&arguments),
        Verb::Export(arguments) => export::run(&arguments),
        Verb::Inspect(arguments) => inspect::run(&arguments),
        Verb::View(arguments) => view::run(&arguments),
        Verb::Completions(arguments) => complete(&arguments, || command(program)),
        Verb::Man(arguments) => write_manual(&arguments, || command(program)),
        Verb::Compiler(arguments) => tools::answer_compiler(&arguments),
        Verb::Process(arguments) => run::process::run(&arguments),
    }
}

/// Print the completion script of a shell
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie completions bash > ~/.local/share/bash-completion/completions/sortie
  sortie completions zsh > ~/.zfunc/_sortie
  sortie completions fish > ~/.config/fish/completions/sortie.fish")]
pub(crate) struct CompletionsArguments {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

/// Write a manual page for every verb into a folder
#[derive(Debug, Args)]
#[command(after_help = "Example:
  sortie man ~/.local/share/man/man1    # then: man sortie-train")]
pub(crate) struct ManArguments {
    /// The folder; it is made where it is missing
    folder: PathBuf,
}

// The whole grammar is the other program's, where it is there.
fn complete(arguments: &CompletionsArguments, grammar: impl FnOnce() -> Command) -> Outcome {
    prefer_tools()?;
    let mut script = Vec::new();
    generate(arguments.shell, &mut grammar(), "sortie", &mut script);
    say!("{}", String::from_utf8_lossy(&script).trim_end());
    Ok(())
}

fn write_manual(arguments: &ManArguments, grammar: impl FnOnce() -> Command) -> Outcome {
    prefer_tools()?;
    let folder = &arguments.folder;
    fs::create_dir_all(folder).map_err(|error| Failure::file(folder, &error))?;
    clap_mangen::generate_to(grammar(), folder).map_err(|error| Failure::file(folder, &error))
}
