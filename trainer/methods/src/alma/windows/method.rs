//! Learning from windows as a [`Method`]: rounds of episodes, and as many updates of both levels.

use std::ops::Range;
use std::path::Path;

use serde::{Deserialize, Serialize};
use sortie_envs::{Environment, Spec};
use sortie_learn::export::{DeployedAgents, Words};
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{Rates, Reports, UpdateReport};
use sortie_learn::subtasks::{
    Allocate, AllocatorNetworks, LearnedAllocator, NoSubtasks, Places, RuleAllocator, Subtasks,
    ToAllocate,
};
use sortie_learn::trajectory::Episode;
use sortie_learn::{Act, Ask, LearnError, Method, Now, State, Transition};
use sortie_nn::random::Generator;

use super::WindowShape;
use super::allocation::{AllocationLearning, AllocationLevel, AllocationNetworks};
use super::config::{Config, Exploration};
use super::deciding::ProposalAllocator;
use super::export::{ProposalGraphs, export_proposals};
use super::low_level::LowLevel;
use super::sampling::{Note, Replay, SampleShape, cut_windows, draw_episodes};
use crate::alma::coach::Advice;
use crate::alma::export;
use crate::alma::learned::Learned;
use crate::alma::records::config::ReturnsConfig;
use crate::alma::teams::{NetworkAgents, Players};

/// Episodes since the run began, and when target networks were renewed last.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Episodes {
    played: u64,
    agents_copied: u64,
    critic_copied: u64,
}

/// Agents with their mixer, and where the run learns one, their allocator.
#[derive(Debug)]
pub struct WindowLearner {
    /// How it learns, and who allocates meanwhile.
    pub config: Config,
    spec: Spec,
    threads: usize,
    /// Agents, mixer and coach.
    pub low_level: LowLevel,
    /// There is one if the run learns to allocate.
    pub allocation: Option<AllocationLevel>,
    places: Places,
    players: Players,
    /// Environment steps of the run when the episodes that are played began.
    began: u64,
    /// Whole episodes.
    pub replay: Replay,
    /// What every update draws.
    sample: SampleShape,
    /// Draws episodes, windows and everything that an update needs.
    generator: Generator,
    episodes: Episodes,
    /// Decisions that were not reported yet.
    decisions: u64,
}

impl WindowLearner {
    /// Draws the first weights, for such an environment.
    pub fn new(config: &Config, spec: &Spec, seed: u64, threads: usize) -> Self {
        let sizes = WindowShape::of(spec);
        let mut weights = generator(seed, Purpose::Weights, 0);
        let mut low_level = LowLevel::new(config.low_level.clone(), sizes, &mut weights);
        if config.coach.enabled {
            low_level.add_coach(&config.coach, &mut weights);
        }
        let learning = config.learns_allocator().then(|| AllocationLearning::of(config, sizes));
        Self {
            places: Places::new(config.allocation.interval),
            players: Players::new(config.low_level.conditioning),
            began: 0,
            allocation: learning.map(|learning| AllocationLevel::new(learning, seed)),
            replay: Replay::new(
                config.learning.episodes,
                config.environment.instances,
                &spec.shape,
            ),
            sample: SampleShape {
                windows: config.learning.windows,
                steps: config.learning.steps,
                ..SampleShape::default()
            },
            generator: generator(seed, Purpose::Replay, 0),
            episodes: Episodes::default(),
            decisions: 0,
            config: config.clone(),
            spec: spec.clone(),
            threads,
            low_level,
        }
    }

    /// One update of each level that has enough to learn from.
    fn update_once(&mut self, environment: &dyn Environment, now: u64, reports: &mut Reports) {
        let Self { config, sample, generator, replay, threads, .. } = self;
        let drawn = if config.low_level.frozen {
            None
        } else {
            draw_episodes(replay, sample.windows, generator, |_| true)
        };
        if let Some(drawn) = drawn {
            let ReturnsConfig { shaping, discount, .. } = config.low_level.returns;
            let shaped = SampleShape { shaping, discount, ..*sample };
            let windows = cut_windows(environment, replay, &drawn, shaped, generator);
            let report = self.low_level.learn(&windows, *threads, generator);
            let report = UpdateReport { loss: report.loss, gradient_norm: report.gradient_norm };
            reports.agents.push(report);
        }
        let Some(allocation) = &mut self.allocation else { return };
        let added = |episode: Episode| replay.steps.note(episode.first).added;
        let recent = |episode| now - added(episode) <= config.allocation.oldest;
        let drawn = draw_episodes(replay, sample.windows, generator, recent);
        if let Some(drawn) = drawn {
            let windows = cut_windows(environment, replay, &drawn, *sample, generator);
            if let Some(report) = allocation.learn(&windows, now, generator, *threads) {
                let (loss, gradient_norm) = (report.critic_loss, report.critic_norm);
                reports.allocator.push(UpdateReport { loss, gradient_norm });
            }
        }
    }

