//! `sortie train`: learns a team and writes a run that can be watched, resumed and exported.

mod reporter;
mod sweep;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::sync::atomic::Ordering;
use std::thread;
use std::time::{Duration, Instant};

use clap::builder::PossibleValue;
use clap::{Args, ValueEnum};
use rustix::process::{Pid, Signal, getppid, set_parent_process_death_signal};
use sortie_bundle::TRAINING;
use sortie_bundle::files::{MOST_TEXT_BYTES, read_text};
use sortie_ipc::Stop;
use sortie_learn::LearnError;
use sortie_learn::run::{
    Outcome as Ending, RunDescription, keys_in, method_of, prolong, replace_products,
};
use sortie_learn::session::{MethodEntry, Session, Setup};
use sortie_methods::METHODS;

use crate::allocation::Allocation;
use crate::failure::{Exit, Failure, Outcome};
use crate::methods;
use crate::output::{self, Common, say, tell, warn_of_refused, whole_number};
use crate::seeds::SeedRange;
use crate::terminal::stop_saying;
use reporter::Reporter;

pub(crate) use sweep::{Sweep, check_stop, learn_all, run_folder, suffixed};

/// Learn a team's policy and write the run to a folder
///
/// Agents and allocator are learned together. The folder gets `train.toml` (the resolved configuration), `curve.json`,
/// `curve.csv`, `curve.svg`, an event file for TensorBoard, checkpoints and, at the end, `result.json`. Ctrl-C writes a
/// checkpoint and stops; `--resume` goes on as if nothing had happened, also after `kill -9`. The same seed gives the
/// same weights. Output that cannot be written ends no training.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie train alma --out runs/first
  sortie train alma --seeds 1..5 --out runs/five
  sortie train alma --print-config > mine.toml
  sortie train alma --set network.width=128 --set run.steps=800000 --seed 7 --out runs/wide
  sortie train alma --mixer qmix --no-mask --allocation coordinated --out runs/compared
  sortie train flat --out runs/flat
  sortie train alma --preset paper --out runs/paper
  sortie train copa --preset paper --out runs/copa
  sortie train refil --env group-matching --out runs/refil
  sortie train alma --resume runs/first
  sortie train alma --resume runs/first --steps 1200000")]
pub(crate) struct TrainArguments {
    /// The algorithm
    #[arg(value_enum)]
    method: Method,
    /// Environment and set of starts [default: the first set of the only environment that the method fits]
    #[arg(long, value_name = "ENV[/SET]")]
    env: Option<String>,
    /// Named configuration to start from: `fast`, or `paper`, the dissertation's algorithm to the letter
    #[arg(long, default_value = USUAL_PRESET)]
    preset: String,
    /// Configuration file to start from, as `train.toml` has it
    #[arg(long, value_name = "FILE", conflicts_with = "preset")]
    config: Option<PathBuf>,
    /// Replace one value of the configuration; may be given several times
    #[arg(long = "set", value_name = "KEY=VALUE")]
    assignments: Vec<String>,
    /// Rule that assigns agents to subtasks in the place of a learned allocator
    #[arg(long, value_enum)]
    allocation: Option<Allocation>,
    /// Agents see everything and their subtask as an input, instead of their own subtask only
    #[arg(long)]
    no_mask: bool,
    /// How the utilities of a team become its value [default: as the configuration says]
    #[arg(long, value_enum)]
    mixer: Option<Mixer>,
    /// Environment steps to learn for, with --resume more than before [default: as the configuration says]
    #[arg(long, value_parser = whole_number)]
    steps: Option<u64>,
    /// One run per seed, A and B included: folders DIR-sA to DIR-sB, as many at a time as there are
    /// cores; the same command again goes on with what is unfinished
    #[arg(long, value_name = "A..B", conflicts_with_all = ["seed", "resume"])]
    seeds: Option<SeedRange>,
    /// Threads that compute gradients; they change no result [default: all cores, with --seeds one]
    #[arg(long, value_parser = threads)]
    threads: Option<usize>,
    /// Folder of the new run [default: runs/METHOD-ENVIRONMENT-sSEED]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Folder of a run to go on with, as it was configured
    #[arg(long, value_name = "DIR", conflicts_with_all = ["out", "preset", "config", "assignments", "allocation", "no_mask", "mixer", "env", "seed"])]
    resume: Option<PathBuf>,
    /// Go on with the products of this processor where it has not those that the run learns with: other bits
    #[arg(long, requires = "resume")]
    other_products: bool,
    /// Print the configuration with an explanation of every key, as a file for --config, and learn nothing
    #[arg(long, conflicts_with_all = ["out", "resume", "seeds"])]
    print_config: bool,
    /// The process of the sweep that this run is part of, without which it stops
    #[arg(long, value_name = "PID", hide = true)]
    sweep: Option<u32>,
    #[command(flatten)]
    common: Common,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Mixer {
    /// Their sum (VDN)
    Sum,
    /// A weighted sum and a value of the state
    Linear,
    /// Two layers with non-negative weights (QMIX)
    Qmix,
}

impl Mixer {
    /// As configurations have it.
    fn name(self) -> &'static str {
        match self {
            Self::Sum => "sum",
            Self::Linear => "linear",
            Self::Qmix => "qmix",
        }
    }
}

