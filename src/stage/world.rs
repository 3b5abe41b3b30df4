//! Any environment as a world that a team of processes acts in.

use alloc::boxed::Box;
use alloc::rc::Rc;
use alloc::vec::Vec;
use core::cell::RefCell;

use sortie_core::EntityMask;
use sortie_core::wire::FrameMut;
use sortie_core::world::{Shape, StepOutcome, UnavailableAction, World};
use sortie_envs::{EntitySet, Environment, Observation, Random, Step, StepError, deployed_tasks};

use crate::tally::Tally;

/// What is played, shared with the onlooker that draws it.
pub type SharedEnvironment = Rc<RefCell<Box<dyn Environment>>>;

/// The finished episodes, shared with whoever reports them.
pub type SharedTally = Rc<RefCell<Tally>>;

/// One instance of an environment that a team of processes acts in.
pub struct EnvironmentWorld {
    /// The environment.
    pub environment: SharedEnvironment,
    /// What has been played.
    pub tally: SharedTally,
    last: Step,
    random: Random,
    seen: RefCell<Seen>,
}

/// Space for what there is to see.
#[derive(Default)]
struct Seen {
    state: Vec<u8>,
    observation: Observation,
}

impl EnvironmentWorld {
    /// A world over the first instance of `environment`, which begins an episode.
    pub fn new(environment: Box<dyn Environment>, random: Random) -> Self {
        let mut world = Self::not_begun(environment, random);
        world.reset();
        world
    }

    /// The same before its first episode: `reset` begins it.
    pub fn not_begun(environment: Box<dyn Environment>, random: Random) -> Self {
        Self {
            environment: Rc::new(RefCell::new(environment)),
            tally: SharedTally::default(),
            last: Step::default(),
            random,
            seen: RefCell::default(),
        }
    }

    /// Draws the next episode, and what its steps leave to chance, from this generator on.
    pub fn draw_from(&mut self, random: Random) {
        self.random = random;
    }

    /// What the last step came to.
    pub fn last_step(&self) -> Step {
        self.last
    }
}

impl World for EnvironmentWorld {
    fn shape(&self) -> Shape {
        let shape = self.environment.borrow().spec().shape;
        Shape {
            agents: shape.agents,
            entities: shape.entities,
            tasks: shape.tasks,
            actions: shape.actions,
            features: shape.features,
        }
    }

    fn reset(&mut self) {
        self.environment.borrow_mut().reset(0, &mut self.random);
    }

    fn observe(&self, frame: &mut FrameMut<'_>) {
        let (environment, mut seen) = (self.environment.borrow(), self.seen.borrow_mut());
        let Seen { state, observation } = &mut *seen;
        state.clear();
        environment.save(0, state);
        environment.observe(state, 0, EntitySet::MAX, observation);
        write_frame(observation, &environment.spec().shape, frame);
    }

    fn step(&mut self, actions: &[u16]) -> Result<StepOutcome, UnavailableAction> {
        let mut environment = self.environment.borrow_mut();
        let step = environment.step(0, actions, &mut self.random).map_err(|error| match error {
            StepError::Unavailable { agent, action } => UnavailableAction { agent, action },
            _ => UnavailableAction { agent: 0, action: sortie_core::NO_ACTION },
        })?;
        self.last = step;
        if step.done() {
            self.tally.borrow_mut().add(environment.episode(0));
        }
        Ok(StepOutcome { episode_ended: step.done(), tasks_changed: step.tasks_changed })
    }
}

/// Writes what there is to see into the frame that the team's processes read.
fn write_frame(seen: &Observation, shape: &sortie_envs::Shape, frame: &mut FrameMut<'_>) {
    let stride = frame.layout().stride();
    for (entity, row) in frame.rows_mut().chunks_exact_mut(stride).enumerate().take(shape.entities)
    {
        let row = &mut row[..shape.features];
        if seen.entities >> entity & 1 == 1 {
            seen.rows.write_dense(seen.row_of(entity), row);
        } else {
            row.fill(0.0);
        }
    }
    frame.set_present(&entity_mask(seen.present));
    frame.set_open_tasks(deployed_tasks(seen.open_tasks));
    frame.set_absent(seen.absent);
    for (agent, (entities, available)) in seen.observable.iter().zip(&seen.available).enumerate() {
        frame.set_observable(agent, &entity_mask(*entities));
        for (action, code) in frame.available_mut(agent).iter_mut().enumerate() {
            *code = (available >> action & 1) as u16;
        }
    }
    for (entity, tasks) in seen.entity_task.iter().enumerate().skip(shape.agents) {
        frame.set_entity_task(entity, deployed_tasks(*tasks));
    }
}

