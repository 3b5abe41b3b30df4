//! An allocator that points and looks ahead: an episode is played to its end under several symmetries of the rules, and the
//! best course is followed for as long as the world does what was foreseen.

use std::collections::VecDeque;

use sortie_bundle::Bundle;
use sortie_core::allocate::PointingMemory;
use sortie_core::{AllocateError, AllocationState, Allocator, UNASSIGNED};
use sortie_envs::random::generator;
use sortie_envs::{Environment, Split};
use sortie_learn::LearnError;
use sortie_learn::subtasks::{
    AllocateTurned, Course, allocation_state, allocation_state_turned, best_course,
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
        let looks = Looks(memory.bind()?);
        Ok(Ahead { looks, world: world.as_mut(), turns: *turns, courses: VecDeque::new() })
    }
}

/// The allocator at work, by looks of another one.
struct Ahead<'a, A> {
    looks: Looks<A>,
    world: &'a mut dyn Environment,
    turns: usize,
    /// The newest first: what is left of each, in states as their rows tell of them.
    courses: VecDeque<Course>,
}

/// An allocator, under any symmetry.
struct Looks<A>(A);

impl<A: Allocator> AllocateTurned for Looks<A> {
    fn allocate_turned(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        in_force: &[u8],
        turn: usize,
    ) -> Result<Vec<u8>, LearnError> {
        let seen = allocation_state_turned(environment, (state, in_force), turn);
        let mut given = vec![UNASSIGNED; seen.agents];
        self.0.allocate(&seen.view(), &mut given)?;
        Ok(given)
    }
}

impl<A: Allocator> Allocator for Ahead<'_, A> {
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        state.check(allocation)?;
        let mut given = None;
        if let Some(known) = self.world.rebuilt(&frame(state)) {
            given = self.followed(&known);
            if given.is_none() {
                self.look(&known, state)?;
                given = self.followed(&known);
            }
        }
        match given {
            Some(given) if given.len() == allocation.len() => allocation.copy_from_slice(&given),
            // Where nothing can be foreseen, such as without one of the agents, one look has to do.
            _ => self.looks.0.allocate(state, allocation)?,
        }
        Ok(())
    }
}

impl<A: Allocator> Ahead<'_, A> {
    /// Finds what is best to do in a state that was not foreseen, and from there on.
    fn look(&mut self, known: &[u8], state: &AllocationState<'_>) -> Result<(), AllocateError> {
        // Whoever has none had one beyond the last.
        let last = |tasks: &u32| tasks.trailing_zeros() as u8;
        let in_force: Vec<u8> = state.entity_task.iter().take(state.agents).map(last).collect();
        let before = (known, &in_force[..]);
        let course = best_course(&mut self.looks, self.world, before, self.turns);
        let course = course.map_err(refusal)?.into_iter();
        let told = |(state, given): (Vec<u8>, _)| Some((known_by_rows(self.world, &state)?, given));
        self.courses.push_front(course.map_while(told).collect());
        self.courses.truncate(COURSES);
        Ok(())
    }

    /// What was found best to do in a state that was foreseen.
    fn followed(&mut self, known: &[u8]) -> Option<Vec<u8>> {
        let is_next = |course: &&mut Course| course.front().is_some_and(|(next, _)| next == known);
        self.courses.iter_mut().find(is_next)?.pop_front().map(|(_, given)| given)
    }
}

