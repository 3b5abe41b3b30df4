//! Pictures of states, by what their environment says of itself.

use super::navigation::Navigation;
use super::picture::Picture;
use super::rover_tower::RoverTower;
use super::scenario::Scenario;
use super::states;
use super::treasure::{AGENTS_PER_BANK, DeadTreasures, TreasureCollection};
use crate::environment::StateError;
use crate::spec::Spec;

/// What there is to draw of a state of an environment that says this of itself.
///
/// # Errors
/// The bytes are no state of this environment.
pub fn picture_of(spec: &Spec, state: &[u8]) -> Result<Picture, StateError> {
    let (agents, limit) = (spec.shape.agents, spec.episode_limit);
    match spec.roles.first().map(|role| role.name) {
        Some("collector") => {
            let banks = agents / AGENTS_PER_BANK;
            drawn(&TreasureCollection::new(banks, DeadTreasures::default(), limit), spec, state)
        }
        Some("rover") => drawn(&RoverTower::new(agents / 2, limit), spec, state),
        _ => drawn(&Navigation::new(agents, limit), spec, state),
    }
}

fn drawn<S: Scenario>(scenario: &S, spec: &Spec, state: &[u8]) -> Result<Picture, StateError> {
    let state = states::read(scenario, spec.state_bytes, state)?;
    Ok(scenario.picture(&state.world))
}
