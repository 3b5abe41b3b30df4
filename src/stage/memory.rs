//! All memory that a team on a stage works in.

use alloc::vec;
use alloc::vec::Vec;
use core::cell::Cell;

use sortie_core::identity::schema_hash;
use sortie_core::limits;
use sortie_core::link::{Clock, FrameBlock};
use sortie_core::plan::{AlignedBytes, Plan};
use sortie_core::wire::{FrameFormat, FrameLayout};
use sortie_core::world::Shape;
use sortie_envs::Entry;

use crate::cast::Cast;
use crate::error::StageError;
use crate::search::{Search, SearchSizes, TeamValuePlan};

/// Time that passes only where everybody waits: what is played depends on no clock.
#[derive(Debug, Default)]
pub(crate) struct StageClock(Cell<u64>);

impl StageClock {
    /// Lets time pass, if it has not passed yet.
    pub(crate) fn advance_to(&self, now_ns: u64) {
        self.0.set(self.0.get().max(now_ns));
    }
}

impl Clock for StageClock {
    fn now_ns(&self) -> u64 {
        self.0.get()
    }
}

/// Plans, arenas and frames of a team.
pub struct Memory {
    pub(crate) agent: AlignedBytes,
    pub(crate) arena: AlignedBytes,
    pub(crate) values: TeamValuePlan,
    pub(crate) search: Search,
    pub(crate) frames: Vec<FrameBlock>,
    pub(crate) format: FrameFormat,
    pub(crate) clock: StageClock,
    pub(crate) entry: &'static Entry,
}

impl Memory {
    /// Memory for a team in an environment whose worlds have this shape.
    ///
    /// # Errors
    /// The plans are damaged, or the team is for another environment.
    pub fn new(cast: &Cast, entry: &'static Entry, shape: Shape) -> Result<Self, StageError> {
        let agent = AlignedBytes::copy_of(&cast.agent);
        let arena = Plan::load(agent.as_slice())?.batch_arena_bytes(limits::AGENTS);
        let values = AlignedBytes::copy_of(&cast.allocator);
        let sizes = SearchSizes {
            entities: cast.entities.into(),
            tasks: cast.tasks.into(),
            team_max: cast.team_max.into(),
        };
        let layout = FrameLayout::new(shape)?;
        // The limits of a layout fit 16 bits.
        let [agents, entities, tasks] =
            [shape.agents, shape.entities, shape.tasks].map(|n| n as u16);
        let schema = schema_hash(cast.contract, agents, entities, tasks);
        Ok(Self {
            arena: AlignedBytes::zeroed(arena),
            agent,
            values: TeamValuePlan::new(values, cast.entities.into())?,
            search: Search::new(entry, sizes).ok_or(StageError::NoRules)?,
            frames: vec![
                FrameBlock::zeroed();
                layout.payload_bytes().div_ceil(size_of::<FrameBlock>())
            ],
            format: FrameFormat { schema, layout },
            clock: StageClock::default(),
            entry,
        })
    }
}
