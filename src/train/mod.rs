//! `sortie train`: learns a team and writes a run that can be watched, resumed and exported.

mod reporter;
mod seeds;

use std::fs;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use sortie_learn::LearnError;
use sortie_learn::methods::Trainer;
use sortie_learn::methods::alma::{Conditioning, MixerKind};
use sortie_learn::methods::paper;
use sortie_learn::run::{Outcome as Ending, Settings};

use crate::arguments::{Allocation, Common};
use crate::environment::ScenarioSetName;
use crate::failure::{Exit, Failure, Outcome};
use crate::output::{self, say, warn_of_refused};
use crate::signals::stop_on_signals;
use reporter::Reporter;
use seeds::SeedRange;

/// Learn a team's policy and write the run to a folder
///
/// Agents and allocator are learned together. The folder gets `train.toml` (the resolved configuration), `curve.json`,
/// `curve.csv`, `curve.svg`, an event file for TensorBoard, checkpoints and, at the end, `result.json`. Ctrl-C writes a checkpoint and stops; `--resume` goes on as if nothing had happened. The same seed gives the same weights.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie train alma --out runs/first
  sortie train alma --seeds 1..5 --out runs/five
  sortie train alma --set network.width=128 --set run.steps=800000 --seed 7 --out runs/wide
  sortie train alma --mixer qmix --no-mask --allocation coordinated --out runs/compared
  sortie train flat --out runs/flat
  sortie train alma --preset paper --out runs/paper
  sortie train copa --preset paper --out runs/copa
  sortie train alma --resume runs/first")]
