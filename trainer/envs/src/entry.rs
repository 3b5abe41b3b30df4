//! What an environment says of itself to be found by its name, and how a variant of it is asked for.

use alloc::boxed::Box;
use alloc::collections::BTreeMap;
use alloc::string::{String, ToString};
use alloc::vec::Vec;
use core::fmt;

use serde::de::value::MapDeserializer;
use serde::de::{DeserializeOwned, IntoDeserializer, Visitor};
use serde::{Deserialize, Deserializer, Serialize, forward_to_deserialize_any};

use crate::environment::{Environment, Split};
use crate::frame::FrameReader;
#[cfg(feature = "std")]
use crate::recorded::Recordings;
use crate::spec::Rule;

/// One environment by its name.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Its name, as `--env` takes it.
    pub name: &'static str,
    /// What it is, in one sentence.
    pub about: &'static str,
    /// The version of its rules.
    pub version: &'static str,
    /// Names of its sets of starts, the default first.
    pub sets: fn() -> Vec<String>,
    /// Makes one.
    pub open: fn(&Choice<'_>) -> Result<Box<dyn Environment>, EnvironmentError>,
    /// The rules that assign agents to subtasks, as in [`Spec::rules`](crate::Spec::rules).
    pub rules: &'static [Rule],
    /// Makes what reads its states back from feature rows, where rules or relations need that.
    pub reader: Option<fn() -> Box<dyn FrameReader>>,
    /// Its recorded episodes.
    #[cfg(feature = "std")]
    pub recordings: Option<Recordings>,
}

/// Which variant of an environment is wanted.
#[derive(Clone, Copy, Debug)]
pub struct Choice<'a> {
    /// The set of starts; without one the default.
    pub set: Option<&'a str>,
    /// Which of its starts are drawn.
    pub split: Split,
    /// How many instances.
    pub instances: usize,
    /// Numbers of the rules that differ from the usual ones.
    pub settings: &'a BTreeMap<String, Setting>,
}

impl Choice<'_> {
    /// The settings as an environment's own type, which knows the usual ones.
    ///
    /// # Errors
    /// A setting is unknown or of another type.
    pub fn settings<T: DeserializeOwned>(&self) -> Result<T, EnvironmentError> {
        let settings = self.settings.iter().map(|(name, value)| (name.as_str(), value.clone()));
        T::deserialize(MapDeserializer::<_, serde::de::value::Error>::new(settings))
            .map_err(|error| EnvironmentError::Setting(error.to_string()))
    }
}

/// One number of the rules.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Setting {
    /// On or off.
    Flag(bool),
    /// A whole number.
    Whole(i64),
    /// A number.
    Number(f64),
    /// A name.
    Text(String),
}

impl From<i64> for Setting {
    fn from(number: i64) -> Self {
        Self::Whole(number)
    }
}

impl<'de> IntoDeserializer<'de> for Setting {
    type Deserializer = Self;

    fn into_deserializer(self) -> Self {
        self
    }
}

impl<'de> Deserializer<'de> for Setting {
    type Error = serde::de::value::Error;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Self::Error> {
        match self {
            Self::Flag(flag) => visitor.visit_bool(flag),
            Self::Whole(number) => visitor.visit_i64(number),
            Self::Number(number) => visitor.visit_f64(number),
            Self::Text(text) => visitor.visit_string(text),
        }
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        name: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Self::Error> {
        match self {
            Self::Text(text) => text.into_deserializer().deserialize_enum(name, variants, visitor),
            other => other.deserialize_any(visitor),
        }
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Self::Error> {
        visitor.visit_some(self)
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf
        unit unit_struct newtype_struct seq tuple tuple_struct map struct identifier ignored_any
    }
}

/// Why there is no such environment.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum EnvironmentError {
    /// No environment has this name.
    Unknown {
        /// The name.
        name: String,
        /// Those that there are.
        known: Vec<&'static str>,
    },
    /// Its set of starts is unknown or impossible; the text says which there are.
    Set(String),
    /// One of its settings is unknown or impossible; the text says which.
    Setting(String),
}

impl fmt::Display for EnvironmentError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unknown { name, known } => {
                write!(f, "no environment `{name}`; there are `{}`", known.join("`, `"))
            }
            Self::Set(reason) | Self::Setting(reason) => f.write_str(reason),
        }
    }
}

impl core::error::Error for EnvironmentError {}
