//! From flags to a setup.

use std::collections::BTreeSet;
use std::fs;

use sortie_learn::run::keys_in;
use sortie_learn::session::Setup;

use super::{Mixer, TrainArguments};
use crate::allocation::Allocation;
use crate::failure::Failure;
use crate::methods;

/// The setup that the command line asks for.
pub(super) fn setup(arguments: &TrainArguments) -> Result<Setup, Failure> {
    let entry = arguments.method.0;
    let mut given = BTreeSet::new();
    let mut setup = match &arguments.config {
        Some(path) => {
            let text = fs::read_to_string(path).map_err(|error| Failure::file(path, &error))?;
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
