//! SARSA on decisions; what was decided and what it earned, up to the next decision, is a segment.
//!
//! `y = discounted task rewards of the segment + discount * f_target(next state, subtask, its next team)`,
//! the next team being the one really sent next. A subtask that is closed by then adds nothing. Loss:
//! squared difference. A drawn segment counts for one of the subtasks that were open, drawn as well:
//! the subtasks of one decision have much in common, and teach less together than those of several.
//!
//! Where a team that is missing at one subtask ends all others too, as when one army takes the base, no subtask's own
//! rewards tell of it. There teams are credited together: the values of all subtasks add up to what the whole team earns,
//! `sum of f = all rewards of the segment + discount * sum of f_target`, so that whose absence it was can show.

use sortie_envs::random::below;
use sortie_envs::{Environment, Observation, Random, Spec, deployed_tasks, members};
use sortie_learn::learner::{Loss, Shard};
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::UpdateReport;
use sortie_learn::trajectory::{Capacity, End, Place, Widths};
use sortie_learn::{LearnError, Learner, State, Trajectories};
use sortie_nn::tape::Parameters;

use super::input::{TeamColumns, TeamQuery, TeamValueInput};
use crate::alma::agents::{UtilityLayers, UtilityShape, UtilityView};
use crate::alma::records::config::{AllocatorConfig, Credit};
use crate::alma::records::replay::Moment;
use crate::alma::records::rules;

/// Segments of a shard: few enough for their activations to stay in cache.
const SEGMENTS: usize = 64;

/// Decisions and what each earned until the next; noted is what follows it counts. One whose episode ran out of time is
/// not learned from: nobody decided then, so that there is no next team to value.
pub type Segments = Trajectories<f32>;

/// A segment, subtasks that were open when it began, one of them or all, and how it is turned.
#[derive(Clone, Copy, Debug)]
pub struct DrawnSegment {
    /// The segment.
    pub place: Place,
    /// The subtasks, as bits.
    pub tasks: u32,
    /// Number of the environment's symmetry.
    pub turn: usize,
}

/// The network of the allocator's level.
#[derive(Clone, Copy, Debug)]
pub struct TeamValues {
    /// Its sizes.
    pub shape: UtilityShape,
    layers: UtilityLayers,
}

/// Segments that are learned from together, and the memory for it.
#[derive(Debug, Default)]
pub struct TeamLesson {
    input: TeamValueInput,
    seen: Observation,
    /// Those of what was learned from last, one for each segment.
    pub(super) targets: Vec<f32>,
    /// The segments' places in the lesson, by queries.
    asked_for: Vec<u32>,
    /// Places in the lesson of what has a next decision, and the subtasks that are open there.
    followed: Vec<(usize, u32)>,
    /// Floating-point operations of the last use.
    pub operations: u64,
}

/// How often segments may be drawn in vain before there seem to be none.
const TRIES: usize = 1_000;

impl DrawnSegment {
    /// Draws one under any of so many symmetries.
    pub fn draw(
        (environment, segments): (&dyn Environment, &Segments),
        (credit, turns): (Credit, usize),
        seen: &mut Observation,
        random: &mut Random,
    ) -> Option<Self> {
        (0..TRIES).find_map(|_| {
            let place = segments.draw(1, random);
            if segments.end(place) == End::TimedOut {
                return None;
            }
            let decision = Moment::read(segments.state(place), environment.spec().shape.agents);
            environment.observe(decision.state, 0, 0, seen);
            let open = deployed_tasks(seen.open_tasks);
            let tasks = match credit {
                Credit::Team => open,
                Credit::Subtask => {
                    let number = below(random, open.count_ones().max(1) as usize);
                    1 << members(open.into()).nth(number)?
                }
            };
            (tasks != 0).then(|| Self { place, tasks, turn: below(random, turns) })
        })
    }

    /// What the teams of some of its subtasks are asked in a decision.
    fn queries<'a>(
        self,
        decision: Moment<'a>,
        tasks: u32,
    ) -> impl Iterator<Item = TeamQuery<'a>> + Clone {
        let (state, turn) = (decision.state, self.turn);
        members((self.tasks & tasks).into()).map(move |task| TeamQuery {
            state,
            task,
            team: decision.team(task),
            turn,
        })
    }
}

impl TeamValues {
    /// Draws all weights.
    pub fn new(config: &AllocatorConfig, spec: &Spec, random: &mut Random) -> (Self, Parameters) {
        let (shape, mut parameters) = (config.shape(spec), Parameters::default());
        shape.draw(&mut parameters, config.network.active_inputs, random);
        shape.forget(&mut parameters.values, TeamColumns::of(spec).pairs());
        (Self { shape, layers: UtilityLayers::of(shape) }, parameters)
    }

