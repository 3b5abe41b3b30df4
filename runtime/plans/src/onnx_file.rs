//! ONNX files that keep their weights in another file beside them, as PyTorch's exporter writes them.
//!
//! Only what must be known of the format to put the weights into the file is read here; whether the rest of it makes
//! sense is found out elsewhere.

use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Component, Path};

use sortie_bundle::files::read_file;

#[cfg(test)]
mod tests;

/// The most bytes of a file, and of the weights beside it.
const MOST: u64 = 1 << 30;

/// Numbers of fields, by the names that ONNX has for them.
const GRAPH: u64 = 7;
const INITIALIZER: u64 = 5;
const RAW_DATA: u64 = 9;
const EXTERNAL_DATA: u64 = 13;
const DATA_LOCATION: u64 = 14;
const KEY: u64 = 1;
const VALUE: u64 = 2;

/// The location of data in another file.
const EXTERNAL: u64 = 1;

/// Whether a file begins as a plan does.
pub fn is_plan(file: &[u8]) -> bool {
    file.starts_with(b"SORTIEPL")
}

/// Reads an ONNX file, as [`read_plan_or_onnx`] does.
///
/// # Errors
/// Those of [`read_plan_or_onnx`], or if the file is a plan.
pub fn read_onnx(path: &Path) -> io::Result<Vec<u8>> {
    let file = read_plan_or_onnx(path)?;
    if is_plan(&file) {
        let what = "it is a plan, compiled already: name the ONNX file that it was made of";
        return Err(io::Error::new(io::ErrorKind::InvalidData, what));
    }
    Ok(file)
}

/// Reads a file. An ONNX file whose weights lie in another file of its folder comes back with them inside.
///
/// # Errors
/// If one of the files cannot be read, or is of another format, or if the weights are said to lie outside of the folder,
/// or where the other file has already ended.
pub fn read_plan_or_onnx(path: &Path) -> io::Result<Vec<u8>> {
    let file = read_file(path, MOST)?;
    if let Some(what) = other_format(path, &file) {
        return Err(io::Error::new(io::ErrorKind::InvalidData, what));
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut beside = Beside { folder, bytes: 0 };
    let whole = rewritten(&file, GRAPH, |graph| {
        rewritten(graph, INITIALIZER, |tensor| beside.complete(tensor))
    })?;
    Ok(whole.unwrap_or(file))
}

/// What a file is that people take for an ONNX file, and what to do about it.
fn other_format(path: &Path, file: &[u8]) -> Option<&'static str> {
    let is_named = |extension: &str| path.extension().is_some_and(|own| own == extension);
    // A header in JSON behind its length.
    let is_safetensors = || {
        let length = u64::from_le_bytes(*file.first_chunk()?);
        let fits = usize::try_from(length).is_ok_and(|length| length <= file.len());
        Some(fits && file.get(8) == Some(&b'{'))
    };
    Some(match file {
        _ if file.starts_with(b"version https://git-lfs") => {
            "it is a pointer of Git LFS, not the file itself: fetch that with `git lfs pull`"
        }
        _ if file.starts_with(b"PK\x03\x04") => {
            "it is a zip archive, as TorchScript and PyTorch's checkpoints are: export the module with `torch.onnx.export`"
        }
        _ if is_safetensors() == Some(true) => {
            "it holds weights of safetensors, and no graph: export the module with `torch.onnx.export`"
        }
        _ if is_named("nn") => {
            "it is a model of Unity's Barracuda: ML-Agents writes an ONNX file beside it"
        }
        _ => return None,
    })
}

/// The files beside a file.
struct Beside<'a> {
    folder: &'a Path,
    /// How many bytes were read of them.
    bytes: u64,
}

/// Where the numbers of a tensor lie.
#[derive(Default)]
struct Place {
    location: String,
    offset: u64,
    /// None: up to the end.
    length: Option<u64>,
}

