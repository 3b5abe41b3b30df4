//! An allocator that looks ahead: an episode is played to its end under several symmetries of the rules, and the best course
//! is followed for as long as the world does what was foreseen.

use std::collections::VecDeque;

use sortie_bundle::OwnedAllocationState;
use sortie_core::{AllocateError, AllocationState, Allocator, UNASSIGNED};
use sortie_envs::{Environment, Frame, Observation};

use super::allocators::allocation_state_within;
use super::symmetries::{AllocateTurned, Course, best_course};
use crate::error::{LearnError, Result};

/// Most courses that are followed at once: worlds whose episodes one allocator is asked about in turn.
const COURSES: usize = 1024;

/// How far a column may be from what was foreseen of it: worlds compute in more digits than their rows have.
const NEAR: f32 = 1e-5;

/// An allocator that looks ahead, by looks of another one.
pub struct LookingAhead<'a> {
    looks: Looks<'a>,
    /// In which courses are played.
    world: &'a mut dyn Environment,
    turns: usize,
    /// The newest first: what is left of each, in states as they will be seen.
    courses: VecDeque<Course<OwnedAllocationState>>,
}

/// An allocator, under any symmetry.
struct Looks<'a> {
    allocator: Box<dyn Allocator + Send + 'a>,
    /// For room.
    seen: Observation,
}

impl AllocateTurned for Looks<'_> {
    fn allocate_turned(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        in_force: &[u8],
        turn: usize,
    ) -> Result<Vec<u8>> {
        let before = (state, in_force);
        let seen = allocation_state_within(environment, before, turn, &mut self.seen);
        let mut given = vec![UNASSIGNED; seen.agents];
        self.allocator.allocate(&seen.view(), &mut given)?;
        Ok(given)
    }
}

impl Allocator for LookingAhead<'_> {
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> std::result::Result<(), AllocateError> {
        state.check(allocation)?;
        let mut given = self.followed(state);
        if given.is_none()
            && let Some(known) = self.world.rebuilt(&Frame::of(state))
        {
            self.look(&known, state)?;
            given = self.followed(state);
        }
        match given {
            Some(given) if given.len() == allocation.len() => allocation.copy_from_slice(&given),
            // Where nothing can be foreseen, such as without one of the agents, one look has to do.
            _ => self.looks.allocator.allocate(state, allocation)?,
        }
        Ok(())
    }
}

impl<'a> LookingAhead<'a> {
    /// Looks by what allocates, under so many symmetries, in a world whose rows tell enough to play an episode on; where they
    /// do not, the allocator decides as without.
    pub fn new(
        allocator: Box<dyn Allocator + Send + 'a>,
        world: &'a mut dyn Environment,
        turns: usize,
    ) -> Self {
        let looks = Looks { allocator, seen: Observation::default() };
        Self { looks, world, turns, courses: VecDeque::new() }
    }

    /// Finds what is best to do in a state that was not foreseen, and from there on.
    fn look(
        &mut self,
        known: &[u8],
        state: &AllocationState<'_>,
    ) -> std::result::Result<(), AllocateError> {
        // Whoever has none had one beyond the last.
        let last = |tasks: &u32| tasks.trailing_zeros() as u8;
        let in_force: Vec<u8> = state.entity_task.iter().take(state.agents).map(last).collect();
        let before = (known, &in_force[..]);
        let course = best_course(&mut self.looks, self.world, before, self.turns);
        let world = &*self.world;
        let seen = |(state, given): (Vec<u8>, Vec<u8>)| {
            let nobody = vec![UNASSIGNED; given.len()];
            let seen = &mut self.looks.seen;
            (allocation_state_within(world, (&state, &nobody), 0, seen), given)
        };
        self.courses.push_front(course.map_err(refusal)?.into_iter().map(seen).collect());
        self.courses.truncate(COURSES);
        Ok(())
    }

    /// What was found best to do in a state that was foreseen.
    fn followed(&mut self, state: &AllocationState<'_>) -> Option<Vec<u8>> {
        let is_next = |course: &&mut Course<_>| {
            course.front().is_some_and(|(next, _): &(OwnedAllocationState, _)| is(next, state))
        };
        self.courses.iter_mut().find(is_next)?.pop_front().map(|(_, given)| given)
    }
}

/// Whether a state shows what was foreseen, whatever is in force in it.
fn is(foreseen: &OwnedAllocationState, state: &AllocationState<'_>) -> bool {
    let foreseen = foreseen.view();
    let entities = || foreseen.present.iter().zip(state.present.iter());
    let is_near = |(own, other): (&f32, &f32)| (own - other).abs() <= NEAR;
    foreseen.agents == state.agents
        && foreseen.open_tasks == state.open_tasks
        && foreseen.available == state.available
        && foreseen.present.len() == state.present.len()
        && entities().all(|(own, other)| {
            let columns = row(&foreseen, own).iter().take(foreseen.stride);
            columns.zip(row(state, other)).all(is_near)
        })
}

