//! The low level of ALMA as published: agents that learn their subtasks through an attention mixer.
//!
//! Dissertation section 7.3, its public code, and section 5.3.2 for the mixer. Agents share one utility
//! network; the utilities of a team's actions are mixed to the value of the team, one value for each
//! subtask; values follow double-Q targets in PopArt's units, by RMSprop. Without subtasks there is one
//! team and the reward of the whole.
//!
//! A step is computed in chunks of states that fit the cache, in a fixed number of lanes with gradients
//! of their own, which are added in order: results depend neither on the number of threads nor on time.

pub mod coaching;
mod hypernetwork;
mod looking;
mod mixer;
mod step;
mod teams;
mod values;

use std::time::Duration;

use sortie_nn::lanes::in_lanes;
use sortie_nn::optimise::{RmsProp, clip_norm};
use sortie_nn::random::Generator;

use super::popart::PopArt;
use super::{LowLevelTimes, Stopwatch, WindowShape, Windows};
use crate::alma::agents::{Conditioning, TaskOrder, UtilityNetwork};
use crate::alma::teams::Agents;
use coaching::{CoachConfig, Coaching, Held, Told};
use looking::Recurrent;
use step::{Bootstrap, Descent, Lane, Side, Step};

pub use super::config::{LowLevelConfig, Nonnegative, PopArtOrder};
pub use hypernetwork::{
    HypernetworkGradient, HypernetworkPass, HypernetworkShape, Merged, MixerInput, Mode,
};
pub use mixer::{HYPERNETWORKS, MergedMixer, Mixer, MixerGradient, MixerPass, MixerShape};
pub use step::Term;
pub use teams::is_available;
pub use values::{agent_utilities, team_input, team_values};

