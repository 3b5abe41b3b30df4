//! Measures a team: greedy episodes on starts that training never sees.
//!
//! Anything that chooses actions can be measured: the utility network in training ([`NetworkTeam`]), a
//! deployed policy ([`PolicyTeam`]) or the scripted low level ([`ScriptedActors`]). Episode e of a seed
//! is the same whoever plays it, so that teams can be compared pair by pair.

use std::collections::BTreeMap;

use serde::Serialize;
use sortie_core::entity_mask::EntityMask;
use sortie_core::policy::{NO_ACTION as NO_ACTION_YET, Observation, Policy, visible};
use sortie_envs::Environment;
use sortie_envs::save_the_city::{
    ACTIONS, AllocationRule, City, Constants, DecisionPoints, EpisodeMetrics, FEATURES,
    SaveTheCity, ScenarioSet, Split, UNASSIGNED, scripted_actions, write_agent_row,
    write_building_row,
};

use rand_core::Rng;

use crate::error::LearnError;
use crate::methods::alma::{NO_ACTION, TeamBatch, UtilityNetwork, UtilityPass, best_action};
use crate::random::{Generator, Purpose, generator};

/// One state in which a team is to act.
#[derive(Clone, Copy, Debug)]
pub struct Scene<'a> {
    /// Which of the worlds played at the same time this is.
    pub world: usize,
    /// Agents and buildings.
    pub city: City<'a>,
    /// The building of every agent, or [`UNASSIGNED`].
    pub allocation: &'a [u8],
    /// The last action of every agent, or [`NO_ACTION`].
    pub last_actions: &'a [u8],
}

/// What chooses the actions of all agents.
pub trait Team {
    /// Writes one available action per existing agent of every scene into `actions` `[scenes, A]`.
    fn act(
        &mut self,
        scenes: &[Scene<'_>],
        actions: &mut [u16],
        agents: usize,
    ) -> Result<(), LearnError>;
}

/// What assigns agents to buildings at decision points.
pub trait Allocate {
    /// Writes the building of every agent, or [`UNASSIGNED`]; `generator` belongs to the episode.
    fn allocate(
        &mut self,
        city: City<'_>,
        generator: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError>;
}

impl Allocate for AllocationRule {
    fn allocate(
        &mut self,
        city: City<'_>,
        generator: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        AllocationRule::allocate(*self, city, generator, allocation);
        Ok(())
    }
}

/// Which episodes are played.
#[derive(Clone, Debug, PartialEq)]
pub struct EvaluationPlan {
    /// The scenarios; their test list is used.
    pub set: ScenarioSet,
    /// Numbers of the rules.
    pub constants: Constants,
    /// Steps between decisions, unless the open tasks change.
    pub interval: u32,
    /// How many episodes.
    pub episodes: usize,
    /// Which episodes: the same seed gives the same starts.
    pub seed: u64,
}

impl EvaluationPlan {
    /// So many episodes of a scenario set by its name, with the usual rules.
    pub fn new(set: &str, episodes: usize, seed: u64) -> Result<Self, LearnError> {
        Ok(Self {
            set: ScenarioSet::named(set)?,
            constants: Constants::default(),
            interval: DecisionPoints::ACTION_LENGTH,
            episodes,
            seed,
        })
    }
}

/// What a team achieved.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evaluation {
    /// Episodes played.
    pub episodes: usize,
    /// Share of episodes with all buildings complete.
    pub success: f64,
    /// 95 % Wilson interval of the success.
    pub success_ci95: [f64; 2],
    /// Mean of the team's return.
    pub return_mean: f64,
    /// Its standard deviation between episodes.
    pub return_sd: f64,
    /// Mean number of steps.
    pub length_mean: f64,
    /// Share of episodes that ran out of time.
    pub timeouts: f64,
    /// Share of episodes in which no building burned down.
    pub none_burned: f64,
    /// Success by team, its kinds as letters.
    pub by_team: BTreeMap<String, TeamSuccess>,
}

/// How one composition of a team did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct TeamSuccess {
    /// Episodes played.
    pub episodes: usize,
    /// Those with all buildings complete.
    pub solved: usize,
}

/// Worlds played at the same time.
const WORLDS: usize = 64;

/// Plays the episodes of a plan with a team and an allocator.
pub fn evaluate(
    plan: &EvaluationPlan,
    team: &mut dyn Team,
    allocator: &mut dyn Allocate,
) -> Result<Evaluation, LearnError> {
    let worlds = WORLDS.min(plan.episodes);
    let mut play = Play::new(plan, worlds)?;
    let mut done = vec![None; plan.episodes];
    while play.step(team, allocator, &mut done)? {}
    Ok(summary(done.into_iter().flatten().collect()))
}

