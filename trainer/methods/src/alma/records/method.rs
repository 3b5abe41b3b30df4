//! Learning from records as a [`Method`].

use std::path::Path;

use rand_core::Rng;
use serde::{Deserialize, Serialize};
use sortie_envs::random::below;
use sortie_envs::{Environment, Observation, Random, Spec};
use sortie_learn::export::{DeployedAgents, Words};
use sortie_learn::learner::Rules;
use sortie_learn::networks::MixerKind;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{Level, Rates, Reports, UpdateReport};
use sortie_learn::subtasks::{
    Allocate, AllocatorNetworks, LearnedAllocator, NoSubtasks, RuleAllocator, Subtasks,
};
use sortie_learn::trajectory::{Capacity, Place, Widths};
use sortie_learn::{
    Act, LearnError, Learner, Method, Now, Scenes, State, Trajectories, Transition,
};

use super::config::{AllocatorConfig, Config, LEARNED, OptimiserConfig};
use super::lesson::{Drawn, Experience, Lesson, Networks, SAMPLES};
use super::replay::Replay;
use super::rollout::{Behaviour, Rollout};
use super::team_value::{
    DrawnSegment, SEGMENTS, Segments, TeamLesson, TeamValueAllocator, TeamValues,
};
use crate::alma::agents::{UtilityShape, UtilityView};
use crate::alma::export;
use crate::alma::learned::{Learned, measured};
use crate::alma::teams::{Agents, NetworkAgents};

/// Tells the allocator's streams of random numbers from the agents'.
const ALLOCATOR_STREAM: u64 = 1;

/// Agents, and where the run learns one, their allocator.
#[derive(Debug)]
pub struct Records {
    config: Config,
    spec: Spec,
    networks: Networks,
    /// The agents.
    pub agents: Learner<Lesson>,
    /// What they learn from.
    pub replay: Replay,
    /// There is one if the run learns an allocator.
    pub allocator: Option<Allocator>,
    /// Acts.
    pub rollout: Rollout,
    /// What the agents draw their samples with.
    random: Random,
    due: Due,
    /// Decisions that were not reported yet.
    decisions: u64,
    /// Whether the allocator learns from the steps that are being taken.
    keeps_segments: bool,
    samples: Vec<(Place, u8)>,
    drawn: Vec<Drawn>,
}

/// The level that allocates, and what it has seen.
#[derive(Debug)]
pub struct Allocator {
    values: TeamValues,
    /// Its networks.
    pub learner: Learner<TeamLesson>,
    /// What it learns from.
    pub segments: Segments,
    random: Random,
    drawn: Vec<DrawnSegment>,
    seen: Observation,
}

/// When each level makes its next update, in environment steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Due(Level<u64>);

impl Due {
    /// Whether a level has an update to make.
    fn any(&self, env_steps: u64) -> bool {
        self.0.agents.min(self.0.allocator) <= env_steps
    }

    /// Which levels have an update to make; they are taken to have made it.
    fn take(&mut self, env_steps: u64, config: &Config) -> Level<bool> {
        let take = |next: &mut u64, pause: u64| {
            let due = *next <= env_steps;
            *next += if due { pause } else { 0 };
            due
        };
        Level {
            agents: take(&mut self.0.agents, config.replay.steps_per_update),
            allocator: take(&mut self.0.allocator, config.allocator.replay.steps_per_update),
        }
    }
}

/// What updates do; the averaged weights begin as a plain mean.
fn rules(optimiser: &OptimiserConfig) -> Rules {
    Rules { mean_first: true, ..Rules::from(optimiser) }
}

impl Records {
    /// Draws the first weights, for an environment.
    pub fn new(config: &Config, environment: &dyn Environment, seed: u64, threads: usize) -> Self {
        let spec = environment.spec();
        let mut weights = generator(seed, Purpose::Weights, 0);
        let (networks, parameters) = Networks::new(config, spec, &mut weights);
        let instances = config.environment.instances;
        let allocator = || Allocator::new(&config.allocator, (spec, instances), seed, threads);
        Self {
            agents: Learner::new(parameters, rules(&config.optimiser), threads),
            networks,
            replay: Replay::new(config, spec),
            allocator: config.learns_allocator().then(allocator),
            rollout: Rollout::new(config, spec),
            random: generator(seed, Purpose::Replay, 0),
            due: Due::default(),
            decisions: 0,
            keeps_segments: false,
            samples: Vec::new(),
            drawn: Vec::new(),
            spec: spec.clone(),
            config: config.clone(),
        }
    }

