//! HAL as a [`Method`].

use sortie_envs::random::chance;
use sortie_envs::{Environment, Random, Sign};
use sortie_learn::configuration::require;
use sortie_learn::export::DeployedAgents;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{Rates, Reports, UpdateReport};
use sortie_learn::session::Opening;
use sortie_learn::trajectory::{End, Place};
use sortie_learn::{Act, Ask, LearnError, Method, Now, State, Transition};

use super::affordances::{Classes, Classifier, Population, Source};
use super::{AffordancesConfig, Config, MeasuredConfig, NetworkConfig, ReturnsConfig};
use crate::options::{
    Actors, Chances, Chooser, Lesson, Lessons, Mask, Measured, NONE, Next, OptionPlace, QNetwork,
    Recorder, Replay, deployed, returns, rules, shown,
};
use crate::pictures::{Body, Heads, NetworkShape, Shown};

/// An agent that learns which milestones can be reached, which to go for, and how.
#[derive(Debug)]
pub struct Hal {
    config: Config,
    shown: Shown,
    controller: QNetwork,
    meta: QNetwork,
    classifier: Classifier,
    recorder: Recorder,
    classes: Classes,
    populations: Vec<Population>,
    /// Milestones, as bits, that were ever reached, and those that the classifier has met both classes of.
    known: [u32; 2],
    /// How often each milestone was reached.
    reached: Vec<u64>,
    /// The milestones' names, and how they show.
    signs: Vec<(String, Sign)>,
    /// What the deployed agent draws by.
    seed: u64,
    /// Draws what updates learn from.
    random: Random,
    updates: u64,
}

impl Hal {
    /// Draws the first weights.
    ///
    /// # Errors
    /// The environment shows no picture that fits, there can be no such networks, or too little is kept.
    pub fn new(config: Config, opening: &Opening<'_>) -> Result<Self, LearnError> {
        let Opening { setup, environment, seed, .. } = *opening;
        let spec = environment.spec();
        let NetworkConfig { body, crop, nearest, width, embedding, dueling, active_inputs: active } =
            config.network;
        let widths = [("width", width), ("embedding", embedding)];
        let shown = shown(spec, body, (crop, nearest), &widths)?;
        let instances = setup.environment.instances;
        let milestones = spec.milestones.len();
        let heads = Heads { goals: milestones, actions: spec.shape.actions, dueling: true };
        let (picture, columns) = (shown.shape(), shown.columns());
        let shape = |width, heads| NetworkShape { body, picture, columns, active, width, heads };
        let weights = |index: u64| generator(seed, Purpose::Weights, index);
        let learned = rules(&config.optimiser, &config.weights);
        let classes = shape(if embedding == 0 { width } else { embedding }, heads.of_goals(false));
        let kept = config.replay.kept(instances, config.returns.option_steps)?;
        let options_kept = config.meta.kept.div_ceil(instances);
        let replay = Replay::new(instances, kept, milestones)
            .by_priority(config.replay.priorities, options_kept);
        Ok(Self {
            controller: QNetwork::new(shape(width, heads), learned, &mut weights(0)),
            meta: QNetwork::new(shape(width, heads.of_goals(dueling)), learned, &mut weights(1)),
            classifier: Classifier::new(classes, learned, &mut weights(2)),
            recorder: Recorder::new(instances, replay),
            classes: Classes::new(milestones, config.affordances.kept),
            populations: vec![Population::default(); milestones],
            known: [0; 2],
            reached: vec![0; milestones],
            signs: spec.milestones.iter().cloned().zip(spec.signs.iter().copied()).collect(),
            seed,
            random: generator(seed, Purpose::Replay, 0),
            updates: 0,
            shown,
            config,
        })
    }