/// The preset that needs no flag.
const USUAL_PRESET: &str = "fast";

/// What is said as soon as a signal comes: updates take up to seconds, and the last checkpoint its time as well.
const STOPPING: &str = "stopping after this update\n";

/// How long a seed of a sweep waits for a run that is being stopped: that of a sweep that was killed.
const PATIENCE: Duration = Duration::from_secs(10);

pub(crate) fn run(arguments: &TrainArguments) -> Outcome {
    if arguments.print_config {
        say!("{}", arguments.method.0.explained(&checked(arguments)?)?.trim_end());
        return Ok(());
    }
    output::may_be_lost();
    let is_told = !arguments.common.quiet && !arguments.common.json && arguments.sweep.is_none();
    let stop = stop_saying(if is_told { STOPPING } else { "" })?;
    if let Some(sweep) = arguments.sweep {
        stop_without(sweep, &stop)?;
    }
    if let Some(seeds) = arguments.seeds {
        return sweep(seeds, checked(arguments)?, arguments, &stop);
    }
    let (mut session, folder) = session(arguments)?;
    warn_of_refused(session.refused());
    let mut reporter = Reporter::new(&session, arguments.common);
    let ending = session.run(&mut reporter, stop.flag());
    drop(reporter);
    let method = arguments.method.0.name;
    match ending? {
        Ending::Stopped if arguments.sweep.is_some() => Err(Failure::new(Exit::Interrupted, "")),
        Ending::Stopped => {
            let folder = folder.display();
            let next = match session.description().config.run.checkpoint_replay {
                true => format!("go on with `sortie train {method} --resume {folder}`"),
                false => format!("use what it learned: `sortie eval {folder}`"),
            };
            Err(Failure::new(Exit::Interrupted, format!("stopped; {next}")))
        }
        Ending::Finished => {
            if !arguments.common.json && !arguments.common.quiet {
                let folder = folder.display();
                say!("done; evaluate it: sortie eval {folder}");
                say!("      deploy it:   sortie export {folder} --out BUNDLE");
            }
            Ok(())
        }
    }
}

/// The setup that the command line asks for, which environment and method take.
pub(crate) fn checked(arguments: &TrainArguments) -> Result<Setup, Failure> {
    let description = RunDescription::new(setup(arguments)?, 0, 1);
    methods::open(arguments.method.0, &description, 1)?;
    Ok(description.config)
}

/// One run per seed.
fn sweep(seeds: SeedRange, mut setup: Setup, arguments: &TrainArguments, stop: &Stop) -> Outcome {
    setup.run.settle_products()?;
    let out = arguments.out.clone().unwrap_or_else(|| usual_folder(arguments, &setup));
    sweep::run(seeds, &setup, arguments.threads.unwrap_or(1), &out, arguments.common, stop)
}

/// Where runs go for which no folder is named, without their seeds.
fn usual_folder(arguments: &TrainArguments, setup: &Setup) -> PathBuf {
    let environment = &setup.environment;
    let mut name = format!("{}-{}", arguments.method.0.name, environment.name);
    let preset = Some(arguments.preset.as_str()).filter(|preset| *preset != USUAL_PRESET);
    for part in [Some(environment.set.as_str()), preset].into_iter().flatten() {
        if !part.is_empty() {
            name = format!("{name}-{part}");
        }
    }
    Path::new("runs").join(name.replace('/', "-"))
}

/// A new run, or one to go on with, and its folder.
fn session(arguments: &TrainArguments) -> Result<(Session, PathBuf), Failure> {
    let folder = match arguments.resume.as_ref().or(arguments.out.as_ref()) {
        Some(folder) => folder.clone(),
        None => run_folder(&usual_folder(arguments, &checked(arguments)?), arguments.common.seed),
    };
    if arguments.resume.is_none() {
        match begun(arguments, &folder) {
            // The process of a sweep that was killed was about to begin it.
            Err(_) if arguments.sweep.is_some() && folder.join(TRAINING).exists() => {}
            Err(failure) if arguments.out.is_none() && failure.exit == Exit::InputOutput => {
                let message = format!("{}; name a folder of yours with `--out`", failure.message);
                return Err(Failure::new(failure.exit, message));
            }
            session => return Ok((session?, folder)),
        }
    }
    check_method(arguments.method, &folder)?;
    change(arguments, &folder)?;
    let patience = if arguments.sweep.is_some() { PATIENCE } else { Duration::ZERO };
    let since = Instant::now();
    loop {
        match resumed(arguments, &folder) {
            Err(LearnError::Busy { .. }) if since.elapsed() < patience => {
                thread::sleep(Duration::from_millis(50));
            }
            session => return Ok((session?, folder)),
        }
    }
}

