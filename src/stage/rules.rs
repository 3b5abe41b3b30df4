//! Rules and relations of an environment, read back from frames: what processes that see nothing else have of them.

use alloc::boxed::Box;

use sortie_core::allocate::TaskRelation;
use sortie_core::{AllocateError, AllocationState, Allocator, EntityMask};
use sortie_envs::random::generator;
use sortie_envs::{Entry, Frame, FrameError, FrameReader, Random};

/// A rule of allocation.
pub struct RuleAllocator {
    reader: Box<dyn FrameReader>,
    rule: usize,
    random: Random,
}

impl RuleAllocator {
    /// The rule of this number; `seed` matters to rules that draw. None where the environment reads no frames.
    pub fn new(entry: &Entry, rule: usize, seed: u64) -> Option<Self> {
        let rule = Some(rule).filter(|rule| *rule < entry.rules.len())?;
        Some(Self { reader: entry.reader?(), rule, random: generator(seed) })
    }
}

impl Allocator for RuleAllocator {
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        state.check(allocation)?;
        let read = self.reader.read(&frame(state));
        read.and_then(|()| self.reader.allocate(self.rule, &mut self.random, allocation))
            .map_err(refusal)
    }
}

/// How entities stand to subtasks, which a learned allocator knows beside features.
pub struct FrameRelation(Box<dyn FrameReader>);

impl FrameRelation {
    /// Those of an environment; none where it reads no frames.
    pub fn new(entry: &Entry) -> Option<Self> {
        Some(Self(entry.reader?()))
    }
}

impl TaskRelation for FrameRelation {
    fn columns(&self) -> usize {
        self.0.relations()
    }

    fn observe(&mut self, state: &AllocationState<'_>) -> Result<(), AllocateError> {
        self.0.read(&frame(state)).map_err(refusal)
    }

    fn write(&mut self, _: &AllocationState<'_>, task: usize, relation: &mut [f32]) {
        self.0.relate(task, relation);
    }
}

fn refusal(error: FrameError) -> AllocateError {
    match error {
        FrameError::TooLarge => AllocateError::TooLarge,
        FrameError::BadLength => AllocateError::BadLength,
        _ => AllocateError::NonFinite,
    }
}

fn frame<'a>(state: &AllocationState<'a>) -> Frame<'a> {
    Frame {
        rows: state.rows,
        stride: state.stride,
        agents: state.agents,
        tasks: state.tasks,
        present: bits(&state.present),
        open_tasks: state.open_tasks,
    }
}

fn bits(entities: &EntityMask) -> u128 {
    let word = |index| u128::from(entities.words().get(index).copied().unwrap_or(0));
    word(0) | word(1) << 64
}
