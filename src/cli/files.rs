//! The files that verbs write: tried before the work, written whole, and never over something else. Among them observations, by
//! a policy that keeps what it decides on, and episodes, a file each.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};

use sortie_bundle::files::{Durability, check_writable, read_file, replace_file};
use sortie_bundle::{Bundle, Recording};
use sortie_core::Policy;
use sortie_envs::golden::{Labels, Record, StartRecording};
use sortie_envs::{Entry, Step};
use sortie_learn::LearnError;
use sortie_learn::draft::DecoratedPolicy;
use sortie_learn::play::{Onlooker, Watched};

use crate::failure::{Exit, Failure, Outcome};

/// The largest file of observations that is read.
const MOST_RECORDED_BYTES: u64 = 1 << 30;

/// What a file holds, by its first bytes. A file that is there already is replaced by one of its own kind only.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Plan,
    Page,
    Observations,
    Episode,
    Certificate,
}

impl Kind {
    fn beginning(self) -> &'static [u8] {
        match self {
            Self::Plan => b"SORTIEPL",
            Self::Page => b"<!doctype html>",
            Self::Observations => b"SORTIEOB",
            Self::Episode => b"{",
            Self::Certificate => b"# Decisions of ",
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Plan => "a plan",
            Self::Page => "a page",
            Self::Observations => "a file of observations",
            Self::Episode => "a recorded episode",
            Self::Certificate => "a certificate",
        }
    }
}

/// Refuses what cannot be written later: places out of reach, and files of another kind.
pub fn try_output(path: &Path, kind: Kind) -> Outcome {
    let file = |error: std::io::Error| Failure::file(path, &error);
    // Devices and pipes are no files to replace.
    if path.is_file() {
        let mut start = Vec::new();
        let length = kind.beginning().len() as u64;
        File::open(path)
            .and_then(|file| file.take(length).read_to_end(&mut start))
            .map_err(file)?;
        if !start.is_empty() && !start.eq_ignore_ascii_case(kind.beginning()) {
            let (path, kind) = (path.display(), kind.name());
            let reason = format!(
                "{path} is there already and is not {kind}: remove it, or choose another name"
            );
            return Err(Failure::new(Exit::Usage, reason));
        }
    }
    check_writable(path).map_err(file)
}

/// Writes a file as a whole, or leaves what is there.
pub fn write_output(path: &Path, content: &[u8]) -> Outcome {
    replace_file(path, content, Durability::Cached).map_err(|error| Failure::file(path, &error))
}

/// What observations of a bundle's agents are recorded in.
pub fn recording_of(bundle: &Bundle) -> Recording {
    let contract = bundle.contract();
    Recording::new(contract.hash(), contract.features.into(), contract.actions.into())
}

/// A policy that records every observation that it decides on.
pub fn recording_policy<'a>(
    policy: &'a mut dyn Policy,
    recording: &'a mut Recording,
) -> impl Policy + 'a {
    DecoratedPolicy::new(policy, |policy, observation, hidden| {
        recording.add(observation);
        policy.decide_with(observation, hidden)
    })
}

/// Reads a file of observations, whatever they are of.
pub fn read_any_recording(path: &Path) -> Result<Recording, Failure> {
    let bytes =
        read_file(path, MOST_RECORDED_BYTES).map_err(|error| Failure::file(path, &error))?;
    Recording::from_bytes(&bytes)
        .map_err(|error| Failure::new(Exit::BadData, error.to_string()).within(path.display()))
}

/// Reads a file of observations that fit a bundle.
pub fn read_recording(path: &Path, bundle: &Bundle) -> Result<Recording, Failure> {
    let recording = read_any_recording(path)?;
    let (want, got) = (bundle.contract().hash(), recording.contract);
    if want != got {
        let message = format!(
            "{}: recorded under contract {got:016x}, {} has {want:016x}: record with `sortie eval {} --dump FILE`",
            path.display(),
            bundle.folder().display(),
            bundle.folder().display()
        );
        return Err(Failure::new(Exit::Mismatch, message));
    }
    Ok(recording)
}

/// Writes recorded episodes into a folder.
pub(crate) struct EpisodeWriter {
    folder: PathBuf,
    start: StartRecording,
    policy: String,
    seed: u64,
    /// The running episodes by number.
    recordings: BTreeMap<usize, Box<dyn Record>>,
}

impl EpisodeWriter {
    /// `labels` name who acts and who allocates.
    pub(crate) fn new(
        folder: &Path,
        entry: &Entry,
        labels: (&str, &str),
        seed: u64,
    ) -> Result<Self, Failure> {
        let start = entry.recordings.and_then(|recordings| recordings.record);
        let never = || {
            let reason = format!("episodes of `{}` are not recorded", entry.name);
            Failure::new(Exit::Usage, reason)
        };
        let start = start.ok_or_else(never)?;
        fs::create_dir_all(folder).map_err(|error| Failure::file(folder, &error))?;
        try_output(&folder.join("00000.json"), Kind::Episode)?;
        let policy = format!("{}, {} allocation", labels.0, labels.1);
        Ok(Self { folder: folder.to_owned(), start, policy, seed, recordings: BTreeMap::new() })
    }
}

impl Onlooker for EpisodeWriter {
    fn started(&mut self, watched: Watched<'_>) -> Result<(), LearnError> {
        let Watched { episode, instance, worlds } = watched;
        let name = format!("{episode:05}-{}", worlds.episode(instance).group);
        let labels = Labels { name, policy: self.policy.clone(), seed: self.seed };
        let elsewhere = || LearnError::Team("it records another environment".to_owned());
        let recording = (self.start)(worlds, instance, labels).ok_or_else(elsewhere)?;
        self.recordings.insert(episode, recording);
        Ok(())
    }

    fn stepped(
        &mut self,
        watched: Watched<'_>,
        actions: &[u16],
        outcome: &Step,
    ) -> Result<(), LearnError> {
        let Watched { episode, worlds, .. } = watched;
        if let Some(recording) = self.recordings.get_mut(&episode) {
            recording.step(worlds, actions, outcome);
        }
        if outcome.done()
            && let Some(recording) = self.recordings.remove(&episode)
        {
            let path = self.folder.join(format!("{episode:05}.json"));
            let episode = recording.finish(worlds);
            replace_file(&path, episode.as_bytes(), Durability::Cached)
                .map_err(|source| LearnError::File { path, source })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_replaced_by_their_own_kind_only() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        for (content, exit) in [
            ("", None),
            ("SORTIEPL and more", None),
            ("<!doctype html>", Some(Exit::Usage)),
            ("S", Some(Exit::Usage)),
        ] {
            std::fs::write(&path, content).unwrap();
            let tried = try_output(&path, Kind::Plan).map_err(|failure| failure.exit);
            assert_eq!(tried.err(), exit, "{content}");
        }
        assert!(try_output(&folder.path().join("new"), Kind::Plan).is_ok());
        let nowhere = try_output(&folder.path().join("no/file"), Kind::Plan).unwrap_err();
        assert_eq!(nowhere.exit, Exit::Missing);
        assert!(try_output(Path::new("/dev/null"), Kind::Page).is_ok());
    }
}
