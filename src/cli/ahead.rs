//! An allocator that points and looks ahead: an episode is played to its end under several symmetries of the rules, and the
//! best course is followed for as long as the world does what was foreseen.

use std::collections::VecDeque;
use std::vec::IntoIter;

use sortie_bundle::Bundle;
use sortie_core::allocate::{PointingAllocator, PointingMemory};
use sortie_core::{AllocateError, AllocationState, Allocator, UNASSIGNED};
use sortie_envs::random::generator;
use sortie_envs::{Environment, Split};
use sortie_learn::LearnError;
use sortie_learn::subtasks::{
    AllocateTurned, allocation_state, allocation_state_turned, best_course,
};
use sortie_plans::CompileError;
use sortie_stage::frame;

use crate::environment::ScenarioSetName;
use crate::failure::{Exit, Failure};

/// Most courses that are followed at once: worlds whose episodes one allocator is asked about in turn.
const COURSES: usize = 1024;

/// The memory of an allocator that looks ahead.
pub struct LookingAhead {
    memory: PointingMemory,
    /// In which courses are played.
    world: Box<dyn Environment>,
    turns: usize,
}

impl LookingAhead {
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
        if known_by_rows(&*world, &state).is_none() {
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
        let pointing = Pointing(memory.bind()?);
        Ok(Ahead { pointing, world: world.as_mut(), turns: *turns, courses: VecDeque::new() })
    }
}

/// The allocator at work.
struct Ahead<'a> {
    pointing: Pointing<'a>,
    world: &'a mut dyn Environment,
    turns: usize,
    courses: VecDeque<Followed>,
}

/// What is left of a course.
struct Followed {
    /// The next state as its rows tell of it, and what is given there.
    next: (Vec<u8>, Vec<u8>),
    rest: IntoIter<(Vec<u8>, Vec<u8>)>,
}

/// A network that points, under any symmetry.
struct Pointing<'a>(PointingAllocator<'a>);

impl AllocateTurned for Pointing<'_> {
    fn allocate_turned(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        in_force: &[u8],
        turn: usize,
    ) -> Result<Vec<u8>, LearnError> {
        let seen = allocation_state_turned(environment, (state, in_force), turn);
        let mut given = vec![UNASSIGNED; seen.agents];
        let allocated = self.0.allocate(&seen.view(), &mut given);
        allocated.map_err(|error| LearnError::Team(error.to_string()))?;
        Ok(given)
    }
}

impl Allocator for Ahead<'_> {
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        state.check(allocation)?;
        let given = match self.world.rebuilt(&frame(state)) {
            Some(known) => self.followed(&known).or_else(|| self.found(&known, state)),
            None => None,
        };
        match given {
            Some(given) if given.len() == allocation.len() => allocation.copy_from_slice(&given),
            // Where nothing can be foreseen, such as without one of the agents, one look has to do.
            _ => self.pointing.0.allocate(state, allocation)?,
        }
        Ok(())
    }
}

impl Ahead<'_> {
    /// What was found best to do in a state that was foreseen.
    fn followed(&mut self, known: &[u8]) -> Option<Vec<u8>> {
        let course = self.courses.iter().position(|course| course.next.0 == known)?;
        let Followed { next: (_, given), rest } = self.courses.remove(course)?;
        self.follow(rest);
        Some(given)
    }

    /// What is best to do in a state that was not foreseen.
    fn found(&mut self, known: &[u8], state: &AllocationState<'_>) -> Option<Vec<u8>> {
        let in_force: Vec<u8> = state.entity_task.iter().take(state.agents).map(task_of).collect();
        let before = (known, &in_force[..]);
        let course = best_course(&mut self.pointing, self.world, before, self.turns).ok()?;
        let mut course = course.into_iter();
        let (_, given) = course.next()?;
        self.follow(course);
        Some(given)
    }

    fn follow(&mut self, mut rest: IntoIter<(Vec<u8>, Vec<u8>)>) {
        let Some((state, given)) = rest.next() else { return };
        if let Some(known) = known_by_rows(self.world, &state) {
            self.courses.push_front(Followed { next: (known, given), rest });
            self.courses.truncate(COURSES);
        }
    }
}

/// A state without what rows do not tell of it.
fn known_by_rows(world: &dyn Environment, state: &[u8]) -> Option<Vec<u8>> {
    world.rebuilt(&frame(&allocation_state(world, state).view()))
}

fn task_of(tasks: &u32) -> u8 {
    if *tasks == 0 { UNASSIGNED } else { tasks.trailing_zeros() as u8 }
}