/// An entity's row, and whatever stands behind it.
fn row<'a>(state: &AllocationState<'a>, entity: usize) -> &'a [f32] {
    state.rows.get(entity * state.stride..).unwrap_or_default()
}

/// Why nothing could be foreseen. A world refuses what is not open.
fn refusal(error: LearnError) -> AllocateError {
    match error {
        LearnError::Allocate(error) => error,
        _ => AllocateError::Infeasible,
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use sortie_envs::random::generator;
    use sortie_envs::{Random, Split, open};

    use super::*;
    use crate::subtasks::{allocation_state, allocation_state_turned};

    const TURNS: usize = 8;

    /// Sends each vehicle to what lies most to the left of what is left, or, coming from every other customer, lowest, else home;
    /// counts how often it was asked, and refuses when it is asked once more than so often.
    #[derive(Clone)]
    struct Leftmost {
        asked: Arc<AtomicUsize>,
        patience: usize,
    }

    impl Leftmost {
        fn new() -> Self {
            Self { asked: Arc::default(), patience: usize::MAX }
        }

        /// Times that it was asked since this was asked last.
        fn asked(&self) -> usize {
            self.asked.swap(0, Ordering::Relaxed)
        }
    }

    impl Allocator for Leftmost {
        fn allocate(
            &mut self,
            state: &AllocationState<'_>,
            allocation: &mut [u8],
        ) -> std::result::Result<(), AllocateError> {
            if self.asked.fetch_add(1, Ordering::Relaxed) == self.patience {
                return Err(AllocateError::NonFinite);
            }
            let (actions, depot) = (state.available.len() / state.agents, state.tasks - 1);
            for agent in 0..state.agents {
                let column = 3 + state.entity_task[agent].trailing_zeros() as usize % 2;
                let place =
                    |task: &usize| state.rows[(state.agents + task) * state.stride + column];
                let is_free = |task: &usize| {
                    let is_left = !allocation[..agent].contains(&(*task as u8));
                    is_left && state.available[agent * actions + 1 + task] != 0
                };
                let first = (0..depot).filter(is_free);
                let first = first.min_by(|one, other| place(one).total_cmp(&place(other)));
                allocation[agent] = first.unwrap_or(depot) as u8;
            }
            Ok(())
        }
    }

    /// An episode, and what is in force in it.
    struct Play {
        world: Box<dyn Environment>,
        in_force: Vec<u8>,
        random: Random,
    }

    fn world(set: &str) -> Box<dyn Environment> {
        open(set, Split::Test, 1, &Default::default()).expect("a set of routes")
    }

    impl Play {
        fn begun(seed: u64) -> Self {
            let (mut world, mut random) = (world("routing/13"), generator(seed));
            world.reset(0, &mut random);
            Self { world, in_force: vec![UNASSIGNED; 4], random }
        }

        /// Goes on from what rows tell of another one.
        fn copied(other: &Self) -> Self {
            let mut world = world("routing/13");
            let seen = allocation_state(&*world, &other.state());
            let known = world.rebuilt(&Frame::of(&seen.view())).expect("rows tell it");
            world.load(0, &known).expect("its own state");
            Self { world, in_force: other.in_force.clone(), random: generator(0) }
        }

        fn state(&self) -> Vec<u8> {
            let mut state = Vec::new();
            self.world.save(0, &mut state);
            state
        }

        fn seen(&self) -> OwnedAllocationState {
            allocation_state_turned(&*self.world, (&self.state(), &self.in_force), 0)
        }

        /// What is given, and whether that was the end.
        fn round(&mut self, given: Vec<u8>) -> bool {
            let mut actions = vec![0; 4];
            self.world.scripted(&self.state(), &given, &mut self.random, &mut actions);
            self.in_force = given;
            let step = self.world.step(0, &actions, &mut self.random);
            step.expect("a script acts as it may").done()
        }

        fn earned(&self) -> f64 {
            self.world.episode(0).episode_return
        }
    }

    fn ahead<'a>(looks: &Leftmost, world: &'a mut dyn Environment) -> LookingAhead<'a> {
        LookingAhead::new(Box::new(looks.clone()), world, TURNS)
    }

    fn asked(
        allocator: &mut impl Allocator,
        play: &Play,
    ) -> std::result::Result<Vec<u8>, AllocateError> {
        let mut given = vec![UNASSIGNED; 4];
        allocator.allocate(&play.seen().view(), &mut given).map(|()| given)
    }

    /// What is first given under a symmetry, what all of it earns, and how many rounds it takes.
    fn by_turn(play: &Play, turn: usize) -> (Vec<u8>, f64, usize) {
        let (mut play, mut allocator) = (Play::copied(play), Leftmost::new());
        let mut first = None;
        for rounds in 1.. {
            let state = play.state();
            let seen = allocation_state_turned(&*play.world, (&state, &play.in_force), turn);
            let mut given = vec![UNASSIGNED; 4];
            allocator.allocate(&seen.view(), &mut given).expect("it fits");
            first.get_or_insert_with(|| given.clone());
            if play.round(given) {
                return (first.unwrap_or_default(), play.earned(), rounds);
            }
        }
        unreachable!("rounds end")
    }

    /// The same of the symmetry that earns most, and of how many rounds all have.
    fn best_turn(play: &Play) -> (Vec<u8>, f64, usize) {
        let all: Vec<_> = (0..TURNS).map(|turn| by_turn(play, turn)).collect();
        let rounds = all.iter().map(|(_, _, rounds)| rounds).sum();
        let most = all.iter().map(|(_, earned, _)| *earned).fold(f64::NEG_INFINITY, f64::max);
        let best = all.into_iter().find(|(_, earned, _)| *earned == most);
        best.map(|(first, earned, _)| (first, earned, rounds)).expect("eight")
    }

    #[test]
    fn the_best_course_is_followed_to_its_end_without_another_look() {
        let mut other = world("routing/13");
        let looks = Leftmost::new();
        let mut ahead = ahead(&looks, &mut *other);
        for seed in 0..20 {
            let mut play = Play::begun(seed);
            let (first, earned, rounds) = best_turn(&play);
            looks.asked();
            let given = asked(&mut ahead, &play).expect("it can be foreseen");
            assert_eq!((&given, looks.asked()), (&first, rounds), "seed {seed}");
            let mut is_over = play.round(given);
            while !is_over {
                is_over = play.round(asked(&mut ahead, &play).expect("it was foreseen"));
            }
            assert_eq!(looks.asked(), 0, "seed {seed}");
            assert!((play.earned() - earned).abs() < 1e-5, "seed {seed}");
            assert!(ahead.courses.iter().all(Course::is_empty), "seed {seed}: nothing is left");
        }
    }

    #[test]
    fn where_something_else_happens_it_looks_again() {
        let mut other = world("routing/13");
        let looks = Leftmost::new();
        let mut ahead = ahead(&looks, &mut *other);
        for seed in 0..20 {
            let mut play = Play::begun(seed);
            let mut given = asked(&mut ahead, &play).expect("it can be foreseen");
            given[0] = 13;
            play.round(given);
            let (first, _, rounds) = best_turn(&play);
            looks.asked();
            assert_eq!(asked(&mut ahead, &play), Ok(first), "seed {seed}");
            assert_eq!(looks.asked(), rounds, "seed {seed}");
        }
    }

    #[test]
    fn courses_of_episodes_that_take_turns_do_not_mix() {
        let mut other = world("routing/13");
        let looks = Leftmost::new();
        let mut ahead = ahead(&looks, &mut *other);
        let mut plays: Vec<Play> = (0..3).map(Play::begun).collect();
        let wanted: Vec<f64> = plays.iter().map(|play| best_turn(play).1).collect();
        let mut is_over = [false; 3];
        while is_over.contains(&false) {
            for (play, is_over) in plays.iter_mut().zip(&mut is_over).filter(|(_, over)| !**over) {
                *is_over = play.round(asked(&mut ahead, play).expect("it can be foreseen"));
            }
        }
        for (play, wanted) in plays.iter().zip(wanted) {
            assert!((play.earned() - wanted).abs() < 1e-5, "{} {wanted}", play.earned());
        }
    }

    #[test]
    fn no_more_courses_are_kept_than_there_is_room_for() {
        let mut other = world("routing/13");
        let looks = Leftmost::new();
        let mut ahead = ahead(&looks, &mut *other);
        let other_play = Play::begun(2).seen();
        let old = Course::from([(other_play.clone(), vec![2]), (other_play, vec![4])]);
        ahead.courses.resize(COURSES, old.clone());
        let mut play = Play::begun(1);
        let given = asked(&mut ahead, &play).expect("it can be foreseen");
        play.round(given);
        assert_eq!((ahead.courses.len(), ahead.courses.back()), (COURSES, Some(&old)));
        looks.asked();
        asked(&mut ahead, &play).expect("it was foreseen");
        assert_eq!(looks.asked(), 0, "the newest is kept");
    }

    #[test]
    fn without_an_agent_one_look_has_to_do() {
        let mut other = world("routing/13");
        let looks = Leftmost::new();
        let mut ahead = ahead(&looks, &mut *other);
        let mut seen = Play::begun(1).seen();
        seen.present.remove(2);
        let (mut want, mut given) = ([UNASSIGNED; 4], [UNASSIGNED; 4]);
        Leftmost::new().allocate(&seen.view(), &mut want).expect("it fits");
        ahead.allocate(&seen.view(), &mut given).expect("it fits");
        assert_eq!((given, looks.asked()), (want, 1));
        let short = ahead.allocate(&seen.view(), &mut given[..3]);
        assert_eq!(short, Err(AllocateError::BadLength));
    }

    #[test]
    fn a_refusal_in_what_is_foreseen_is_said() {
        let mut other = world("routing/13");
        let looks = Leftmost { patience: 5, ..Leftmost::new() };
        let mut ahead = ahead(&looks, &mut *other);
        assert_eq!(asked(&mut ahead, &Play::begun(1)), Err(AllocateError::NonFinite));
    }
}
