//! The low level of ALMA as published: agents that learn their subtasks through an attention mixer.
//!
//! Dissertation section 7.3, its public code, and section 5.3.2 for the mixer. Agents share one utility
//! network; the utilities of a team's actions are mixed to the value of the team, one value for each
//! subtask; values follow double-Q targets in PopArt's units, by RMSprop. Without subtasks there is one
//! team and the reward of the whole.
//!
//! With the subtask mask an agent sees its team only; without it ("no mask") it sees everything, and a
//! subtask's embedding is added to what `fc1` gives for an entity: further rows of `fc1` for one-hot marks
//! behind the features. Which mark stands for which subtask is shuffled before each pass, so that no
//! subtask is special; spare marks let one network serve more subtasks than it was trained with.
//!
//! A step is computed window by window, in a fixed number of lanes with gradients of their own, which are
//! added in order: results depend neither on the number of threads nor on time.

mod agents;
pub mod coaching;
mod mixer;
mod step;
mod teams;

use std::ops::Range;

use rand_core::Rng;
use sortie_learn::networks::{AimedHead, Targets};
use sortie_nn::lanes::in_lanes;
use sortie_nn::optimise::{RmsProp, clip_norm};
use sortie_nn::random::Generator;
use sortie_nn::tape::Parameters;

use super::popart::PopArt;
use super::{WindowShape, Windows, add_up};
use crate::alma::agents::{TaskOrder, UtilityShape, UtilityView};
use crate::alma::coach::{Coach, CoachShape};
use crate::alma::teams::Agents;
use agents::AgentLayers;
use coaching::{CoachConfig, CoachingLayers};
use step::{Comparison, Lane, Layers, Side, Step};

pub use super::config::{LowLevelConfig, Nonnegative, PopArtOrder};
pub use mixer::{HypernetworkLayers, HypernetworkShape, Mixer, MixerInput, MixerShape, Mode};
pub use step::Term;

/// Parts of a step with gradients of their own.
const LANES: usize = 8;

/// What a step found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LowLevelReport {
    /// Terms of the loss; a step without any changes nothing.
    pub terms: usize,
    /// Mean squared error in normalised units.
    pub loss: f64,
    /// What a coach adds to the loss.
    pub coach_loss: f64,
    /// Mean target in real units.
    pub target: f64,
    /// Norm of the gradient before clipping.
    pub gradient_norm: f32,
}

/// The learner: networks, target networks and optimiser. All state is open, to be saved and restored.
#[derive(Clone, Debug)]
pub struct LowLevel {
    /// The switches and rates.
    pub config: LowLevelConfig,
    sizes: WindowShape,
    layers: Layers,
    /// The networks that learn, one behind the other: agents, who act, and under these names `memory`, `mixer`, `coach` and
    /// `recognition`.
    pub online: Parameters,
    /// Those that value what comes next.
    pub target: Vec<f32>,
    /// The statistics of the mixer's targets.
    pub popart: PopArt,
    /// The same of the mixer that values what comes next.
    pub target_popart: PopArt,
    /// Follows the gradient.
    pub optimiser: RmsProp,
    lanes: Vec<Lane>,
    /// The last gradient, of all parameters that learn.
    pub gradient: Vec<f32>,
}

impl LowLevel {
    /// A learner with new networks. Of the sizes those of the environment count, not those of a batch.
    pub fn new(config: LowLevelConfig, sizes: WindowShape, generator: &mut Generator) -> Self {
        let mut online = Parameters::default();
        let agents = AgentLayers::new(&config, sizes, &mut online, generator);
        let mixer = Mixer::new(config.mixer(sizes), &mut online, generator);
        let merged = online.values.len();
        Self {
            config,
            sizes,
            layers: Layers { agents, mixer, coaching: None, merged },
            target: online.values.clone(),
            optimiser: RmsProp::new(merged),
            popart: PopArt::default(),
            target_popart: PopArt::default(),
            lanes: vec![Lane::default(); LANES],
            gradient: Vec::new(),
            online,
        }
    }

