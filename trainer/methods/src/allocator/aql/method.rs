//! Amortised Q-learning as a [`Method`].

use std::sync::Mutex;

use sortie_envs::random::{chance, member};
use sortie_envs::{Environment, Random, Spec, UNASSIGNED};
use sortie_learn::export::DeployedAgents;
use sortie_learn::learner::{Loss, Rules};
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{Rates, Reports};
use sortie_learn::session::Opening;
use sortie_learn::subtasks::{Allocate, AllocatedTeam, ScriptedAgents, Subtasks, ToAllocate};
use sortie_learn::trajectory::{Capacity, Widths};
use sortie_learn::{Act, Ask, LearnError, Learner, Method, Now, State, Trajectories, Transition};
use sortie_nn::lanes::in_lanes;

use super::Config;
use super::proposer::{Lesson, Networks, Proposer, Teachers};
use crate::allocator::deciding::{Asked, Seen};
use crate::allocator::method::loss;
use crate::allocator::network::{Critic, Network};
use crate::allocator::scripted;

const NOT_DEPLOYED: &str = "what proposes and its critic are measured only; `sortie train allocator` without \
    `--preset paper` learns an allocator that is deployed";

/// A policy that proposes, its critic, and the episodes that both learn from.
pub(in crate::allocator) struct Aql {
    config: Config,
    network: Network,
    proposing: Learner<()>,
    pub(super) critic: Critic,
    pub(super) valuing: Learner<()>,
    /// Of every step what agents were given.
    pub(super) replay: Trajectories<Vec<u8>>,
    /// Draws episodes to learn from.
    random: Random,
    proposers: Vec<Proposer>,
    pub(super) lessons: Vec<Lesson>,
    /// `[instances, A]`: the allocations in force.
    in_force: Vec<Vec<u8>>,
    /// Episodes that were over when the last updates were made.
    learned: u64,
    threads: usize,
}

impl Aql {
    /// Draws the first weights.
    ///
    /// # Errors
    /// Sizes do not fit each other.
    pub(in crate::allocator) fn new(
        config: Config,
        opening: &Opening<'_>,
    ) -> Result<Self, LearnError> {
        let Opening { setup, environment, seed, threads } = *opening;
        let (spec, instances) = (environment.spec(), setup.environment.instances);
        let columns = [spec.fixed, spec.shape.features];
        let drawn = |number| generator(seed, Purpose::Weights, number);
        let (network, weights) = Network::new(&config.network, columns, &mut drawn(0))?;
        let (critic, values) = Critic::new(&config.network, columns, &mut drawn(1))?;
        let rules = Rules::from(&config.optimiser);
        let widths = Widths { agents: spec.shape.agents, ..Widths::default() };
        let lesson = |number: usize| {
            Lesson::new(environment, generator(seed, Purpose::Proposals, number as u64))
        };
        Ok(Self {
            network,
            proposing: Learner::new(weights, rules, threads),
            critic,
            valuing: Learner::new(values, rules, threads),
            replay: Trajectories::noting(
                Capacity::Episodes(config.replay.capacity),
                instances,
                widths,
            ),
            random: generator(seed, Purpose::Replay, 0),
            proposers: (0..instances).map(|_| Proposer::new(environment)).collect(),
            lessons: (0..config.replay.batch).map(lesson).collect(),
            in_force: vec![vec![UNASSIGNED; spec.shape.agents]; instances],
            learned: 0,
            threads,
            config,
        })
    }

