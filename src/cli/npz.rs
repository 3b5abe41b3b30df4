//! Arrays that NumPy saved together: `numpy.savez`, a zip archive of `.npy` files that are not compressed.
//!
//! Every length in such a file is only claimed: nothing is read or reserved beyond the file's own bytes.

use std::collections::BTreeMap;
use std::path::Path;

use sortie_bundle::files::{MOST_BYTES, read_file};
use sortie_plans::{PolicyFacts, RecordedCase};

use crate::failure::{Exit, Failure};

/// The arrays of a file by name.
pub type Arrays = BTreeMap<String, Array>;

/// An array of numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    pub shape: Vec<usize>,
    /// Row by row. Whole numbers are exact as far as 2^24.
    pub numbers: Vec<f32>,
}

pub fn read(path: &Path) -> Result<Arrays, Failure> {
    let failed = |error: std::io::Error| Failure::file(path, &error);
    let bytes = read_file(path, MOST_BYTES).map_err(failed)?;
    arrays(&bytes)
        .map_err(|reason| Failure::new(Exit::BadData, format!("{}: {reason}", path.display())))
}

/// Reads the arrays of an archive, or says why not.
fn arrays(archive: &[u8]) -> Result<Arrays, String> {
    let mut arrays = Arrays::new();
    for Member { name, bytes } in members(archive)? {
        let name = name.strip_suffix(".npy").unwrap_or(&name).to_owned();
        let array = array(bytes).map_err(|reason| format!("`{name}` {reason}"))?;
        arrays.insert(name, array);
    }
    Ok(arrays)
}

/// A file of an archive.
struct Member<'a> {
    name: String,
    bytes: &'a [u8],
}

/// The files of a zip archive, as its directory lists them.
fn members(archive: &[u8]) -> Result<Vec<Member<'_>>, String> {
    const END: [u8; 4] = *b"PK\x05\x06";
    const END_BYTES: usize = 22;
    const ENTRY: [u8; 4] = *b"PK\x01\x02";
    const ENTRY_BYTES: usize = 46;
    const FILE: [u8; 4] = *b"PK\x03\x04";
    const FILE_BYTES: usize = 30;
    let broken = || "is no whole .npz file: save it again with `numpy.savez`".to_owned();
    let last = archive.len().checked_sub(END_BYTES).ok_or_else(broken)?;
    // A comment of at most 64 KiB may stand behind.
    let end = (last.saturating_sub(0xFFFF)..=last).rev();
    let end = end.filter_map(|at| archive.get(at..)).find(|rest| rest.starts_with(&END));
    let end = end.ok_or_else(broken)?;
    let count = half(end, 10).ok_or_else(broken)?;
    let mut at = word(end, 16).ok_or_else(broken)?;
    let mut members = Vec::new();
    for _ in 0..count {
        let entry = archive.get(at..).filter(|entry| entry.starts_with(&ENTRY));
        let entry = entry.ok_or_else(broken)?;
        let part = |at| half(entry, at).ok_or_else(broken);
        let whole = |at| word(entry, at).ok_or_else(broken);
        let (name_bytes, extra, comment) = (part(28)?, part(30)?, part(32)?);
        let name = entry.get(ENTRY_BYTES..ENTRY_BYTES + name_bytes).ok_or_else(broken)?;
        let name = String::from_utf8_lossy(name).into_owned();
        if part(10)? != 0 {
            return Err(format!("`{name}` is compressed: save it with `numpy.savez`"));
        }
        let (length, start) = (whole(24)?, whole(42)?);
        let file = archive.get(start..).filter(|file| file.starts_with(&FILE));
        let file = file.ok_or_else(broken)?;
        let before = half(file, 26).zip(half(file, 28)).ok_or_else(broken)?;
        let data = FILE_BYTES + before.0 + before.1;
        let bytes = file.get(data..).and_then(|rest| rest.get(..length)).ok_or_else(broken)?;
        members.push(Member { name, bytes });
        at += ENTRY_BYTES + name_bytes + extra + comment;
    }
    Ok(members)
}

/// A number of two bytes.
fn half(bytes: &[u8], at: usize) -> Option<usize> {
    Some(u16::from_le_bytes(*bytes.get(at..)?.first_chunk()?).into())
}

/// A number of four bytes.
fn word(bytes: &[u8], at: usize) -> Option<usize> {
    usize::try_from(u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?)).ok()
}

/// Reads an `.npy` file.
fn array(file: &[u8]) -> Result<Array, String> {
    let broken = || "is no array: save it again with `numpy.savez`".to_owned();
    let rest = file.strip_prefix(b"\x93NUMPY").ok_or_else(broken)?;
    let (length, start) = match rest.first().ok_or_else(broken)? {
        1 => (half(rest, 2), 4),
        _ => (word(rest, 2), 6),
    };
    let rest = rest.get(start..).ok_or_else(broken)?;
    let (header, data) = rest.split_at_checked(length.ok_or_else(broken)?).ok_or_else(broken)?;
    let header = std::str::from_utf8(header).map_err(|_| broken())?;
    if value_of(header, "fortran_order").ok_or_else(broken)?.starts_with("True") {
        return Err("is stored column by column: save `numpy.ascontiguousarray` of it".to_owned());
    }
    let shape = shape(header).ok_or_else(broken)?;
    let kind = value_of(header, "descr").ok_or_else(broken)?;
    let kind = kind.get(1..).and_then(|kind| kind.split(['\'', '"']).next()).ok_or_else(broken)?;
    let numbers = numbers(kind, data).ok_or_else(|| {
        format!("has the type `{kind}`: save it as float16, float32, float64, int64, int32, uint8 or bool")
    })?;
    let length = shape.iter().try_fold(1_usize, |length, size| length.checked_mul(*size));
    if length != Some(numbers.len()) {
        return Err(broken());
    }
    Ok(Array { shape, numbers })
}

