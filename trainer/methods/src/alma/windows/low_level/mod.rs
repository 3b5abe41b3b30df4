//! The low level of ALMA as published: agents that learn their subtasks through an attention mixer.
//!
//! Dissertation section 7.3, its public code, and section 5.3.2 for the mixer. Agents share one utility
//! network; the utilities of a team's actions are mixed to the value of the team, one value for each
//! subtask; values follow double-Q targets in PopArt's units, by RMSprop. Without subtasks there is one
//! team and the reward of the whole.
//!
//! A step is computed window by window, in a fixed number of lanes with gradients of their own, which are
//! added in order: results depend neither on the number of threads nor on time.

mod agents;
pub mod coaching;
mod mixer;
mod step;
mod teams;
mod values;

use std::time::Duration;

use rand_core::Rng;
use sortie_nn::lanes::in_lanes;
use sortie_nn::layers::elementwise;
use sortie_nn::layers::gru::lengths;
use sortie_nn::layers::matrix::Store;
use sortie_nn::optimise::{RmsProp, clip_norm};
use sortie_nn::random::Generator;

use super::popart::PopArt;
use super::{LowLevelTimes, Stopwatch, WindowShape, Windows};
use crate::alma::agents::{TaskOrder, UtilityNetwork, drawn};
use crate::alma::coach::Coach;
use crate::alma::teams::Agents;
use coaching::{CoachConfig, Coaching};
use step::{Comparison, Lane, Layers, Side, Step};

pub use super::config::{LowLevelConfig, Nonnegative, PopArtOrder};
pub use mixer::{
    HYPERNETWORKS, HypernetworkLayers, HypernetworkShape, Mixer, MixerInput, MixerShape, Mode,
};
pub use step::Term;
pub use teams::is_available;
pub use values::{agent_utilities, team_input, team_values};

/// Parts of a step with gradients of their own.
const LANES: usize = 8;

/// Agents and the mixer of their utilities.
#[derive(Clone, Debug, PartialEq)]
pub struct LowLevelNetworks {
    /// The agents' utility network.
    pub agents: UtilityNetwork,
    /// The recurrent unit before the agents' head, as [`sortie_nn::layers::gru`] has it; empty where agents
    /// have no memory.
    pub gru: Vec<f32>,
    /// The mixer.
    pub mixer: Mixer,
    /// The statistics of the mixer's targets.
    pub popart: PopArt,
}

/// What a step found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LowLevelReport {
    /// Terms of the loss; a step without any changes nothing.
    pub terms: usize,
    /// Mean squared error in normalised units.
    pub loss: f64,
    /// What a coach adds to the loss.
    pub coach_loss: f64,
    /// Mean absolute error in normalised units.
    pub error: f64,
    /// Mean value in normalised units.
    pub value: f64,
    /// Mean target in real units.
    pub target: f64,
    /// Norm of the gradient before clipping.
    pub gradient_norm: f32,
}

/// The learner: networks, target networks and optimiser.
///
/// All state is open, in plain vectors, to be saved and restored: two [`LowLevelNetworks`], and the
/// squares of [`optimisers`](Self::optimisers); and, where agents have a coach, that of
/// [`coaching`](Self::coaching).
#[derive(Clone, Debug)]
pub struct LowLevel {
    config: LowLevelConfig,
    sizes: WindowShape,
    /// The networks that learn; the agents among them act.
    pub online: LowLevelNetworks,
    /// The networks that value what comes next.
    pub target: LowLevelNetworks,
    /// The optimisers of agents, recurrent unit and mixer, with as many squares as these have parameters.
    pub optimisers: [RmsProp; 3],
    /// The agents' coach, if they have one.
    pub coaching: Option<Coaching>,
    lanes: Vec<Lane>,
    gradient: Vec<f32>,
    optimiser_time: Duration,
}

