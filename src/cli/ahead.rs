//! A bundle's allocator that points, and looks ahead in a world of its own.

use sortie_bundle::Bundle;
use sortie_core::Allocator;
use sortie_core::allocate::PointingMemory;
use sortie_envs::random::generator;
use sortie_envs::{Environment, Frame, Split};
use sortie_learn::subtasks::{LookingAhead, allocation_state};
use sortie_plans::CompileError;

use crate::environment::ScenarioSetName;
use crate::failure::{Exit, Failure};

/// The memory of an allocator that looks ahead.
pub struct LookingAheadMemory {
    memory: PointingMemory,
    /// In which courses are played.
    world: Box<dyn Environment>,
    turns: usize,
}

impl LookingAheadMemory {
    /// By so many symmetries, or as many as there are.
    ///
    /// # Errors
    /// The bundle's environment is not built in, or its rows do not tell enough to play an episode on.
    pub fn open(bundle: &Bundle, memory: PointingMemory, turns: usize) -> Result<Self, Failure> {
        let name = ScenarioSetName::parse(&bundle.manifest().contract.environment.name)?;
        let mut world = name.open(Split::Test)?;
        let mut state = Vec::new();
        world.reset(0, &mut generator(0));
        world.save(0, &mut state);
        if world.rebuilt(&Frame::of(&allocation_state(&*world, &state).view())).is_none() {
            let message = format!(
                "rows of `{}` do not tell enough to look ahead: leave `--proposals` out",
                name.entry().name
            );
            return Err(Failure::new(Exit::Usage, message));
        }
        let turns = turns.min(world.spec().turns);
        Ok(Self { memory, world, turns })
    }

    /// The allocator over this memory.
    ///
    /// # Errors
    /// The plans are other networks'.
    pub fn bind(&mut self) -> Result<impl Allocator + Send + '_, CompileError> {
        let Self { memory, world, turns } = self;
        Ok(LookingAhead::new(Box::new(memory.bind()?), world.as_mut(), *turns))
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use sortie_bundle::POINTING_PLANS;
    use sortie_core::plan::AlignedBytes;

    use super::*;

    #[test]
    fn rows_have_to_tell_enough() {
        let bundle = |name: &str| {
            let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models");
            Bundle::open(&models.join(name)).expect("a shipped bundle")
        };
        let routes = bundle("routing");
        let memory = || {
            let plan = |name| AlignedBytes::copy_of(routes.part(name).expect("a plan"));
            let (_, rules) = routes.pointing_graphs().expect("it points");
            PointingMemory::new(POINTING_PLANS.map(plan), rules).expect("plans")
        };
        let mut opened =
            LookingAheadMemory::open(&routes, memory(), 99).expect("routes can be foreseen");
        assert_eq!(opened.turns, 8);
        assert!(opened.bind().is_ok());
        let refused = LookingAheadMemory::open(&bundle("save-the-city"), memory(), 8).err();
        assert!(refused.is_some_and(|failure| failure.message.contains("`--proposals`")));
    }
}
