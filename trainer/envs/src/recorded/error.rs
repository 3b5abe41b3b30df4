//! Why a recorded episode cannot be replayed.

use std::fmt;

/// A file that cannot be read or does not follow the schema.
#[derive(Debug)]
#[non_exhaustive]
pub enum GoldenError {
    /// The file cannot be read.
    Read(std::io::Error),
    /// The text is not JSON.
    Json(serde_json::Error),
    /// A field is missing, or its value is not what the schema asks for.
    Field {
        /// Path of the field, such as `steps[3].actions[1]`.
        field: String,
        /// What is wrong with it.
        reason: String,
    },
}

impl GoldenError {
    pub(crate) fn field(field: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Field { field: field.into(), reason: reason.into() }
    }
}

impl fmt::Display for GoldenError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Read(_) => f.write_str("the recorded episode cannot be read"),
            Self::Json(_) => f.write_str("the recorded episode is not JSON"),
            Self::Field { field, reason } => write!(f, "field `{field}` {reason}"),
        }
    }
}

impl std::error::Error for GoldenError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Read(source) => Some(source),
            Self::Json(source) => Some(source),
            Self::Field { .. } => None,
        }
    }
}
