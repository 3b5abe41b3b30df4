//! Definitions of types (`.msg`), and the hash by which two hosts know that they have the same.
//!
//! The hash is RIHS01: SHA-256 of a type's description in JSON, spaces included, its fields in their order and all types that
//! are part of it by name. Comments, constants and default values do not count. Messages are dropped in silence where the
//! hashes of both ends differ.

use std::collections::BTreeMap;
use std::fmt::{self, Write};

use sha2::{Digest, Sha256};

use crate::messages::{Message, definition};
use crate::names::{NameError, TypeName, is_word};

/// What the number of a type is raised by, for one, an array, and sequences with a bound and without.
const KINDS: [u8; 4] = [0, 48, 96, 144];
const NESTED: u8 = 1;
const STRING: u8 = 17;
const BOUNDED_STRING: u8 = 21;

/// Types within types within types: deeper ones are refused.
const DEEPEST: usize = 32;

/// Numbers of types that are not made of others.
const PRIMITIVES: [(&str, u8); 14] = [
    ("int8", 2),
    ("uint8", 3),
    // A character of ROS is one byte, without a sign.
    ("char", 3),
    ("int16", 4),
    ("uint16", 5),
    ("int32", 6),
    ("uint32", 7),
    ("int64", 8),
    ("uint64", 9),
    ("float32", 10),
    ("float64", 11),
    ("bool", 15),
    ("byte", 16),
    ("string", STRING),
];

/// Why a definition is none.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DefinitionError {
    /// A line is neither a field nor a constant.
    #[error("line {line} of {name}: `{text}` is neither `type name` nor `type NAME=value`")]
    Line {
        /// The type.
        name: TypeName,
        /// From 1.
        line: usize,
        /// What stands there.
        text: String,
    },
    /// The type of a field is none.
    #[error("line {line} of {name}: `{text}` is no type")]
    Field {
        /// The type.
        name: TypeName,
        /// From 1.
        line: usize,
        /// What stands there.
        text: String,
    },
    /// It has no field.
    #[error("{0} has no field")]
    Empty(TypeName),
    /// Nobody has the definition of a part.
    #[error("there is no definition of {0}; add it to `messages::DEFINITIONS`")]
    Unknown(TypeName),
    /// Parts within parts without end.
    #[error("{0} is part of itself, or of more than 32 others")]
    Deep(TypeName),
    /// Not the name of a type.
    #[error(transparent)]
    Name(#[from] NameError),
}

/// What one type consists of.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Definition {
    /// The type.
    pub name: TypeName,
    /// Its fields, in their order.
    pub fields: Vec<Field>,
    /// Constants with their values as they are written; they are no part of a message.
    pub constants: Vec<(String, String)>,
}

/// A field of a type.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    /// Its name.
    pub name: String,
    /// The number of its type.
    type_id: u8,
    /// Of an array or a bounded sequence.
    capacity: u64,
    /// Of a bounded text.
    text_capacity: u64,
    /// Where it is made of others.
    nested: Option<TypeName>,
}

