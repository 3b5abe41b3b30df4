//! Files of recorded episodes.

use std::collections::BTreeMap;

use safetensors::SafeTensors;
use serde_json::Value;
use sortie_envs::gridworld::Task;

use super::folder;

/// The bytes of a tensor, with its sizes.
struct Tensor {
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

/// One recorded episode.
pub(crate) struct Episode {
    /// File and number.
    pub(crate) name: String,
    pub(crate) agents: usize,
    pub(crate) treasures: usize,
    pub(crate) map: String,
    pub(crate) tiers: Vec<Task>,
    tensors: BTreeMap<String, Tensor>,
}

/// The episodes in the file of a set.
pub(crate) fn episodes(set: &str) -> Vec<Episode> {
    let bytes = std::fs::read(folder().join(format!("{set}.safetensors"))).unwrap();
    let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
    let metadata = header.metadata().as_ref().unwrap();
    let whole = |name: &str| metadata[name].parse::<usize>().unwrap();
    let told: Vec<Value> = serde_json::from_str(&metadata["episodes"]).unwrap();
    let mut tensors = BTreeMap::<String, BTreeMap<String, Tensor>>::new();
    for (name, view) in SafeTensors::deserialize(&bytes).unwrap().tensors() {
        let (episode, name) = name.split_once('/').unwrap();
        let tensor = Tensor { shape: view.shape().to_vec(), bytes: view.data().to_vec() };
        tensors.entry(episode.to_owned()).or_default().insert(name.to_owned(), tensor);
    }
    let lines = |map: &Value| -> Vec<String> {
        map.as_array().unwrap().iter().map(|row| row.as_str().unwrap().to_owned()).collect()
    };
    let named = |((episode, tensors), told): ((String, _), &Value)| Episode {
        name: format!("{set} {episode}"),
        agents: whole("n_agents"),
        treasures: whole("n_obj_types"),
        map: lines(&told["map"]).join("\n"),
        tiers: tiers(&told["task_tiers"]),
        tensors,
    };
    tensors.into_iter().zip(&told).map(named).collect()
}

/// Tasks by their published numbers.
pub(crate) fn tiers(numbers: &Value) -> Vec<Task> {
    let task = |number: &Value| match number.as_u64().unwrap() {
        1 => Task::All,
        2 => Task::Same,
        3 => Task::Own,
        other => panic!("task {other}"),
    };
    numbers.as_array().unwrap().iter().map(task).collect()
}

impl Episode {
    pub(crate) fn steps(&self) -> usize {
        self.tensors["actions"].shape[0]
    }

    fn row_bytes(&self, name: &str, row: usize) -> &[u8] {
        let Tensor { shape, bytes } = &self.tensors[name];
        let width = bytes.len() / shape[0];
        &bytes[row * width..][..width]
    }

    /// One row of small whole numbers.
    pub(crate) fn bytes(&self, name: &str, row: usize) -> &[u8] {
        self.row_bytes(name, row)
    }

    /// One row of 32-bit numbers.
    pub(crate) fn floats(&self, name: &str, row: usize) -> Vec<f32> {
        let bytes = self.row_bytes(name, row);
        bytes.as_chunks().0.iter().map(|it| f32::from_le_bytes(*it)).collect()
    }

    /// All 64-bit numbers of a tensor.
    pub(crate) fn doubles(&self, name: &str) -> Vec<f64> {
        let bytes = &self.tensors[name].bytes;
        bytes.as_chunks().0.iter().map(|it| f64::from_le_bytes(*it)).collect()
    }
}