    /// Both networks, by the weights that learn.
    pub(super) fn networks(&self) -> Networks<'_> {
        Networks {
            proposing: (&self.network, &self.proposing.online.values),
            critic: (&self.critic, &self.valuing.online.values),
            input: self.config.critic.input,
        }
    }

    /// The allocator as it is measured.
    fn best(&self) -> BestProposal<'_> {
        let networks = Networks {
            proposing: (&self.network, &self.proposing.average),
            critic: (&self.critic, &self.valuing.average),
            input: self.config.critic.input,
        };
        BestProposal { networks, count: self.config.proposals.count, proposer: None }
    }

    /// Learns once from a batch of episodes.
    fn learn(
        &mut self,
        environment: &dyn Environment,
        rate: f32,
        reports: &mut Reports,
    ) -> Result<(), LearnError> {
        let mut episodes = Vec::new();
        self.replay.draw_episodes(self.config.replay.batch, &mut self.random, &mut episodes);
        let mut lessons = std::mem::take(&mut self.lessons);
        let teachers = Teachers {
            networks: self.networks(),
            target: &self.valuing.target,
            learns: self.config.critic.target,
            count: self.config.proposals.count,
        };
        let failed = Mutex::new(Ok(()));
        in_lanes(self.threads, &mut lessons, |number, lesson| {
            let episode = (&self.replay, episodes[number]);
            let prepared = lesson.prepare(environment, teachers, episode);
            if let (Err(error), Ok(mut failed)) = (prepared, failed.lock()) {
                *failed = Err(error);
            }
        });
        self.lessons = lessons;
        failed.into_inner().unwrap_or(Ok(()))?;

        let Self { lessons, network, critic, proposing, valuing, config, .. } = self;
        let situations = lessons.iter().map(|lesson| lesson.targets.len()).sum::<usize>().max(1);
        reports.allocator.push(valuing.update(lessons.len(), rate, |shard| {
            let lesson = &lessons[shard.number];
            let pass = &mut shard.pass;
            if lesson.targets.is_empty() {
                return Loss::of(pass, |pass| pass.input(1, &[0.0]));
            }
            let tables = critic.network.encode(pass, &lesson.taken.subtasks.rows);
            let values = critic.values(pass, tables, &lesson.taken.made);
            Loss::mean_square(pass, values, &lesson.targets, situations)
        }));
        let decisions = lessons.iter().map(|lesson| lesson.best.made.len()).sum::<usize>().max(1);
        let (entropy, share) = (config.proposals.entropy, 1.0 / decisions as f32);
        reports.agents.push(proposing.update(lessons.len(), rate, |shard| {
            let best = &lessons[shard.number].best;
            if best.made.len() == 0 {
                return Loss::of(&mut shard.pass, |pass| pass.input(1, &[0.0]));
            }
            loss(&mut shard.pass, network, best, &[1.0], (entropy, share))
        }));
        Ok(())
    }
}

impl Method for Aql {
    fn waits(&self) -> bool {
        true
    }

    fn act(&mut self, ask: Ask<'_>, now: Now) -> Result<(), LearnError> {
        let Ask { scenes, random, actions } = ask;
        let environment = scenes.environment;
        let team = environment.spec().shape.agents;
        let epsilon = self.config.exploration.epsilon_at(now.env_steps);
        let mut proposers = std::mem::take(&mut self.proposers);
        let mut in_force = std::mem::take(&mut self.in_force);
        let (networks, count) = (self.networks(), self.config.proposals.count);
        let mut lanes: Vec<_> =
            proposers.iter_mut().zip(&mut in_force).zip(random).map(|lane| (lane, None)).collect();
        for (scene, actions) in scenes.scenes.iter().zip(actions.chunks_exact_mut(team)) {
            lanes[scene.instance].1 = Some((scene, actions, Ok(())));
        }
        in_lanes(self.threads, &mut lanes, |_, (((proposer, in_force), random), scene)| {
            let Some((scene, actions, done)) = scene else { return };
            if scene.begins {
                in_force.fill(UNASSIGNED);
                // Between episodes the weights change.
                proposer.forget();
            }
            let asked = [Asked { episode: 0, state: scene.state, before: in_force }];
            let given = if chance(random, epsilon.into()) {
                let seen = Seen { environment, turn: 0, states: &asked };
                let any = |_: &[f32], offered| member(random, offered).unwrap_or(0);
                proposer.proposing.allocate(networks.proposing, seen, any).pop()
            } else {
                let best = proposer.best(networks, &asked, count, random);
                *done =
                    best.as_ref().map(drop).map_err(|error| LearnError::Team(error.to_string()));
                best.ok().and_then(|mut best| best.pop()).map(|best| best.allocation)
            };
            if let Some(given) = given {
                environment.scripted(scene.state, &given, random, actions);
                **in_force = given;
            }
        });
        let failed = lanes.into_iter().filter_map(|lane| lane.1).find_map(|scene| scene.2.err());
        (self.proposers, self.in_force) = (proposers, in_force);
        failed.map_or(Ok(()), Err)
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        let given = self.in_force[transition.instance].clone();
        self.replay.push_noted(transition, given);
        Ok(())
    }

