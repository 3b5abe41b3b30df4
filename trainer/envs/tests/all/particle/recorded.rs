//! Files of recorded episodes.

use std::collections::BTreeMap;
use std::path::PathBuf;

use safetensors::{Dtype, SafeTensors};
use sortie_envs::particle::{Mover, Point};

/// The numbers of a tensor, whatever their type, with its first size.
struct Tensor {
    rows: usize,
    numbers: Vec<f64>,
}

/// One recorded episode.
pub(crate) struct Episode {
    /// File and number.
    pub(crate) name: String,
    tensors: BTreeMap<String, Tensor>,
    /// Width of what each agent sees.
    pub(crate) widths: Vec<usize>,
}

/// The episodes in the file of a set.
pub(crate) fn episodes(set: &str) -> Vec<Episode> {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/particle");
    let bytes = std::fs::read(folder.join(format!("{set}.safetensors"))).unwrap();
    let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
    let widths = &header.metadata().as_ref().unwrap()["obs_dims"];
    let widths: Vec<usize> = serde_json::from_str(widths).unwrap();
    let mut found = BTreeMap::<String, BTreeMap<String, Tensor>>::new();
    for (name, view) in SafeTensors::deserialize(&bytes).unwrap().tensors() {
        let data = view.data();
        let numbers = match view.dtype() {
            Dtype::F64 => data.as_chunks().0.iter().map(|it| f64::from_le_bytes(*it)).collect(),
            Dtype::F32 => {
                data.as_chunks().0.iter().map(|it| f32::from_le_bytes(*it).into()).collect()
            }
            Dtype::I32 => {
                data.as_chunks().0.iter().map(|it| i32::from_le_bytes(*it).into()).collect()
            }
            Dtype::I8 => data.iter().map(|it| it.cast_signed().into()).collect(),
            Dtype::U8 => data.iter().map(|it| f64::from(*it)).collect(),
            other => panic!("{name}: numbers of type {other:?}"),
        };
        let (episode, name) = name.split_once('/').unwrap();
        let tensor = Tensor { rows: view.shape()[0], numbers };
        found.entry(episode.to_owned()).or_default().insert(name.to_owned(), tensor);
    }
    let named = |(episode, tensors)| Episode {
        name: format!("{set} {episode}"),
        tensors,
        widths: widths.clone(),
    };
    found.into_iter().map(named).collect()
}

impl Episode {
    pub(crate) fn steps(&self) -> usize {
        self.tensors["actions"].rows
    }

    /// One row of a tensor.
    pub(crate) fn row(&self, name: &str, row: usize) -> &[f64] {
        let Tensor { rows, numbers } = &self.tensors[name];
        let width = numbers.len() / rows;
        &numbers[row * width..][..width]
    }

    /// One row of small whole numbers.
    pub(crate) fn whole(&self, name: &str, row: usize) -> Vec<u8> {
        self.row(name, row).iter().map(|number| *number as u8).collect()
    }

    /// All of a tensor of small whole numbers.
    pub(crate) fn all(&self, name: &str) -> Vec<u8> {
        self.tensors[name].numbers.iter().map(|number| *number as u8).collect()
    }

    pub(crate) fn actions(&self, step: usize) -> Vec<u16> {
        self.whole("actions", step).into_iter().map(u16::from).collect()
    }

    /// One row of points.
    pub(crate) fn points(&self, name: &str, row: usize) -> Vec<Point> {
        self.row(name, row).as_chunks().0.to_vec()
    }

    /// The landmarks of the whole episode.
    pub(crate) fn landmarks(&self) -> Vec<Point> {
        self.tensors["landmark_pos"].numbers.as_chunks().0.to_vec()
    }

    /// So many of the first agents before a step.
    pub(crate) fn movers(&self, step: usize, count: usize) -> Vec<Mover> {
        let both = self.points("pos", step).into_iter().zip(self.points("vel", step));
        both.map(|(position, velocity)| Mover { position, velocity }).take(count).collect()
    }

    /// What all agents see before a step, where it was recorded.
    pub(crate) fn seen(&self, step: usize) -> Option<&[f64]> {
        let rows = &self.tensors["obs_steps"].numbers;
        let row = rows.iter().position(|recorded| *recorded == step as f64)?;
        Some(self.row("obs", row))
    }
}
