//! Checkpoints: everything that a run needs to go on exactly as if it had never stopped.
//!
//! A checkpoint is a folder named by its environment steps. It is written beside its final place,
//! forced to the disk, and renamed; the one before is deleted only afterwards. So a crash at any
//! instant leaves a complete checkpoint, and a damaged one is recognised by its checksums.
//!
//! | file | content |
//! | --- | --- |
//! | `manifest.toml` | format version, version of Sortie, steps, instructions of products, sizes and CRC-64 of the others |
//! | `tensors.safetensors` | networks, each with its vectors (`online/`, `target/`, those of the optimiser), cut into their tensors |
//! | `state.postcard` | counters, generators, running episodes, the curve, the replays |

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crc::{CRC_64_XZ, Crc, Table};
use safetensors::tensor::{Dtype, SafeTensorError, SafeTensors, TensorView};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use sortie_bundle::files::{
    Durability, MOST_TEXT_BYTES, read_file, read_text, sync_folder, write_parts,
};
use sortie_nn::layers::products::Products;
use sortie_nn::tape::Tensor;

use crate::error::{LearnError, Result};

/// Version of the files of a checkpoint; another version is refused.
const FORMAT: u32 = 6;
/// The oldest version whose networks are still read; nobody can go on from it.
const READABLE: u32 = 3;
const KEPT: usize = 2;
/// What the name of a checkpoint ends with while it is written.
const UNFINISHED: &str = "unfinished";
const MANIFEST: &str = "manifest.toml";
const TENSORS: &str = "tensors.safetensors";
const STATE: &str = "state.postcard";

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Manifest {
    format: u32,
    version: String,
    env_steps: u64,
    /// Instructions of matrix products.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    products: Option<String>,
    /// Sizes of networks, which checkpoints of before had.
    #[serde(default, skip_serializing)]
    shapes: Option<toml::Table>,
    files: BTreeMap<String, FileSum>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileSum {
    bytes: u64,
    /// CRC-64/XZ in hexadecimal.
    crc64: String,
}

impl FileSum {
    fn of<'a>(parts: impl IntoIterator<Item = &'a [u8]>) -> Self {
        static CRC: Crc<u64, Table<16>> = Crc::<u64, Table<16>>::new(&CRC_64_XZ);
        let (mut bytes, mut digest) = (0, CRC.digest());
        for part in parts {
            bytes += part.len() as u64;
            digest.update(part);
        }
        Self { bytes, crc64: format!("{:016x}", digest.finalize()) }
    }
}

/// Everything that a run depends on, as a [visit](crate::state::State) has found it.
#[derive(Debug, Default)]
pub struct Written {
    /// Name, sizes and numbers of every tensor, as the file has them.
    pub tensors: Vec<(String, Vec<usize>, Vec<u8>)>,
    /// Everything else by its name.
    pub values: BTreeMap<String, Vec<u8>>,
}

/// The checkpoints of a run.
#[derive(Clone, Debug)]
pub struct Checkpoints {
    folder: PathBuf,
}

/// What a checkpoint is opened for, which decides how thoroughly it is checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OpenFor {
    /// To use a network: the checksum of the tensors and the size of the state.
    Use,
    /// To go on learning: both checksums.
    Resume,
}

/// A checkpoint, and why newer ones were passed over.
#[derive(Clone, Debug)]
pub struct Found {
    /// The newest sound checkpoint.
    pub checkpoint: Checkpoint,
    /// One sentence per newer checkpoint that was refused.
    pub refused: Vec<String>,
}

