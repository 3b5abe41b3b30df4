//! Play without a thought, which everything that is learned has to beat.

use sortie_envs::random::{generator, member};
use sortie_envs::{Observation, Random};

use crate::error::LearnError;
use crate::method::{Act, Scenes};

/// Agents that take any available action.
#[derive(Debug)]
pub struct RandomTeam {
    random: Random,
    seen: Observation,
}

impl RandomTeam {
    /// Agents that draw from the generator of a seed.
    pub fn new(seed: u64) -> Self {
        Self { random: generator(seed), seen: Observation::default() }
    }
}

impl Act for RandomTeam {
    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        _: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        let agents = scenes.environment.spec().shape.agents;
        for (scene, actions) in scenes.scenes.iter().zip(actions.chunks_exact_mut(agents)) {
            scenes.environment.observe(scene.state, 0, 0, &mut self.seen);
            for (action, available) in actions.iter_mut().zip(&self.seen.available) {
                *action = member(&mut self.random, (*available).into()).unwrap_or(0) as u16;
            }
        }
        Ok(())
    }
}