impl LowLevel {
    /// A learner with new networks. Of the sizes those of the environment count, not those of a batch.
    pub fn new(config: LowLevelConfig, sizes: WindowShape, generator: &mut Generator) -> Self {
        let agents = values::initialise_agents(&config, sizes, generator);
        let gru = if config.recurrent { initialise_unit(config.base, generator) } else { vec![] };
        let online = LowLevelNetworks {
            agents,
            gru,
            mixer: Mixer::initialise(config.mixer(sizes), generator),
            popart: PopArt::default(),
        };
        let agents = online.agents.parameters().len();
        let counts = [agents, online.gru.len(), online.mixer.parameters().len()];
        Self {
            config,
            sizes,
            target: online.clone(),
            optimisers: counts.map(RmsProp::new),
            coaching: None,
            lanes: vec![Lane::default(); LANES],
            gradient: Vec::new(),
            optimiser_time: Duration::ZERO,
            online,
        }
    }

    /// Gives agents a new coach, in place of any that they have.
    ///
    /// Panics if they have subtasks or memories: coached agents have neither.
    pub fn add_coach(&mut self, config: CoachConfig, generator: &mut Generator) {
        let LowLevelConfig { conditioning, recurrent, .. } = self.config;
        assert!(!conditioning.has_subtasks() && !recurrent, "agents that take no coach");
        let shape = self.config.coach(self.sizes);
        self.coaching = Some(Coaching::new(config, shape, self.sizes.actions, generator));
    }

    /// The switches and rates.
    pub fn config(&self) -> &LowLevelConfig {
        &self.config
    }

