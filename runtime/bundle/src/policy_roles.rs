//! `policy.toml`: what is what in the file of a policy that was not trained here.

use std::collections::BTreeMap;

use serde::{Deserialize, Deserializer, Serialize};

/// What is said of the inputs and outputs of a policy's ONNX file; what is left out is found.
///
/// The keys are the command line's flags: `output = "action"`, `state = ["h:h_next"]`, `size = { N = 7 }`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PolicyRoles {
    /// The outputs that are wanted, each with `:discrete` or `:continuous` behind its name where that must be said.
    #[serde(deserialize_with = "one_or_several", skip_serializing_if = "Vec::is_empty")]
    pub output: Vec<String>,
    /// Recurrent states, `IN:OUT` each; `none` alone where what looks like one is none.
    #[serde(deserialize_with = "one_or_several", skip_serializing_if = "Vec::is_empty")]
    pub state: Vec<String>,
    /// The mask of available actions; `none` where what looks like one is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub available: Option<String>,
    /// The input that holds the entities `[1, N, D]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub entities: Option<String>,
    /// Which of them the agent may attend to: `NAME:visible` where that is 1, `NAME:blocked` where it is 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mask: Option<String>,
    /// Which of them the agent itself is: `first`, or the input with its number.
    #[serde(rename = "self", skip_serializing_if = "Option::is_none")]
    pub own: Option<String>,
    /// Sizes that the file leaves open, by their name in it.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub size: BTreeMap<String, usize>,
}

impl PolicyRoles {
    /// Reads a file; the error says what is wrong in one line.
    ///
    /// # Errors
    /// It is no TOML, has another key, or a value of another type.
    pub fn from_toml(text: &[u8]) -> Result<Self, String> {
        let text = str::from_utf8(text).map_err(|error| error.to_string())?;
        toml::from_str(text).map_err(|error: toml::de::Error| error.message().to_owned())
    }

    /// The file.
    pub fn to_toml(&self) -> String {
        // Plain values have a form in TOML; an empty file would still say nothing wrong.
        toml::to_string(self).unwrap_or_default()
    }
}

fn one_or_several<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<String>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged, expecting = "expected a name, or a list of names")]
    enum Names {
        One(String),
        Several(Vec<String>),
    }
    Ok(match Names::deserialize(from)? {
        Names::One(name) => vec![name],
        Names::Several(names) => names,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read() {
        let size = BTreeMap::from([("N".to_owned(), 7)]);
        let (output, state) = (vec!["q:discrete".to_owned()], vec!["h:h_next".to_owned()]);
        let named = |name: &str| Some(name.to_owned());
        let (entities, mask, own) = (named("seen"), named("pad:blocked"), named("first"));
        let available = named("none");
        let roles = PolicyRoles { output, state, available, entities, mask, own, size };
        assert!(roles.to_toml().contains("self = \"first\""));
        assert_eq!(PolicyRoles::from_toml(roles.to_toml().as_bytes()), Ok(roles));
        assert_eq!(PolicyRoles::default().to_toml(), "");
        let one = PolicyRoles::from_toml(b"output = 'q'").unwrap();
        assert_eq!(one.output, ["q"]);
    }

    #[test]
    fn other_keys_are_refused_with_those_that_there_are() {
        let error = |text: &str| PolicyRoles::from_toml(text.as_bytes()).unwrap_err();
        let unknown = error("outputs = 'q'");
        assert!(unknown.starts_with("unknown field `outputs`, expected one of `output`, `state`"));
        assert_eq!(error("output = 3"), "expected a name, or a list of names");
        assert!(!error("output = ").is_empty());
    }
}
