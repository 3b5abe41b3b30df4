//! Records the episodes of an evaluation, a file each.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use sortie_bundle::files::{Durability, replace_file};
use sortie_envs::golden::{Labels, Record, StartRecording};
use sortie_envs::{Entry, Step};
use sortie_learn::LearnError;
use sortie_learn::play::{Onlooker, Watched};

use crate::failure::{Exit, Failure};
use crate::files::{Kind, try_output};

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
