//! Measures a team: greedy episodes on starts that training never sees.
//!
//! Any [`Team`] under any allocator can be measured. Episode e of a seed is the same whoever plays it, so that teams can
//! be compared pair by pair. Worlds stand side by side: who is due decides, all act at once, each is stepped.

mod planner;

use sortie_envs::{
    DecisionPoints, EntitySet, Environment, Observation, Random, Split, Step, UNASSIGNED,
};
use sortie_learn::LearnError;
use sortie_learn::evaluate::Evaluation;
use sortie_learn::play::{Onlooker, WORLDS, watch};
use sortie_nn::random::Generator;

use super::agents::NO_ACTION;
use super::teams::{Allocate, AllocatedTeam, Scene, Situation, Team};

pub use planner::{Planner, PlannerReport};

/// Which episodes are played.
#[derive(Clone, Copy)]
pub struct EvaluationPlan<'a> {
    /// What is played in, on starts that training never draws.
    pub environment: &'a dyn Environment,
    /// Steps between decisions, unless the open tasks change.
    pub interval: u32,
    /// How many episodes.
    pub episodes: usize,
    /// Which episodes: the same seed gives the same starts.
    pub seed: u64,
}

impl<'a> EvaluationPlan<'a> {
    /// So many episodes of a seed, with the usual interval between decisions.
    pub fn new(environment: &'a dyn Environment, episodes: usize, seed: u64) -> Self {
        Self { environment, interval: DecisionPoints::ACTION_LENGTH, episodes, seed }
    }

    fn open(&self, instances: usize) -> Box<dyn Environment> {
        self.environment.open(instances, Split::Test)
    }
}

/// Plays the episodes of a plan with a team and an allocator.
pub fn evaluate(
    plan: &EvaluationPlan<'_>,
    team: &mut dyn Team,
    allocator: &mut dyn Allocate,
) -> Result<Evaluation, LearnError> {
    evaluate_watched(plan, team, allocator, &mut ())
}

/// Plays the episodes of a plan while `onlooker` watches.
pub fn evaluate_watched(
    plan: &EvaluationPlan<'_>,
    team: &mut dyn Team,
    allocator: &mut dyn Allocate,
    onlooker: &mut dyn Onlooker,
) -> Result<Evaluation, LearnError> {
    let mut worlds = plan.open(WORLDS.min(plan.episodes));
    let mut team = AllocatedTeam::new(Box::new(team), Box::new(allocator), plan.interval);
    let done = watch(&mut *worlds, &mut team, 0..plan.episodes, plan.seed, onlooker)?;
    Ok(Evaluation::of(worlds.spec(), &done))
}

/// Plays the last episode of a plan alone: the same one that [`evaluate`] plays last.
pub fn watch_last_episode(
    plan: &EvaluationPlan<'_>,
    team: &mut dyn Team,
    allocator: &mut dyn Allocate,
    onlooker: &mut dyn Onlooker,
) -> Result<(), LearnError> {
    let mut worlds = plan.open(1);
    let mut team = AllocatedTeam::new(Box::new(team), Box::new(allocator), plan.interval);
    let last = plan.episodes.saturating_sub(1)..plan.episodes;
    watch(&mut *worlds, &mut team, last, plan.seed, onlooker)?;
    Ok(())
}

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
struct Worlds {
    environment: Box<dyn Environment>,
    interval: u32,
    worlds: Vec<World>,
    /// Worlds that play, in rising order.
    active: Vec<usize>,
    /// The actions of every active world `[active, A]`.
    actions: Vec<u16>,
}

