//! Looking ahead by symmetries: an episode is played to its end under each of several, and the best of them is followed.

use std::collections::VecDeque;

use sortie_envs::Environment;

use crate::error::{LearnError, Result};

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
    ) -> Result<Vec<u8>>;
}

/// States of an episode from one on, and what is given in each.
pub type Course<S = Vec<u8>> = VecDeque<(S, Vec<u8>)>;

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
) -> Result<Course> {
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
) -> Result<(f64, Course)> {
    let mut random = sortie_envs::random::generator(0);
    let mut actions = vec![0; world.spec().shape.agents];
    let (mut course, mut earned) = (Course::new(), 0.0);
    let (mut state, mut given) = (state.to_vec(), in_force.to_vec());
    world.load(0, &state).map_err(LearnError::environment)?;
    loop {
        given = allocator.allocate_turned(world, &state, &given, turn)?;
        world.scripted(&state, &given, &mut random, &mut actions);
        course.push_back((std::mem::take(&mut state), given.clone()));
        let step = world.step(0, &actions, &mut random)?;
        earned += step.reward;
        if step.done() {
            return Ok((earned, course));
        }
        world.save(0, &mut state);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sortie_envs::random::generator;
    use sortie_envs::{Split, UNASSIGNED, open};

    /// Has the vehicle of the symmetry's number drive all routes: to the next customer by number under the first and the last, by
    /// nearness under the others. Notes what was in force.
    #[derive(Default)]
    struct OneVehicle {
        asked: Vec<(usize, Vec<u8>)>,
    }

    impl AllocateTurned for OneVehicle {
        fn allocate_turned(
            &mut self,
            environment: &dyn Environment,
            state: &[u8],
            in_force: &[u8],
            turn: usize,
        ) -> Result<Vec<u8>> {
            self.asked.push((turn, in_force.to_vec()));
            let (mut offers, mut goals) = (Vec::new(), vec![UNASSIGNED; 4]);
            environment.offers(state, &mut offers);
            environment.allocate(0, state, &mut generator(0), &mut goals);
            let nearest = goals.iter().find(|task| **task != UNASSIGNED);
            let nearest = nearest.ok_or_else(|| LearnError::Team("all is done".to_owned()))?;
            let mut given = vec![UNASSIGNED; 4];
            let is_numbered = turn == 0 || turn == 3;
            given[turn] = if is_numbered { offers[turn].trailing_zeros() as u8 } else { *nearest };
            Ok(given)
        }
    }

    fn routes() -> Box<dyn Environment> {
        open("routing/9-sequential", Split::Test, 1, &Default::default()).expect("a set")
    }

    fn saved(world: &dyn Environment) -> Vec<u8> {
        let mut state = Vec::new();
        world.save(0, &mut state);
        state
    }

    /// What an episode comes to that is driven under one symmetry alone.
    fn earned(world: &mut dyn Environment, start: &[u8], turn: usize) -> f64 {
        let (mut allocator, mut actions) = (OneVehicle::default(), [0; 4]);
        world.load(0, start).expect("its own state");
        loop {
            let state = saved(world);
            let given = allocator.allocate_turned(world, &state, &[], turn).expect("it goes on");
            world.scripted(&state, &given, &mut generator(0), &mut actions);
            if world.step(0, &actions, &mut generator(0)).expect("it may").done() {
                return world.episode(0).episode_return;
            }
        }
    }

    /// Of the second and the third symmetry, which earn the same, the first is taken, unless numbers come in a better order.
    #[test]
    fn a_course_is_the_first_of_those_that_earn_most() {
        let (mut world, mut other) = (routes(), routes());
        let mut by_nearness = 0;
        for seed in 0..10 {
            other.reset(0, &mut generator(seed));
            let (start, in_force) = (saved(&*other), [3, 1, UNASSIGNED, 0]);
            let all = [0, 1, 2, 3].map(|turn| earned(&mut *other, &start, turn));
            let best = usize::from(all[1] > all[0]);
            by_nearness += best;
            let mut allocator = OneVehicle::default();
            let course = best_course(&mut allocator, &mut *world, (&start, &in_force), 4);
            let course = course.expect("all can be played");
            let mut actions = [0; 4];
            other.load(0, &start).expect("its own state");
            for (place, (state, given)) in course.iter().enumerate() {
                assert_eq!(*state, saved(&*other), "round {place}");
                assert!(given[best] != UNASSIGNED, "{given:?} is of another symmetry");
                other.scripted(state, given, &mut generator(0), &mut actions);
                let step = other.step(0, &actions, &mut generator(0)).expect("it may");
                assert_eq!(step.done(), place + 1 == course.len());
            }
            assert_eq!(other.episode(0).episode_return, all[best]);
            // What was in force before, then what was given.
            let mut before = in_force.to_vec();
            let of_best = allocator.asked.iter().filter(|(turn, _)| *turn == best);
            for ((_, told), (_, given)) in of_best.zip(&course) {
                assert_eq!(*told, before);
                before.clone_from(given);
            }
            let mut turns: Vec<usize> = allocator.asked.iter().map(|(turn, _)| *turn).collect();
            turns.dedup();
            assert_eq!(turns, [0, 1, 2, 3]);
        }
        assert!(by_nearness > 5, "{by_nearness}");
    }

    #[test]
    fn what_cannot_be_played_is_said() {
        let (mut world, mut allocator) = (routes(), OneVehicle::default());
        let unknown = best_course(&mut allocator, &mut *world, (&[1], &[UNASSIGNED; 4]), 4);
        assert!(matches!(unknown, Err(LearnError::Environment(_))));
    }
}