    /// Gives agents that have none a coach.
    ///
    /// Panics if they have subtasks or memories: coached agents have neither.
    pub fn add_coach(&mut self, config: &CoachConfig, generator: &mut Generator) {
        let LowLevelConfig { conditioning, recurrent, .. } = self.config;
        assert!(!conditioning.has_subtasks() && !recurrent, "agents that take no coach");
        let sizes = (self.config.coach(self.sizes), self.sizes.actions);
        let coaching = CoachingLayers::new(config, sizes, &mut self.online, generator);
        let merged = self.online.values.len();
        self.layers = Layers { coaching: Some(coaching), merged, ..self.layers };
        self.optimiser = RmsProp::new(merged);
        self.target.clone_from(&self.online.values);
    }

    /// The sizes of the agents' network, whose parameters come first.
    pub fn shape(&self) -> UtilityShape {
        self.config.shape(self.sizes)
    }

    /// Where the parameters stand whose tensors' names begin so.
    pub fn part(&self, name: &str) -> Range<usize> {
        let own = self.online.tensors().iter().filter(|tensor| tensor.name.starts_with(name));
        let whole = own.map(|tensor| tensor.range.clone());
        whole.reduce(|whole, next| whole.start..next.end).unwrap_or_default()
    }

    /// What agents act by.
    pub fn players(&self) -> Agents<'_> {
        let parameters = &self.online.values[..];
        let coach = self.layers.coaching.map(|coaching| coaching.coach);
        Agents {
            network: UtilityView { shape: self.shape(), parameters },
            unit: self.layers.agents.unit,
            coach: coach.map(|layers| Coach { layers, parameters }),
        }
    }

    /// Draws which marks stand for which subtasks, for one pass.
    pub fn draw_order(&self, generator: &mut Generator) -> TaskOrder {
        let tasks = self.sizes.tasks + self.config.extra_tasks;
        TaskOrder::shuffled(self.config.conditioning.task_columns(tasks), generator)
    }

    /// Copies the networks that learn to those that value what comes next.
    pub fn copy_target(&mut self) {
        self.target.copy_from_slice(&self.online.values);
        self.target_popart = self.popart;
    }

    /// Takes one step on a batch, with so many threads. The generator shuffles subtask marks.
    ///
    /// Panics if the batch is of another environment's sizes.
    pub fn learn(
        &mut self,
        windows: &Windows,
        threads: usize,
        generator: &mut Generator,
    ) -> LowLevelReport {
        let report = self.descend(windows, threads, generator);
        if report.terms > 0 {
            self.follow();
        }
        report
    }

    /// The first half of a step: targets, PopArt's statistics and the gradient.
    pub fn descend(
        &mut self,
        windows: &Windows,
        threads: usize,
        generator: &mut Generator,
    ) -> LowLevelReport {
        let WindowShape { windows: count, steps, .. } = windows.shape;
        let sizes = WindowShape { windows: count, steps, ..self.sizes };
        assert_eq!(windows.shape, sizes, "windows of another environment");
        let mut step = self.begin(windows, generator);
        let states = step.states();
        let by_window: Vec<&[usize]> = states.chunk_by(|a, b| a / steps == b / steps).collect();
        let own = |lane: usize| by_window.iter().skip(lane).step_by(LANES);
        let Self { config, online, popart, target_popart, lanes, .. } = self;
        lanes.iter_mut().for_each(|lane| lane.begin(step.online.parameters.len()));
        in_lanes(threads, lanes, |index, lane| {
            own(index).for_each(|states| step.value(target_popart, states, lane));
        });
        let all = lanes.iter().flat_map(|lane| &lane.terms);
        let terms = all.clone().count();
        if terms == 0 {
            return LowLevelReport::default();
        }
        let target_mean = all.clone().map(|term| term.target).sum::<f64>() / terms as f64;
        let head = step.layers.mixer.head_range();
        let own_head = &mut online.values[head.clone()];
        let before = own_head.to_vec();
        popart.update(all.map(|term| (term.target, 1.0)), own_head);
        step.online.parameters[head].copy_from_slice(own_head);
        let head = match config.popart_order {
            PopArtOrder::RescaleFirst => &*own_head,
            PopArtOrder::Reference => &before,
        };
        let comparison = Comparison { popart, head, terms };
        in_lanes(threads, lanes, |index, lane| {
            own(index).for_each(|states| step.descend(&comparison, states, lane));
        });
        add_up(lanes.iter().map(|lane| &lane.gradient), &mut self.gradient);
        let merged = (step.layers.merged, &mut self.gradient);
        step.layers.mixer.hand_back(&mut lanes[0].tape, &step.online.parameters, merged);
        let sum = |of: fn(&Lane) -> f64| self.lanes.iter().map(of).sum::<f64>();
        LowLevelReport {
            terms,
            loss: sum(|lane| lane.squared_error) / terms as f64,
            coach_loss: sum(|lane| lane.coach_loss),
            target: target_mean,
            gradient_norm: norm(&self.gradient),
        }
    }

    /// Draws the marks and seeds of a step, and puts the parameters of all networks behind each other.
    fn begin<'a>(&mut self, windows: &'a Windows, generator: &mut Generator) -> Step<'a> {
        let orders = [self.draw_order(generator), self.draw_order(generator)];
        let Self { config, online, target, layers, lanes, .. } = self;
        let marks = layers.coaching.map_or(0, |coaching| coaching.coach.shape.marks);
        let [coach, target_coach, recognition_order] =
            [0, 1, 2].map(|_| TaskOrder::shuffled(marks, generator));
        let mut side = |values: &[f32], order, coach_order| {
            let mut parameters = values.to_vec();
            layers.mixer.append_merged(&mut lanes[0].tape, &mut parameters);
            Side { parameters, order, coach_order, seed: generator.next_u64() }
        };
        let [order, target_order] = orders;
        Step {
            config: config.clone(),
            windows,
            layers: *layers,
            online: side(&online.values, order, coach),
            target: side(target, target_order, target_coach),
            mixer_order: TaskOrder::identity(windows.shape.tasks),
            recognition_order,
        }
    }

    /// The second half of a step: clipping and the optimiser.
    pub fn follow(&mut self) {
        clip_norm(&mut self.gradient, self.config.clip);
        let rate = self.config.learning_rate;
        self.optimiser.step(&mut self.online.values, &self.gradient, rate);
    }

    /// Floating-point operations of all steps up to now: those of matrix products and attention.
    pub fn operations(&self) -> u64 {
        self.lanes.iter().map(|lane| lane.operations).sum()
    }

    /// The terms of the last step, in no particular order.
    pub fn terms(&self) -> impl Iterator<Item = &Term> + Clone {
        self.lanes.iter().flat_map(|lane| &lane.terms)
    }
}

