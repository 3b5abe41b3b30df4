//! What goes into a bundle besides its networks.

use std::path::Path;

use crate::error::LearnError;
use crate::evaluate::Evaluation;

/// A measured allocation, for the card.
#[derive(Clone, Debug)]
pub struct Measured {
    /// The scenario set that it was measured on; the bundle serves its sizes.
    pub set: String,
    /// Who allocated.
    pub allocation: String,
    /// How the team did.
    pub evaluation: Evaluation,
}

/// A file of a run that becomes part of its bundle.
///
/// # Errors
/// It cannot be read.
pub fn read_part(folder: &Path, name: &str) -> Result<Vec<u8>, LearnError> {
    let path = folder.join(name);
    std::fs::read(&path).map_err(LearnError::file(path))
}