    /// Those that act by the averaged weights, or by the weights that learn.
    fn actors(&self, averaged: bool) -> Actors<'_> {
        let AffordancesConfig { mask, threshold, unreached, .. } = self.config.affordances;
        let (meta, classifier) = (self.meta.weights(averaged), self.classifier.weights(averaged));
        let known = self.known;
        let chooser = Chooser { mask, threshold, unreached, meta, classifier, known };
        Actors {
            option_steps: self.config.returns.option_steps,
            shown: &self.shown,
            controller: self.controller.weights(averaged),
            chooser: Some(chooser),
        }
    }

    /// The agent with so much of chance left.
    pub fn measured(&self, chances: MeasuredConfig) -> Measured<'_> {
        Measured::new(self.actors(true), chances.chances())
    }

    /// One update of each network that is due.
    fn learn(&mut self, environment: &dyn Environment, now: Now, reports: &mut Reports) {
        self.updates += 1;
        let learning_rate = self.config.optimiser.learning_rate_at(now.env_steps, now.of);
        self.learn_values(environment, now, learning_rate, reports);
        if self.config.affordances.mask == Mask::Learned {
            self.learn_affordances(learning_rate);
        }
    }

    fn learn_values(
        &mut self,
        environment: &dyn Environment,
        now: Now,
        learning_rate: f32,
        reports: &mut Reports,
    ) {
        let Self { config, controller, meta, .. } = self;
        let exponent = config.replay.importance_at(now);
        let (replay, shown, random) = (&mut self.recorder.replay, &self.shown, &mut self.random);
        let mut update = Update { config, replay, shown, environment, exponent, random };
        reports.agents.push(update.controller(controller, learning_rate));
        if self.updates > config.meta.first && self.updates.is_multiple_of(config.meta.every) {
            reports.allocator.extend(update.meta(meta, learning_rate));
        }
        let every = config.returns.target_every;
        if every > 0 && self.updates.is_multiple_of(every) {
            controller.learner.copy_to_target();
            meta.learner.copy_to_target();
        }
    }

    /// What is due of the embedding, the positives and the classes.
    fn learn_affordances(&mut self, learning_rate: f32) {
        let Self { config, classifier, classes, populations, random, shown, .. } = self;
        let (config, replay) = (&config.affordances, &self.recorder.replay);
        let source = Source { config, classes, replay, shown };
        let (round, [embeds, measures, classifies]) = config.due(self.updates);
        if config.filter && measures {
            let milestone = (round / config.refresh) as usize % populations.len();
            classifier.refresh(&mut populations[milestone], milestone, source, random);
        }
        if embeds || classifies {
            classifier.update(source, populations, [embeds, classifies], learning_rate, random);
        }
    }
}

impl Method for Hal {
    fn act(&mut self, ask: Ask<'_>, now: Now) -> Result<(), LearnError> {
        let Ask { scenes, random, actions } = ask;
        let exploration = &self.config.exploration;
        let [goals, afforded] = exploration.goals_at(self.config.affordances.mask, now);
        let (drawn, reached) = (exploration.actions_at(now), &self.reached);
        let chances = Chances { actions: drawn, goals, afforded, reached, varied: false };
        let mut player = std::mem::take(&mut self.recorder.player);
        player.act(self.actors(false), scenes, chances, random, actions);
        self.recorder.player = player;
        Ok(())
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        let option_steps = self.config.returns.option_steps;
        if let Some(option) = self.recorder.record(transition, &self.shown, option_steps) {
            if let Some(count) = self.reached.get_mut(usize::from(option.reached)) {
                *count += 1;
            }
            self.classes.add(&option, &mut self.random);
            self.known = self.classes.known();
        }
        Ok(())
    }

    fn update(&mut self, environment: &dyn Environment, now: Now) -> Result<Reports, LearnError> {
        let due = self.config.replay.due(self.config.exploration.first, now);
        let mut reports = Reports::default();
        while self.updates < due {
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

    fn deployed(&self) -> Result<DeployedAgents<'_>, LearnError> {
        require(
            self.config.affordances.mask == Mask::Learned,
            "only agents that have learned what they can reach are deployed: those of `hal`",
        )?;
        require(
            self.config.network.body == Body::Layers,
            "agents of convolutions are not deployed: those of `network.body=layers` are",
        )?;
        let actors = self.actors(true);
        let chances = self.config.measured.chances();
        let agents = deployed(actors, &self.signs, chances, self.seed);
        agents.ok_or_else(|| {
            let reason = "the environment does not say how its milestones show in what is observed";
            LearnError::Config(reason.to_owned())
        })
    }

    fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        self.controller.learner.state_as(state, |part| format!("controller/{part}"))?;
        self.meta.learner.state_as(state, |part| format!("meta/{part}"))?;
        self.classifier.learner.state_as(state, |part| format!("classifier/{part}"))?;
        // Which answers of the classifier count is part of what was learned; so few bits are exact.
        let mut known = self.known.map(|set| set as f32);
        state.vector("known", &mut known)?;
        self.known = known.map(|set| set as u32);
        self.recorder.state(state)?;
        state.value("classes", &mut self.classes)?;
        state.value("populations", &mut self.populations)?;
        state.value("reached", &mut self.reached)?;
        state.value("random", &mut self.random)?;
        state.value("updates", &mut self.updates)
    }
}

/// Draws of an option before an update is given up: nothing is kept yet.
const TRIES: usize = 10_000;

/// What updates are made of.
pub(super) struct Update<'a> {
    pub(super) config: &'a Config,
    pub(super) replay: &'a mut Replay,
    pub(super) shown: &'a Shown,
    pub(super) environment: &'a dyn Environment,
    /// How far losses make up for priorities.
    pub(super) exponent: f32,
    pub(super) random: &'a mut Random,
}

