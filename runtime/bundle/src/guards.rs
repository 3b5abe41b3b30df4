//! `guards.toml`: the ranges in which what a bundle's agents observe must lie, by the names of features.

use std::collections::BTreeMap;
use std::fmt::Write;

use serde::Deserialize;

use crate::contract::ContractV1;

/// No limit on either side.
const FREE: [f32; 2] = [f32::NEG_INFINITY, f32::INFINITY];

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    /// Lowest and highest value.
    features: BTreeMap<String, [f32; 2]>,
}

/// Reads the ranges of features, `[d, 2]`, in the contract's order: infinite for those that are not named. The error says what
/// is wrong in one line.
///
/// # Errors
/// It is no TOML, has something else than `[features]`, or one of them is no feature or no range.
pub fn guards_from_toml(text: &[u8], contract: &ContractV1) -> Result<Vec<[f32; 2]>, String> {
    let text = str::from_utf8(text).map_err(|error| error.to_string())?;
    let File { mut features } = toml::from_str(text).map_err(|error| error.message().to_owned())?;
    if features.is_empty() {
        return Err("nothing is guarded: name features in `[features]`".to_owned());
    }
    // Of NaN nothing is true.
    let is_range = |[lowest, highest]: &[f32; 2]| lowest <= highest;
    if let Some((name, [lowest, highest])) = features.iter().find(|(_, range)| !is_range(range)) {
        return Err(format!("`{name}` has no range from {lowest} to {highest}"));
    }
    let names = contract.feature_names.iter();
    let ranges = names.map(|name| features.remove(name).unwrap_or(FREE)).collect();
    match features.into_keys().next() {
        Some(name) => Err(format!("the contract has no feature `{name}`")),
        None => Ok(ranges),
    }
}

/// The file of such ranges.
pub fn guards_to_toml(ranges: &[[f32; 2]], contract: &ContractV1) -> String {
    let mut text = "[features]\n".to_owned();
    for (name, [lowest, highest]) in contract.feature_names.iter().zip(ranges) {
        let name = toml::Value::from(name.as_str());
        // To a string nothing fails to be written.
        let _ = writeln!(text, "{name} = [{lowest:?}, {highest:?}]");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contract::tests::contract;

    #[test]
    fn what_is_written_is_read() {
        let contract = contract();
        let ranges = [[-0.1, 1.0e-7], [0.0, 3.0e30], FREE];
        let text = guards_to_toml(&ranges, &contract);
        assert_eq!(guards_from_toml(text.as_bytes(), &contract), Ok(ranges.to_vec()), "{text}");
        let one = guards_from_toml(b"[features]\ny = [-1, 2]\n", &contract);
        assert_eq!(one, Ok(vec![FREE, [-1.0, 2.0], FREE]));
    }

    #[test]
    fn what_is_no_range_of_a_feature_is_refused_by_name() {
        for (text, flaw) in [
            ("", "missing field `features`"),
            ("[features]\n", "nothing is guarded: name features in `[features]`"),
            ("[features]\nx = [2, 1]\n", "`x` has no range from 2 to 1"),
            ("[features]\nx = [nan, 1]\n", "`x` has no range from NaN to 1"),
            ("[features]\nspeed = [0, 1]\n", "the contract has no feature `speed`"),
            ("[features]\nx = [0, 1]\n[outputs]\n", "unknown field `outputs`, expected `features`"),
        ] {
            assert_eq!(guards_from_toml(text.as_bytes(), &contract()), Err(flaw.to_owned()));
        }
        assert!(guards_from_toml(&[0xFF], &contract()).is_err());
    }
}
