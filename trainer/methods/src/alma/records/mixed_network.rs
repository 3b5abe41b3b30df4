//! All that the agents' level learns: their utilities, and the mixer that training needs.

use super::learner::Parameters;
use super::mixer::Mixer;
use crate::alma::agents::UtilityNetwork;

/// A utility network with its mixer.
#[derive(Clone, Debug, PartialEq)]
pub struct MixedNetwork {
    /// What agents act by, and all that is deployed.
    pub utility: UtilityNetwork,
    /// Makes a team's value of its agents' utilities.
    pub mixer: Mixer,
}

impl Parameters for UtilityNetwork {
    fn parts(&self) -> Vec<&[f32]> {
        vec![self.parameters()]
    }

    fn parts_mut(&mut self) -> Vec<&mut [f32]> {
        vec![self.parameters_mut()]
    }
}

/// The utility network's parameters, then the mixer's.
impl Parameters for MixedNetwork {
    fn parts(&self) -> Vec<&[f32]> {
        vec![self.utility.parameters(), self.mixer.parameters()]
    }

    fn parts_mut(&mut self) -> Vec<&mut [f32]> {
        vec![self.utility.parameters_mut(), self.mixer.parameters_mut()]
    }
}
