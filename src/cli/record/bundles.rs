//! The bundles that a team decides by while it is recorded: the record brings all of them along.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::thread::JoinHandle;

use sortie_bundle::Bundle;
use sortie_ipc::{Domain, DomainFacts, model_text};

use super::log::Log;
use crate::deployment::{beside, model_id, open_bundle};
use crate::failure::{Exit, Failure, Outcome};
use crate::output::tell;

/// A bundle's model, and its files by their names.
type Read = (String, Vec<(String, Vec<u8>)>);

/// What a record brings along.
pub(super) struct Bundles<'a> {
    domain: &'a Domain,
    /// The team's as the record began, beside which those lie that it changes to.
    folder: &'a Path,
    /// Of the newest frame.
    generation: u16,
    /// The models of those that the record has, or was to have.
    known: BTreeSet<String>,
    /// One that is being read, which takes longer than a recorder may look away.
    reading: Option<JoinHandle<Result<Read, Failure>>>,
}

impl<'a> Bundles<'a> {
    /// Has the record bring along the bundle of the team.
    pub(super) fn open(
        domain: &'a Domain,
        folder: &'a Path,
        facts: &DomainFacts,
        log: &mut Log,
    ) -> Result<Self, Failure> {
        let (bundle, model) = (open_bundle(folder)?, facts.model().to_owned());
        let own = model_text(model_id(&bundle));
        if own != model {
            let folder = folder.display();
            let message = format!("{folder} is not the team's bundle: {own}, which has {model}");
            return Err(Failure::new(Exit::Mismatch, message));
        }
        attach(log, read(&bundle)?);
        let (generation, known) = (facts.bundles().generation(), BTreeSet::from([model]));
        Ok(Self { domain, folder, generation, known, reading: None })
    }

    /// Has the record bring along what the team has changed to, of which a frame of this generation tells.
    pub(super) fn look(&mut self, generation: u16, log: &mut Log) -> Outcome {
        if self.reading.as_ref().is_some_and(JoinHandle::is_finished) {
            self.end(log);
        }
        if generation == self.generation || self.reading.is_some() {
            return Ok(());
        }
        self.generation = generation;
        let Some(facts) = self.domain.facts()? else { return Ok(()) };
        let bundle = facts.bundles().of(generation);
        if self.known.insert(bundle.model.clone()) {
            let folder = beside(self.folder, &bundle.name);
            self.reading =
                Some(std::thread::spawn(move || open_bundle(&folder).and_then(|it| read(&it))));
        }
        Ok(())
    }

    /// Waits for what is being read.
    pub(super) fn end(&mut self, log: &mut Log) {
        let Some(reading) = self.reading.take() else { return };
        match reading.join().unwrap_or_else(|_| Err(Failure::new(Exit::Bug, "it was not read"))) {
            Ok(read) => attach(log, read),
            Err(failure) => tell!(
                "warning: the record does not bring along what the team has changed to: {}",
                failure.message
            ),
        }
    }
}

fn attach(log: &mut Log, (model, files): Read) {
    for (name, data) in files {
        log.attach(&format!("bundle/{model}/{name}"), &data);
    }
}

fn read(bundle: &Bundle) -> Result<Read, Failure> {
    let folder = bundle.folder();
    let failed = |error| Failure::file(folder, &error);
    let entries = folder.read_dir().map_err(failed)?;
    let mut paths: Vec<PathBuf> = Vec::new();
    for entry in entries {
        paths.push(entry.map_err(failed)?.path());
    }
    paths.sort();
    let files = paths.iter().filter(|path| path.is_file()).map(|path| {
        let data = std::fs::read(path).map_err(|error| Failure::file(path, &error))?;
        Ok((path.file_name().unwrap_or_default().to_string_lossy().into_owned(), data))
    });
    Ok((model_text(model_id(bundle)), files.collect::<Result<_, Failure>>()?))
}
