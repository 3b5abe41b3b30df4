//! All memory that a team on a stage works in.

use alloc::boxed::Box;
use alloc::vec;
use alloc::vec::Vec;
use core::cell::Cell;

use sortie_core::allocate::{PointingMemory, PointingRules};
use sortie_core::identity::schema_hash;
use sortie_core::limits;
use sortie_core::link::{Clock, FrameBlock};
use sortie_core::plan::{AlignedBytes, Plan, PlanError};
use sortie_core::wire::{FrameFormat, FrameLayout};
use sortie_core::world::Shape;
use sortie_envs::Entry;

use crate::allocation::{Search, SearchSizes, TeamValuePlan};
use crate::cast::{AllocatorCast, Cast};
use crate::error::StageError;
use crate::mind::{Learned, Mind};

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

/// Plans and arenas of the agents, and whose are which.
pub(crate) struct AgentMemory {
    plans: Vec<AlignedBytes>,
    arenas: Vec<AlignedBytes>,
}

impl AgentMemory {
    pub(crate) fn new(cast: &Cast) -> Result<Self, StageError> {
        let plans: Vec<AlignedBytes> =
            cast.plans.iter().map(|plan| AlignedBytes::copy_of(plan)).collect();
        let bytes = |plan: &AlignedBytes| Ok(Plan::load(plan.as_slice())?.arena_bytes());
        let bytes = plans.iter().map(bytes).collect::<Result<Vec<usize>, PlanError>>()?;
        // Networks of options do not work at once: the largest arena is for all.
        let most = bytes.iter().copied().max().unwrap_or(0);
        let bytes = if cast.options.is_some() { vec![most] } else { bytes };
        Ok(Self { arenas: bytes.into_iter().map(AlignedBytes::zeroed).collect(), plans })
    }

    /// What the agents decide by.
    pub(crate) fn mind(&mut self, cast: &Cast) -> Result<Mind<'_>, StageError> {
        let Self { plans, arenas } = self;
        if let Some(settings) = &cast.options {
            return Mind::of_options(settings, plans, arenas);
        }
        let one_for_all = vec![0; limits::AGENTS];
        let plan_of = if cast.plan_of.is_empty() { one_for_all } else { cast.plan_of.clone() };
        Ok(Mind::of_networks(plans, arenas, plan_of)?)
    }
}

/// The memory of a learned allocator.
pub(crate) enum AllocatorMemory {
    /// It values teams, and searches for the best ones.
    TeamValue(TeamValuePlan, Search),
    Pointing(PointingMemory),
}

impl AllocatorMemory {
    fn new(cast: &AllocatorCast, entry: &'static Entry) -> Result<Self, StageError> {
        match cast {
            AllocatorCast::TeamValue { plan, entities, tasks, team_max } => {
                let [entities, tasks, team_max] = [*entities, *tasks, *team_max].map(usize::from);
                let values = TeamValuePlan::new(AlignedBytes::copy_of(plan), entities)?;
                let search = Search::new(entry, SearchSizes { entities, tasks, team_max });
                Ok(Self::TeamValue(values, search.ok_or(StageError::NoRules)?))
            }
            AllocatorCast::Pointing { plans, exclusive, first_action } => {
                let plans = plans.each_ref().map(|plan| AlignedBytes::copy_of(plan));
                let rules = PointingRules { exclusive: *exclusive, first_action: *first_action };
                Ok(Self::Pointing(PointingMemory::new(plans, rules)?))
            }
        }
    }

    /// The allocator over this memory.
    pub(crate) fn bind(&mut self) -> Result<Learned<'_>, PlanError> {
        Ok(match self {
            Self::TeamValue(values, search) => {
                Learned::TeamValue(Box::new(search.allocator(values.bind()?)))
            }
            Self::Pointing(memory) => Learned::Pointing(Box::new(memory.bind()?)),
        })
    }
}

/// Plans, arenas and frames of a team.
pub struct Memory {
    pub(crate) agents: AgentMemory,
    pub(crate) allocator: Option<AllocatorMemory>,
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
        let layout = FrameLayout::new(shape)?;
        // The limits of a layout fit 16 bits.
        let [agents, entities, tasks] =
            [shape.agents, shape.entities, shape.tasks].map(|n| n as u16);
        let schema = schema_hash(cast.contract, agents, entities, tasks);
        let allocator = cast.allocator.as_ref();
        Ok(Self {
            agents: AgentMemory::new(cast)?,
            allocator: allocator.map(|cast| AllocatorMemory::new(cast, entry)).transpose()?,
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