    /// One update of the agents, if there is enough to learn from.
    pub fn update_agents(
        &mut self,
        environment: &dyn Environment,
        learning_rate: f32,
    ) -> Option<UpdateReport> {
        let Self { config, networks, agents, replay, random, samples, drawn, .. } = self;
        if !replay.has(config.replay.warm_up) {
            return None;
        }
        let turns = if config.replay.symmetries { environment.spec().turns } else { 1 };
        replay.draw(config.replay.batch, random, samples);
        drawn.clear();
        drawn.extend(samples.iter().map(|sample| Drawn {
            sample: *sample,
            turn: below(random, turns),
            marks: random.next_u64(),
        }));
        let experience = Experience { environment, replay };
        let shards = drawn.len().div_ceil(SAMPLES);
        (shards > 0).then(|| {
            agents.update(shards, learning_rate, |shard| {
                let own = drawn.chunks(SAMPLES).nth(shard.number).unwrap_or_default();
                networks.loss(shard, experience, own, drawn.len())
            })
        })
    }

    /// What the last update of the agents learned from.
    pub fn drawn(&self) -> &[Drawn] {
        &self.drawn
    }

    /// One update of each level that is due.
    fn update_once(&mut self, environment: &dyn Environment, now: Now, reports: &mut Reports) {
        let due = self.due.take(now.env_steps, &self.config);
        if due.agents {
            let rate = self.config.optimiser.learning_rate_at(now.env_steps, now.of);
            reports.agents.extend(self.update_agents(environment, rate));
        }
        let config = &self.config.allocator;
        if let Some(allocator) = self.allocator.as_mut().filter(|_| due.allocator) {
            let rate = config.optimiser.learning_rate_at(now.env_steps, now.of);
            reports.allocator.extend(allocator.update(config, environment, rate));
        }
    }

    /// The agents that are measured.
    fn measured(&self) -> Agents<'_> {
        Agents::new(UtilityView { shape: self.networks.shape, parameters: &self.agents.average })
    }

    /// The agents, and what they are allocated by if the run learns that.
    fn allocated(&self) -> Subtasks<'_> {
        let Config { network, allocation, .. } = &self.config;
        let team_max = allocation.team_max;
        Subtasks {
            agents: Box::new(NetworkAgents::new(self.measured(), network.subtask)),
            are_seen: network.subtask.has_subtasks(),
            interval: allocation.interval,
            allocator: self.allocator.as_ref().map(|allocator| LearnedAllocator {
                allocate: Box::new(TeamValueAllocator::new(allocator.measured(), team_max)),
                networks: AllocatorNetworks::TeamValue(Box::new(allocator.measured().layers())),
                team_max: Some(team_max),
            }),
        }
    }

    /// Who allocates where the team is measured.
    fn measured_allocator<'a>(
        &'a self,
        learned: Option<LearnedAllocator<'a>>,
    ) -> Box<dyn Allocate + 'a> {
        if !self.config.network.subtask.has_subtasks() {
            return Box::new(NoSubtasks);
        }
        match (self.config.allocation.measured(), learned) {
            (LEARNED, Some(learned)) => learned.allocate,
            // Whoever is measured under learned allocation learns it.
            (LEARNED, None) => Box::new(NoSubtasks),
            (rule, _) => Box::new(RuleAllocator(rule)),
        }
    }
}