fn begun(arguments: &TrainArguments, folder: &Path) -> Result<Session, Failure> {
    let (seed, threads) = (arguments.common.seed, arguments.threads.unwrap_or(cores()));
    let description = RunDescription::new(setup(arguments)?, seed, threads);
    let (environment, method) = methods::open(arguments.method.0, &description, threads)?;
    Ok(Session::begin(description, environment, method, folder)?)
}

fn resumed(arguments: &TrainArguments, folder: &Path) -> Result<Session, LearnError> {
    Session::resume(folder, |description| {
        let threads = arguments.threads.unwrap_or(description.threads);
        methods::open(arguments.method.0, description, threads)
    })
}

/// Changes what may be changed of a run that is gone on with.
fn change(arguments: &TrainArguments, folder: &Path) -> Outcome {
    if let Some(steps) = arguments.steps {
        prolong(folder, steps)?;
    }
    if arguments.other_products
        && let Some(products) = replace_products(folder)?
    {
        tell!(
            "warning: {} goes on with `{products}` products, and so with other bits",
            folder.display()
        );
    }
    Ok(())
}

/// Refuses to go on with a run of another method.
fn check_method(method: Method, folder: &Path) -> Outcome {
    let learned = method_of(folder)?;
    if learned == method.0.name {
        return Ok(());
    }
    let (folder, asked) = (folder.display(), method.0.name);
    let reason = format!(
        "{folder} learns by `{learned}`, not by `{asked}`: `sortie train {learned} --resume {folder}`"
    );
    Err(Failure::new(Exit::Usage, reason))
}

/// Stops this run when the process of its sweep dies.
fn stop_without(sweep: u32, stop: &Stop) -> Outcome {
    set_parent_process_death_signal(Some(Signal::INT))
        .map_err(|error| Failure::new(Exit::InputOutput, format!("prctl: {error}")))?;
    // It may have died before.
    if getppid().map(Pid::as_raw_nonzero).is_none_or(|parent| parent.get() as u32 != sweep) {
        stop.flag().store(true, Ordering::Relaxed);
    }
    Ok(())
}

fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

fn threads(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(threads) if (1..=1024).contains(&threads) => Ok(threads),
        _ => Err("expected a number of threads from 1 to 1024".to_string()),
    }
}

/// The setup that the command line asks for.
fn setup(arguments: &TrainArguments) -> Result<Setup, Failure> {
    let entry = arguments.method.0;
    let mut given = BTreeSet::new();
    let mut setup = match &arguments.config {
        Some(path) => {
            let text =
                read_text(path, MOST_TEXT_BYTES).map_err(|error| Failure::file(path, &error))?;
            let read = entry.read(&text).and_then(|setup| Ok((setup, keys_in(&text)?)));
            let (setup, keys) =
                read.map_err(|error| Failure::from(error).within(path.display()))?;
            given.extend(keys);
            setup
        }
        None => entry.preset(&arguments.preset)?,
    };
    if let Some(name) = &arguments.env {
        methods::choose(&mut setup.environment, name)?;
    }
    // A preset fits itself to the world, which there may only be with its settings.
    let of_the_world = |assignment: &&String| assignment.trim_start().starts_with("environment.");
    for assignment in arguments.assignments.iter().filter(of_the_world) {
        setup = entry.set(&setup, assignment)?;
    }
    if arguments.config.is_none() {
        methods::suit(entry, &arguments.preset, &mut setup)?;
    }
    for (flag, value) in [
        ("--allocation", arguments.allocation.map(Allocation::name)),
        ("--mixer", arguments.mixer.map(Mixer::name)),
        ("--no-mask", arguments.no_mask.then_some("")),
    ] {
        if let Some(value) = value {
            setup = entry.set_flag(&setup, flag, value)?;
        }
    }
    if let Some(steps) = arguments.steps {
        setup.run.steps = steps;
    }
    for assignment in &arguments.assignments {
        setup = entry.set(&setup, assignment)?;
        given.extend(assignment.split_once('=').map(|(key, _)| key.trim().to_owned()));
    }
    entry.fit_to_length(&mut setup, |key| given.contains(key));
    methods::settle(entry, &mut setup.environment)?;
    Ok(setup)
}

/// What learns.
#[derive(Clone, Copy, Debug)]
struct Method(&'static MethodEntry);

impl ValueEnum for Method {
    fn value_variants<'a>() -> &'a [Self] {
        static ALL: LazyLock<Vec<Method>> = LazyLock::new(|| METHODS.iter().map(Method).collect());
        &ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.0.name).help(self.0.about))
    }
}
