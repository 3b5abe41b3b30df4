//! The team that the program acts in: eleven words of the file that `SORTIE_DOMAIN` names, little-endian.

use sortie_core::Shape;
use sortie_core::roles::{Identity, RunnerOptions};
use sortie_core::wire::{FrameFormat, FrameLayout};

use crate::words;

const DOMAIN: &[u8] = include_bytes!(env!("SORTIE_DOMAIN"));
const SCHEMA: u64 = (word(1) as u64) << 32 | word(0) as u64;
const DECISION_INTERVAL: u32 = word(7);
const HAS_SUBTASKS: bool = word(8) != 0;
/// `u32::MAX`: there is none.
const SAFE_ACTION: u32 = word(9);
const AGENT: u32 = word(10);

/// The team's sizes.
pub(crate) const SHAPE: Shape = Shape {
    agents: word(2) as usize,
    entities: word(3) as usize,
    tasks: word(4) as usize,
    actions: word(5) as usize,
    features: word(6) as usize,
};

const fn word(index: usize) -> u32 {
    words::word(DOMAIN, index)
}

/// The team's frames, if there can be such.
pub(crate) fn format() -> Option<FrameFormat> {
    Some(FrameFormat { schema: SCHEMA, layout: FrameLayout::new(SHAPE).ok()? })
}

/// What a runner of its one agent is started with.
pub(crate) fn runner(format: FrameFormat) -> RunnerOptions {
    RunnerOptions {
        format,
        identity: Identity::new(AGENT + 1, "device"),
        agents: 1 << AGENT,
        subtasks: HAS_SUBTASKS,
        decision_interval: DECISION_INTERVAL,
        period_ns: 0,
        safe_action: u16::try_from(SAFE_ACTION).ok(),
    }
}