pub(crate) struct TrainArguments {
    /// The algorithm
    #[arg(value_enum)]
    method: Method,
    /// Environment and scenario set [default: save-the-city/2-5a_2-5b]
    #[arg(long, value_name = "ENV[/SET]")]
    env: Option<String>,
    /// Named configuration to start from: `fast`, or `paper`, the dissertation's algorithm to the letter
    #[arg(long, default_value = "fast")]
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
    /// Environment steps to learn for [default: as the configuration says]
    #[arg(long)]
    steps: Option<u64>,
    /// One run per seed, A and B included: folders DIR-sA to DIR-sB, as many at a time as there are
    /// cores; the same command again goes on with what is unfinished
    #[arg(long, value_name = "A..B", conflicts_with_all = ["seed", "resume"])]
    seeds: Option<SeedRange>,
    /// Threads that compute gradients; they change no result [default: all cores, with --seeds one]
    #[arg(long, value_parser = threads)]
    threads: Option<usize>,
    /// Folder of the new run
    #[arg(long, value_name = "DIR", required_unless_present = "resume")]
    out: Option<PathBuf>,
    /// Folder of a run to go on with, as it was configured
    #[arg(long, value_name = "DIR", conflicts_with_all = ["out", "config", "assignments", "allocation", "no_mask", "mixer", "steps", "env"])]
    resume: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Method {
    /// Subtask-masked utilities under an allocation (dissertation chapter 7)
    Alma,
    /// The same without subtasks: everybody sees everything and earns the whole team's reward
    Flat,
    /// Flat agents and a coach that sees everything and tells each of them a strategy now and then; learned
    /// from windows by either preset
    Copa,
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

pub(crate) fn run(arguments: &TrainArguments) -> Outcome {
    output::may_be_lost();
    let stop = stop_on_signals()?;
    if let (Some(seeds), Some(out)) = (arguments.seeds, &arguments.out) {
        let config = configuration(arguments)?;
        let threads = arguments.threads.unwrap_or(1);
        return seeds::run(seeds, &config, threads, out, arguments.common, &stop);
    }
    let (mut trainer, folder) = trainer(arguments)?;
    warn_of_refused(trainer.refused());
    let mut reporter = Reporter::new(&trainer, arguments.common);
    let ending = trainer.run(&mut reporter, stop.flag())?;
    reporter.finish();
    match ending {
        Ending::Stopped => Err(Failure::new(
            Exit::Interrupted,
            format!("stopped; go on with `sortie train alma --resume {}`", folder.display()),
        )),
        Ending::Finished => {
            if !arguments.common.json && !arguments.common.quiet {
                let folder = folder.display();
                say!(
                    "done; evaluate with `sortie eval {folder}`, deploy with `sortie export {folder} --out BUNDLE`"
                );
            }
            Ok(())
        }
    }
}

fn trainer(arguments: &TrainArguments) -> Result<(Trainer, PathBuf), Failure> {
    if let Some(folder) = &arguments.resume {
        return Ok((Trainer::resume(folder, arguments.threads)?, folder.clone()));
    }
    let folder = arguments.out.clone().unwrap_or_default();
    let threads = arguments.threads.unwrap_or(cores());
    let config = configuration(arguments)?;
    Ok((Trainer::new(config, arguments.common.seed, threads, &folder)?, folder))
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

fn configuration(arguments: &TrainArguments) -> Result<Settings, Failure> {
    let mut settings = match &arguments.config {
        Some(path) => configuration_file(path)?,
        None if arguments.method == Method::Copa && arguments.preset == "fast" => {
            Settings::Windows(paper::Config::like_fast())
        }
        None => Settings::preset(&arguments.preset).map_err(usage)?,
    };
    if let Some(name) = &arguments.env {
        settings.environment_mut().set = ScenarioSetName::parse(name)?.set().to_string();
    }
    if let Some(allocation) = arguments.allocation {
        allocate_by(&mut settings, allocation);
    }
    if let Some(mixer) = arguments.mixer {
        mix_by(&mut settings, mixer)?;
    }
    match arguments.method {
        Method::Alma if arguments.no_mask => *settings.subtask_mut() = Conditioning::Input,
        Method::Alma => {}
        Method::Flat | Method::Copa if arguments.no_mask || arguments.allocation.is_some() => {
            let reason = "`flat` and `copa` have no subtasks: drop `--no-mask` and `--allocation`";
            return Err(Failure::new(Exit::Usage, reason.to_string()));
        }
        Method::Flat => {
            *settings.subtask_mut() = Conditioning::None;
            if let Settings::Windows(config) = &mut settings {
                config.coach.enabled = false;
            }
        }
        Method::Copa => enable_coach(&mut settings)?,
    }
    if let Some(steps) = arguments.steps {
        settings.run_mut().steps = steps;
    }
    for assignment in &arguments.assignments {
        settings.set(assignment).map_err(usage)?;
    }
    Ok(settings)
}

/// Has a rule allocate in the place of a learned allocator.
fn allocate_by(settings: &mut Settings, allocation: Allocation) {
    match settings {
        Settings::Records(config) => {
            let weight = |rule| f64::from(u8::from(rule == allocation));
            config.allocation.learned = 0.0;
            config.allocation.coordinated = weight(Allocation::Coordinated);
            config.allocation.heuristic = weight(Allocation::Heuristic);
            config.allocation.random = weight(Allocation::Random);
        }
        Settings::Windows(config) => {
            let rule = match allocation {
                Allocation::Coordinated => "coordinated",
                Allocation::Heuristic => "heuristic",
                Allocation::Random => "random",
            };
            config.allocation.by = rule.to_owned();
        }
    }
}

/// Has a coach tell flat agents strategies.
fn enable_coach(settings: &mut Settings) -> Outcome {
    let Settings::Windows(config) = settings else {
        let reason =
            "`copa` learns from windows: give a configuration with `learner = \"windows\"`";
        return Err(Failure::new(Exit::Usage, reason.to_string()));
    };
    config.enable_coach();
    Ok(())
}

fn mix_by(settings: &mut Settings, mixer: Mixer) -> Result<(), Failure> {
    let kind = match mixer {
        Mixer::Sum => MixerKind::Sum,
        Mixer::Linear => MixerKind::Linear,
        Mixer::Qmix => MixerKind::Qmix,
    };
    match settings {
        Settings::Records(config) => config.mixer.kind = kind,
        Settings::Windows(_) if kind == MixerKind::Qmix => {}
        Settings::Windows(_) => {
            let reason = "the preset `paper` mixes by `qmix` only";
            return Err(Failure::new(Exit::Usage, reason.to_string()));
        }
    }
    Ok(())
}

fn configuration_file(path: &Path) -> Result<Settings, Failure> {
    let text = fs::read_to_string(path).map_err(|error| Failure::file(path, &error))?;
    Settings::from_toml(&text)
        .map_err(|error| Failure::new(Exit::BadData, format!("{}: {error}", path.display())))
}

fn usage(error: LearnError) -> Failure {
    Failure::new(Exit::Usage, error.to_string())
}
