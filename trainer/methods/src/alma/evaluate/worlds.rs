//! Worlds side by side: who is due decides, all act at once, each is stepped.

use sortie_envs::{DecisionPoints, EntitySet, Environment, Observation, Random, Step, UNASSIGNED};
use sortie_nn::random::Generator;

use super::EvaluationPlan;
use crate::alma::agents::NO_ACTION;
use crate::alma::teams::{Allocate, Scene, Situation, Team};
use sortie_learn::LearnError;

/// What a world remembers between steps.
struct World {
    /// Draws what the rules of the world leave to chance.
    random: Random,
    /// Draws what the allocator leaves to chance.
    generator: Generator,
    decisions: DecisionPoints,
    tasks_changed: bool,
    is_over: bool,
    /// Rewards of the team since it began to play.
    earned: f64,
    allocation: Vec<u8>,
    last_actions: Vec<u8>,
    strategies: Vec<f32>,
    state: Vec<u8>,
    seen: Observation,
}

impl World {
    /// Takes over the state of an instance.
    fn look(&mut self, environment: &dyn Environment, instance: usize) {
        self.state.clear();
        environment.save(instance, &mut self.state);
        environment.observe(&self.state, 0, EntitySet::MAX, &mut self.seen);
    }
}

/// The worlds; some of them play.
pub(super) struct Worlds {
    pub(super) environment: Box<dyn Environment>,
    interval: u32,
    worlds: Vec<World>,
    /// Worlds that play, in rising order.
    active: Vec<usize>,
    /// The actions of every active world `[active, A]`.
    actions: Vec<u16>,
}

impl Worlds {
    /// So many worlds of a plan; none plays yet.
    pub(super) fn new(plan: &EvaluationPlan<'_>, count: usize) -> Self {
        Self {
            environment: plan.open(count),
            interval: plan.interval,
            worlds: Vec::new(),
            active: Vec::new(),
            actions: Vec::new(),
        }
    }

    fn agents(&self) -> usize {
        self.environment.spec().shape.agents
    }

    /// Begins an episode in a world, the next one to play or one that plays; its state has been set.
    pub(super) fn begin(&mut self, index: usize, random: Random, generator: Generator) {
        let agents = self.agents();
        let mut world = World {
            random,
            generator,
            decisions: DecisionPoints::every(self.interval),
            tasks_changed: false,
            is_over: false,
            earned: 0.0,
            allocation: vec![UNASSIGNED; agents],
            last_actions: vec![NO_ACTION; agents],
            strategies: Vec::new(),
            state: Vec::new(),
            seen: Observation::default(),
        };
        world.look(&*self.environment, index);
        match self.worlds.get_mut(index) {
            Some(place) => *place = world,
            None => self.worlds.push(world),
        }
        if self.active.last().is_none_or(|last| *last < index) {
            self.active.push(index);
        }
    }

    /// Puts a world in the middle of an episode whose allocation has just been decided.
    pub(super) fn decided(
        &mut self,
        index: usize,
        last_actions: &[u8],
        allocation: &[u8],
        team: &mut dyn Team,
    ) -> Result<(), LearnError> {
        let world = &mut self.worlds[index];
        world.decisions.is_due(false);
        world.last_actions.copy_from_slice(last_actions);
        world.allocation.copy_from_slice(allocation);
        team.advise(&world.seen, &mut world.strategies)
    }

    /// What the team has earned in a world since it began to play there.
    pub(super) fn earned(&self, index: usize) -> f64 {
        self.worlds[index].earned
    }

    /// The worlds that play.
    pub(super) fn active(&self) -> &[usize] {
        &self.active
    }

    /// What the team sees of a world.
    pub(super) fn scene(&self, index: usize) -> Scene<'_> {
        let World { allocation, last_actions, strategies, state, seen, .. } = &self.worlds[index];
        let (world, environment) = (index, &*self.environment);
        Scene { world, environment, state, seen, allocation, last_actions, strategies }
    }

    /// Decides where a decision is due, and lets the team choose the actions of all active worlds.
    pub(super) fn choose(
        &mut self,
        team: &mut dyn Team,
        allocator: &mut dyn Allocate,
    ) -> Result<(), LearnError> {
        for index in &self.active {
            let world = &mut self.worlds[*index];
            if world.decisions.is_due(world.tasks_changed) {
                let World { generator, allocation, strategies, state, seen, last_actions, .. } =
                    world;
                let situation = Situation { environment: &*self.environment, state, last_actions };
                allocator.decide(situation, team, generator, allocation)?;
                team.advise(seen, strategies)?;
            }
        }
        let agents = self.agents();
        let mut actions = std::mem::take(&mut self.actions);
        actions.clear();
        actions.resize(self.active.len() * agents, 0);
        let scenes: Vec<Scene<'_>> = self.active.iter().map(|index| self.scene(*index)).collect();
        team.act(&scenes, &mut actions, agents)?;
        self.actions = actions;
        Ok(())
    }

    /// Steps the active world at a place.
    pub(super) fn advance(&mut self, place: usize) -> Result<Step, LearnError> {
        let (index, agents) = (self.active[place], self.agents());
        let actions = &self.actions[place * agents..][..agents];
        let world = &mut self.worlds[index];
        let outcome = self.environment.step(index, actions, &mut world.random)?;
        for (last, action) in world.last_actions.iter_mut().zip(actions) {
            *last = *action as u8;
        }
        world.tasks_changed = outcome.tasks_changed;
        world.is_over = outcome.done();
        world.earned += outcome.reward;
        world.look(&*self.environment, index);
        Ok(outcome)
    }

    /// Ends the play of worlds whose episode is over.
    pub(super) fn retire(&mut self) {
        self.active.retain(|index| !self.worlds[*index].is_over);
    }

    /// Ends all play.
    pub(super) fn clear(&mut self) {
        self.active.clear();
    }
}