/// One world and its running episode.
struct World {
    episode: usize,
    generator: Generator,
    decisions: DecisionPoints,
    tasks_changed: bool,
    allocation: Vec<u8>,
    last_actions: Vec<u8>,
}

/// A finished episode: the team's letters and the counts.
type Finished = (String, EpisodeMetrics);

struct Play<'a> {
    plan: &'a EvaluationPlan,
    city: SaveTheCity,
    worlds: Vec<World>,
    /// Worlds that still play.
    active: Vec<usize>,
    next_episode: usize,
    actions: Vec<u16>,
}

impl<'a> Play<'a> {
    fn new(plan: &'a EvaluationPlan, worlds: usize) -> Result<Self, LearnError> {
        let agents = plan.set.max_agents;
        let mut city = SaveTheCity::new(plan.set.clone(), plan.constants, worlds, 0)?;
        city.use_split(Split::Test);
        let world = |_| World {
            episode: 0,
            generator: generator(0, Purpose::Evaluation, 0),
            decisions: DecisionPoints::every(plan.interval),
            tasks_changed: false,
            allocation: vec![UNASSIGNED; agents],
            last_actions: vec![NO_ACTION; agents],
        };
        let mut play = Self {
            plan,
            city,
            worlds: (0..worlds).map(world).collect(),
            active: (0..worlds).collect(),
            next_episode: 0,
            actions: vec![0; worlds * agents],
        };
        for world in 0..worlds {
            play.start(world);
        }
        Ok(play)
    }

    /// Starts the next episode in a world; false when all episodes have begun.
    fn start(&mut self, index: usize) -> bool {
        if self.next_episode == self.plan.episodes {
            return false;
        }
        let world = &mut self.worlds[index];
        world.episode = self.next_episode;
        world.generator = generator(self.plan.seed, Purpose::Evaluation, self.next_episode as u64);
        world.decisions.restart();
        world.tasks_changed = false;
        world.last_actions.fill(NO_ACTION);
        self.city.seed(index, world.generator.next_u64());
        self.city.reset(index);
        self.next_episode += 1;
        true
    }

    /// One step in every active world; false when all episodes are finished.
    fn step(
        &mut self,
        team: &mut dyn Team,
        allocator: &mut dyn Allocate,
        done: &mut [Option<Finished>],
    ) -> Result<bool, LearnError> {
        for index in &self.active {
            let world = &mut self.worlds[*index];
            if world.decisions.is_due(world.tasks_changed) {
                let city = self.city.city(*index);
                allocator.allocate(city, &mut world.generator, &mut world.allocation)?;
            }
        }
        let agents = self.plan.set.max_agents;
        let mut actions = std::mem::take(&mut self.actions);
        actions.fill(0);
        let scenes: Vec<Scene<'_>> = self.active.iter().map(|index| self.scene(*index)).collect();
        team.act(&scenes, &mut actions[..scenes.len() * agents], agents)?;
        self.actions = actions;

        let mut active = std::mem::take(&mut self.active);
        let mut place = 0;
        let mut failure = None;
        active.retain(|index| {
            let result = self.advance(*index, place, done);
            place += 1;
            result.unwrap_or_else(|error| {
                failure.get_or_insert(error);
                false
            })
        });
        self.active = active;
        failure.map_or(Ok(!self.active.is_empty()), Err)
    }

    fn scene(&self, index: usize) -> Scene<'_> {
        let world = &self.worlds[index];
        Scene {
            world: index,
            city: self.city.city(index),
            allocation: &world.allocation,
            last_actions: &world.last_actions,
        }
    }

    /// Steps a world with the actions at a place; false when it has no episode left.
    fn advance(
        &mut self,
        index: usize,
        place: usize,
        done: &mut [Option<Finished>],
    ) -> Result<bool, LearnError> {
        let agents = self.plan.set.max_agents;
        let actions = &self.actions[place * agents..][..agents];
        let outcome = self.city.step(index, actions)?;
        let world = &mut self.worlds[index];
        for (last, action) in world.last_actions.iter_mut().zip(actions) {
            *last = *action as u8;
        }
        world.tasks_changed = outcome.tasks_changed;
        if !outcome.done() {
            return Ok(true);
        }
        let letters = self.city.city(index).agents.iter().map(|agent| agent.kind.letter());
        done[world.episode] = Some((letters.collect(), *self.city.metrics(index)));
        Ok(self.start(index))
    }
}

