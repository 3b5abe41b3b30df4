//! What a key of a configuration may be: its unit, its range, and a sentence about it.

use std::fmt;

use strsim::levenshtein;
use toml::Value;

/// Keys that stand together in a file, under a heading.
#[derive(Clone, Copy, Debug)]
pub struct Section {
    /// The heading, as in `allocator.replay`; empty for what stands at the top.
    pub name: &'static str,
    /// What it is about, in one sentence.
    pub about: &'static str,
    /// Its keys, in the order of the file.
    pub keys: &'static [Key],
}

/// A key of a configuration.
#[derive(Clone, Copy, Debug)]
pub struct Key {
    /// Its name within its section.
    pub name: &'static str,
    /// What its value counts; empty where that is no number.
    pub unit: &'static str,
    /// What its value may be.
    pub range: Range,
    /// What it does, in one sentence.
    pub about: &'static str,
}

/// What the value of a key may be. Limits belong to it.
#[derive(Clone, Copy, Debug)]
pub enum Range {
    /// A whole number.
    Whole(i64, i64),
    /// A number.
    Number(f64, f64),
    /// A number above zero.
    Positive(f64),
    /// Numbers, at least one.
    Numbers(f64, f64),
    /// One of these words.
    OneOf(&'static [&'static str]),
    /// `true` or `false`.
    Truth,
    /// Text that a function accepts, and what that is.
    Said(fn(&str) -> bool, &'static str),
    /// Any text.
    Text,
}

impl Key {
    /// A key: its name within its section, the unit of its value (empty for what is no number), what it may be, and
    /// what it does in one sentence.
    pub const fn new(
        name: &'static str,
        unit: &'static str,
        range: Range,
        about: &'static str,
    ) -> Self {
        Self { name, unit, range, about }
    }

    /// Range and unit.
    pub(super) fn limits(&self) -> String {
        let Self { unit, range, .. } = self;
        if unit.is_empty() { range.to_string() } else { format!("{range} ({unit})") }
    }
}

impl Range {
    /// Whether a value is of the right kind and within the limits.
    pub fn holds(self, value: &Value) -> bool {
        match (self, value) {
            (Self::Whole(from, to), Value::Integer(number)) => (from..=to).contains(number),
            (Self::Number(from, to), value) => {
                number(value).is_some_and(|number| (from..=to).contains(&number))
            }
            (Self::Positive(to), value) => {
                number(value).is_some_and(|number| number > 0.0 && number <= to)
            }
            (Self::Numbers(from, to), Value::Array(values)) => {
                let holds = |value| Self::Number(from, to).holds(value);
                !values.is_empty() && values.iter().all(holds)
            }
            (Self::OneOf(words), Value::String(word)) => words.contains(&word.as_str()),
            (Self::Said(accepts, _), Value::String(text)) => accepts(text),
            (Self::Truth, Value::Boolean(_)) | (Self::Text, Value::String(_)) => true,
            _ => false,
        }
    }
}

fn number(value: &Value) -> Option<f64> {
    match value {
        Value::Integer(number) => Some(*number as f64),
        Value::Float(number) => Some(*number),
        _ => None,
    }
}

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Whole(from, to) => write!(f, "a whole number from {from} to {to}"),
            Self::Number(from, to) => write!(f, "a number from {from} to {to}"),
            Self::Positive(to) => write!(f, "a number above 0, at most {to}"),
            Self::Numbers(from, to) => {
                write!(f, "a list of at least one number from {from} to {to}")
            }
            Self::OneOf([word]) => write!(f, "`{word}`"),
            Self::OneOf(words) => write!(f, "one of `{}`", words.join("`, `")),
            Self::Truth => f.write_str("`true` or `false`"),
            Self::Said(_, what) => f.write_str(what),
            Self::Text => f.write_str("text"),
        }
    }
}

/// A key of these sections by its whole name, as in `allocator.replay.batch`.
pub(crate) fn find<'a>(sections: &'a [Section], path: &str) -> Option<&'a Key> {
    let (section, name) = path.rsplit_once('.').unwrap_or(("", path));
    let section = sections.iter().find(|other| other.name == section)?;
    section.keys.iter().find(|key| key.name == name)
}

/// The whole names of all keys, in the order of the file.
pub fn paths(sections: &[Section]) -> impl Iterator<Item = String> {
    let path = |section: &Section, key: &Key| match section.name {
        "" => key.name.to_owned(),
        name => format!("{name}.{}", key.name),
    };
    sections.iter().flat_map(move |section| section.keys.iter().map(move |key| path(section, key)))
}

/// The key that somebody who wrote `path` may have meant.
pub(super) fn nearest_path(sections: &[Section], path: &str) -> Option<String> {
    let name = |path: &str| path.rsplit('.').next().unwrap_or_default().to_owned();
    let near = |other: &String| {
        let whole = levenshtein(path, other);
        // Its section may be missing or another.
        whole.min(levenshtein(&name(path), &name(other)) + 1)
    };
    let best = paths(sections).min_by_key(near)?;
    (near(&best) <= 1 + name(path).chars().count() / 4).then_some(best)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_belong_to_a_range_and_what_is_no_number_does_not() {
        let float = Value::Float;
        for value in [f64::NAN, f64::INFINITY, -1e-9, 2.0] {
            assert!(!Range::Number(0.0, 1.0).holds(&float(value)), "{value}");
        }
        assert!(!Range::Positive(1.0).holds(&float(0.0)));
        assert!(Range::Positive(1.0).holds(&Value::Integer(1)));
        assert!(Range::Whole(1, 3).holds(&Value::Integer(3)));
        assert!(!Range::Whole(1, 3).holds(&Value::Integer(4)));
        assert!(!Range::Whole(1, 3).holds(&float(2.0)));
        assert!(!Range::Numbers(0.0, 1.0).holds(&Value::Array(Vec::new())));
        let lower =
            Range::Said(|text| text.bytes().all(|byte| byte.is_ascii_lowercase()), "lower case");
        assert!(lower.holds(&Value::String("foo".to_owned())));
        assert!(!lower.holds(&Value::String("Foo".to_owned())));
    }
}