/// The set as the runtime has it.
fn entity_mask(set: EntitySet) -> EntityMask {
    EntityMask::from_words(&[set as u64, (set >> 64) as u64])
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use sortie_core::{
        AllocateError, AllocationState, Allocator, DecideError, Decision, Observation as Own,
        Policy,
    };
    use sortie_envs::random::generator;
    use sortie_envs::{ENVIRONMENTS, Entry, Split};
    use sortie_ipc::{DomainContract, InProcess, Stop, WorldSettings, run_in_process};

    use super::*;
    use crate::RuleAllocator;

    /// Takes the last available action of so many, or always the first, which is to stop.
    struct Last(usize, bool);

    impl Policy for Last {
        fn actions(&self) -> usize {
            self.0
        }

        fn utilities(&mut self, _: &Own<'_>, utilities: &mut [f32]) -> Result<(), DecideError> {
            (0_u16..).zip(utilities).for_each(|(action, utility)| *utility = action.into());
            Ok(())
        }

        fn decide(&mut self, seen: &Own<'_>) -> Result<Decision, DecideError> {
            assert!(seen.visible.iter().count() >= 1, "an agent sees itself at least");
            let last = seen.available.iter().rposition(|code| *code != 0);
            let action = if self.1 { Some(0) } else { last };
            let action = action.ok_or(DecideError::BadLength)? as u16;
            Ok(Decision { action, utility: 0.0 })
        }
    }

    /// Sends everybody to the first subtask that is open, and counts who is left of eight.
    struct Counts(usize);

    impl Allocator for Counts {
        fn allocate(
            &mut self,
            state: &AllocationState<'_>,
            allocation: &mut [u8],
        ) -> Result<(), AllocateError> {
            let living = (0..state.agents).filter(|agent| state.present.contains(*agent));
            for agent in living.clone() {
                let health = state.rows[agent * state.stride + 7];
                assert!(health > 0.0, "the dead get nothing to do");
                allocation[agent] = state.open_tasks.trailing_zeros() as u8;
            }
            self.0 = self.0.min(living.count());
            Ok(())
        }
    }

    /// Plays episodes of an environment in this process, without subtasks.
    fn play(name: &str, seed: u64, episodes: u32) -> EnvironmentWorld {
        play_under(name, seed, episodes, None)
    }

    fn play_under(
        name: &str,
        seed: u64,
        episodes: u32,
        allocator: Option<&mut dyn Allocator>,
    ) -> EnvironmentWorld {
        let environment = sortie_envs::open(name, Split::Train, 1, &Default::default());
        let mut world = EnvironmentWorld::new(environment.expect("it opens"), generator(seed));
        let actions = world.shape().actions;
        let contract = DomainContract {
            hash: 1,
            decision_interval: 5,
            subtasks: allocator.is_some(),
            ..DomainContract::default()
        };
        let settings = WorldSettings { episodes: Some(episodes), ..WorldSettings::default() };
        let mut policy = Last(actions, allocator.is_some());
        // Lent for as long as the team plays.
        let allocator = allocator.map(|allocator| allocator as &mut dyn Allocator);
        let team = InProcess { world: &mut world, policy: &mut policy, allocator };
        run_in_process(team, &contract, &settings, &mut (), &Stop::default())
            .expect("the episodes are played");
        world
    }

    #[test]
    fn every_environment_is_a_world_that_repeats_and_is_counted() {
        for entry in ENVIRONMENTS {
            let (world, again) = (play(entry.name, 3, 3), play(entry.name, 3, 3));
            let (tally, same) = (world.tally.borrow(), again.tally.borrow());
            assert_eq!(tally.episodes, 3, "{}", entry.name);
            assert_eq!(tally.returns, same.returns, "{}", entry.name);
            assert_eq!(tally.by_team.values().map(|team| team.episodes).sum::<usize>(), 3);
            let environment = world.environment.borrow();
            let (spec, last) = (environment.spec(), tally.last.as_ref().expect("an episode"));
            assert_eq!(*last, same.last.clone().expect("an episode"));
            for (metric, value) in spec.metrics.iter().zip(&last.metrics) {
                let sum = tally.metric(spec, &metric.name);
                assert!(sum.episodes <= 3 && (value.is_none() || sum.episodes >= 1));
            }
        }
    }

    #[test]
    fn allocators_count_without_the_dead() {
        let mut counts = Counts(8);
        play_under("skirmish/8s-disadvantage", 5, 3, Some(&mut counts));
        assert!(counts.0 < 8, "some die");
    }

    /// A rule that has been asked before, beside one that has not.
    struct Anew {
        entry: &'static Entry,
        rule: usize,
        asked: RuleAllocator,
        given: BTreeSet<Vec<u8>>,
    }

    impl Allocator for Anew {
        fn allocate(
            &mut self,
            state: &AllocationState<'_>,
            allocation: &mut [u8],
        ) -> Result<(), AllocateError> {
            let mut anew = RuleAllocator::new(self.entry, self.rule, 5).expect("the rule");
            anew.allocate(state, allocation)?;
            let again = &mut allocation.to_vec();
            self.asked.allocate(state, again)?;
            assert_eq!(again, allocation);
            self.given.insert(allocation.to_vec());
            Ok(())
        }
    }

    #[test]
    fn rules_that_draw_do_so_by_the_state_and_not_by_what_was_asked_before() {
        let entry = ENVIRONMENTS.iter().find(|entry| entry.name == "save-the-city").expect("it");
        let rule = entry.rules.iter().position(|rule| rule.name == "random").expect("it draws");
        let asked = RuleAllocator::new(entry, rule, 5).expect("the rule");
        let mut anew = Anew { entry, rule, asked, given: BTreeSet::new() };
        play_under("save-the-city", 5, 2, Some(&mut anew));
        assert!(anew.given.len() > 5, "other states, other draws");
    }

    #[test]
    fn sums_are_those_of_the_episodes() {
        let world = play("group-matching/2x2x1", 1, 1);
        let (tally, environment) = (world.tally.borrow(), world.environment.borrow());
        let last = tally.last.as_ref().expect("an episode");
        assert_eq!(tally.metric(environment.spec(), "matches").sum, last.metrics[0].unwrap());
        assert_eq!(tally.returns, last.episode_return);
        assert_eq!(tally.solved, usize::from(last.solved));
        assert_eq!(tally.metric(environment.spec(), "no such thing").episodes, 0);
    }
}