/// Parts of a step with gradients of their own.
const LANES: usize = 8;
/// States that a lane computes at a time: few enough for their activations to stay in cache.
const CHUNK: usize = 32;

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
        let gru = if config.recurrent {
            looking::initialise_unit(config.base, generator)
        } else {
            vec![]
        };
        let online = LowLevelNetworks {
            agents,
            gru,
            mixer: Mixer::initialise(config.mixer(sizes), generator),
            popart: PopArt::default(),
        };
        let agents = online.agents.parameters().len();
        let counts = [agents, online.gru.len(), online.mixer.parameters().len()];
        let lane = Lane::new(&online.agents, &online.gru, &online.mixer);
        Self {
            config,
            sizes,
            target: online.clone(),
            optimisers: counts.map(RmsProp::new),
            coaching: None,
            lanes: vec![lane; LANES],
            gradient: vec![0.0; counts.iter().sum()],
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
        let coaching = Coaching::new(config, shape, self.sizes.actions, generator);
        let own = self.optimisers.iter().map(|optimiser| optimiser.square.len()).sum::<usize>();
        self.gradient.resize(own + coaching.parameters(), 0.0);
        self.coaching = Some(coaching);
    }

    /// The switches and rates.
    pub fn config(&self) -> &LowLevelConfig {
        &self.config
    }

    /// What agents act by.
    pub fn players(&self) -> Agents<'_> {
        Agents {
            network: &self.online.agents,
            memory_unit: &self.online.gru,
            coach: self.coaching.as_ref().map(|coaching| &coaching.online),
        }
    }

    /// Draws which marks stand for which subtasks, for one pass.
    pub fn draw_order(&self, generator: &mut Generator) -> TaskOrder {
        if self.config.conditioning == Conditioning::Input {
            TaskOrder::shuffled(self.sizes.tasks + self.config.extra_tasks, generator)
        } else {
            TaskOrder::identity(0)
        }
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
        let orders = [self.draw_order(generator), self.draw_order(generator)];
        let mixer_order = TaskOrder::identity(sizes.tasks);
        let step = Step { config: &self.config, windows, mixer_order: &mixer_order };
        let states = step.states();
        let merged = [self.online.mixer.merge(), self.target.mixer.merge()];
        let [online_merged, target_merged] = &merged;
        let [online_order, target_order] = &orders;
        let Self { online, target, lanes, coaching, .. } = self;
        lanes.iter_mut().for_each(Lane::begin);
        let coaching = coaching.as_ref();
        let told = coaching.map(|coaching| coaching.tell(windows, threads, lanes, generator));

        let bootstrap = Bootstrap {
            online: side(online, told.as_ref().map(Told::online), online_merged, online_order),
            target: side(target, told.as_ref().map(Told::target), target_merged, target_order),
            popart: &target.popart,
        };
        // Memories reach over a window.
        let chunks: Vec<&[usize]> = if self.config.recurrent {
            states.chunk_by(|a, b| a / steps == b / steps).collect()
        } else {
            states.chunks(CHUNK).collect()
        };
        let own = |lane: usize| chunks.iter().skip(lane).step_by(LANES);
        in_lanes(threads, lanes, |index, lane| {
            let mut watch = Stopwatch::start();
            own(index).for_each(|states| step.value(&bootstrap, states, lane));
            lane.targets_time += watch.lap();
        });
        let mut watch = Stopwatch::start();
        let all = lanes.iter().flat_map(|lane| &lane.terms);
        let terms = all.clone().count();
        if terms == 0 {
            return LowLevelReport::default();
        }
        let target_mean = all.clone().map(|term| term.target).sum::<f64>() / terms as f64;
        let before = online.mixer.head();
        let before = (before.0.to_vec(), before.1.to_vec());
        let rescale = online.popart.update(all.map(|term| (term.target, 1.0)));
        let (weights, biases) = online.mixer.head_mut();
        rescale.apply(weights, biases);

        let head = match self.config.popart_order {
            PopArtOrder::RescaleFirst => online.mixer.head(),
            PopArtOrder::Reference => (&*before.0, &*before.1),
        };
        let side = side(online, told.as_ref().map(Told::online), online_merged, online_order);
        let guess = coaching.zip(told.as_ref()).map(|(coaching, told)| coaching.guess(told));
        let descent = Descent { online: side, popart: &online.popart, head, terms, guess };
        self.optimiser_time += watch.lap();
        in_lanes(threads, lanes, |index, lane| {
            let mut watch = Stopwatch::start();
            own(index).for_each(|states| step.descend(&descent, states, lane));
            lane.descent_time += watch.lap();
        });
        if let Some((coaching, told)) = coaching.zip(told.as_ref()) {
            coaching.descend(told, windows, threads, lanes);
        }
        let mut watch = Stopwatch::start();
        self.add_lanes(online_merged);
        self.optimiser_time += watch.lap();
        let sum = |of: fn(&Lane) -> f64| self.lanes.iter().map(of).sum::<f64>() / terms as f64;
        LowLevelReport {
            terms,
            loss: sum(|lane| lane.sums.squared_error),
            coach_loss: self.lanes.iter().map(|lane| lane.coach.loss).sum(),
            error: sum(|lane| lane.sums.error),
            value: sum(|lane| lane.sums.value),
            target: target_mean,
            gradient_norm: norm(&self.gradient),
        }
    }

    /// Adds the gradients of all lanes, in order.
    fn add_lanes(&mut self, merged: &MergedMixer) {
        let (first, rest) = self.lanes.split_first_mut().expect("at least one lane");
        for lane in rest {
            first.agents.iter_mut().zip(&lane.agents).for_each(|(sum, value)| *sum += value);
            first.mixer.add(&lane.mixer);
        }
        let (agents, rest) = self.gradient.split_at_mut(first.agents.len());
        let (mixer, coach) = rest.split_at_mut(self.online.mixer.parameters().len());
        agents.copy_from_slice(&first.agents);
        first.mixer.write(&self.online.mixer, merged, mixer);
        if let Some(coaching) = &self.coaching {
            coaching.write_gradient(&self.lanes, coach);
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

    /// Floating-point operations of all steps up to now: those of matrix products and attention, without
    /// those of a coach.
    pub fn operations(&self) -> u64 {
        self.lanes.iter().map(Lane::operations).sum()
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

fn side<'a>(
    networks: &'a LowLevelNetworks,
    told: Option<Held<'a>>,
    merged: &'a MergedMixer,
    order: &'a TaskOrder,
) -> Side<'a> {
    let agents = Recurrent { network: &networks.agents, gru: &networks.gru };
    Side { agents, told, mixer: &networks.mixer, merged, order }
}

fn norm(vector: &[f32]) -> f32 {
    vector.iter().map(|value| f64::from(*value).powi(2)).sum::<f64>().sqrt() as f32
}

#[cfg(test)]
mod tests;