impl Beside<'_> {
    /// A tensor with its numbers inside; none if it has them.
    fn complete(&mut self, tensor: &[u8]) -> io::Result<Option<Vec<u8>>> {
        let (mut place, mut is_external, mut rest) = (Place::default(), false, Vec::new());
        let mut left = tensor;
        while !left.is_empty() {
            let Some(field) = Field::take(&mut left) else { return Ok(None) };
            match field.number {
                EXTERNAL_DATA => place.note(field.content),
                DATA_LOCATION => is_external = field.value == EXTERNAL,
                _ => rest.extend(field.whole),
            }
        }
        if !is_external {
            return Ok(None);
        }
        put(&mut rest, RAW_DATA, &self.read(&place)?);
        Ok(Some(rest))
    }

    fn read(&mut self, place: &Place) -> io::Result<Vec<u8>> {
        let failed = |kind: io::ErrorKind, reason: &str| {
            io::Error::new(kind, format!("its weights lie in `{}`, {reason}", place.location))
        };
        let refused = |reason: &str| failed(io::ErrorKind::InvalidData, reason);
        let mut parts = Path::new(&place.location).components();
        if place.location.is_empty() || !parts.all(|part| matches!(part, Component::Normal(_))) {
            return Err(refused("which is no name of a file in its folder"));
        }
        let missing = |error: io::Error| {
            let reason = "which must lie in the same folder and cannot be read";
            failed(error.kind(), &format!("{reason} ({error})"))
        };
        let path = self.folder.join(&place.location);
        // A link could lead anywhere, and reading what is no file may never end.
        if !fs::symlink_metadata(&path).map_err(missing)?.is_file() {
            return Err(refused("which is no file"));
        }
        let mut file = File::open(&path).map_err(missing)?;
        let all = file.metadata().map_err(missing)?.len();
        let length = place.length.unwrap_or(all.saturating_sub(place.offset));
        if place.offset.checked_add(length).is_none_or(|end| end > all) {
            return Err(refused(
                "which has fewer bytes than it says: it may belong to another export",
            ));
        }
        self.bytes = self.bytes.saturating_add(length);
        if self.bytes > MOST {
            return Err(refused("and are more than 1 GiB"));
        }
        let mut bytes = Vec::new();
        file.seek(SeekFrom::Start(place.offset)).map_err(missing)?;
        file.take(length).read_to_end(&mut bytes).map_err(missing)?;
        Ok(bytes)
    }
}

impl Place {
    /// Notes a pair of a key and a value.
    fn note(&mut self, pair: &[u8]) {
        let text = |number: u64| {
            let mut left = pair;
            let fields = std::iter::from_fn(|| Field::take(&mut left));
            let content = fields.filter(|field| field.number == number).last();
            content.map_or("", |field| str::from_utf8(field.content).unwrap_or_default())
        };
        match (text(KEY), text(VALUE)) {
            ("location", name) => name.clone_into(&mut self.location),
            // What is no number lies nowhere.
            ("offset", offset) => self.offset = offset.parse().unwrap_or(u64::MAX),
            ("length", length) => self.length = Some(length.parse().unwrap_or(u64::MAX)),
            _ => {}
        }
    }
}

/// A field of a message as Protocol Buffers write them.
struct Field<'a> {
    number: u64,
    /// What it holds, where that is a number.
    value: u64,
    /// What it holds, where that is text, bytes or another message.
    content: &'a [u8],
    whole: &'a [u8],
}

impl<'a> Field<'a> {
    /// The next field; none where there is no more, or something else.
    fn take(left: &mut &'a [u8]) -> Option<Self> {
        let start = *left;
        let key = take_number(left)?;
        let (mut value, mut content) = (0, [].as_slice());
        match key & 7 {
            0 => value = take_number(left)?,
            1 => content = take_bytes(left, 8)?,
            2 => {
                let length = take_number(left)?;
                content = take_bytes(left, usize::try_from(length).ok()?)?;
            }
            5 => content = take_bytes(left, 4)?,
            _ => return None,
        }
        let whole = start.get(..start.len() - left.len())?;
        Some(Self { number: key >> 3, value, content, whole })
    }
}

fn take_bytes<'a>(left: &mut &'a [u8], count: usize) -> Option<&'a [u8]> {
    let (taken, rest) = left.split_at_checked(count)?;
    *left = rest;
    Some(taken)
}

/// Seven bits a byte, the lowest first; all but the last have the eighth bit.
fn take_number(left: &mut &[u8]) -> Option<u64> {
    let mut number = 0;
    for shift in (0..64).step_by(7) {
        let byte = u64::from(*take_bytes(left, 1)?.first()?);
        number |= (byte & 0x7f) << shift;
        if byte < 0x80 {
            return Some(number);
        }
    }
    None
}

fn put_number(to: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        to.push((number & 0x7f) as u8 | 0x80);
        number >>= 7;
    }
    to.push(number as u8);
}

/// Writes a field that holds bytes.
fn put(to: &mut Vec<u8>, number: u64, content: &[u8]) {
    put_number(to, number << 3 | 2);
    put_number(to, content.len() as u64);
    to.extend(content);
}

/// A message with other contents of the fields of one number; none where all stay as they are, or where it is no message.
fn rewritten(
    message: &[u8],
    number: u64,
    mut other: impl FnMut(&[u8]) -> io::Result<Option<Vec<u8>>>,
) -> io::Result<Option<Vec<u8>>> {
    let (mut written, mut is_other, mut left) = (Vec::new(), false, message);
    while !left.is_empty() {
        let Some(field) = Field::take(&mut left) else { return Ok(None) };
        let content = if field.number == number { other(field.content)? } else { None };
        match content {
            Some(content) => {
                is_other = true;
                put(&mut written, number, &content);
            }
            None => written.extend(field.whole),
        }
    }
    Ok(is_other.then_some(written))
}