    /// What agents act by.
    pub fn players(&self) -> Agents<'_> {
        Agents {
            network: self.online.agents.view(),
            memory_unit: &self.online.gru,
            coach: self.coaching.as_ref().map(|coaching| &coaching.online),
        }
    }

    /// Draws which marks stand for which subtasks, for one pass.
    pub fn draw_order(&self, generator: &mut Generator) -> TaskOrder {
        let tasks = self.sizes.tasks + self.config.extra_tasks;
        TaskOrder::shuffled(self.config.conditioning.task_columns(tasks), generator)
    }

    /// Copies the networks that learn to those that value what comes next.
    pub fn copy_target(&mut self) {
        self.target.clone_from(&self.online);
        self.coaching.iter_mut().for_each(Coaching::copy_target);
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
        let Self { config, online, target, lanes, .. } = self;
        lanes.iter_mut().for_each(|lane| lane.begin(step.online.parameters.len()));
        in_lanes(threads, lanes, |index, lane| {
            let mut watch = Stopwatch::start();
            own(index).for_each(|states| step.value(&target.popart, states, lane));
            lane.targets_time += watch.lap();
        });
        let mut watch = Stopwatch::start();
        let all = lanes.iter().flat_map(|lane| &lane.terms);
        let terms = all.clone().count();
        if terms == 0 {
            return LowLevelReport::default();
        }
        let target_mean = all.clone().map(|term| term.target).sum::<f64>() / terms as f64;
        let (weights, biases) = online.mixer.head();
        let before = (weights.to_vec(), biases.to_vec());
        let rescale = online.popart.update(all.map(|term| (term.target, 1.0)));
        let (weights, biases) = online.mixer.head_mut();
        rescale.apply(weights, biases);
        step.set_head(online.mixer.head());
        let head = match config.popart_order {
            PopArtOrder::RescaleFirst => online.mixer.head(),
            PopArtOrder::Reference => (&*before.0, &*before.1),
        };
        let comparison = Comparison { popart: &online.popart, head, terms };
        self.optimiser_time += watch.lap();
        in_lanes(threads, lanes, |index, lane| {
            let mut watch = Stopwatch::start();
            own(index).for_each(|states| step.descend(&comparison, states, lane));
            lane.descent_time += watch.lap();
        });
        let mut watch = Stopwatch::start();
        let gradient = &mut self.gradient;
        gradient.clear();
        gradient.resize(step.online.parameters.len(), 0.0);
        for lane in lanes.iter() {
            elementwise::scale(1.0, &lane.gradient, Store::Add, gradient);
        }
        step.hand_back(&mut lanes[0].tape, gradient);
        self.optimiser_time += watch.lap();
        let sum = |of: fn(&Lane) -> f64| self.lanes.iter().map(of).sum::<f64>() / terms as f64;
        LowLevelReport {
            terms,
            loss: sum(|lane| lane.sums.squared_error),
            coach_loss: self.lanes.iter().map(|lane| lane.sums.coach).sum(),
            error: sum(|lane| lane.sums.error),
            value: sum(|lane| lane.sums.value),
            target: target_mean,
            gradient_norm: norm(&self.gradient),
        }
    }

    /// Draws the marks and seeds of a step, and puts the parameters of all networks behind each other.
    fn begin<'a>(&mut self, windows: &'a Windows, generator: &mut Generator) -> Step<'a> {
        let orders = [self.draw_order(generator), self.draw_order(generator)];
        let Self { config, online, target, coaching, lanes, .. } = self;
        let shapes = (online.agents.shape(), online.mixer.shape());
        let layers = Layers::new(shapes, config.recurrent, coaching.as_ref());
        let marks = coaching.as_ref().map_or(0, |coaching| coaching.online.shape().marks);
        let [coach, target_coach, recognition_order] =
            [0, 1, 2].map(|_| TaskOrder::shuffled(marks, generator));
        let coaches = coaching.as_ref().map_or([&[][..]; 2], |coaching| {
            [&coaching.online, &coaching.target].map(Coach::parameters)
        });
        let recognition = coaching.as_ref().map_or(&[][..], |it| it.recognition.parameters());
        let mut side = |networks: &LowLevelNetworks, coach: &[f32], order, coach_order| {
            let LowLevelNetworks { agents, gru, mixer, .. } = networks;
            let own = [agents.parameters(), gru, mixer.parameters(), coach, recognition];
            let mut parameters = own.concat();
            layers.mixer.append_merged(&mut lanes[0].tape, &mut parameters);
            Side { parameters, order, coach_order, seed: generator.next_u64() }
        };
        let [order, target_order] = orders;
        Step {
            config: config.clone(),
            windows,
            layers,
            online: side(online, coaches[0], order, coach),
            target: side(target, coaches[1], target_order, target_coach),
            mixer_order: TaskOrder::identity(windows.shape.tasks),
            recognition_order,
        }
    }

    /// The second half of a step: clipping and the optimiser.
    pub fn follow(&mut self) {
        let mut watch = Stopwatch::start();
        clip_norm(&mut self.gradient, self.config.clip);
        let LowLevelNetworks { agents, gru, mixer, .. } = &mut self.online;
        let mut rest = &*self.gradient;
        for (parameters, optimiser) in [agents.parameters_mut(), gru, mixer.parameters_mut()]
            .into_iter()
            .zip(&mut self.optimisers)
        {
            let gradient = rest.split_off(..parameters.len()).expect("one slope per parameter");
            optimiser.step(parameters, gradient, self.config.learning_rate);
        }
        if let Some(coaching) = &mut self.coaching {
            coaching.follow(rest, self.config.learning_rate);
        }
        self.optimiser_time += watch.lap();
    }

    /// How long the parts of all steps have taken up to now.
    pub fn times(&self) -> LowLevelTimes {
        LowLevelTimes {
            targets: self.lanes.iter().map(|lane| lane.targets_time).sum(),
            descent: self.lanes.iter().map(|lane| lane.descent_time).sum(),
            optimiser: self.optimiser_time,
        }
    }

    /// Floating-point operations of all steps up to now: those of matrix products and attention.
    pub fn operations(&self) -> u64 {
        self.lanes.iter().map(|lane| lane.operations).sum()
    }

    /// The last gradient: of the parameters of agents, recurrent unit, mixer, coach and
    /// recognition.
    pub fn gradient(&self) -> &[f32] {
        &self.gradient
    }

    /// The terms of the last step, in no particular order.
    pub fn terms(&self) -> impl Iterator<Item = &Term> + Clone {
        self.lanes.iter().flat_map(|lane| &lane.terms)
    }
}

/// Draws a recurrent unit.
fn initialise_unit(width: usize, generator: &mut Generator) -> Vec<f32> {
    drawn(lengths(width).map(|length| (length, width)), generator)
}

fn norm(vector: &[f32]) -> f32 {
    vector.iter().map(|value| f64::from(*value).powi(2)).sum::<f64>().sqrt() as f32
}

#[cfg(test)]
mod tests;