impl Allocator {
    fn new(
        config: &AllocatorConfig,
        (spec, instances): (&Spec, usize),
        seed: u64,
        threads: usize,
    ) -> Self {
        let mut weights = generator(seed, Purpose::Weights, ALLOCATOR_STREAM);
        let (values, parameters) = TeamValues::new(config, spec, &mut weights);
        let widths = Widths { tasks: spec.shape.tasks, ..Widths::default() };
        let kept = Capacity::States(config.replay.capacity / instances);
        Self {
            values,
            learner: Learner::new(parameters, rules(&config.optimiser), threads),
            segments: Trajectories::noting(kept, instances, widths),
            random: generator(seed, Purpose::Replay, ALLOCATOR_STREAM),
            drawn: Vec::new(),
            seen: Observation::default(),
        }
    }

    /// One update, if there is enough to learn from.
    pub fn update(
        &mut self,
        config: &AllocatorConfig,
        environment: &dyn Environment,
        learning_rate: f32,
    ) -> Option<UpdateReport> {
        let Self { values, learner, segments, random, drawn, seen } = self;
        if !segments.can_draw(1) || segments.states() < config.replay.warm_up {
            return None;
        }
        let turns = if config.replay.symmetries { environment.spec().turns } else { 1 };
        let experience = (environment, &*segments);
        let rules = (config.credit, turns);
        let draw = |_| DrawnSegment::draw(experience, rules, seen, random);
        drawn.clear();
        drawn.extend((0..config.replay.batch).filter_map(draw));
        let shards = drawn.len().div_ceil(SEGMENTS);
        (shards > 0).then(|| {
            learner.update(shards, learning_rate, |shard| {
                let own = drawn.chunks(SEGMENTS).nth(shard.number).unwrap_or_default();
                values.loss(shard, experience, own, drawn.len())
            })
        })
    }

    fn measured(&self) -> UtilityView<'_> {
        UtilityView { shape: self.values.shape, parameters: &self.learner.average }
    }

    /// The weights that learn.
    pub fn online(&self) -> UtilityView<'_> {
        UtilityView { shape: self.values.shape, parameters: &self.learner.online.values }
    }
}