fn summary(episodes: Vec<Finished>) -> Evaluation {
    let count = episodes.len();
    let mean = |value: &dyn Fn(&EpisodeMetrics) -> f64| {
        episodes.iter().map(|(_, metrics)| value(metrics)).sum::<f64>() / count.max(1) as f64
    };
    let share = |holds: &dyn Fn(&EpisodeMetrics) -> bool| mean(&|m| f64::from(u8::from(holds(m))));
    let return_mean = mean(&|m| m.episode_return);
    let spread: f64 = episodes.iter().map(|(_, m)| (m.episode_return - return_mean).powi(2)).sum();
    let mut by_team = BTreeMap::<String, TeamSuccess>::new();
    for (team, metrics) in &episodes {
        let entry = by_team.entry(team.clone()).or_default();
        entry.episodes += 1;
        entry.solved += usize::from(metrics.solved);
    }
    let solved = by_team.values().map(|team| team.solved).sum();
    Evaluation {
        episodes: count,
        success: share(&|m| m.solved),
        success_ci95: wilson_interval(solved, count),
        return_mean,
        return_sd: (spread / count.saturating_sub(1).max(1) as f64).sqrt(),
        length_mean: mean(&|m| f64::from(m.steps)),
        timeouts: share(&|m| m.timed_out),
        none_burned: share(&|m| m.none_burned()),
        by_team,
    }
}

/// The 95 % Wilson interval of a share.
pub fn wilson_interval(successes: usize, trials: usize) -> [f64; 2] {
    if trials == 0 {
        return [0.0, 1.0];
    }
    let z = 1.959_964;
    let (n, p) = (trials as f64, successes as f64 / trials as f64);
    let middle = (p + z * z / (2.0 * n)) / (1.0 + z * z / n);
    let half = z / (1.0 + z * z / n) * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
    [(middle - half).max(0.0), (middle + half).min(1.0)]
}

/// The utility network, greedy, on all scenes at once.
#[derive(Debug)]
pub struct NetworkTeam<'a> {
    network: &'a UtilityNetwork,
    pass: UtilityPass,
    batch: TeamBatch,
    actors: Vec<(usize, usize)>,
}

impl<'a> NetworkTeam<'a> {
    /// Acts by a network.
    pub fn new(network: &'a UtilityNetwork) -> Self {
        let pass = UtilityPass::new(network.shape());
        Self { network, pass, batch: TeamBatch::default(), actors: Vec::new() }
    }
}

impl Team for NetworkTeam<'_> {
    fn act(
        &mut self,
        scenes: &[Scene<'_>],
        actions: &mut [u16],
        agents: usize,
    ) -> Result<(), LearnError> {
        self.batch.clear();
        self.actors.clear();
        for (place, scene) in scenes.iter().enumerate() {
            self.batch.push_teams(scene.city, scene.allocation, scene.last_actions, |agent| {
                self.actors.push((place, agent));
            });
        }
        for (place, scene) in scenes.iter().enumerate() {
            self.batch.push_unassigned(scene.city, scene.allocation, scene.last_actions, |agent| {
                self.actors.push((place, agent))
            });
        }
        let utilities = self.pass.forward(self.network, self.batch.finish());
        for ((place, agent), utilities) in self.actors.iter().zip(utilities.chunks_exact(ACTIONS)) {
            let available = scenes[*place].city.agents[*agent].available;
            actions[place * agents + agent] = best_action(utilities, available).into();
        }
        Ok(())
    }
}

/// The scripted low level.
#[derive(Debug)]
pub struct ScriptedActors {
    generator: Generator,
}

impl ScriptedActors {
    /// A script that breaks ties by a seed.
    pub fn new(seed: u64) -> Self {
        Self { generator: generator(seed, Purpose::Evaluation, u64::MAX) }
    }
}

impl Team for ScriptedActors {
    fn act(
        &mut self,
        scenes: &[Scene<'_>],
        actions: &mut [u16],
        agents: usize,
    ) -> Result<(), LearnError> {
        for (scene, actions) in scenes.iter().zip(actions.chunks_exact_mut(agents)) {
            scripted_actions(scene.city, scene.allocation, &mut self.generator, actions);
        }
        Ok(())
    }
}

/// A deployed policy, agent by agent, on what each of them would see.
#[derive(Debug)]
pub struct PolicyTeam<P> {
    policy: P,
    rows: Vec<f32>,
    last_actions: Vec<u16>,
    entity_task: Vec<u32>,
}

impl<P: Policy> PolicyTeam<P> {
    /// Acts by a policy that was trained on SaveTheCity.
    pub fn new(policy: P) -> Self {
        Self { policy, rows: Vec::new(), last_actions: Vec::new(), entity_task: Vec::new() }
    }