/// A state without what rows do not tell of it.
fn known_by_rows(world: &dyn Environment, state: &[u8]) -> Option<Vec<u8>> {
    world.rebuilt(&frame(&allocation_state(world, state).view()))
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
    use std::path::Path;

    use sortie_bundle::{OwnedAllocationState, POINTING_PLANS};
    use sortie_core::plan::AlignedBytes;
    use sortie_envs::{Random, open};

    use super::*;

    const TURNS: usize = 8;

    /// Sends each vehicle to what lies most to the left of what is left, or, coming from every other customer, lowest, else home;
    /// counts how often it was asked, and refuses when it is asked once more than so often.
    struct Leftmost {
        asked: usize,
        patience: usize,
    }

    impl Leftmost {
        fn new() -> Self {
            Self { asked: 0, patience: usize::MAX }
        }
    }

    impl Allocator for Leftmost {
        fn allocate(
            &mut self,
            state: &AllocationState<'_>,
            allocation: &mut [u8],
        ) -> Result<(), AllocateError> {
            if self.asked == self.patience {
                return Err(AllocateError::NonFinite);
            }
            self.asked += 1;
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
            let known = known_by_rows(&*world, &other.state()).expect("rows tell it");
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

    fn ahead(looks: Leftmost, world: &mut dyn Environment) -> Ahead<'_, Leftmost> {
        Ahead { looks: Looks(looks), world, turns: TURNS, courses: VecDeque::new() }
    }

    fn asked(allocator: &mut impl Allocator, play: &Play) -> Result<Vec<u8>, AllocateError> {
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
        let mut ahead = ahead(Leftmost::new(), &mut *other);
        for seed in 0..20 {
            let mut play = Play::begun(seed);
            let (first, earned, rounds) = best_turn(&play);
            ahead.looks.0.asked = 0;
            let given = asked(&mut ahead, &play).expect("it can be foreseen");
            assert_eq!((&given, ahead.looks.0.asked), (&first, rounds), "seed {seed}");
            let mut is_over = play.round(given);
            while !is_over {
                is_over = play.round(asked(&mut ahead, &play).expect("it was foreseen"));
            }
            assert_eq!(ahead.looks.0.asked, rounds, "seed {seed}");
            assert!((play.earned() - earned).abs() < 1e-5, "seed {seed}");
            assert!(ahead.courses.iter().all(Course::is_empty), "seed {seed}: nothing is left");
        }
    }

    #[test]
    fn where_something_else_happens_it_looks_again() {
        let mut other = world("routing/13");
        let mut ahead = ahead(Leftmost::new(), &mut *other);
        for seed in 0..20 {
            let mut play = Play::begun(seed);
            let mut given = asked(&mut ahead, &play).expect("it can be foreseen");
            given[0] = 13;
            play.round(given);
            let (first, _, rounds) = best_turn(&play);
            ahead.looks.0.asked = 0;
            assert_eq!(asked(&mut ahead, &play), Ok(first), "seed {seed}");
            assert_eq!(ahead.looks.0.asked, rounds, "seed {seed}");
        }
    }

    #[test]
    fn courses_of_episodes_that_take_turns_do_not_mix() {
        let mut other = world("routing/13");
        let mut ahead = ahead(Leftmost::new(), &mut *other);
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
        let mut ahead = ahead(Leftmost::new(), &mut *other);
        let old = Course::from([(vec![1], vec![2]), (vec![3], vec![4])]);
        ahead.courses.resize(COURSES, old.clone());
        let mut play = Play::begun(1);
        let given = asked(&mut ahead, &play).expect("it can be foreseen");
        play.round(given);
        assert_eq!((ahead.courses.len(), ahead.courses.back()), (COURSES, Some(&old)));
        let before = ahead.looks.0.asked;
        asked(&mut ahead, &play).expect("it was foreseen");
        assert_eq!(ahead.looks.0.asked, before, "the newest is kept");
    }

    #[test]
    fn without_an_agent_one_look_has_to_do() {
        let mut other = world("routing/13");
        let mut ahead = ahead(Leftmost::new(), &mut *other);
        let mut seen = Play::begun(1).seen();
        seen.present.remove(2);
        let (mut want, mut given) = ([UNASSIGNED; 4], [UNASSIGNED; 4]);
        Leftmost::new().allocate(&seen.view(), &mut want).expect("it fits");
        ahead.allocate(&seen.view(), &mut given).expect("it fits");
        assert_eq!((given, ahead.looks.0.asked), (want, 1));
        let short = ahead.allocate(&seen.view(), &mut given[..3]);
        assert_eq!(short, Err(AllocateError::BadLength));
    }

    #[test]
    fn a_refusal_in_what_is_foreseen_is_said() {
        let mut other = world("routing/13");
        let mut ahead = ahead(Leftmost { asked: 0, patience: 5 }, &mut *other);
        assert_eq!(asked(&mut ahead, &Play::begun(1)), Err(AllocateError::NonFinite));
    }

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
        let mut opened = LookingAhead::open(&routes, memory(), 99).expect("routes can be foreseen");
        assert_eq!(opened.turns, TURNS);
        assert!(opened.bind().is_ok());
        let refused = LookingAhead::open(&bundle("save-the-city"), memory(), 8).err();
        assert!(refused.is_some_and(|failure| failure.message.contains("`--proposals`")));
    }
}
