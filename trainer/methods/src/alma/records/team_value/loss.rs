//! SARSA on decisions; what was decided and what it earned, up to the next decision, is a segment.
//!
//! `y = discounted task rewards of the segment + discount * f_target(next state, subtask, its next team)`,
//! the next team being the one really sent next. A subtask that is closed by then adds nothing. Loss:
//! squared difference. A drawn segment counts for one of the subtasks that were open, drawn as well:
//! the subtasks of one decision have much in common, and teach less together than those of several.

use sortie_envs::random::below;
use sortie_envs::{Environment, Observation, Random, Spec, members};
use sortie_learn::Trajectories;
use sortie_learn::learner::{Loss, Shard};
use sortie_learn::trajectory::{End, Place};
use sortie_nn::tape::Parameters;

use super::input::{TeamColumns, TeamQuery, TeamValueInput};
use crate::alma::agents::{UtilityLayers, UtilityShape};
use crate::alma::records::config::AllocatorConfig;
use crate::alma::records::replay::Moment;

/// Segments of a shard: few enough for their activations to stay in cache.
pub(in crate::alma::records) const SEGMENTS: usize = 64;

/// Decisions and what each earned until the next; noted is what follows it counts. One whose episode ran out of time is
/// not learned from: nobody decided then, so that there is no next team to value.
pub type Segments = Trajectories<f32>;

/// A segment, one of the subtasks that were open when it began, and how it is turned.
#[derive(Clone, Copy, Debug)]
pub struct DrawnSegment {
    /// The segment.
    pub place: Place,
    /// The subtask.
    pub task: usize,
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
    /// Those of what was learned from last.
    pub(super) targets: Vec<f32>,
    /// Places in the lesson of what has a next decision.
    followed: Vec<usize>,
    /// Floating-point operations of the last use.
    pub operations: u64,
}

/// How often segments may be drawn in vain before there seem to be none.
const TRIES: usize = 1_000;

impl DrawnSegment {
    /// Draws one under any of so many symmetries.
    pub fn draw(
        (environment, segments): (&dyn Environment, &Segments),
        turns: usize,
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
            let open = seen.open_tasks;
            let number = below(random, open.count_ones().max(1) as usize);
            let task = members(open.into()).nth(number)?;
            Some(Self { place, task, turn: below(random, turns) })
        })
    }

    /// What its subtask's team is asked in a decision.
    fn query(self, decision: Moment<'_>) -> TeamQuery<'_> {
        let Self { task, turn, .. } = self;
        TeamQuery { state: decision.state, task, team: decision.team(task), turn }
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
        let TeamLesson { input, targets, operations, .. } = &mut **lesson;
        let decision = |place| Moment::read(segments.state(place), environment.spec().shape.agents);
        let queries = drawn.iter().map(|drawn| drawn.query(decision(drawn.place)));
        let values = self.layers.utilities(pass, input.queries(environment, queries));
        let loss = Loss::mean_square(pass, values, targets, count);
        *operations += pass.operations(true);
        loss
    }

    /// Writes the target of every drawn subtask.
    fn find_targets(
        &self,
        shard: &mut Shard<'_, TeamLesson>,
        (environment, segments): (&dyn Environment, &Segments),
        drawn: &[DrawnSegment],
    ) {
        let TeamLesson { input, seen, targets, followed, operations } = &mut *shard.space;
        let reward = |drawn: &DrawnSegment| segments.rewards(drawn.place).tasks[drawn.task];
        targets.clear();
        targets.extend(drawn.iter().map(reward));
        let next = |drawn: &DrawnSegment| {
            let bytes = segments.state(drawn.place.after(1));
            Moment::read(bytes, environment.spec().shape.agents)
        };
        let mut goes_on = |drawn: &DrawnSegment| {
            segments.end(drawn.place) == End::Open && {
                environment.observe(next(drawn).state, 0, 0, seen);
                seen.open_tasks >> drawn.task & 1 == 1
            }
        };
        followed.clear();
        followed.extend((0..drawn.len()).filter(|number| goes_on(&drawn[*number])));
        *operations = 0;
        if followed.is_empty() {
            return;
        }
        let queries = followed.iter().map(|number| {
            let drawn = &drawn[*number];
            drawn.query(next(drawn))
        });
        let mut pass = shard.spare.begin(shard.target);
        let values = self.layers.utilities(&mut pass, input.queries(environment, queries));
        for (number, value) in followed.iter().zip(pass.values(values)) {
            targets[*number] += segments.note(drawn[*number].place) * value;
        }
        *operations += pass.operations(false);
    }
}
