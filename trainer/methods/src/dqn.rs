//! A deep Q-network without goals (Mnih et al. 2015): what HAL is compared with (Rainbow of dissertation chapter 6).
//!
//! It learns the values of actions alone, and is paid for what it reaches.

#[cfg(test)]
mod tests;

use sortie_envs::random::chance;
use sortie_envs::{Environment, Random};
use sortie_learn::configuration::Range::{Numbers, OneOf, Truth, Whole};
use sortie_learn::configuration::{OPTIMISER, OptimiserConfig, SHARE};
use sortie_learn::learner::Rules;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{Rates, Reports};
use sortie_learn::session::{MethodEntry, Opening, Preset, Setup};
use sortie_learn::trajectory::{End, Place};
use sortie_learn::{Act, Ask, LearnError, Method, Now, State, Transition, sections};
use sortie_nn::schedule::linear;

use crate::options::{
    self, Actors, Chances, Lesson, Lessons, NONE, Next, Note, Paid, QNetwork, REPLAY, Recorder,
    Replay, ReturnRules, WEIGHTS, fast_optimiser, fast_setup, learned_as, misfit, paper_optimiser,
    paper_setup, returns, shown,
};
use crate::pictures::{Heads, NetworkShape, Shown};

pub use crate::options::{Measured, ReplayConfig, WeightsConfig};
pub use crate::pictures::Body;

sections! {
    /// Sizes, chances and rates; the default is the preset `fast`.
    Config, KEYS;

    /// What the network is shown, and how wide it is.
    network: NetworkConfig {
        /// Two layers over sparse inputs, or convolutions over the picture as published.
        body: Body = Body::Layers, OneOf(Body::WORDS);
        /// Cells around the agent, each way across, that are shown one by one; odd.
        crop: usize = 5, Whole(1, 15), "cells";
        /// Whether the nearest cell of every kind is shown.
        nearest: bool = true, Truth;
        /// Width of the hidden layers, a multiple of 8.
        width: usize = 64, Whole(8, 1024), "columns";
        /// Inputs that differ from zero, which the first weights are sized for.
        active_inputs: usize = 30, Whole(1, 4096), "columns";
    }

    /// What is paid for, and how it becomes targets.
    returns: ReturnsConfig {
        /// Whether every milestone is paid for when an episode first reaches it, all of them together 1; the task alone, 1,
        /// otherwise.
        milestones: bool = true, Truth;
        /// Steps before a target bootstraps.
        steps: u8 = 3, Whole(1, 254), "steps";
        /// Worth of a reward one step later.
        discount: f32 = 0.97, SHARE, "factor per step";
        /// What a step costs.
        cost: f32 = 0.0, SHARE, "reward";
        /// Whether rewards are learned as `sign(r) log2(1 + abs(r))`.
        logarithm: bool = false, Truth;
        /// Whether values that are looked up are held between 0 and 1.
        bounded: bool = true, Truth;
        /// Whether steps behind which time was over, or nothing could be reached any more, are learned from.
        time_outs: bool = true, Truth;
        /// From one copy of the weights to those that targets are computed by to the next; 0 moves these by
        /// `optimiser.target_rate` in every update.
        target_every: u64 = 0, Whole(0, 20_000_000), "updates";
        /// Whether actions that change nothing are worth nothing.
        no_operations: bool = true, Truth;
        /// Whether states are shown left for right half of the time.
        mirror: bool = true, Truth;
    }

    /// How much is tried out.
    exploration: ExplorationConfig {
        /// In which all actions are drawn.
        first: u64 = 6_400, Whole(0, 20_000_000), "environment steps";
        /// Over which the chance changes.
        share: f64 = 0.8, SHARE, "share of the run";
        /// Of a random action: from the first chance to the second in a straight line.
        actions: [f32; 2] = [0.5, 0.05], Numbers(0.0, 1.0), "probability";
    }

    /// How much of chance is left where agents are measured.
    measured: MeasuredConfig {
        /// Of a random action.
        actions: f32 = 0.05, SHARE, "probability";
        /// Whether a view that is met again since the last milestone is answered by the next best action.
        varied: bool = true, Truth;
    }

    /// What is kept, and how much of it an update sees.
    replay: ReplayConfig = ReplayConfig::default(), REPLAY;
    /// What keeps weights small.
    weights: WeightsConfig = WeightsConfig::default(), WEIGHTS;
    /// How the weights follow the gradient.
    optimiser: OptimiserConfig = OptimiserConfig::default(), OPTIMISER;
}

