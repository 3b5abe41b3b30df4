//! `sortie firmware`: the same decisions on a microcontroller, and what they need there.

mod figures;
mod numbers;
mod subject;
mod team;
mod toolchain;

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use serde::Serialize;
use sortie_cli::failure::{Exit, Failure, Outcome};
use sortie_cli::files::write_output;
use sortie_cli::output::{Common, Table, print_json, say, tell};
use sortie_cli::policy::PlanProfile;
use sortie_cli::terminal;
use sortie_core::plan::Profile;

use self::figures::{COLUMNS, Flash, Instructions, Ram, Recorded, Told, Verdict};
use self::team::TeamArguments;
use self::toolchain::Program;
use crate::document::Document;

pub(crate) use self::figures::Figures;
pub(crate) use self::subject::{Named, Subject};
pub(crate) use self::toolchain::{Board, Toolchain};

/// Run a bundle's policy, or a plan, on an emulated microcontroller, and print what it needs there
///
/// Builds a program with the plan inside, runs it on the bundle's golden observations or episodes, and compares the bits of
/// all that comes out with those of this machine: exit code 1 where they differ. A plan without a bundle decides on random
/// cases. Prints instructions, flash, RAM and stack; instructions are not cycles.
///
/// It needs the sources of Sortie (`runtime/firmware`), cargo, a compiler with a library for the board, and QEMU. What is
/// missing is named, with exit code 69; nothing is installed.
///
/// With --team the board acts for one agent of a running team: packets cross its serial line, which may be damaged, and
/// each of its actions is compared with what this machine's runtime decides on the same frame (exit code 1).
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie firmware models/save-the-city --board cortex-m4f --profile int8
  sortie firmware models/save-the-city --board rv32imc --json
  sortie firmware models/save-the-city --board cortex-m0 --profile int8 --table docs/evidence/firmware.md
  sortie firmware models/rover-tower-8 --board cortex-m3 --agent 7
  sortie firmware walking.plan --board cortex-m4f
  sortie firmware models/save-the-city --board cortex-m4f --profile int8 --all-visible
  sortie firmware models/save-the-city --board cortex-m4f --read
  sortie firmware models/save-the-city --board cortex-m4f --team --episodes 20
  sortie firmware models/save-the-city --board cortex-m4f --team --damage 2000 --resets 5 --json")]
pub(crate) struct FirmwareArguments {
    /// A bundle's folder, or a plan
    #[arg(value_name = "BUNDLE|PLAN")]
    subject: PathBuf,
    /// The board
    #[arg(long, value_enum)]
    board: Board,
    /// How the plan computes [default: exact; of a plan, as it does]
    #[arg(long, value_enum)]
    profile: Option<PlanProfile>,
    /// The agent that the board acts for, in a team whose agents decide by several networks or with --team
    #[arg(long, default_value_t = 0)]
    agent: u8,
    /// Golden cases to decide on, the first so many [default: all]
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u32).range(1..))]
    decisions: Option<u32>,
    /// Let an agent of a bundle see all entities of a case: what a decision takes at most. A row of its own in the table
    #[arg(long, conflicts_with = "team")]
    all_visible: bool,
    /// Have the board read the plan when it starts, by one program for all plans, which is built once: the same bits. In the
    /// table a row of its own, whose code is that of all operators. Not for an agent that runs options
    #[arg(long, conflicts_with = "team")]
    read: bool,
    /// A Markdown document with a table of such figures. Exit code 1 where instructions are more than 1 % above it, bytes more
    /// than 3 %, or the bits are others; where another compiler built what it has, a warning above 10 %
    #[arg(long, value_name = "FILE")]
    table: Option<PathBuf>,
    /// Write the figures to the table instead
    #[arg(long, requires = "table")]
    write: bool,
    /// The folder `runtime/firmware` of Sortie's sources [default: below this folder or one above it, or where this program was built]
    #[arg(long, value_name = "FOLDER", env = "SORTIE_FIRMWARE")]
    sources: Option<PathBuf>,
    /// A compiler with the sources of its library, for boards that the toolchain of rustup has no library for
    #[arg(long, value_name = "PROGRAM", default_value = "/usr/bin/rustc")]
    rustc: PathBuf,
    /// Seconds after which a board that does not end, or does not answer, is given up
    #[arg(long, value_name = "SECONDS", default_value_t = 600, value_parser = clap::value_parser!(u64).range(1..))]
    limit: u64,
    #[command(flatten)]
    team: TeamArguments,
    #[command(flatten)]
    common: Common,
}