impl Update<'_> {
    /// Makes an update of the controller: how actions lead to each milestone (equation 6.1, double Q-learning).
    pub(super) fn controller(&mut self, q: &mut QNetwork, learning_rate: f32) -> UpdateReport {
        let mut lessons = Vec::new();
        while lessons.len() < self.config.replay.batch {
            lessons.extend(self.draw_step());
        }
        let report = q.update(self.lessons(&lessons), learning_rate);
        let drawn = lessons.iter().map(|lesson| lesson.state);
        self.replay.correct_steps(drawn.zip(q.errors().iter().copied()));
        report
    }

    /// Makes an update of the meta-controller: how goals lead to the task. None where too little is kept.
    pub(super) fn meta(&mut self, q: &mut QNetwork, learning_rate: f32) -> Option<UpdateReport> {
        let (batch, milestones) = (self.config.meta.batch, q.network.heads.actions);
        let draws = (0..TRIES).filter_map(|_| self.draw_option(milestones));
        let (drawn, lessons): (Vec<_>, Vec<_>) = draws.take(batch).unzip();
        if lessons.len() < batch {
            return None;
        }
        let report = q.update(self.lessons(&lessons), learning_rate);
        self.replay.correct_options(drawn.into_iter().zip(q.errors().iter().copied()));
        Some(report)
    }

    pub(super) fn lessons<'a>(&'a self, lessons: &'a [Lesson]) -> Lessons<'a> {
        let (exponent, bounded) = (self.exponent, self.config.returns.bounded);
        Lessons { lessons, replay: self.replay, shown: self.shown, exponent, bounded }
    }

    /// A step to learn from; none where it is none to begin with.
    pub(super) fn draw_step(&mut self) -> Option<Lesson> {
        let config = &self.config.returns;
        let (state, priority) = self.replay.draw(self.config.replay.reached, self.random);
        let note = self.replay.steps.note(state);
        let earned = |goal| returns(self.replay, state, config.rules(), config.paid(goal));
        let (own, next) = earned(note.goal)?;
        let other = if config.relabel { note.option_reached } else { NONE };
        let other = if other == note.goal { NONE } else { other };
        let also = if other == NONE { 0.0 } else { earned(other)?.0 };
        let goals = [(note.goal, own), (other, also)];
        let is_mirrored = config.mirror && chance(self.random, 0.5);
        let action = self.replay.steps.actions(state)[0];
        let action = self.environment.turned_action(is_mirrored.into(), action).into();
        Some(Lesson { state, is_mirrored, action, goals, next, priority })
    }

    /// An option to learn from; none where it is none to begin with.
    pub(super) fn draw_option(&mut self, milestones: usize) -> Option<(OptionPlace, Lesson)> {
        let Config { returns, meta, .. } = self.config;
        let (option, priority) = self.replay.draw_option(meta.solved, self.random)?;
        let Course { start: state, goal, reward, next } =
            self.config.course(self.replay, option, milestones)?;
        let is_mirrored = returns.mirror && chance(self.random, 0.5);
        let everything = |next: Next| Next { mask: u32::MAX, ..next };
        let next = if meta.masked { next } else { next.map(everything) };
        let (action, goals) = (goal.into(), [(0, reward), (NONE, 0.0)]);
        Some((option, Lesson { state, is_mirrored, action, goals, next, priority }))
    }
}

/// What some options from one on led to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Course {
    pub(super) start: Place,
    /// The goal that counts as chosen.
    pub(super) goal: u8,
    /// What was earned.
    pub(super) reward: f32,
    /// Where a value is looked up, and the milestones that could be chosen there.
    pub(super) next: Option<Next>,
}

impl Config {
    /// What the options of an episode from one on led to; none where that is not known yet. Of so many milestones the last is
    /// the task.
    pub(super) fn course(
        &self,
        replay: &Replay,
        (instance, number): OptionPlace,
        milestones: usize,
    ) -> Option<Course> {
        let ReturnsConfig { relabel, time_outs, .. } = self.returns;
        let ([worth, cost], task) = (self.returns.worth(), milestones as u8 - 1);
        let first = *replay.option((instance, number))?;
        // An option that fulfilled the task counts as meant to.
        let goal = if relabel && first.reached == task { task } else { first.goal };
        let all = u32::MAX >> (32 - milestones);
        let (mut reward, mut discount, mut next) = (0.0, 1.0, None);
        for ahead in 0..self.meta.options as u32 {
            let Some(option) = replay.option((instance, number + ahead)) else { break };
            let over = |reward| Course { start: first.start, goal, reward, next: None };
            if option.reached == task {
                return Some(over(reward + discount * worth));
            }
            // What comes before an option that is not learned from ends where it begins.
            if option.end != End::Open && !time_outs {
                if ahead == 0 {
                    return None;
                }
                next = Some((option.start, option.mask));
                break;
            }
            if option.reached != NONE {
                reward -= discount * cost;
            }
            if option.end == End::Over {
                return Some(over(reward));
            }
            let steps = option.steps.into();
            discount *= self.meta.discount * self.meta.step_discount.powi(steps);
            // The mask of an option that still runs is not known yet, nor one behind the last.
            next = Some((option.start.after(option.steps.into()), all));
            if option.end == End::TimedOut {
                break;
            }
        }
        let (place, mask) = next?;
        let following = replay.option((instance, number + self.meta.options as u32));
        let mask =
            following.filter(|option| option.start == place).map_or(mask, |option| option.mask);
        let next = Some(Next { place, discount, mask });
        replay.steps.has(place).then_some(Course { start: first.start, goal, reward, next })
    }
}
