//! Looking ahead by symmetries: an episode is played to its end under each of several, and the best of them is followed.

use sortie_envs::Environment;

use crate::error::LearnError;

/// What allocates by a state as a symmetry of the rules shows it.
pub trait AllocateTurned {
    /// The allocation `[A]` of a state in which another one was in force.
    ///
    /// # Errors
    /// The allocator does not fit the environment.
    fn allocate_turned(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        in_force: &[u8],
        turn: usize,
    ) -> Result<Vec<u8>, LearnError>;
}

/// The states of an episode from one on, and what is given in each.
pub type Course = Vec<(Vec<u8>, Vec<u8>)>;

/// The course that earns most, of one under each of so many symmetries; of equals the first. Agents do as their environment's
/// script says.
///
/// What was learned is not the same under all symmetries: its mistakes under one are not those under another.
///
/// # Errors
/// The allocator does not fit the environment, or the world has no such state.
pub fn best_course(
    allocator: &mut impl AllocateTurned,
    world: &mut dyn Environment,
    (state, in_force): (&[u8], &[u8]),
    turns: usize,
) -> Result<Course, LearnError> {
    let mut best: Option<(f64, Course)> = None;
    for turn in 0..turns {
        let (earned, course) = played(allocator, world, (state, in_force), turn)?;
        if best.as_ref().is_none_or(|(most, _)| earned > *most) {
            best = Some((earned, course));
        }
    }
    Ok(best.map(|(_, course)| course).unwrap_or_default())
}

/// Plays to the end by what one symmetry makes of it; what that earns, and the course.
fn played(
    allocator: &mut impl AllocateTurned,
    world: &mut dyn Environment,
    (state, in_force): (&[u8], &[u8]),
    turn: usize,
) -> Result<(f64, Course), LearnError> {
    let mut random = sortie_envs::random::generator(0);
    let mut actions = vec![0; world.spec().shape.agents];
    let (mut course, mut earned) = (Course::new(), 0.0);
    let (mut state, mut given) = (state.to_vec(), in_force.to_vec());
    world.load(0, &state).map_err(LearnError::environment)?;
    loop {
        given = allocator.allocate_turned(world, &state, &given, turn)?;
        world.scripted(&state, &given, &mut random, &mut actions);
        course.push((std::mem::take(&mut state), given.clone()));
        let step = world.step(0, &actions, &mut random)?;
        earned += step.reward;
        if step.done() {
            return Ok((earned, course));
        }
        world.save(0, &mut state);
    }
}
