//! One number for the bits of many utilities, by which machines are compared.

use alloc::vec;
use alloc::vec::Vec;

use sortie_core::{DecideError, Observation, Policy};

use crate::cast::{Cast, GoldenObservation};
use crate::error::StageError;
use crate::memory::AgentMemory;

/// FNV-1a of 64 bits over the bits of utilities, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UtilityHash(u64);

impl Default for UtilityHash {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl UtilityHash {
    /// Adds utilities.
    pub fn add(&mut self, utilities: &[f32]) {
        for byte in utilities.iter().flat_map(|utility| utility.to_bits().to_le_bytes()) {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }

    /// The number.
    pub fn value(self) -> u64 {
        self.0
    }
}

/// The hash of a policy's utilities, all observations those of one agent in one episode.
///
/// # Errors
/// The policy does not take an observation.
pub fn hash_of<'o>(
    policy: &mut dyn Policy,
    observations: impl Iterator<Item = Observation<'o>>,
) -> Result<u64, DecideError> {
    let mut utilities = vec![0.0; policy.actions()];
    let mut memory = vec![0.0; policy.hidden()];
    let mut hash = UtilityHash::default();
    for observation in observations {
        policy.utilities_with(&observation, &mut memory, &mut utilities)?;
        hash.add(&utilities);
    }
    Ok(hash.value())
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hash_is_of_every_bit_in_order() {
        let of = |parts: &[&[f32]]| {
            let mut hash = UtilityHash::default();
            parts.iter().for_each(|part| hash.add(part));
            hash.value()
        };
        // FNV-1a of the eight bytes 0, 0, 0x80, 0x3f, 0, 0, 0, 0x40.
        assert_eq!(of(&[&[1.0, 2.0]]), 0x097a_69ee_2da3_01d8);
        assert_eq!(of(&[&[1.0, 2.0]]), of(&[&[1.0], &[2.0]]));
        assert_eq!(of(&[]), 0xcbf2_9ce4_8422_2325);
        assert_ne!(of(&[&[1.0, 2.0]]), of(&[&[2.0, 1.0]]));
        assert_ne!(of(&[&[0.0]]), of(&[&[-0.0]]), "the sign of zero is a bit");
    }
}