impl Checkpoints {
    /// The checkpoints in a folder, which need not exist yet.
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned() }
    }

    /// Writes a checkpoint and deletes those that are no longer needed.
    ///
    /// # Errors
    /// The disk is full, or a file cannot be written.
    pub fn write(&self, env_steps: u64, written: &Written) -> Result<PathBuf> {
        std::fs::create_dir_all(&self.folder).map_err(LearnError::file(&self.folder))?;
        let place = self.folder.join(format!("{env_steps:012}"));
        let unfinished = place.with_extension(UNFINISHED);
        remove(&unfinished)?;
        let written = write_files(&unfinished, env_steps, written).and_then(|()| {
            remove(&place)?;
            std::fs::rename(&unfinished, &place).map_err(LearnError::file(&place))
        });
        if written.is_err() {
            // The first error matters. On a full disk this makes room for what was there before.
            let _ = remove(&unfinished);
        }
        written?;
        sync_folder(&self.folder).map_err(LearnError::file(&self.folder))?;
        for old in self.complete()?.iter().rev().skip(KEPT) {
            remove(old)?;
        }
        Ok(place)
    }

    /// Removes what processes were writing when they died.
    pub fn remove_unfinished(&self) {
        for entry in std::fs::read_dir(&self.folder).into_iter().flatten().flatten() {
            if entry.path().extension().is_some_and(|end| end == UNFINISHED) {
                let _ = remove(&entry.path());
            }
        }
    }

    /// Whether there is any, sound or not.
    pub fn exist(&self) -> Result<bool> {
        Ok(!self.complete()?.is_empty())
    }

    /// The newest checkpoint that is whole and of this version.
    pub fn newest(&self, purpose: OpenFor) -> Result<Found> {
        let mut refused = Vec::new();
        for place in self.complete()?.iter().rev() {
            match Checkpoint::open(place, purpose) {
                Ok(checkpoint) => return Ok(Found { checkpoint, refused }),
                Err(error) => refused.push(error.to_string()),
            }
        }
        let reason = if refused.is_empty() {
            "there is no checkpoint".to_owned()
        } else {
            format!("no checkpoint can be used: {}", refused.join("; "))
        };
        Err(LearnError::format(&self.folder, reason))
    }

    /// Folders of finished checkpoints, the oldest first.
    fn complete(&self) -> Result<Vec<PathBuf>> {
        if !self.folder.exists() {
            return Ok(Vec::new());
        }
        let entries = std::fs::read_dir(&self.folder).map_err(LearnError::file(&self.folder))?;
        let mut places = Vec::new();
        for entry in entries {
            let path = entry.map_err(LearnError::file(&self.folder))?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            if !name.is_empty() && name.bytes().all(|byte| byte.is_ascii_digit()) {
                places.push(path);
            }
        }
        places.sort();
        Ok(places)
    }
}

/// Writes the files of a checkpoint into a new folder and forces them to the disk.
fn write_files(folder: &Path, env_steps: u64, written: &Written) -> Result<()> {
    let bad = |error: &dyn std::fmt::Display| LearnError::format(folder, error);
    let write = |name: &str, parts: &[&[u8]]| {
        let path = folder.join(name);
        let written = write_parts(&path, parts.iter().copied(), Durability::Forced);
        written.map_err(LearnError::file(path))
    };
    std::fs::create_dir(folder).map_err(LearnError::file(folder))?;
    let tensors = written
        .tensors
        .iter()
        .map(|(name, sizes, bytes)| Ok((name, TensorView::new(Dtype::F32, sizes.clone(), bytes)?)));
    let tensors: Result<Vec<_>, SafeTensorError> = tensors.collect();
    let tensors = tensors.and_then(|tensors| safetensors::serialize(tensors, None));
    let tensors = tensors.map_err(|error| bad(&error))?;
    let values = in_parts(&written.values).map_err(|error| bad(&error))?;
    let values = values.iter().flat_map(|(before, value)| [before.as_slice(), value]);
    let mut files = BTreeMap::new();
    for (name, parts) in [(TENSORS, vec![&*tensors]), (STATE, values.collect())] {
        write(name, &parts)?;
        files.insert(name.to_owned(), FileSum::of(parts));
    }
    let version = env!("CARGO_PKG_VERSION").to_owned();
    let products = Some(Products::here().to_string());
    let manifest = Manifest { format: FORMAT, version, env_steps, products, shapes: None, files };
    let manifest = toml::to_string(&manifest).map_err(|error| bad(&error))?;
    write(MANIFEST, &[manifest.as_bytes()])?;
    sync_folder(folder).map_err(LearnError::file(folder))
}

/// One checkpoint whose manifest fits its files.
#[derive(Clone, Debug)]
pub struct Checkpoint {
    place: PathBuf,
    manifest: Manifest,
    tensors: Vec<u8>,
}

impl Checkpoint {
    /// Opens a checkpoint's folder and checks its version and its files.
    pub fn open(place: &Path, purpose: OpenFor) -> Result<Self> {
        let path = place.join(MANIFEST);
        let text = read_text(&path, MOST_TEXT_BYTES).map_err(LearnError::file(&path))?;
        let table: toml::Table = text.parse().map_err(|e| LearnError::format(&path, e))?;
        let format = table.get("format").and_then(toml::Value::as_integer);
        let oldest = if purpose == OpenFor::Use { READABLE } else { FORMAT };
        if !format.is_some_and(|format| (oldest.into()..=FORMAT.into()).contains(&format)) {
            let found = format.map_or("none".to_owned(), |format| format.to_string());
            let aim = if purpose == OpenFor::Use { "reads" } else { "goes on from" };
            let reason = format!("format {found}, but this version of Sortie {aim} {FORMAT}");
            return Err(LearnError::format(&path, reason));
        }
        let manifest: Manifest = table.try_into().map_err(|e| LearnError::format(&path, e))?;
        let mut checkpoint = Self { place: place.to_owned(), manifest, tensors: Vec::new() };
        match purpose {
            OpenFor::Use => checkpoint.check_size(STATE)?,
            OpenFor::Resume => drop(checkpoint.read(STATE)?),
        }
        checkpoint.tensors = checkpoint.read(TENSORS)?;
        Ok(checkpoint)
    }

