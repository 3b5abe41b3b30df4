//! Learning from records as a [`Method`].

use std::path::Path;

use rand_core::Rng;
use sortie_envs::random::below;
use sortie_envs::{Environment, Observation, Random, Spec, deployed_tasks};
use sortie_learn::configuration::require;
use sortie_learn::export::{DeployedAgents, Words};
use sortie_learn::networks::MixerKind;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{Level, Rates, Reports, UpdateReport};
use sortie_learn::subtasks::{
    Allocate, AllocatorNetworks, LearnedAllocator, NoSubtasks, Places, RuleAllocator, Subtasks,
};
use sortie_learn::trajectory::Place;
use sortie_learn::{Act, Ask, LearnError, Learner, Method, Now, State, Transition};

use super::config::{Config, LEARNED};
use super::deciding::{Deciding, Decisions};
use super::lesson::{Drawn, Experience, Lesson, Networks, SAMPLES};
use super::replay::{Moment, Replay};
use super::rules;
use super::team_value::{Allocator, TeamValueAllocator};
use crate::alma::agents::{Conditioning, UtilityShape, UtilityView};
use crate::alma::export;
use crate::alma::learned::{Learned, measured};
use crate::alma::teams::{Agents, NetworkAgents, Players};

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
    places: Places,
    /// The running episode of each instance.
    episodes: Vec<Decisions>,
    deciding: Deciding,
    players: Players,
    seen: Observation,
    /// What the agents draw their samples with.
    random: Random,
    /// When each level makes its next update, in environment steps.
    due: Level<u64>,
    /// Decisions that were not reported yet.
    decisions: u64,
    /// Whether the allocator learns from the steps that are being taken.
    keeps_segments: bool,
    samples: Vec<(Place, u8)>,
    drawn: Vec<Drawn>,
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
            places: Places::new(config.allocation.interval),
            episodes: (0..instances).map(Decisions::new).collect(),
            deciding: Deciding::new(config, spec),
            players: Players::new(config.network.subtask),
            seen: Observation::default(),
            random: generator(seed, Purpose::Replay, 0),
            due: Level::default(),
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

    /// Floating-point operations of acting up to now, those of passes.
    pub fn operations(&self) -> u64 {
        self.players.operations + self.deciding.search.operations()
    }

    /// What the last update of the agents learned from.
    pub fn drawn(&self) -> &[Drawn] {
        &self.drawn
    }

    /// One update of each level that is due.
    fn update_once(&mut self, environment: &dyn Environment, now: Now, reports: &mut Reports) {
        let is_due = |next: &mut u64, pause: u64| {
            let is_due = *next <= now.env_steps;
            *next += if is_due { pause } else { 0 };
            is_due
        };
        let [of_agents, of_allocator] = [&self.config.replay, &self.config.allocator.replay];
        let agents_due = is_due(&mut self.due.agents, of_agents.steps_per_update);
        let allocator_due = is_due(&mut self.due.allocator, of_allocator.steps_per_update);
        if agents_due {
            let rate = self.config.optimiser.learning_rate_at(now.env_steps, now.of);
            reports.agents.extend(self.update_agents(environment, rate));
        }
        let config = &self.config.allocator;
        if let Some(allocator) = self.allocator.as_mut().filter(|_| allocator_due) {
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

impl Method for Records {
    fn begins(&mut self, instance: usize, random: &mut Random) {
        self.episodes[instance].restart(&self.deciding, random);
    }

    fn act(&mut self, ask: Ask<'_>, now: Now) -> Result<(), LearnError> {
        let Ask { scenes, random, actions } = ask;
        let Self { config, places, episodes, deciding, players, .. } = self;
        let Config { exploration, allocator, .. } = config;
        self.keeps_segments = now.env_steps >= allocator.learns_from;
        let (mut network, mut segments) = (None, None);
        if let Some(Allocator { values, learner, segments: kept, .. }) = &mut self.allocator {
            let online = UtilityView { shape: values.shape, parameters: &learner.online.values };
            network = (now.env_steps >= allocator.decides_from).then_some(online);
            segments = self.keeps_segments.then_some(kept);
        }
        for scene in scenes.scenes {
            let place = places.look(scenes.environment, scene);
            if place.is_due {
                let (instance, at) = (scene.instance, (scenes.environment, scene.state));
                let (episode, random) = (&mut episodes[instance], &mut random[instance]);
                deciding.decide(episode, at, place, random, network, segments.as_deref_mut())?;
                self.decisions += 1;
            }
        }
        let (shape, parameters) = (self.networks.shape, &*self.agents.online.values);
        let agents = Agents::new(UtilityView { shape, parameters });
        let (epsilon, spread) = (exploration.epsilon_at(now.env_steps), &exploration.spread);
        let explores = |world: usize| epsilon * spread[world % spread.len()];
        let rest = config.network.subtask == Conditioning::Mask;
        let shown = places.scenes(scenes);
        players.explore(agents, &shown, random, (explores, rest), actions)?;
        places.note(scenes, actions);
        Ok(())
    }

    /// Keeps a step, and the segment that it completes.
    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        let Transition { environment, instance, state, actions, next, .. } = *transition;
        let (place, episode) = (self.places.of(instance), &mut self.episodes[instance]);
        environment.observe(next, 0, 0, &mut self.seen);
        let did: Vec<u8> = actions.iter().map(|action| *action as u8).collect();
        let (allocation, last_actions) = (&place.allocation, &place.last_actions);
        let moment = Moment { state, allocation, last_actions, actions: &did };
        let seen = (&place.seen, deployed_tasks(self.seen.open_tasks));
        self.replay.push(transition, seen, (moment, &episode.before));
        episode.before.clone_from(allocation);
        let segments = self.allocator.as_mut().map(|allocator| &mut allocator.segments);
        let segments = segments.filter(|_| self.keeps_segments);
        episode.remember(transition, self.config.allocator.discount, segments);
        Ok(())
    }

    fn update(&mut self, environment: &dyn Environment, now: Now) -> Result<Reports, LearnError> {
        let decisions = std::mem::take(&mut self.decisions);
        let mut reports = Reports { decisions, ..Reports::default() };
        while self.due.agents.min(self.due.allocator) <= now.env_steps {
            self.update_once(environment, now, &mut reports);
        }
        Ok(reports)
    }

    fn rates(&self, now: Now) -> Rates {
        let epsilon = self.config.exploration.epsilon_at(now.env_steps);
        let learning_rate = self.config.optimiser.learning_rate_at(now.env_steps, now.of);
        Rates { epsilon, learning_rate }
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
        let instances = self.episodes.len();
        state.value("decisions", &mut self.episodes)?;
        require(self.episodes.len() == instances, "the checkpoint has other instances")?;
        self.places.visit(state, self.spec.shape.agents)?;
        agents.state_as(state, |part| format!("agents/{part}"))?;
        self.replay.visit(state)?;
        allocator.as_mut().map_or(Ok(()), |allocator| allocator.state(state))
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

#[cfg(test)]
mod tests;
