//! The agent without goals as a [`Method`].

#[cfg(test)]
mod tests;

use sortie_envs::random::chance;
use sortie_envs::{Environment, Random};
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{Rates, Reports};
use sortie_learn::session::Opening;
use sortie_learn::{Act, LearnError, Method, Now, Scenes, State, Transition};

use super::returns::{PayRules, returns};
use super::{Config, MeasuredConfig, NetworkConfig};
use crate::options::{
    Actors, Lesson, Memory, NONE, Place, Player, Recorder, Replay, descend, shown,
};
use crate::pictures::{Heads, Learner, NetworkShape, Shown};

/// Steps of a stretch that reaches no milestone: as many as an option of HAL has.
const STRETCH: u8 = 51;

/// An agent that learns what actions are worth to it.
#[derive(Debug)]
pub struct Dqn {
    config: Config,
    shown: Shown,
    heads: Heads,
    rules: PayRules,
    learner: Learner,
    recorder: Recorder,
    /// Draws what updates learn from.
    random: Random,
    updates: u64,
    memory: Memory<Place>,
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
        let (picture, columns, outputs) = (shown.shape(), shown.columns(), heads.outputs());
        let shape = NetworkShape { body, picture, columns, active, width, outputs };
        let mut random = generator(seed, Purpose::Weights, 0);
        let (kept, milestones) = (config.replay.kept(instances, STRETCH)?, spec.milestones.len());
        let replay = Replay::new(instances, kept, shown.bytes(), milestones);
        let replay = match config.replay.priorities {
            0.0 => replay,
            exponent => replay.by_priority(exponent, 1),
        };
        Ok(Self {
            rules: config.returns.rules(milestones),
            learner: Learner::new(shape, &config.optimiser, &mut random),
            recorder: Recorder::new(instances, replay),
            random: generator(seed, Purpose::Replay, 0),
            updates: 0,
            memory: Memory::default(),
            shown,
            heads,
            config,
        })
    }

    fn actors<'a>(&'a self, weights: &'a [f32]) -> Actors<'a> {
        Actors {
            option_steps: STRETCH,
            shown: &self.shown,
            heads: self.heads,
            controller: (&self.learner.network, weights),
            chooser: None,
        }
    }

    /// The agent with so much of chance left.
    pub fn measured(&self, chances: MeasuredConfig) -> Measured<'_> {
        let actors = self.actors(&self.learner.average);
        Measured { actors, chances, player: Player::default() }
    }

    /// A step to learn from; none where it is none to begin with.
    fn draw(&mut self, environment: &dyn Environment) -> Option<Lesson<Place>> {
        let (replay, random) = (&self.recorder.replay, &mut self.random);
        let (state, priority) = replay.draw(self.config.replay.reached, random);
        let (earned, next) = returns(replay, state, self.rules)?;
        let is_mirrored = self.config.returns.mirror && chance(random, 0.5);
        let action = replay.moment(state).action.into();
        let action = environment.turned_action(is_mirrored.into(), action).into();
        let goals = [(0, earned), (NONE, 0.0)];
        Some(Lesson { drawn: state, priority, state, is_mirrored, action, goals, next })
    }

    fn learn(&mut self, environment: &dyn Environment, now: Now, reports: &mut Reports) {
        self.updates += 1;
        self.memory.lessons.clear();
        while self.memory.lessons.len() < self.config.replay.batch {
            let lesson = self.draw(environment);
            self.memory.lessons.extend(lesson);
        }
        let Config { returns, replay: sizes, optimiser, weights, .. } = &self.config;
        let (replay, learner) = (&mut self.recorder.replay, &mut self.learner);
        let (settings, kept) =
            ((sizes.importance_at(now), returns.bounded), (&*replay, &self.shown));
        let loss = descend(learner, self.heads, settings, kept, &mut self.memory);
        replay.correct_steps(self.memory.corrections());
        let rate = optimiser.learning_rate_at(now.env_steps, now.of);
        reports.agents.push(learner.step(optimiser, rate, weights.decay, loss));
        if returns.target_every > 0 && self.updates.is_multiple_of(returns.target_every) {
            learner.copy_to_target();
        }
    }
}

impl Method for Dqn {
    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        now: Now,
        random: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        let mut player = std::mem::take(&mut self.recorder.player);
        let actions_chance = self.config.exploration.actions_at(now);
        let chances = MeasuredConfig { actions: actions_chance, varied: false }.chances();
        player.act(self.actors(&self.learner.online), scenes, chances, random, actions);
        self.recorder.player = player;
        Ok(())
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        self.recorder.record(transition, &self.shown, STRETCH);
        Ok(())
    }

    fn update(
        &mut self,
        environment: &dyn Environment,
        now: Now,
        reports: &mut Reports,
    ) -> Result<(), LearnError> {
        let due = self.config.replay.due(self.config.exploration.first, now);
        while self.updates < due {
            self.learn(environment, now, reports);
        }
        Ok(())
    }

    fn rates(&self, now: Now) -> Rates {
        Rates {
            epsilon: self.config.exploration.actions_at(now),
            learning_rate: self.config.optimiser.learning_rate_at(now.env_steps, now.of),
        }
    }

    fn team(&self) -> Box<dyn Act + '_> {
        Box::new(self.measured(self.config.measured.clone()))
    }

    fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        self.learner.state(state, "agent")?;
        self.recorder.state(state)?;
        state.value("random", &mut self.random)?;
        state.value("updates", &mut self.updates)
    }
}

/// An agent that is measured.
#[derive(Debug)]
pub struct Measured<'a> {
    actors: Actors<'a>,
    chances: MeasuredConfig,
    player: Player,
}

impl Act for Measured<'_> {
    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        random: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        self.player.act(self.actors, scenes, self.chances.chances(), random, actions);
        Ok(())
    }
}