impl Method for Records {
    fn begins(&mut self, instance: usize, random: &mut Random) {
        self.rollout.begin(instance, random);
    }

    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        now: Now,
        random: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        let Config { exploration, allocator: config, .. } = &self.config;
        self.keeps_segments = now.env_steps >= config.learns_from;
        let (mut network, mut segments) = (None, None);
        if let Some(Allocator { values, learner, segments: kept, .. }) = &mut self.allocator {
            let online = UtilityView { shape: values.shape, parameters: &learner.online.values };
            network = (now.env_steps >= config.decides_from).then_some(online);
            segments = self.keeps_segments.then_some(kept);
        }
        let parameters = &self.agents.online.values;
        let behaviour = Behaviour {
            agents: UtilityView { shape: self.networks.shape, parameters },
            epsilon: exploration.epsilon_at(now.env_steps),
            allocator: network,
        };
        self.decisions += self.rollout.act(scenes, random, behaviour, segments, actions)?;
        Ok(())
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        let segments = self.allocator.as_mut().map(|allocator| &mut allocator.segments);
        let segments = segments.filter(|_| self.keeps_segments);
        self.rollout.remember(transition, &mut self.replay, segments);
        Ok(())
    }

    fn update(
        &mut self,
        environment: &dyn Environment,
        now: Now,
        reports: &mut Reports,
    ) -> Result<(), LearnError> {
        reports.decisions += std::mem::take(&mut self.decisions);
        while self.due.any(now.env_steps) {
            self.update_once(environment, now, reports);
        }
        Ok(())
    }

    fn rates(&self, now: Now) -> Rates {
        Rates {
            epsilon: self.config.exploration.epsilon_at(now.env_steps),
            learning_rate: self.config.optimiser.learning_rate_at(now.env_steps, now.of),
        }
    }

    fn team(&self) -> Box<dyn Act + '_> {
        let mut subtasks = self.allocated();
        let allocator = self.measured_allocator(subtasks.allocator.take());
        Box::new(subtasks.under(allocator))
    }

    fn subtasks(&self) -> Option<Subtasks<'_>> {
        Some(self.allocated())
    }

    fn deployed(&self) -> Result<DeployedAgents<'_>, LearnError> {
        export::deployed(self.measured(), self.config.network.subtask)
    }

    fn words(&self) -> Words {
        let Config { network, mixer, returns, replay, allocation, .. } = &self.config;
        let allocator = match &self.allocator {
            None => String::new(),
            Some(_) => format!(
                "The allocator values every team at every open subtask by a network of the same kind and takes the\n\
                 best allocation; a team has at most {} agents.\n\n",
                allocation.team_max
            ),
        };
        let allocators = self.allocator.as_ref().map(|allocator| allocator.values.shape);
        let mut departures = export::skips(self.networks.shape, allocators);
        departures += match mixer.kind {
            MixerKind::Sum => {
                "- Utilities of a subtask's team are summed (VDN); there is no mixing network.\n"
            }
            MixerKind::Linear => {
                "- Utilities of a subtask's team are mixed by a weighted sum, not by two layers.\n"
            }
            MixerKind::Qmix => "",
        };
        departures += &format!(
            "- It learns from records of one step and one subtask, with {}-step returns and discount {}.\n\
             - Adam with averaged weights; embedding width {}.\n",
            returns.steps, returns.discount, network.width,
        );
        if returns.shaping != 0.0 {
            departures += &format!(
                "- Potential shaping of {} per cell between an agent and its subtask, which leaves the best policy\n  \
                 as it is.\n",
                returns.shaping
            );
        }
        if replay.symmetries {
            departures += "- Sampled records are turned and mirrored at random.\n";
        }
        export::words(allocator, departures)
    }

    fn allocation(&self) -> &str {
        self.config.measured_allocation()
    }

    fn allocator_steps(&self) -> Option<[u64; 2]> {
        let config = &self.config.allocator;
        self.allocator.is_some().then_some([config.learns_from, config.decides_from])
    }

    /// Begins with the averaged weights of another run.
    fn take_over(&mut self, folder: &Path) -> Result<(), LearnError> {
        let learned = Learned::open(folder, &self.spec)?;
        let (network, agents) = (learned.network.view(), &mut self.agents);
        begin_with(agents, self.networks.shape, network, ["agents of another shape", "network"])?;
        let (Some(allocator), Some(network)) = (&mut self.allocator, &learned.team_values) else {
            return Ok(());
        };
        let (shape, what) = (allocator.values.shape, ["another allocator", "allocator.network"]);
        begin_with(&mut allocator.learner, shape, network.view(), what)
    }

    /// Who wants weights gets those that are measured.
    fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        let Self { config, networks, agents, allocator, .. } = self;
        if state.wants_weights() {
            let name = format!("agents/{}", measured(&config.optimiser));
            state.tensors(&name, &networks.shape.tensors(), &mut agents.average)?;
            let Some(Allocator { values, learner, .. }) = allocator else { return Ok(()) };
            let name = format!("allocator/{}", measured(&config.allocator.optimiser));
            return state.tensors(&name, &values.shape.tensors(), &mut learner.average);
        }
        state.value("due", &mut self.due)?;
        state.value("random", &mut self.random)?;
        self.rollout.visit(state)?;
        agents.state_as(state, |part| format!("agents/{part}"))?;
        self.replay.visit(state)?;
        let Some(Allocator { learner, segments, random, .. }) = allocator else { return Ok(()) };
        learner.state_as(state, |part| format!("allocator/{part}"))?;
        state.value("allocator/random", random)?;
        segments.visit_as(state, "segments")
    }
}

/// A learner whose networks all begin as another one of the same shape; `what` says of what, and by which key's section it
/// may get that shape.
fn begin_with<S>(
    learner: &mut Learner<S>,
    shape: UtilityShape,
    network: UtilityView<'_>,
    [what, key]: [&str; 2],
) -> Result<(), LearnError> {
    if shape != network.shape {
        let hint = shape.hint_to_become(network.shape, &format!("{key}.skip"));
        return Err(LearnError::Config(format!("`run.from` has {what}{hint}")));
    }
    let Learner { online, target, average, .. } = learner;
    for weights in [&mut online.values, target, average] {
        weights[..network.parameters.len()].copy_from_slice(network.parameters);
    }
    Ok(())
}