impl Worlds {
    /// So many worlds of a plan; none plays yet.
    fn new(plan: &EvaluationPlan<'_>, count: usize) -> Self {
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
    fn begin(&mut self, index: usize, random: Random, generator: Generator) {
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
    fn decided(
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
    fn earned(&self, index: usize) -> f64 {
        self.worlds[index].earned
    }

    fn active(&self) -> &[usize] {
        &self.active
    }

    /// What the team sees of a world.
    fn scene(&self, index: usize) -> Scene<'_> {
        let World { allocation, last_actions, strategies, state, seen, .. } = &self.worlds[index];
        let (world, environment) = (index, &*self.environment);
        Scene { world, environment, state, seen, allocation, last_actions, strategies }
    }

    /// Decides where a decision is due, and lets the team choose the actions of all active worlds.
    fn choose(
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
    fn advance(&mut self, place: usize) -> Result<Step, LearnError> {
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
    fn retire(&mut self) {
        self.active.retain(|index| !self.worlds[*index].is_over);
    }

    /// Ends all play.
    fn clear(&mut self) {
        self.active.clear();
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use sortie_envs::save_the_city::{Scenario, ScenarioSet};
    use sortie_learn::random::{Purpose, generator};

    use super::*;
    use crate::alma::agents::{NetworkPolicy, UtilityNetwork};
    use crate::alma::records::Config;
    use crate::alma::teams::{NetworkTeam, PolicyTeam, RuleAllocator, ScriptedActors};

    fn measured(episodes: usize, team: &mut dyn Team, allocator: &mut dyn Allocate) -> Evaluation {
        let environment =
            sortie_envs::open("save-the-city/2-5a_2-5b", Split::Test, 1, &Default::default());
        let environment = environment.unwrap();
        let plan = EvaluationPlan::new(&*environment, episodes, 11);
        evaluate(&plan, team, allocator).unwrap()
    }

    #[test]
    fn the_scripted_team_reaches_its_known_level() {
        let mut team = ScriptedActors::new(1);
        let coordinated = measured(1000, &mut team, &mut RuleAllocator("coordinated"));
        assert!((0.68..0.82).contains(&coordinated.success), "{coordinated:?}");
        let heuristic = measured(1000, &mut team, &mut RuleAllocator("heuristic"));
        assert!((0.44..0.56).contains(&heuristic.success), "{heuristic:?}");
        assert_eq!(coordinated.by_team.len(), 13);
        assert_eq!(coordinated.by_team.values().map(|team| team.episodes).sum::<usize>(), 1000);
        let failed: usize = heuristic.failures.values().sum();
        assert_eq!(
            failed,
            heuristic.by_team.values().map(|t| t.episodes - t.solved).sum::<usize>()
        );
        let burned = heuristic.failures.iter().filter(|(cause, _)| cause.starts_with("burned"));
        let burned: usize = burned.map(|(_, count)| count).sum();
        assert_eq!(burned as f64, (1000.0 * (1.0 - heuristic.metrics["none_burned"])).round());
        let [low, high] = coordinated.success_ci95;
        assert!(low < coordinated.success && coordinated.success < high);
    }

    /// Whatever list the environment was opened for.
    #[test]
    fn a_team_is_measured_on_the_test_list_of_scenarios() {
        let name = "save-the-city/2-8a_2-8b_sim_Q1";
        let opened = sortie_envs::open(name, Split::Train, 1, &Default::default()).unwrap();
        let plan = EvaluationPlan::new(&*opened, 100, 1);
        let mut team = ScriptedActors::new(1);
        let measured = evaluate(&plan, &mut team, &mut RuleAllocator("heuristic")).unwrap();
        let letters =
            |scenario: &Scenario| scenario.team.iter().map(|kind| kind.letter()).collect();
        let set = ScenarioSet::named("2-8a_2-8b_sim_Q1").unwrap();
        let teams: BTreeSet<String> = set.test.iter().map(letters).collect();
        assert_eq!(measured.by_team.into_keys().collect::<BTreeSet<_>>(), teams);
    }

    #[test]
    fn an_evaluation_repeats() {
        let run = || measured(100, &mut ScriptedActors::new(3), &mut RuleAllocator("random"));
        assert_eq!(run(), run());
    }

    #[test]
    fn a_policy_acts_as_the_network_that_it_is_made_of() {
        let config = Config::default();
        let mut weights = generator(4, Purpose::Weights, 0);
        let environment =
            sortie_envs::open("save-the-city", Split::Test, 1, &Default::default()).unwrap();
        let shape = config.network.shape(environment.spec());
        // So large weights that whatever is seen decides what is done.
        let network = UtilityNetwork::initialise(shape, 0.02, &mut weights);
        let play = |team: &mut dyn Team| measured(40, team, &mut RuleAllocator("heuristic"));
        let by_network = play(&mut NetworkTeam::new(&network));
        let by_policy = play(&mut PolicyTeam::new(NetworkPolicy::new(&network)));
        assert_eq!(by_network, by_policy);
        assert!(by_network.length_mean > 10.0);
    }
}