    /// Renews target networks whose time has come.
    fn copy_targets(&mut self) {
        let learning = &self.config.learning;
        let Episodes { played, agents_copied, critic_copied } = &mut self.episodes;
        if *played >= *agents_copied + learning.copy_agents_every {
            *agents_copied = *played;
            self.low_level.copy_target();
        }
        if *played >= *critic_copied + learning.copy_critic_every {
            *critic_copied = *played;
            self.allocation.iter_mut().for_each(AllocationLevel::copy_target);
        }
    }

    /// The agents, and what they are allocated by if the run learns that: the critic's best of as many proposals as in
    /// training, of which the first is what the policy holds most probable.
    fn allocated(&self) -> Subtasks<'_> {
        let Config { low_level, allocation, .. } = &self.config;
        let agents = NetworkAgents::new(self.low_level.players(), low_level.conditioning);
        let allocator = self.allocation.as_ref().map(|level| {
            let networks = level.networks();
            let mut proposing = ProposalAllocator::new(networks, allocation.proposals);
            proposing.greedy_first = true;
            let write = move |contract| {
                let AllocationNetworks { policy, critic } = networks;
                let graphs = export_proposals(policy, critic, contract);
                graphs.map(|ProposalGraphs { trunk, step, critic }| [trunk, step, critic])
            };
            LearnedAllocator {
                allocate: Box::new(proposing),
                networks: AllocatorNetworks::Proposals(Box::new(write)),
                team_max: None,
            }
        });
        Subtasks {
            agents: Box::new(agents),
            are_seen: low_level.conditioning.has_subtasks(),
            interval: allocation.interval,
            allocator,
        }
    }

    /// Who allocates: where a team is measured, or while so much is tried out.
    fn allocator<'a>(
        config: &'a Config,
        learned: Option<&'a AllocationLevel>,
        exploration: Option<Exploration>,
    ) -> Box<dyn Allocate + 'a> {
        match (config.rule(), learned) {
            (Some(rule), _) => Box::new(RuleAllocator(rule)),
            (None, Some(level)) => {
                let proposals = config.allocation.proposals;
                let mut own = ProposalAllocator::new(level.networks(), proposals);
                own.exploration = exploration;
                Box::new(own)
            }
            (None, None) => Box::new(NoSubtasks),
        }
    }
}

impl Method for WindowLearner {
    /// As in the public code.
    fn waits(&self) -> bool {
        true
    }

    fn act(&mut self, ask: Ask<'_>, now: Now) -> Result<(), LearnError> {
        let Ask { scenes, random, actions } = ask;
        let Self { config, low_level, allocation, places, players, .. } = self;
        let exploration = config.exploration.at(now.env_steps);
        let mut allocator = Self::allocator(config, allocation.as_ref(), Some(exploration));
        let agents = low_level.players();
        let mut advice = agents.coach.map(Advice::new);
        let decides = low_level.config.conditioning.has_subtasks() || advice.is_some();
        for scene in scenes.scenes {
            let place = places.look(scenes.environment, scene);
            if scene.begins {
                self.began = now.env_steps;
            }
            if !place.is_due {
                continue;
            }
            let (environment, state) = (scenes.environment, scene.state);
            let (random, allocation) = (&mut random[scene.instance], &mut place.allocation[..]);
            allocator.allocate(ToAllocate { environment, state, random, allocation })?;
            if let Some(advice) = &mut advice {
                advice.draw(&place.seen, random, &mut place.strategies);
            }
            self.decisions += u64::from(decides);
        }
        let explores = |_| exploration.actions;
        players.explore(agents, &places.scenes(scenes), random, (explores, false), actions)?;
        places.note(scenes, actions);
        Ok(())
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        let place = self.places.of(transition.instance);
        let note = Note { decision: place.is_due, added: self.began };
        self.replay.push(transition, &place.allocation, note);
        Ok(())
    }

    /// As many updates of each level as episodes were played.
    fn update(&mut self, environment: &dyn Environment, now: Now) -> Result<Reports, LearnError> {
        let decisions = std::mem::take(&mut self.decisions);
        let mut reports = Reports { decisions, ..Reports::default() };
        let instances = self.config.environment.instances;
        for _ in 0..instances {
            (0..self.config.learning.updates)
                .for_each(|_| self.update_once(environment, now.env_steps, &mut reports));
            self.copy_targets();
        }
        self.episodes.played += instances as u64;
        Ok(reports)
    }

    fn rates(&self, now: Now) -> Rates {
        Rates {
            epsilon: self.config.exploration.at(now.env_steps).actions,
            learning_rate: self.config.low_level.learning_rate,
        }
    }

