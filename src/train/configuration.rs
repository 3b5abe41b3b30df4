//! From flags to a configuration.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use sortie_learn::LearnError;
use sortie_learn::run::{Configuration, keys_in};
use sortie_learn::session::{MethodEntry, Setup};
use sortie_methods::alma::records::{Conditioning, MixerKind};
use sortie_methods::alma::settings::Settings;
use sortie_methods::alma::windows;

use super::method::AlmaMethod;
use super::{Mixer, TrainArguments};
use crate::allocation::Allocation;
use crate::environment::ScenarioSetName;
use crate::failure::{Exit, Failure, Outcome};
use crate::methods;

/// The setup of a method that learns in any environment, as the command line asks for it.
pub(super) fn setup(entry: &MethodEntry, arguments: &TrainArguments) -> Result<Setup, Failure> {
    let refused =
        [("--no-mask", arguments.no_mask), ("--allocation", arguments.allocation.is_some())];
    if let Some((flag, _)) = refused.iter().find(|(_, is_given)| *is_given) {
        let reason = format!("`{}` has no subtasks: drop `{flag}`", entry.name);
        return Err(Failure::new(Exit::Usage, reason));
    }
    let mut setup = match &arguments.config {
        Some(path) => {
            let text = fs::read_to_string(path).map_err(|error| Failure::file(path, &error))?;
            let first = entry.preset(entry.presets[0].name)?;
            let read = entry.read(&first, &text);
            read.map_err(|error| Failure::from(error).within(path.display()))?
        }
        None => entry.preset(&arguments.preset)?,
    };
    if let Some(name) = &arguments.env {
        methods::choose(&mut setup.environment, name)?;
    }
    if setup.environment.name.is_empty() {
        let reason = format!(
            "`{}` learns anywhere: say where by `--env`: {}",
            entry.name,
            methods::environment_names()
        );
        return Err(Failure::new(Exit::Usage, reason));
    }
    if let Some(mixer) = arguments.mixer {
        setup = entry.set(&setup, &format!("mixer.kind={}", mixer.name()))?;
    }
    if let Some(steps) = arguments.steps {
        setup.run.steps = steps;
    }
    for assignment in &arguments.assignments {
        setup = entry.set(&setup, assignment)?;
    }
    setup.check()?;
    Ok(setup)
}

/// The configuration that the command line asks for.
pub(super) fn configuration(
    method: AlmaMethod,
    arguments: &TrainArguments,
) -> Result<Settings, Failure> {
    let mut given = BTreeSet::new();
    let mut settings = match &arguments.config {
        Some(path) => configuration_file(path, &mut given)?,
        None if method == AlmaMethod::Copa && arguments.preset == "fast" => {
            Settings::Windows(windows::Config::like_fast())
        }
        None => Settings::preset(&arguments.preset).map_err(usage)?,
    };
    if let Some(name) = &arguments.env {
        settings.environment_mut().set =
            ScenarioSetName::parse_with_subtasks(name)?.set().to_string();
    }
    if let Some(allocation) = arguments.allocation {
        allocate_by(&mut settings, allocation);
    }
    if let Some(mixer) = arguments.mixer {
        mix_by(&mut settings, mixer)?;
    }
    match method {
        AlmaMethod::Alma if arguments.no_mask => *settings.subtask_mut() = Conditioning::Input,
        AlmaMethod::Alma => {}
        AlmaMethod::Flat | AlmaMethod::Copa
            if arguments.no_mask || arguments.allocation.is_some() =>
        {
            let reason = "`flat` and `copa` have no subtasks: drop `--no-mask` and `--allocation`";
            return Err(Failure::new(Exit::Usage, reason.to_string()));
        }
        AlmaMethod::Flat => {
            *settings.subtask_mut() = Conditioning::None;
            if let Settings::Windows(config) = &mut settings {
                config.coach.enabled = false;
            }
        }
        AlmaMethod::Copa => enable_coach(&mut settings)?,
    }
    if let Some(steps) = arguments.steps {
        settings.run_mut().steps = steps;
    }
    for assignment in &arguments.assignments {
        settings.set(assignment).map_err(usage)?;
        given.extend(assignment.split_once('=').map(|(key, _)| key.trim().to_owned()));
    }
    settings.fit_to_length(|key| given.contains(key));
    Ok(settings)
}

/// Has a rule allocate in the place of a learned allocator.
fn allocate_by(settings: &mut Settings, allocation: Allocation) {
    match settings {
        Settings::Records(config) => {
            let weight = |rule| f64::from(u8::from(rule == allocation.name()));
            config.allocation.learned = 0.0;
            config.allocation.coordinated = weight("coordinated");
            config.allocation.heuristic = weight("heuristic");
            config.allocation.random = weight("random");
        }
        Settings::Windows(config) => config.allocation.by = allocation.name().to_owned(),
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

/// Reads a file, and adds the keys that it has a value for.
fn configuration_file(path: &Path, given: &mut BTreeSet<String>) -> Result<Settings, Failure> {
    let text = fs::read_to_string(path).map_err(|error| Failure::file(path, &error))?;
    let bad = |error: LearnError| Failure::from(error).within(path.display());
    let settings = Settings::from_toml(&text).map_err(bad)?;
    given.extend(keys_in(&text).map_err(bad)?);
    Ok(settings)
}

fn usage(error: LearnError) -> Failure {
    Failure::new(Exit::Usage, error.to_string())
}