    fn observe(&mut self, scene: &Scene<'_>) {
        let (agents, buildings) = (scene.city.agents, scene.city.buildings);
        self.rows.resize((agents.len() + buildings.len()) * FEATURES, 0.0);
        let mut rows = self.rows.chunks_exact_mut(FEATURES);
        for (agent, row) in agents.iter().zip(&mut rows) {
            write_agent_row(agent, row);
        }
        for (building, row) in buildings.iter().zip(&mut rows) {
            write_building_row(building, row);
        }
        let widen =
            |action: &u8| if *action == NO_ACTION { NO_ACTION_YET } else { (*action).into() };
        self.last_actions.clear();
        self.last_actions.extend(scene.last_actions[..agents.len()].iter().map(widen));
        let task_bit = |task: &u8| 1u32.checked_shl((*task).into()).unwrap_or(0);
        self.entity_task.clear();
        self.entity_task.extend(scene.allocation[..agents.len()].iter().map(task_bit));
        self.entity_task.extend((0..buildings.len()).map(|task| 1 << task));
    }
}

impl<P: Policy> Team for PolicyTeam<P> {
    fn act(
        &mut self,
        scenes: &[Scene<'_>],
        actions: &mut [u16],
        agents: usize,
    ) -> Result<(), LearnError> {
        for (scene, actions) in scenes.iter().zip(actions.chunks_exact_mut(agents)) {
            self.observe(scene);
            let everything = EntityMask::first(self.entity_task.len());
            for (index, agent) in scene.city.agents.iter().enumerate() {
                let task = scene.allocation[index];
                let subtask = (task != UNASSIGNED).then_some(task);
                let available: [u16; ACTIONS] =
                    std::array::from_fn(|action| agent.available >> action & 1);
                let observation = Observation {
                    rows: &self.rows,
                    stride: FEATURES,
                    last_actions: &self.last_actions,
                    visible: visible(everything, everything, &self.entity_task, subtask),
                    self_index: index,
                    available: &available,
                };
                let decision = self.policy.decide(&observation);
                actions[index] = decision.map_err(|e| LearnError::Team(e.to_string()))?.action;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::alma::NetworkPolicy;

    fn plan(episodes: usize) -> EvaluationPlan {
        EvaluationPlan::new("2-5a_2-5b", episodes, 11).unwrap()
    }

    #[test]
    fn the_scripted_team_reaches_its_known_level() {
        let mut team = ScriptedActors::new(1);
        let coordinated =
            evaluate(&plan(1000), &mut team, &mut AllocationRule::Coordinated).unwrap();
        assert!((0.68..0.82).contains(&coordinated.success), "{coordinated:?}");
        let heuristic = evaluate(&plan(1000), &mut team, &mut AllocationRule::Heuristic).unwrap();
        assert!((0.44..0.56).contains(&heuristic.success), "{heuristic:?}");
        assert_eq!(coordinated.by_team.len(), 13);
        assert_eq!(coordinated.by_team.values().map(|team| team.episodes).sum::<usize>(), 1000);
        let [low, high] = coordinated.success_ci95;
        assert!(low < coordinated.success && coordinated.success < high);
    }

    #[test]
    fn an_evaluation_repeats() {
        let run = || {
            evaluate(&plan(100), &mut ScriptedActors::new(3), &mut AllocationRule::Random).unwrap()
        };
        assert_eq!(run(), run());
    }

    #[test]
    fn a_policy_acts_as_the_network_that_it_is_made_of() {
        let config = crate::methods::alma::Config::default();
        let mut weights = generator(4, Purpose::Weights, 0);
        let shape = config.network.shape(ACTIONS);
        let network = UtilityNetwork::initialise(shape, 8.0, &mut weights);
        let play = |team: &mut dyn Team| {
            evaluate(&plan(40), team, &mut AllocationRule::Heuristic).unwrap()
        };
        let by_network = play(&mut NetworkTeam::new(&network));
        let by_policy = play(&mut PolicyTeam::new(NetworkPolicy::new(&network)));
        assert_eq!(by_network, by_policy);
        assert!(by_network.length_mean > 10.0);
    }

    #[test]
    fn the_wilson_interval_agrees_with_known_values() {
        let [low, high] = wilson_interval(10, 20);
        assert!((low - 0.2993).abs() < 1e-3 && (high - 0.7007).abs() < 1e-3, "{low} {high}");
        assert_eq!(wilson_interval(0, 0), [0.0, 1.0]);
        assert!(wilson_interval(20, 20)[1] <= 1.0);
    }
}