    /// Environment steps when it was written.
    pub fn env_steps(&self) -> u64 {
        self.manifest.env_steps
    }

    /// Its folder.
    pub fn place(&self) -> &Path {
        &self.place
    }

    /// A vector of a network as in `agents/online`, put together from its tensors.
    ///
    /// # Errors
    /// It has not all of them, or of other sizes.
    pub fn vector(&self, name: &str, tensors: &[Tensor]) -> Result<Vec<f32>> {
        let parts = tensors.iter().map(|tensor| {
            self.whole_vector(&format!("{name}/{}", tensor.name), tensor.range.len())
        });
        Ok(parts.collect::<Result<Vec<_>, _>>()?.concat())
    }

    /// A vector of so many numbers that was saved whole, by network and vector as in `mixer/online`.
    pub fn whole_vector(&self, name: &str, count: usize) -> Result<Vec<f32>> {
        let file = SafeTensors::deserialize(&self.tensors).map_err(|error| self.bad(error))?;
        let view = file.tensor(name).map_err(|error| self.bad(format!("{name}: {error}")))?;
        let (numbers, rest) = view.data().as_chunks::<4>();
        if view.dtype() != Dtype::F32 || numbers.len() != count || !rest.is_empty() {
            return Err(self.bad(format!("{name} has another size or type")));
        }
        let numbers = numbers.iter().map(|bytes| f32::from_le_bytes(*bytes));
        if let Some(place) = numbers.clone().position(|number| !number.is_finite()) {
            return Err(self.bad(format!("{name}: number {place} is not finite")));
        }
        Ok(numbers.collect())
    }

    /// Everything that is not a parameter vector.
    pub fn state<T: DeserializeOwned>(&self) -> Result<T> {
        postcard::from_bytes(&self.read(STATE)?).map_err(|error| self.bad(error))
    }

    fn read(&self, name: &str) -> Result<Vec<u8>> {
        let path = self.place.join(name);
        let damaged = || LearnError::format(&path, "cut short or damaged: its checksum is another");
        let stated = self.manifest.files.get(name).ok_or_else(damaged)?;
        let content = match read_file(&path, stated.bytes) {
            Err(error) if error.kind() == ErrorKind::FileTooLarge => return Err(damaged()),
            read => read.map_err(LearnError::file(&path))?,
        };
        if *stated == FileSum::of([&*content]) { Ok(content) } else { Err(damaged()) }
    }

    fn check_size(&self, name: &str) -> Result<()> {
        let path = self.place.join(name);
        let bytes = std::fs::metadata(&path).map_err(LearnError::file(&path))?.len();
        if self.manifest.files.get(name).is_some_and(|sum| sum.bytes == bytes) {
            Ok(())
        } else {
            Err(LearnError::format(path, "cut short or damaged: its size is another"))
        }
    }

    /// Says what is wrong with it.
    pub fn bad(&self, reason: impl ToString) -> LearnError {
        LearnError::format(&self.place, reason)
    }
}

/// Numbers as files have them.
pub(crate) fn in_bytes(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

fn remove(folder: &Path) -> Result<()> {
    match std::fs::remove_dir_all(folder) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(LearnError::file(folder)(error))
        }
        _ => Ok(()),
    }
}

/// Values as postcard writes a map, without a copy of them: each with what stands before it, which is how many there are,
/// then its name and how long it is.
fn in_parts(values: &BTreeMap<String, Vec<u8>>) -> postcard::Result<Vec<(Vec<u8>, &[u8])>> {
    let mut parts = vec![(postcard::to_stdvec(&values.len())?, &[][..])];
    for (name, value) in values {
        let mut before = postcard::to_stdvec(name)?;
        before.extend(postcard::to_stdvec(&value.len())?);
        parts.push((before, value));
    }
    Ok(parts)
}

#[cfg(test)]
mod tests;