    /// The part that some segments have in the mean loss over so many.
    pub fn loss(
        &self,
        shard: &mut Shard<'_, TeamLesson>,
        (environment, segments): (&dyn Environment, &Segments),
        drawn: &[DrawnSegment],
        count: usize,
    ) -> Loss {
        self.find_targets(shard, (environment, segments), drawn);
        let Shard { pass, space: lesson, .. } = shard;
        let TeamLesson { input, targets, asked_for, operations, .. } = &mut **lesson;
        asked_for.clear();
        let decision = |place| Moment::read(segments.state(place), environment.spec().shape.agents);
        let queries = (0_u32..).zip(drawn).flat_map(|(number, drawn)| {
            drawn.queries(decision(drawn.place), u32::MAX).map(move |query| (number, query))
        });
        asked_for.extend(queries.clone().map(|(number, _)| number));
        let queries = queries.map(|(_, query)| query);
        let values = self.layers.utilities(pass, input.queries(environment, queries));
        let sums = pass.scatter(values, asked_for, drawn.len());
        let loss = Loss::mean_square(pass, sums, targets, count);
        *operations += pass.operations(true);
        loss
    }

    /// Writes the target of every drawn segment.
    fn find_targets(
        &self,
        shard: &mut Shard<'_, TeamLesson>,
        (environment, segments): (&dyn Environment, &Segments),
        drawn: &[DrawnSegment],
    ) {
        let TeamLesson { input, seen, targets, followed, operations, .. } = &mut *shard.space;
        let reward = |drawn: &DrawnSegment| {
            let rewards = segments.rewards(drawn.place).tasks;
            members(drawn.tasks.into()).map(|task| rewards[task]).sum::<f32>()
        };
        targets.clear();
        targets.extend(drawn.iter().map(reward));
        let next = |drawn: &DrawnSegment| {
            let bytes = segments.state(drawn.place.after(1));
            Moment::read(bytes, environment.spec().shape.agents)
        };
        let mut open_next = |drawn: &DrawnSegment| {
            if segments.end(drawn.place) != End::Open {
                return 0;
            }
            environment.observe(next(drawn).state, 0, 0, seen);
            drawn.tasks & deployed_tasks(seen.open_tasks)
        };
        followed.clear();
        let all = drawn.iter().enumerate().map(|(number, drawn)| (number, open_next(drawn)));
        followed.extend(all.filter(|(_, tasks)| *tasks != 0));
        *operations = 0;
        if followed.is_empty() {
            return;
        }
        let queries = followed.iter().flat_map(|(number, tasks)| {
            let drawn = &drawn[*number];
            drawn.queries(next(drawn), *tasks)
        });
        let asked_for = followed
            .iter()
            .flat_map(|(number, tasks)| members((*tasks).into()).map(move |_| *number));
        let mut pass = shard.spare.begin_forward(shard.target);
        let values = self.layers.utilities(&mut pass, input.queries(environment, queries));
        for (number, value) in asked_for.zip(pass.values(values)) {
            targets[number] += segments.note(drawn[number].place) * value;
        }
        *operations += pass.operations(false);
    }
}

/// Tells the allocator's streams of random numbers from the agents'.
const ALLOCATOR_STREAM: u64 = 1;

/// The level that allocates, and what it has seen.
#[derive(Debug)]
pub struct Allocator {
    pub(in crate::alma::records) values: TeamValues,
    /// Its networks.
    pub learner: Learner<TeamLesson>,
    /// What it learns from.
    pub segments: Segments,
    random: Random,
    drawn: Vec<DrawnSegment>,
    seen: Observation,
}

impl Allocator {
    pub(in crate::alma::records) fn new(
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
    pub(in crate::alma::records) fn measured(&self) -> UtilityView<'_> {
        UtilityView { shape: self.values.shape, parameters: &self.learner.average }
    }

    /// The weights that learn.
    pub fn online(&self) -> UtilityView<'_> {
        UtilityView { shape: self.values.shape, parameters: &self.learner.online.values }
    }

    /// Names everything that later updates depend on.
    pub(in crate::alma::records) fn state(
        &mut self,
        state: &mut State<'_>,
    ) -> Result<(), LearnError> {
        self.learner.state_as(state, |part| format!("allocator/{part}"))?;
        state.value("allocator/random", &mut self.random)?;
        self.segments.visit_as(state, "segments")
    }
}