impl MeasuredConfig {
    fn chances(&self) -> Chances<'static> {
        let Self { actions, varied } = *self;
        Chances { actions, goals: 0.0, afforded: 0.0, reached: &[], varied }
    }
}

impl ExplorationConfig {
    /// The chance of a random action.
    fn actions_at(&self, now: Now) -> f32 {
        let ([start, end], over) = (self.actions, self.share * now.of as f64);
        if now.env_steps < self.first {
            1.0
        } else {
            linear(start, end, over as u64, now.env_steps)
        }
    }
}

impl ReturnsConfig {
    fn rules(&self) -> ReturnRules {
        let Self { steps, discount, no_operations, time_outs, .. } = *self;
        ReturnRules { steps, discount, no_operations, time_outs }
    }

    /// What a step earns that is paid for, where there are so many milestones, and what any other does.
    fn rewards(&self, milestones: usize) -> [f32; 2] {
        let pay = if self.milestones { 1.0 / milestones as f32 } else { 1.0 };
        [pay - self.cost, -self.cost].map(|reward| learned_as(reward, self.logarithm))
    }

    /// What steps are: episodes go on until the last of so many milestones, the task, or until nothing can be reached.
    fn paid(&self, milestones: usize) -> impl Fn(&Note, End) -> Paid + use<> {
        let ([paid, other], all) = (self.rewards(milestones), self.milestones);
        move |note, end| {
            let is_task = usize::from(note.reached) + 1 == milestones;
            let is_last = end != End::Open;
            let is_paid = if all { note.is_first } else { is_task };
            let reward = if is_paid { paid } else { other };
            Paid { reward, is_last, is_over: is_last && is_task }
        }
    }
}

impl Config {
    /// The published settings of the iron task (dissertation chapter 6 and the public code).
    fn paper() -> Self {
        let (replay, optimiser) = (ReplayConfig::paper(), paper_optimiser());
        let mut paper = Self { replay, optimiser, ..Self::default() };
        let Self { network, returns, .. } = &mut paper;
        (network.body, network.crop, network.nearest) = (Body::Convolution, 11, false);
        network.width = 512;
        (returns.steps, returns.discount, returns.cost) = (10, 0.99, 0.01);
        (returns.logarithm, returns.bounded, returns.time_outs) = (true, false, false);
        (returns.no_operations, returns.mirror) = (false, false);
        returns.target_every = 10_000;
        paper.exploration.first = 400;
        paper.measured.varied = false;
        paper.weights.decay = 1e-5;
        paper
    }
}

/// An agent without goals.
pub const DQN: MethodEntry = MethodEntry {
    name: "dqn",
    about: "An agent without goals that is paid for the milestones it reaches (Rainbow in dissertation chapter 6)",
    keys: |_| KEYS,
    presets: &[Preset { name: "fast", setup: fast }, Preset { name: "paper", setup: paper }],
    flags: &[],
    compared_with: None,
    in_proportion: &[],
    suit: |_, _, _| {},
    settle_older: |_| {},
    misfit,
    open,
};

fn fast() -> Setup {
    fast_setup(&Config { optimiser: fast_optimiser(), ..Config::default() })
}

fn paper() -> Setup {
    paper_setup(&Config::paper())
}

fn open(opening: &Opening<'_>) -> Result<Box<dyn Method>, LearnError> {
    Ok(Box::new(Dqn::new(opening.setup.own()?, opening)?))
}

/// Steps of a stretch that reaches no milestone: as many as an option of HAL has.
const STRETCH: u8 = 51;

/// An agent that learns what actions are worth to it.
#[derive(Debug)]
pub struct Dqn {
    config: Config,
    shown: Shown,
    agent: QNetwork,
    recorder: Recorder,
    milestones: usize,
    /// Draws what updates learn from.
    random: Random,
}

