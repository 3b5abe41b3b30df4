//! What goes into a bundle besides its networks.

use std::fmt::Write as _;
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

/// The card's table of measured episodes, a row for each set.
pub fn measured_table(measured: &[Measured]) -> String {
    let mut table = "\
         | starts | episodes | success (95 % interval) | time-outs | return | steps |\n\
         | --- | --- | --- | --- | --- | --- |\n"
        .to_owned();
    for Measured { set, evaluation, .. } in measured {
        let [low, high] = evaluation.success_ci95;
        // Writing to a string cannot fail.
        let _ = writeln!(
            table,
            "| `{set}` | {} | {:.3} ({low:.3} to {high:.3}) | {:.3} | {:.2} | {:.2} |",
            evaluation.episodes,
            evaluation.success,
            evaluation.timeouts,
            evaluation.return_mean,
            evaluation.length_mean,
        );
    }
    table
}

/// A file of a run that becomes part of its bundle.
///
/// # Errors
/// It cannot be read.
pub fn read_part(folder: &Path, name: &str) -> Result<Vec<u8>, LearnError> {
    let path = folder.join(name);
    std::fs::read(&path).map_err(LearnError::file(path))
}