impl LowLevelConfig {
    /// What the head points at in an environment of these sizes.
    pub fn targets(&self, sizes: WindowShape) -> Targets {
        if self.head == AimedHead::Pointing { sizes.targets } else { Targets::NONE }
    }

    /// The sizes of the agents' network in an environment of these sizes.
    pub fn shape(&self, sizes: WindowShape) -> UtilityShape {
        let marks = self.conditioning.task_columns(sizes.tasks + self.extra_tasks);
        UtilityShape {
            input: sizes.features + sizes.actions + marks,
            width: self.width,
            heads: self.heads,
            base: self.base,
            actions: sizes.actions,
            skip: self.skip,
            targets: self.targets(sizes),
        }
    }

    /// The sizes of a coach in an environment of these sizes: as wide as its players.
    pub fn coach(&self, sizes: WindowShape) -> CoachShape {
        CoachShape {
            features: sizes.features,
            marks: sizes.tasks + self.extra_tasks,
            width: self.width,
            heads: self.heads,
            strategy: self.base,
        }
    }

    /// The sizes of the mixer in an environment of these sizes.
    pub fn mixer(&self, sizes: WindowShape) -> MixerShape {
        let tasks = if self.conditioning.has_subtasks() { sizes.tasks } else { 1 };
        let marks = self.conditioning.task_columns(sizes.tasks);
        MixerShape {
            hypernetwork: HypernetworkShape {
                input: sizes.features + sizes.actions + marks,
                width: self.hypernetwork_width,
                heads: self.hypernetwork_heads,
                mixing: self.mixing,
            },
            slots: sizes.agents,
            outputs: if self.popart_per_task { tasks } else { 1 },
            nonnegative: self.nonnegative,
            bias_nonnegative: self.bias_nonnegative,
        }
    }
}

fn norm(vector: &[f32]) -> f32 {
    vector.iter().map(|value| f64::from(*value).powi(2)).sum::<f64>().sqrt() as f32
}

#[cfg(test)]
pub(crate) mod tests;