/// What stands behind a key of the header, a Python dictionary as NumPy writes it.
fn value_of<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let (_, value) = header.split_once(&format!("'{key}':"))?;
    Some(value.trim_start())
}

fn shape(header: &str) -> Option<Vec<usize>> {
    let (sizes, _) = value_of(header, "shape")?.strip_prefix('(')?.split_once(')')?;
    let sizes = sizes.split(',').map(str::trim).filter(|size| !size.is_empty());
    sizes.map(|size| size.parse().ok()).collect()
}

/// The numbers of a known type; none of others.
fn numbers(kind: &str, data: &[u8]) -> Option<Vec<f32>> {
    fn each<const N: usize>(data: &[u8], number: fn([u8; N]) -> f32) -> Vec<f32> {
        data.as_chunks().0.iter().map(|bytes| number(*bytes)).collect()
    }
    Some(match kind {
        "<f2" => each(data, |bytes| of_half(u16::from_le_bytes(bytes))),
        "<f4" => each(data, f32::from_le_bytes),
        "<f8" => each(data, |bytes| f64::from_le_bytes(bytes) as f32),
        "<i8" => each(data, |bytes| i64::from_le_bytes(bytes) as f32),
        "<i4" => each(data, |bytes| i32::from_le_bytes(bytes) as f32),
        "|u1" | "|b1" => each(data, |[byte]| f32::from(byte)),
        _ => return None,
    })
}

/// A number of 16 bits: a sign, five bits of exponent, ten of fraction.
fn of_half(bits: u16) -> f32 {
    let (exponent, fraction) = (i32::from(bits >> 10 & 31), f32::from(bits & 1023));
    let size = match exponent {
        0 => fraction * 2.0_f32.powi(-24),
        31 if fraction == 0.0 => f32::INFINITY,
        31 => f32::NAN,
        _ => (1024.0 + fraction) * 2.0_f32.powi(exponent - 25),
    };
    if bits >> 15 == 1 { -size } else { size }
}

/// What was recorded, in the order in which a policy takes it.
pub struct RecordedInputs<'a> {
    arrays: &'a Arrays,
    /// Cases, at least one.
    pub count: usize,
    given: Vec<&'a Array>,
    /// Recurrent states; none where one of them was not recorded.
    states: Option<Vec<&'a Array>>,
}

impl<'a> RecordedInputs<'a> {
    /// Finds the inputs of a policy.
    ///
    /// # Errors
    /// The message names what is missing, or is not as the policy takes it.
    pub fn of(facts: &PolicyFacts, arrays: &'a Arrays) -> Result<Self, String> {
        let first = facts.given().find_map(|input| arrays.get(&format!("in__{}", input.name)));
        let count = first.and_then(|array| array.shape.first().copied()).unwrap_or(0);
        let mut inputs = Self { arrays, count, given: Vec::new(), states: None };
        for input in facts.given() {
            let array = inputs.needed(&format!("in__{}", input.name), input.length())?;
            inputs.given.push(array);
        }
        if count == 0 {
            return Err("the first axis of every array counts the cases: there are none".to_owned());
        }
        let states = facts.states.iter();
        let states =
            states.map(|state| inputs.found(&format!("in__{}", state.input), state.length));
        inputs.states = states.collect::<Result<Option<Vec<_>>, _>>()?;
        Ok(inputs)
    }

    /// An array that need not have been recorded.
    pub fn found(&self, name: &str, length: usize) -> Result<Option<&'a Array>, String> {
        match self.arrays.get(name) {
            Some(array) => self.checked(name, array, length).map(Some),
            None => Ok(None),
        }
    }

    /// An array that must have been.
    pub fn needed(&self, name: &str, length: usize) -> Result<&'a Array, String> {
        self.found(name, length)?.ok_or_else(|| self.missing(name))
    }

    /// Says that an array is missing.
    pub fn missing(&self, name: &str) -> String {
        let names: Vec<&str> = self.arrays.keys().map(String::as_str).collect();
        format!("there is no `{name}`, only {}", names.join(", "))
    }

    /// Whether all recurrent states were recorded.
    pub fn has_states(&self) -> bool {
        self.states.is_some()
    }

    /// The numbers of a case in an array.
    pub fn numbers(&self, array: &'a Array, case: usize) -> &'a [f32] {
        let length = array.numbers.len() / self.count.max(1);
        array.numbers.get(case * length..(case + 1) * length).unwrap_or_default()
    }

    /// The inputs of a case.
    pub fn case(&self, case: usize) -> RecordedCase<'a> {
        let inputs = self.given.iter().map(|array| self.numbers(array, case)).collect();
        let states = self.states.as_ref().map(|states| {
            states.iter().flat_map(|array| self.numbers(array, case)).copied().collect()
        });
        RecordedCase { inputs, states }
    }

    /// Refuses an array that does not hold so many numbers a case, or something that is no number.
    fn checked(&self, name: &str, array: &'a Array, length: usize) -> Result<&'a Array, String> {
        let cases = array.shape.first().copied().unwrap_or(0);
        if cases.checked_mul(length) != Some(array.numbers.len()) {
            return Err(format!(
                "`{name}` has the sizes {:?}, needed are cases of {length} numbers",
                array.shape
            ));
        }
        if cases != self.count {
            return Err(format!(
                "the first axis of every array counts the cases: {} in one, {cases} in `{name}`",
                self.count
            ));
        }
        match array.numbers.iter().position(|number| number.is_nan()) {
            Some(at) => Err(format!("`{name}` holds NaN in case {}", at / length.max(1))),
            None => Ok(array),
        }
    }
}

#[cfg(test)]
mod tests;
