//! The level that allocates while a run learns it: its networks, what they learn from, and their updates.

use sortie_envs::{Environment, Observation, Random, Spec};
use sortie_learn::learner::Rules;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::UpdateReport;
use sortie_learn::trajectory::{Capacity, Widths};
use sortie_learn::{LearnError, Learner, State, Trajectories};

use super::config::{AllocatorConfig, OptimiserConfig};
use super::team_value::{DrawnSegment, SEGMENTS, Segments, TeamLesson, TeamValues};
use crate::alma::agents::UtilityView;

/// Tells the allocator's streams of random numbers from the agents'.
const ALLOCATOR_STREAM: u64 = 1;

/// What updates do; the averaged weights begin as a plain mean.
pub(super) fn rules(optimiser: &OptimiserConfig) -> Rules {
    Rules { mean_first: true, ..Rules::from(optimiser) }
}

/// The level that allocates, and what it has seen.
#[derive(Debug)]
pub struct Allocator {
    pub(super) values: TeamValues,
    /// Its networks.
    pub learner: Learner<TeamLesson>,
    /// What it learns from.
    pub segments: Segments,
    random: Random,
    drawn: Vec<DrawnSegment>,
    seen: Observation,
}

impl Allocator {
    pub(super) fn new(
        config: &AllocatorConfig,
        (spec, instances): (&Spec, usize),
        seed: u64,
        threads: usize,
    ) -> Self {
        let mut weights = generator(seed, Purpose::Weights, ALLOCATOR_STREAM);
        let (values, parameters) = TeamValues::new(config, spec, &mut weights);
        let widths = Widths { tasks: spec.shape.tasks, ..Widths::default() };
        let kept = Capacity::States(config.replay.capacity / instances);
        Self {
            values,
            learner: Learner::new(parameters, rules(&config.optimiser), threads),
            segments: Trajectories::noting(kept, instances, widths),
            random: generator(seed, Purpose::Replay, ALLOCATOR_STREAM),
            drawn: Vec::new(),
            seen: Observation::default(),
        }
    }

    /// One update, if there is enough to learn from.
    pub fn update(
        &mut self,
        config: &AllocatorConfig,
        environment: &dyn Environment,
        learning_rate: f32,
    ) -> Option<UpdateReport> {
        let Self { values, learner, segments, random, drawn, seen } = self;
        if !segments.can_draw(1) || segments.states() < config.replay.warm_up {
            return None;
        }
        let turns = if config.replay.symmetries { environment.spec().turns } else { 1 };
        let experience = (environment, &*segments);
        let rules = (config.credit, turns);
        let draw = |_| DrawnSegment::draw(experience, rules, seen, random);
        drawn.clear();
        drawn.extend((0..config.replay.batch).filter_map(draw));
        let shards = drawn.len().div_ceil(SEGMENTS);
        (shards > 0).then(|| {
            learner.update(shards, learning_rate, |shard| {
                let own = drawn.chunks(SEGMENTS).nth(shard.number).unwrap_or_default();
                values.loss(shard, experience, own, drawn.len())
            })
        })
    }

    /// Those that are measured.
    pub(super) fn measured(&self) -> UtilityView<'_> {
        UtilityView { shape: self.values.shape, parameters: &self.learner.average }
    }

    /// The weights that learn.
    pub fn online(&self) -> UtilityView<'_> {
        UtilityView { shape: self.values.shape, parameters: &self.learner.online.values }
    }

    /// Names everything that later updates depend on.
    pub(super) fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        self.learner.state_as(state, |part| format!("allocator/{part}"))?;
        state.value("allocator/random", &mut self.random)?;
        self.segments.visit_as(state, "segments")
    }
}
