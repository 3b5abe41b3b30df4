//! The scripted team of an environment without subtasks.

use sortie_envs::{Environment, Random};
use sortie_learn::random::{Purpose, generator};
use sortie_learn::{Act, LearnError, Scenes};

use crate::environment::ScenarioSetName;
use crate::failure::{Exit, Failure};

/// Acts by the environment's script.
pub(crate) struct Scripted {
    random: Random,
    unassigned: Vec<u8>,
}

impl Scripted {
    /// The team of an environment in which nobody is allocated; ties are broken by the seed.
    pub(crate) fn of(
        name: &ScenarioSetName,
        environment: &dyn Environment,
        seed: u64,
    ) -> Result<Self, Failure> {
        if environment.spec().shape.tasks > 0 {
            let message = format!("the scripted team of `{name}` needs somebody who allocates");
            return Err(Failure::new(Exit::Usage, message));
        }
        let unassigned = vec![sortie_core::UNASSIGNED; environment.spec().shape.agents];
        Ok(Self { random: generator(seed, Purpose::Evaluation, u64::MAX), unassigned })
    }
}

impl Act for Scripted {
    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        _: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        let Self { random, unassigned } = self;
        for (scene, actions) in scenes.scenes.iter().zip(actions.chunks_exact_mut(unassigned.len()))
        {
            if !scenes.environment.scripted(scene.state, unassigned, random, actions) {
                let name = scenes.environment.spec().name;
                return Err(LearnError::Team(format!("`{name}` has no scripted team")));
            }
        }
        Ok(())
    }
}