#[derive(Serialize)]
struct Report<'a> {
    #[serde(flatten)]
    figures: &'a Figures,
    /// Whether what comes out has the bits of this machine's.
    equal: bool,
}

impl FirmwareArguments {
    /// The profile of a bundle's plans.
    fn profile(&self) -> Profile {
        self.profile.unwrap_or(PlanProfile::Exact).profile()
    }
}

pub(crate) fn run(arguments: &FirmwareArguments) -> Outcome {
    let named = Named::open(&arguments.subject, arguments.profile.map(PlanProfile::profile))?;
    let sources = sources(arguments.sources.as_deref())?;
    let toolchain = Toolchain::find(&arguments.board.machine(), &arguments.rustc)?;
    if arguments.team.team {
        return team::run(arguments, named.bundle()?, &sources, &toolchain);
    }
    let mut subject = subject(arguments, &named)?;
    if arguments.read {
        subject = subject.read()?;
    }
    let bench = Bench {
        board: arguments.board,
        sources: &sources,
        toolchain: &toolchain,
        limit: Duration::from_secs(arguments.limit),
    };
    let figures = measure(&bench, &subject, arguments.common)?;
    let equal = figures.hash == figures.host_hash;
    if arguments.common.json {
        print_json(&Report { figures: &figures, equal });
    } else {
        print(&figures);
    }
    if !equal {
        let message =
            "what the board decides has other bits than on this machine; please report this";
        return Err(Failure::difference(message));
    }
    match &arguments.table {
        Some(table) => compare(table, &figures, arguments.write),
        None => Ok(()),
    }
}

/// What the board decides by, and on what.
fn subject(arguments: &FirmwareArguments, named: &Named) -> Result<Subject, Failure> {
    let most = arguments.decisions.map_or(usize::MAX, |most| most as usize);
    match named {
        Named::Bundle(bundle) => {
            let cases = (most, arguments.all_visible);
            Subject::of_bundle(bundle, arguments.profile(), arguments.agent.into(), cases)
        }
        Named::Plan(path, plan) => Subject::of_plan(path, plan, arguments.common.seed, most),
    }
}

/// A board, and what builds and runs programs for it.
pub(crate) struct Bench<'a> {
    pub(crate) board: Board,
    pub(crate) sources: &'a Path,
    pub(crate) toolchain: &'a Toolchain,
    /// After which a board that does not end is given up.
    pub(crate) limit: Duration,
}