    fn update(&mut self, environment: &dyn Environment, now: Now) -> Result<Reports, LearnError> {
        let (mut reports, round) = (Reports::default(), self.in_force.len());
        let is_over = self.replay.finished() >= self.learned + round as u64;
        if !is_over || self.replay.episodes() < self.config.replay.batch {
            return Ok(reports);
        }
        self.learned = self.replay.finished();
        reports.decisions = self.replay.latest(round).map(|episode| episode.steps as u64).sum();
        let rate = self.config.optimiser.learning_rate_at(now.env_steps, now.of);
        for _ in 0..self.config.replay.updates {
            self.learn(environment, rate, &mut reports)?;
        }
        Ok(reports)
    }

    fn rates(&self, now: Now) -> Rates {
        let epsilon = self.config.exploration.epsilon_at(now.env_steps);
        let learning_rate = self.config.optimiser.learning_rate_at(now.env_steps, now.of);
        Rates { epsilon, learning_rate }
    }

    fn team(&self) -> Box<dyn Act + '_> {
        Box::new(AllocatedTeam::new(Box::new(ScriptedAgents::new(0)), Box::new(self.best()), 1))
    }

    fn subtasks(&self) -> Option<Subtasks<'_>> {
        // The graphs of what proposes; nothing asks for them, as the agents are not deployed.
        Some(scripted(self.best(), (&self.network, &self.proposing.average)))
    }

    fn deployed(&self) -> Result<DeployedAgents<'_>, LearnError> {
        Err(LearnError::Config(NOT_DEPLOYED.to_owned()))
    }

    fn allocation(&self) -> &str {
        "learned"
    }

    fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        self.proposing.state_as(state, |part| format!("proposals/{part}"))?;
        self.valuing.state_as(state, |part| format!("critic/{part}"))?;
        state.value("random", &mut self.random)?;
        state.value("learned", &mut self.learned)?;
        let random = self.lessons.iter().map(|lesson| lesson.random.clone());
        let mut random: Vec<Random> = random.collect();
        state.value("proposals/random", &mut random)?;
        self.lessons.iter_mut().zip(random).for_each(|(lesson, random)| lesson.random = random);
        self.replay.visit(state)
    }
}

/// The best of what is proposed.
struct BestProposal<'a> {
    networks: Networks<'a>,
    count: usize,
    proposer: Option<Proposer>,
}

impl Allocate for BestProposal<'_> {
    fn allocate(&mut self, to_allocate: ToAllocate<'_>) -> Result<(), LearnError> {
        let ToAllocate { environment, state, random, allocation } = to_allocate;
        let proposer = self.proposer.get_or_insert_with(|| Proposer::new(environment));
        let asked = [Asked { episode: 0, state, before: allocation }];
        let best = proposer.best(self.networks, &asked, self.count, random)?;
        best.iter().for_each(|best| allocation.copy_from_slice(&best.allocation));
        Ok(())
    }

    fn choose_among(&mut self, proposals: Option<usize>, _: &Spec) -> bool {
        self.count = proposals.unwrap_or(self.count);
        true
    }
}
