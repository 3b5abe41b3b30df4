//! HAL as a [`Method`].

use sortie_envs::random::chance;
use sortie_envs::{Environment, Random, Sign};
use sortie_learn::export::DeployedAgents;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{Rates, Reports};
use sortie_learn::session::Opening;
use sortie_learn::{Act, LearnError, Method, Now, Scenes, State, Transition};

use super::affordances::{self, Classes, Population};
use super::{AffordancesConfig, Config, MeasuredConfig, MetaConfig, NetworkConfig, ReturnsConfig};
use crate::options::{
    self, Actors, Chances, Chooser, Lesson, Mask, NONE, Next, OptionPlace, Place, Player, Recorder,
    Replay, ReplayConfig, course, deployed, shown, window,
};
use crate::pictures::{Body, Heads, Learner, NetworkShape, Shown};

/// An agent that learns which milestones can be reached, which to go for, and how.
#[derive(Debug)]
pub struct Hal {
    config: Config,
    shown: Shown,
    heads: Heads,
    controller: Learner,
    meta: Learner,
    classifier: Learner,
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
    memories: (ControllerMemory, MetaMemory, affordances::Memory),
}

/// What masks say of a milestone beside the truth, over all choices of a goal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MaskCounts {
    /// Choices where it could be reached.
    pub afforded: u64,
    /// Those of them where the mask hides it.
    pub over_pruned: u64,
    /// Choices where it could not be reached.
    pub others: u64,
    /// Those of them where the mask lets it through.
    pub under_pruned: u64,
}

impl Hal {
    /// Draws the first weights.
    ///
    /// # Errors
    /// The environment shows no picture that fits, there can be no such networks, or too little is kept.
    pub fn new(config: Config, opening: &Opening<'_>) -> Result<Self, LearnError> {
        let Opening { setup, environment, seed, .. } = *opening;
        let spec = environment.spec();
        let NetworkConfig { body, crop, nearest, width, embedding, dueling, .. } = config.network;
        let widths = [("width", width), ("embedding", embedding)];
        let shown = shown(spec, body, (crop, nearest), &widths)?;
        let instances = setup.environment.instances;
        let milestones = spec.milestones.len();
        let heads = Heads { goals: milestones, actions: spec.shape.actions, dueling: true };
        let learner = |width: usize, outputs: usize, index: u64| {
            let mut random = generator(seed, Purpose::Weights, index);
            let (columns, active) = (shown.columns(), config.network.active_inputs);
            let picture = shown.shape();
            let shape = NetworkShape { body, picture, columns, active, width, outputs };
            Learner::new(shape, &config.optimiser, &mut random)
        };
        let kept = config.replay.kept(instances, config.returns.option_steps)?;
        let replay = Replay::new(instances, kept, shown.bytes(), milestones);
        let replay = match config.replay.priorities {
            0.0 => replay,
            exponent => replay.by_priority(exponent, config.meta.kept.div_ceil(instances)),
        };
        Ok(Self {
            controller: learner(width, heads.outputs(), 0),
            meta: learner(width, heads.of_goals(dueling).outputs(), 1),
            classifier: learner(if embedding == 0 { width } else { embedding }, milestones, 2),
            recorder: Recorder::new(instances, replay),
            classes: Classes::new(milestones, config.affordances.kept),
            populations: vec![Population::default(); milestones],
            known: [0; 2],
            reached: vec![0; milestones],
            signs: spec.milestones.iter().cloned().zip(spec.signs.iter().copied()).collect(),
            seed,
            random: generator(seed, Purpose::Replay, 0),
            updates: 0,
            memories: Default::default(),
            shown,
            heads,
            config,
        })
    }