/// Builds the program, and runs it on the board.
pub(crate) fn measure(
    bench: &Bench<'_>,
    subject: &Subject,
    common: Common,
) -> Result<Figures, Failure> {
    let Bench { board, sources, toolchain, limit } = *bench;
    let machine = board.machine();
    let folder = tempfile::tempdir()
        .map_err(|error| Failure::file(Path::new("a temporary folder"), &error))?;
    let cases = folder.path().join("cases.bin");
    fs::write(&cases, &subject.cases).map_err(|error| Failure::file(&cases, &error))?;
    for (name, content) in &subject.read {
        let path = folder.path().join(name);
        fs::write(&path, &*machine.laid_out(content)?)
            .map_err(|error| Failure::file(&path, &error))?;
    }
    let spinner = terminal::spinner(common);
    spinner.set_message("building the firmware");
    let program = Program { name: subject.program, features: &[], files: &subject.files };
    let program = toolchain.build(&machine, sources, &program)?;
    spinner.set_message("running it on the board");
    let mut emulator = toolchain.emulator(&machine, &program);
    emulator.arg("-nographic").current_dir(folder.path());
    let told = Told::by(emulator, limit)?;
    spinner.finish_and_clear();
    Ok(Figures {
        board: board.name(),
        bundle: subject.name.clone(),
        profile: subject.profile.name(),
        compiler: toolchain.version.clone(),
        decisions: told.number("decisions")?,
        hash: format!("{:016x}", told.number("hash")?),
        host_hash: format!("{:016x}", subject.hash),
        instructions: Instructions::told(&told)?,
        flash: Flash::told(&told)?,
        ram: Ram::told(&told)?,
    })
}

/// The folder of the firmware's sources, which this program does not hold.
pub(crate) fn sources(named: Option<&Path>) -> Result<PathBuf, Failure> {
    const FOLDER: &str = "runtime/firmware";
    let is_there =
        |folder: &PathBuf| folder.join("boards").is_dir() && folder.join("Cargo.toml").is_file();
    let around = std::env::current_dir().unwrap_or_default();
    let around = around.ancestors().map(|folder| folder.join(FOLDER));
    let built = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(FOLDER);
    let found = match named {
        Some(folder) => Some(folder.to_owned()).filter(is_there),
        None => around.chain([built]).find(is_there),
    };
    let found = found.ok_or_else(|| {
        let message = format!(
            "the firmware is built from Sortie's sources, which this program does not hold: \
             get those of version {} and name their folder `{FOLDER}` with `--sources FOLDER`",
            env!("CARGO_PKG_VERSION")
        );
        Failure::new(Exit::Missing, message)
    })?;
    fs::canonicalize(&found).map_err(|error| Failure::file(&found, &error))
}

fn print(figures: &Figures) {
    let Figures { board, bundle, profile, decisions, instructions, flash, ram, .. } = figures;
    say!("{bundle}, {profile}, on {board} (emulated), built by rustc {}", figures.compiler);
    let equal = if figures.hash == figures.host_hash { "the bits of" } else { "OTHER bits than" };
    say!("{decisions} decisions: {equal} this machine's, hash {}", figures.hash);
    let mut table = Table::new(&["", ""]);
    let mut row = |name: &str, number: u64| table.row([name.to_owned(), number.to_string()]);
    let visible = match instructions.most_visible {
        0 => String::new(),
        visible => format!(" ({visible} visible)"),
    };
    row(&format!("instructions of a decision, most{visible}"), instructions.most);
    row("instructions of a decision, mean", instructions.mean);
    row("flash: code and constants, bytes", flash.code);
    row("flash: the plan, bytes", flash.plan);
    row("RAM, bytes", ram.all);
    row("  of it the arena", ram.arena);
    row("  of it what an agent remembers", ram.states);
    row("  of it the loaded plan", ram.loaded);
    row("  of it the stack of a decision", ram.stack);
    row("stack of loading, bytes", ram.loading_stack);
    table.print();
}

/// Holds figures to a table, or writes them to it.
fn compare(path: &Path, figures: &Figures, write: bool) -> Outcome {
    let mut recorded = Recorded(Document::open(path, COLUMNS, write)?);
    if write {
        recorded.put(figures);
        return write_output(path, recorded.0.write().as_bytes());
    }
    let within = |said: String| format!("{}: {said}", path.display());
    match recorded.judge(figures) {
        Verdict::Held => {}
        Verdict::New => {
            tell!("note: {}", within("nothing is recorded of this; `--write` does".to_owned()))
        }
        Verdict::Larger(said) => tell!("warning: {}", within(said + ", by another compiler")),
        Verdict::Broken(said) => return Err(Failure::difference(within(said))),
    }
    Ok(())
}