impl Definition {
    /// Of the text of a `.msg` file.
    ///
    /// # Errors
    /// See [`DefinitionError`].
    ///
    /// ```
    /// use sortie_ros2::{Definition, TypeName};
    ///
    /// let name = TypeName::new("demo_msgs/msg/Pose")?;
    /// let pose = Definition::parse(name, "float64[3] at  # metres\nuint8 LOST=1\nuint8 state 0\n")?;
    /// assert_eq!(pose.fields.len(), 2);
    /// assert_eq!(pose.constants, [("LOST".to_owned(), "1".to_owned())]);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn parse(name: TypeName, text: &str) -> Result<Self, DefinitionError> {
        let mut definition = Self { name, fields: Vec::new(), constants: Vec::new() };
        for (number, whole) in text.lines().enumerate() {
            let code = whole.split('#').next().unwrap_or_default().trim();
            if !code.is_empty() {
                definition.add(number.saturating_add(1), code)?;
            }
        }
        if definition.fields.is_empty() {
            return Err(DefinitionError::Empty(definition.name));
        }
        Ok(definition)
    }

    fn add(&mut self, line: usize, code: &str) -> Result<(), DefinitionError> {
        let Self { name, .. } = self;
        let wrong = || DefinitionError::Line { name: name.clone(), line, text: code.to_owned() };
        let (kind, rest) = code.split_once(char::is_whitespace).ok_or_else(wrong)?;
        if let Some((constant, value)) = rest.split_once('=') {
            let constant = Some(constant.trim()).filter(|name| is_word(name)).ok_or_else(wrong)?;
            self.constants.push((constant.to_owned(), value.trim().to_owned()));
            return Ok(());
        }
        // What follows is the default value.
        let field =
            rest.split_whitespace().next().filter(|field| is_word(field)).ok_or_else(wrong)?;
        let field = Field::parse(field, kind, name.package()).ok_or_else(|| {
            DefinitionError::Field { name: name.clone(), line, text: kind.to_owned() }
        })?;
        self.fields.push(field);
        Ok(())
    }

    fn write(&self, json: &mut String) -> fmt::Result {
        write!(json, r#"{{"type_name": "{}", "fields": ["#, self.name)?;
        for (index, field) in self.fields.iter().enumerate() {
            let Field { name, type_id, capacity, text_capacity, nested } = field;
            let comma = if index == 0 { "" } else { ", " };
            let nested = nested.as_ref().map(TypeName::as_str).unwrap_or_default();
            write!(
                json,
                r#"{comma}{{"name": "{name}", "type": {{"type_id": {type_id}, "capacity": {capacity}, "string_capacity": {text_capacity}, "nested_type_name": "{nested}"}}}}"#
            )?;
        }
        json.write_str("]}")
    }
}

impl Field {
    /// Of the words of a line, in a definition of `package`; `None`: there is no such type.
    fn parse(name: &str, kind: &str, package: &str) -> Option<Self> {
        let (element, count) = match kind.strip_suffix(']').map(|kind| kind.rsplit_once('[')) {
            None => (kind, None),
            Some(divided) => divided.map(|(element, count)| (element, Some(count)))?,
        };
        let (many, capacity) = match count {
            None => (0, 0),
            Some("") => (3, 0),
            Some(count) => match count.strip_prefix("<=") {
                Some(bound) => (2, count_of(bound)?),
                None => (1, count_of(count)?),
            },
        };
        let (base, text_capacity, nested) = match element.split_once("<=") {
            Some(("string", bound)) => (BOUNDED_STRING, count_of(bound)?, None),
            Some(_) => return None,
            None => match PRIMITIVES.iter().find(|(primitive, _)| *primitive == element) {
                Some((_, number)) => (*number, 0, None),
                None => (NESTED, 0, Some(nested(element, package)?)),
            },
        };
        let type_id = base.checked_add(*KINDS.get(many)?)?;
        Some(Self { name: name.to_owned(), type_id, capacity, text_capacity, nested })
    }
}

fn count_of(text: &str) -> Option<u64> {
    text.trim().parse().ok().filter(|count| *count > 0)
}

/// `std_msgs/Header`, or `Header` of the same package.
fn nested(element: &str, package: &str) -> Option<TypeName> {
    // Names of types begin with a capital: what does not is a primitive of which nobody has heard.
    let (package, name) = element.split_once('/').unwrap_or((package, element));
    let is_name = name.starts_with(|first: char| first.is_ascii_uppercase());
    is_name.then(|| TypeName::new(&format!("{package}/msg/{name}")).ok())?
}

/// The hash of a type, by which both ends of a topic know that they mean the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TypeHash {
    /// From ROS 2 Iron on.
    Rihs01([u8; 32]),
    /// ROS 2 Humble has none.
    NotSupported,
}