    fn actors(&self, weights: impl Fn(&Learner) -> &[f32]) -> Actors<'_> {
        Actors {
            option_steps: self.config.returns.option_steps,
            shown: &self.shown,
            heads: self.heads,
            controller: (&self.controller.network, weights(&self.controller)),
            chooser: Some(self.chooser(weights)),
        }
    }

    fn chooser(&self, weights: impl Fn(&Learner) -> &[f32]) -> Chooser<'_> {
        let AffordancesConfig { mask, threshold, unreached, .. } = self.config.affordances;
        Chooser {
            mask,
            threshold,
            unreached,
            heads: self.heads.of_goals(self.config.network.dueling),
            meta: (&self.meta.network, weights(&self.meta)),
            classifier: (&self.classifier.network, weights(&self.classifier)),
            known: self.known,
        }
    }

    /// The agent with so much of chance left.
    pub fn measured(&self, chances: MeasuredConfig) -> Measured<'_> {
        let actors = self.actors(|learner| &learner.average);
        let masks = vec![MaskCounts::default(); self.heads.goals];
        Measured { actors, chances, player: Player::default(), masks }
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
        let Config { network, returns, meta: own, replay: sizes, optimiser, weights, .. } =
            &self.config;
        let (heads, shown, random) = (self.heads, &self.shown, &mut self.random);
        let (replay, memories) = (&mut self.recorder.replay, &mut self.memories);
        let exponent = sizes.importance_at(now);
        let controller = &mut self.controller;
        let (settings, kept) = ((returns, sizes, exponent), (&mut *replay, shown, environment));
        let loss = update_controller(controller, heads, settings, kept, &mut memories.0, random);
        reports.agents.push(controller.step(optimiser, learning_rate, weights.decay, loss));
        let meta = &mut self.meta;
        if self.updates > own.first && self.updates.is_multiple_of(own.every) {
            let (heads, settings) = (heads.of_goals(network.dueling), (own, returns, exponent));
            let loss = update_meta(meta, heads, settings, (replay, shown), &mut memories.1, random);
            let report = |loss| meta.step(optimiser, learning_rate, weights.decay, loss);
            reports.allocator.extend(loss.map(report));
        }
        if returns.target_every > 0 && self.updates.is_multiple_of(returns.target_every) {
            self.controller.copy_to_target();
            self.meta.copy_to_target();
        }
    }

    /// What is due of the embedding, the positives and the classes.
    fn learn_affordances(&mut self, learning_rate: f32) {
        let own = &self.config.affordances;
        let (round, [embeds, measures, classifies]) = own.due(self.updates);
        let (kept, random) = ((&self.recorder.replay, &self.shown), &mut self.random);
        let (classifier, memory) = (&mut self.classifier, &mut self.memories.2);
        if own.filter && measures {
            let milestone = (round / own.refresh) as usize % self.populations.len();
            let population = &mut self.populations[milestone];
            let from = (&self.classes, &*classifier);
            affordances::refresh(population, milestone, own.population, from, kept, memory, random);
        }
        if embeds || classifies {
            let parts = [embeds, classifies];
            let data = (&self.classes, &*self.populations);
            let loss = affordances::descend(classifier, own, parts, data, kept, memory, random);
            let decay = self.config.weights.decay;
            classifier.step(&self.config.optimiser, learning_rate, decay, loss);
        }
    }
}

impl Method for Hal {
    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        now: Now,
        random: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        let exploration = &self.config.exploration;
        let [goals, afforded] = exploration.goals_at(self.config.affordances.mask, now);
        let actions_chance = exploration.actions_at(now);
        let mut player = std::mem::take(&mut self.recorder.player);
        let chances = Chances {
            actions: actions_chance,
            goals,
            afforded,
            reached: &self.reached,
            varied: false,
        };
        let actors = self.actors(|learner| &learner.online);
        player.act(actors, scenes, chances, random, actions);
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

    fn deployed(&self) -> Result<DeployedAgents<'_>, LearnError> {
        if self.config.affordances.mask != Mask::Learned {
            let reason =
                "only agents that have learned what they can reach are deployed: those of `hal`";
            return Err(LearnError::Config(reason.to_owned()));
        }
        if self.config.network.body == Body::Convolution {
            let reason =
                "agents of convolutions are not deployed: those of `network.body=layers` are";
            return Err(LearnError::Config(reason.to_owned()));
        }
        let actors = self.actors(|learner| &learner.average);
        let chances = self.config.measured.chances();
        let agents = deployed(actors, &self.signs, chances, self.seed);
        agents.ok_or_else(|| {
            let reason = "the environment does not say how its milestones show in what is observed";
            LearnError::Config(reason.to_owned())
        })
    }

    fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        self.controller.state(state, "controller")?;
        self.meta.state(state, "meta")?;
        self.classifier.state(state, "classifier")?;
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

/// An agent that is measured.
#[derive(Debug)]
pub struct Measured<'a> {
    actors: Actors<'a>,
    chances: MeasuredConfig,
    player: Player,
    /// By milestones: the masks that goals were chosen from so far, where the environment knows the truth.
    pub masks: Vec<MaskCounts>,
}

impl Measured<'_> {
    /// Holds the masks of the goals that were just chosen against the truth.
    fn count_masks(&mut self, scenes: &Scenes<'_>) {
        for scene in scenes.scenes {
            let running = &self.player.running[scene.instance];
            if running.steps != 1 {
                continue;
            }
            let Some(truth) = scenes.environment.affordances(scene.state) else { return };
            for (milestone, counts) in self.masks.iter_mut().enumerate() {
                let is = |set: u32| u64::from(set >> milestone & 1);
                counts.afforded += is(truth);
                counts.over_pruned += is(truth & !running.mask);
                counts.others += is(!truth);
                counts.under_pruned += is(running.mask & !truth);
            }
        }
    }
}