    fn team(&self) -> Box<dyn Act + '_> {
        Box::new(self.allocated().under(Self::allocator(
            &self.config,
            self.allocation.as_ref(),
            None,
        )))
    }

    fn subtasks(&self) -> Option<Subtasks<'_>> {
        Some(self.allocated())
    }

    fn deployed(&self) -> Result<DeployedAgents<'_>, LearnError> {
        export::deployed(self.low_level.players(), self.config.low_level.conditioning)
    }

    fn words(&self) -> Words {
        let allocator = match &self.allocation {
            None => "",
            Some(_) => {
                "The allocator is a policy that proposes allocations, and a critic that values them and takes the best\n\
                 (dissertation section 7.2).\n\n"
            }
        };
        let mut departures = export::skips(self.low_level.shape(), None);
        departures += if departures.is_empty() { "- Nowhere but in" } else { "- In" };
        departures += " the sampled windows: none learns a step from one episode to the next.\n";
        export::words(allocator.to_owned(), departures)
    }

    fn allocation(&self) -> &str {
        self.config.measured_allocation()
    }

    /// Begins with the agents of another run, of any preset.
    fn take_over(&mut self, folder: &Path) -> Result<(), LearnError> {
        let learned = Learned::open(folder, &self.spec)?;
        let (shape, memory) = (self.low_level.shape(), self.low_level.part("memory"));
        let Learned { network, memory_unit, .. } = &learned;
        if (network.shape, memory_unit.len()) != (shape, memory.len()) {
            let hint = shape.hint_to_become(network.shape, "low_level.skip");
            let reason = format!("`run.from` has agents of another shape{hint}");
            return Err(LearnError::Config(reason));
        }
        let LowLevel { online, target, .. } = &mut self.low_level;
        for values in [&mut online.values, target] {
            values[..network.parameters.len()].copy_from_slice(&network.parameters);
            values[memory.clone()].copy_from_slice(memory_unit);
        }
        Ok(())
    }

    /// Between two rounds no episode runs, so that instances remember nothing.
    fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        low_level_state(&mut self.low_level, state)?;
        if let Some(level) = &mut self.allocation {
            allocation_state(level, state)?;
        }
        state.value("episodes", &mut self.episodes)?;
        state.value("generator", &mut self.generator)?;
        self.replay.visit(state)
    }
}

/// Names the networks of agents, mixer and coach with what the optimiser keeps.
fn low_level_state(level: &mut LowLevel, state: &mut State<'_>) -> Result<(), LearnError> {
    let tensors = level.shape().tensors();
    let [memory, mixer, coach, recognition] =
        ["memory", "mixer", "coach", "recognition"].map(|name| level.part(name));
    let LowLevel { online, target, optimiser, popart, target_popart, .. } = level;
    let (online, square) = (&mut online.values, &mut optimiser.square);
    for (name, values, popart) in
        [("online", &mut *online, popart), ("target", &mut *target, target_popart)]
    {
        state.tensors(&format!("agents/{name}"), &tensors, values)?;
        visit_part(state, &format!("mixer/{name}"), values, &mixer)?;
        visit_part(state, &format!("memory/{name}"), values, &memory)?;
        state.value(&format!("mixer/{name}-statistics"), popart)?;
    }
    state.tensors("agents/square", &tensors, square)?;
    visit_part(state, "mixer/square", square, &mixer)?;
    visit_part(state, "memory/square", square, &memory)?;
    visit_part(state, "coach/online", online, &coach)?;
    visit_part(state, "coach/target", target, &coach)?;
    visit_part(state, "coach/square", square, &coach)?;
    visit_part(state, "recognition/online", online, &recognition)?;
    visit_part(state, "recognition/square", square, &recognition)
}

/// Names a part of a vector, if there is one.
fn visit_part(
    state: &mut State<'_>,
    name: &str,
    values: &mut [f32],
    part: &Range<usize>,
) -> Result<(), LearnError> {
    if part.is_empty() { Ok(()) } else { state.vector(name, &mut values[part.clone()]) }
}

/// The same of critic and policy.
fn allocation_state(level: &mut AllocationLevel, state: &mut State<'_>) -> Result<(), LearnError> {
    let AllocationLevel { critic, target, policy, optimisers, .. } = level;
    let [of_critic, of_policy] = optimisers;
    state.vector("critic/online", &mut critic.parameters.values)?;
    state.vector("critic/target", &mut target.parameters.values)?;
    state.vector("critic/square", &mut of_critic.square)?;
    state.vector("policy/online", &mut policy.parameters.values)?;
    state.vector("policy/square", &mut of_policy.square)?;
    state.value("critic/online-statistics", &mut critic.popart)?;
    state.value("critic/target-statistics", &mut target.popart)
}

#[cfg(test)]
mod tests;