/// What stands in keys in place of a hash, in ROS 2 Humble.
const NOT_SUPPORTED: &str = "TypeHashNotSupported";
const RIHS01: &str = "RIHS01_";

impl TypeHash {
    /// Of a type, by definitions that `find` knows.
    ///
    /// # Errors
    /// See [`DefinitionError`].
    pub fn compute<'a>(
        name: &TypeName,
        find: &dyn Fn(&str) -> Option<&'a str>,
    ) -> Result<Self, DefinitionError> {
        let mut parts = BTreeMap::new();
        gather(name, find, &mut parts, DEEPEST)?;
        let own = parts.remove(name).ok_or_else(|| DefinitionError::Unknown(name.clone()))?;
        let mut json = String::from(r#"{"type_description": "#);
        // Writing to a text does not fail.
        let _ = own.write(&mut json);
        json.push_str(r#", "referenced_type_descriptions": ["#);
        for (index, part) in parts.values().enumerate() {
            json.push_str(if index == 0 { "" } else { ", " });
            let _ = part.write(&mut json);
        }
        json.push_str("]}");
        Ok(Self::Rihs01(Sha256::digest(json).into()))
    }

    /// Of its text in a key; `None`: it is none.
    pub fn parse(text: &str) -> Option<Self> {
        if text == NOT_SUPPORTED {
            return Some(Self::NotSupported);
        }
        let digits = text.strip_prefix(RIHS01)?.as_bytes();
        let mut hash = [0; 32];
        let (pairs, rest) = digits.as_chunks::<2>();
        if pairs.len() != hash.len() || !rest.is_empty() {
            return None;
        }
        for (to, [high, low]) in hash.iter_mut().zip(pairs) {
            *to = digit(*high)? << 4 | digit(*low)?;
        }
        Some(Self::Rihs01(hash))
    }
}

fn digit(letter: u8) -> Option<u8> {
    match letter {
        b'0'..=b'9' => Some(letter - b'0'),
        b'a'..=b'f' => Some(letter - b'a' + 10),
        _ => None,
    }
}

impl fmt::Display for TypeHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self::Rihs01(hash) = self else { return f.write_str(NOT_SUPPORTED) };
        f.write_str(RIHS01)?;
        hash.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// The type and all that it consists of.
fn gather<'a>(
    name: &TypeName,
    find: &dyn Fn(&str) -> Option<&'a str>,
    parts: &mut BTreeMap<TypeName, Definition>,
    deepest: usize,
) -> Result<(), DefinitionError> {
    if parts.contains_key(name) {
        return Ok(());
    }
    let deeper = deepest.checked_sub(1).ok_or_else(|| DefinitionError::Deep(name.clone()))?;
    let text = find(name.as_str()).ok_or_else(|| DefinitionError::Unknown(name.clone()))?;
    let own = Definition::parse(name.clone(), text)?;
    for part in own.fields.iter().filter_map(|field| field.nested.as_ref()) {
        gather(part, find, parts, deeper)?;
    }
    parts.insert(name.clone(), own);
    Ok(())
}

/// What the other hosts run: it decides what stands in keys for the hash of a type.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Release {
    /// ROS 2 Humble: no hashes.
    Humble,
    /// ROS 2 Jazzy and later.
    #[default]
    Jazzy,
}

impl Release {
    /// What stands in keys for a type that crosses.
    ///
    /// # Errors
    /// See [`DefinitionError`]; for types of this crate there is none.
    ///
    /// ```
    /// use sortie_ros2::{Release, messages::Text};
    ///
    /// let hash = Release::Jazzy.hash_of::<Text>()?.to_string();
    /// assert_eq!(hash, "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18");
    /// # Ok::<(), sortie_ros2::DefinitionError>(())
    /// ```
    pub fn hash_of<M: Message>(self) -> Result<TypeHash, DefinitionError> {
        match self {
            Self::Humble => Ok(TypeHash::NotSupported),
            Self::Jazzy => TypeHash::compute(&TypeName::new(M::NAME)?, &definition),
        }
    }
}