impl Act for Measured<'_> {
    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        random: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        self.player.act(self.actors, scenes, self.chances.chances(), random, actions);
        self.count_masks(scenes);
        Ok(())
    }
}

/// Memory of updates of the controller: how actions lead to each milestone (equation 6.1, double Q-learning).
pub(super) type ControllerMemory = options::Memory<Place>;

/// Adds the gradient of an update of the controller, and returns its loss.
pub(super) fn update_controller(
    learner: &mut Learner,
    heads: Heads,
    (returns, sizes, exponent): (&ReturnsConfig, &ReplayConfig, f32),
    (replay, shown, environment): (&mut Replay, &Shown, &dyn Environment),
    memory: &mut ControllerMemory,
    random: &mut Random,
) -> f64 {
    memory.lessons.clear();
    while memory.lessons.len() < sizes.batch {
        memory.lessons.extend(draw_step(replay, (returns, sizes), environment, random));
    }
    let settings = (exponent, returns.bounded);
    let loss = options::descend(learner, heads, settings, (replay, shown), memory);
    replay.correct_steps(memory.corrections());
    loss
}

/// A step to learn from; none where it is none to begin with.
fn draw_step(
    replay: &Replay,
    (returns, sizes): (&ReturnsConfig, &ReplayConfig),
    environment: &dyn Environment,
    random: &mut Random,
) -> Option<Lesson<Place>> {
    let rules = returns.rules();
    let (place, priority) = replay.draw(sizes.reached, random);
    let window = window(replay, place, rules)?;
    let moment = replay.moment(place);
    let is_mirrored = returns.mirror && chance(random, 0.5);
    let action = environment.turned_action(is_mirrored.into(), moment.action.into());
    let other = if returns.relabel { moment.option_reached } else { NONE };
    let other = if other == moment.goal { NONE } else { other };
    let goals = [moment.goal, other].map(|goal| (goal, window.earned(goal, rules)));
    let next = window.next.map(|place| Next { place, discount: window.discount, mask: u32::MAX });
    let action = action.into();
    Some(Lesson { drawn: place, priority, state: place, is_mirrored, action, goals, next })
}

/// Memory of updates of the meta-controller: how goals lead to the task.
pub(super) type MetaMemory = options::Memory<OptionPlace>;

/// Draws of an option before an update is given up: nothing is kept yet.
const TRIES: usize = 10_000;

/// Adds the gradient of an update of the meta-controller, and returns its loss; none where too little is kept.
pub(super) fn update_meta(
    learner: &mut Learner,
    heads: Heads,
    (config, returns, exponent): (&MetaConfig, &ReturnsConfig, f32),
    (replay, shown): (&mut Replay, &Shown),
    memory: &mut MetaMemory,
    random: &mut Random,
) -> Option<f64> {
    memory.lessons.clear();
    for _ in 0..TRIES {
        memory.lessons.extend(draw_option(replay, heads.actions, (config, returns), random));
        if memory.lessons.len() == config.batch {
            break;
        }
    }
    if memory.lessons.len() < config.batch {
        return None;
    }
    let settings = (exponent, returns.bounded);
    let loss = options::descend(learner, heads, settings, (replay, shown), memory);
    replay.correct_options(memory.corrections());
    Some(loss)
}

/// An option to learn from; none where it is none to begin with.
fn draw_option(
    replay: &mut Replay,
    milestones: usize,
    (config, returns): (&MetaConfig, &ReturnsConfig),
    random: &mut Random,
) -> Option<Lesson<OptionPlace>> {
    let option = replay.draw_option_by_priority(random).or_else(|| {
        let is_solved = chance(random, config.solved.into());
        let place = replay.draw_option(is_solved, random);
        place.or_else(|| replay.draw_option(false, random)).map(|place| (place, 1.0))
    });
    let (drawn, priority) = option?;
    let course = course(replay, drawn, returns.course_rules(config, milestones))?;
    let is_mirrored = returns.mirror && chance(random, 0.5);
    let next = course.next.map(|(place, mask)| Next {
        place,
        discount: course.discount,
        mask: if config.masked { mask } else { u32::MAX },
    });
    let (action, goals) = (course.goal.into(), [(0, course.reward), (NONE, 0.0)]);
    Some(Lesson { drawn, priority, state: course.start, is_mirrored, action, goals, next })
}