impl Dqn {
    /// Draws the first weights.
    ///
    /// # Errors
    /// The environment shows no picture that fits, there can be no such network, or too little is kept.
    pub fn new(config: Config, opening: &Opening<'_>) -> Result<Self, LearnError> {
        let Opening { setup, environment, seed, .. } = *opening;
        let (spec, instances) = (environment.spec(), setup.environment.instances);
        let NetworkConfig { body, crop, nearest, width, active_inputs: active } = config.network;
        let shown = shown(spec, body, (crop, nearest), &[("width", width)])?;
        let heads = Heads { goals: 1, actions: spec.shape.actions, dueling: true };
        let (picture, columns) = (shown.shape(), shown.columns());
        let shape = NetworkShape { body, picture, columns, active, width, heads };
        let rules = options::rules(&config.optimiser, &config.weights);
        let rules = match config.returns.target_every {
            0 => rules,
            target_every => Rules { target_every, target_rate: 1.0, ..rules },
        };
        let (kept, milestones) = (config.replay.kept(instances, STRETCH)?, spec.milestones.len());
        let replay = Replay::new(instances, kept, milestones);
        Ok(Self {
            agent: QNetwork::new(shape, rules, &mut generator(seed, Purpose::Weights, 0)),
            recorder: Recorder::new(instances, replay.by_priority(config.replay.priorities, 1)),
            random: generator(seed, Purpose::Replay, 0),
            shown,
            milestones,
            config,
        })
    }

    fn actors(&self, averaged: bool) -> Actors<'_> {
        let controller = self.agent.weights(averaged);
        Actors { option_steps: STRETCH, shown: &self.shown, controller, chooser: None }
    }

    /// The agent with so much of chance left.
    pub fn measured(&self, chances: MeasuredConfig) -> Measured<'_> {
        Measured::new(self.actors(true), chances.chances())
    }

    /// What a step earned, and where a value is looked up behind it; none where that is not learned from.
    fn returns(&self, state: Place) -> Option<(f32, Option<Next>)> {
        let config = &self.config.returns;
        returns(&self.recorder.replay, state, config.rules(), config.paid(self.milestones))
    }

    /// A step to learn from; none where it is none to begin with.
    fn draw(&mut self, environment: &dyn Environment) -> Option<Lesson> {
        let reached = self.config.replay.reached;
        let (state, priority) = self.recorder.replay.draw(reached, &mut self.random);
        let (earned, next) = self.returns(state)?;
        let is_mirrored = self.config.returns.mirror && chance(&mut self.random, 0.5);
        let action = self.recorder.replay.steps.actions(state)[0];
        let action = environment.turned_action(is_mirrored.into(), action).into();
        let goals = [(0, earned), (NONE, 0.0)];
        Some(Lesson { state, is_mirrored, action, goals, next, priority })
    }

    /// Makes an update.
    fn learn(&mut self, environment: &dyn Environment, now: Now, reports: &mut Reports) {
        let mut lessons = Vec::new();
        while lessons.len() < self.config.replay.batch {
            lessons.extend(self.draw(environment));
        }
        let Self { config, agent, recorder, shown, .. } = self;
        let (exponent, bounded) = (config.replay.importance_at(now), config.returns.bounded);
        let replay = &mut recorder.replay;
        let batch = Lessons { lessons: &lessons, replay, shown, exponent, bounded };
        let rate = config.optimiser.learning_rate_at(now.env_steps, now.of);
        reports.agents.push(agent.update(batch, rate));
        let drawn = lessons.iter().map(|lesson| lesson.state);
        replay.correct_steps(drawn.zip(agent.errors().iter().copied()));
    }
}

impl Method for Dqn {
    fn act(&mut self, ask: Ask<'_>, now: Now) -> Result<(), LearnError> {
        let Ask { scenes, random, actions } = ask;
        let mut player = std::mem::take(&mut self.recorder.player);
        let epsilon = self.config.exploration.actions_at(now);
        let chances = MeasuredConfig { actions: epsilon, varied: false }.chances();
        player.act(self.actors(false), scenes, chances, random, actions);
        self.recorder.player = player;
        Ok(())
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        self.recorder.record(transition, &self.shown, STRETCH);
        Ok(())
    }

    fn update(&mut self, environment: &dyn Environment, now: Now) -> Result<Reports, LearnError> {
        let due = self.config.replay.due(self.config.exploration.first, now);
        let mut reports = Reports::default();
        while self.agent.learner.updates() < due {
            self.learn(environment, now, &mut reports);
        }
        Ok(reports)
    }

    fn rates(&self, now: Now) -> Rates {
        let epsilon = self.config.exploration.actions_at(now);
        let learning_rate = self.config.optimiser.learning_rate_at(now.env_steps, now.of);
        Rates { epsilon, learning_rate }
    }

    fn team(&self) -> Box<dyn Act + '_> {
        Box::new(self.measured(self.config.measured.clone()))
    }

    fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        self.agent.learner.state_as(state, |part| format!("agent/{part}"))?;
        self.recorder.state(state)?;
        state.value("random", &mut self.random)
    }
}
