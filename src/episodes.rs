//! Records the episodes of an evaluation, a file each.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use sortie_bundle::files::{Durability, replace_file};
use sortie_envs::{Environment, Step};
use sortie_learn::LearnError;
use sortie_learn::play::{Onlooker, Watched};
use sortie_methods::alma::evaluate::{Labels, Recorder, cities};

use crate::failure::Failure;
use crate::files::{Kind, try_output};

/// Writes recorded episodes into a folder.
pub(crate) struct EpisodeWriter {
    folder: PathBuf,
    policy: String,
    seed: u64,
    /// The running episodes by number.
    recorders: BTreeMap<usize, Recorder>,
}

impl EpisodeWriter {
    /// `labels` name who acts and who allocates.
    pub(crate) fn new(folder: &Path, labels: (&str, &str), seed: u64) -> Result<Self, Failure> {
        fs::create_dir_all(folder).map_err(|error| Failure::file(folder, &error))?;
        try_output(&folder.join("00000.json"), Kind::Episode)?;
        let policy = format!("{}, {} allocation", labels.0, labels.1);
        Ok(Self { folder: folder.to_owned(), policy, seed, recorders: BTreeMap::new() })
    }
}

impl Onlooker for EpisodeWriter {
    fn started(&mut self, watched: Watched<'_>) -> Result<(), LearnError> {
        let Watched { episode, instance, .. } = watched;
        let worlds = cities(&watched)?;
        let name = format!("{episode:05}-{}", worlds.episode(instance).group);
        let labels = Labels { name, policy: self.policy.clone(), seed: self.seed };
        self.recorders.insert(episode, Recorder::new(worlds, instance, labels));
        Ok(())
    }

    fn stepped(
        &mut self,
        watched: Watched<'_>,
        actions: &[u16],
        outcome: &Step,
    ) -> Result<(), LearnError> {
        let Watched { episode, instance, .. } = watched;
        let worlds = cities(&watched)?;
        if let Some(recorder) = self.recorders.get_mut(&episode) {
            recorder.record(worlds, &actions[..worlds.agent_count(instance)], outcome);
        }
        if outcome.done()
            && let Some(recorder) = self.recorders.remove(&episode)
        {
            let path = self.folder.join(format!("{episode:05}.json"));
            let episode = recorder.finish(worlds);
            replace_file(&path, episode.as_bytes(), Durability::Cached)
                .map_err(|source| LearnError::File { path, source })?;
        }
        Ok(())
    }
}
