//! What a run has learned to allocate with, as far as bundles hold it.

use crate::alma::agents::UtilityNetwork;
use crate::alma::config::Config;
use crate::alma::run::{Run, RunAllocator};

/// A learned allocator.
#[derive(Clone, Copy, Debug)]
pub struct LearnedAllocator<'a> {
    /// Its team-value network.
    pub network: &'a UtilityNetwork,
    /// Largest team of one building.
    pub team_max: usize,
}

impl<'a> LearnedAllocator<'a> {
    /// The allocator of a run, if the run learns one.
    pub fn of(run: &'a Run) -> Option<Self> {
        let Config::Records(config) = &run.config else { return None };
        let team_max = config.allocation.team_max;
        match &run.allocator {
            Some(RunAllocator::TeamValue(network)) => Some(Self { network, team_max }),
            _ => None,
        }
    }
}
