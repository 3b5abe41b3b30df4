//! What machines are compared by: what a bundle's agents answer where they were asked once.

use alloc::vec::Vec;

use crate::cast::Cast;
use crate::error::StageError;
use crate::golden::GoldenObservation;
use crate::memory::AgentMemory;
use crate::utilities::hash_of;

/// The hash of all utilities of a team's golden observations.
///
/// # Errors
/// A plan is damaged, or for other observations.
pub fn golden_hash(cast: &Cast) -> Result<u64, StageError> {
    let mut memory = AgentMemory::new(cast)?;
    let rows: Vec<Vec<f32>> = cast.golden.iter().map(GoldenObservation::dense).collect();
    let seen = cast.golden.iter().zip(&rows).map(|(seen, rows)| seen.view(rows));
    Ok(hash_of(&mut memory.mind(cast)?, seen)?)
}
