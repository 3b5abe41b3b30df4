//! What was decided again beside what was recorded, bit by bit.

use std::fmt;

use serde::Serialize;
use sortie_core::UNASSIGNED;
use sortie_core::wire::{ActionMsg, AllocMsg};

use super::contents::Shown;
use super::roles::Judge;

/// What of an answer is the same whenever it is given.
const DECIDED: u16 = ActionMsg::STALE_ALLOC
    | ActionMsg::NO_ALLOC
    | ActionMsg::FALLBACK
    | ActionMsg::STATE_RESET
    | ActionMsg::GUARD;

/// Counts what comes out otherwise, and keeps the first of it.
#[derive(Default)]
pub(super) struct Comparison {
    pub(super) different: u64,
    pub(super) first_difference: Option<Difference>,
}

impl Comparison {
    fn note(&mut self, difference: Difference) {
        self.different += 1;
        self.first_difference.get_or_insert(difference);
    }
}

impl Judge for Comparison {
    fn action(&mut self, recorded: &ActionMsg, made: Option<&ActionMsg>, frame: &Shown) {
        if let Some(difference) = different(recorded, made, frame.header.episode) {
            self.note(difference);
        }
    }

    fn allocation(&mut self, recorded: &AllocMsg, made: Result<&AllocMsg, String>, frame: &Shown) {
        if made.as_ref().is_ok_and(|made| tasks(made).eq(tasks(recorded))) {
            return;
        }
        let told = |message: &AllocMsg| format!("{:?}", tasks(message).collect::<Vec<_>>());
        self.note(Difference {
            tick: recorded.tick as u32,
            episode: frame.header.episode,
            agent: None,
            what: "the allocation",
            recorded: told(recorded),
            made: made.map_or_else(|reason| reason, told),
        });
    }
}

/// The subtasks of all agents.
pub(super) fn tasks(message: &AllocMsg) -> impl Iterator<Item = Option<u8>> {
    let tasks = message.task.iter().take(message.n_agents.into());
    tasks.map(|task| Some(*task).filter(|task| *task != UNASSIGNED))
}

/// A decision that came out otherwise.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Difference {
    pub(super) tick: u32,
    pub(super) episode: u32,
    /// None of an allocation.
    pub(super) agent: Option<u16>,
    pub(super) what: &'static str,
    pub(super) recorded: String,
    pub(super) made: String,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { tick, episode, agent, what, recorded, made } = self;
        write!(f, "tick {tick}, episode {episode}")?;
        if let Some(agent) = agent {
            write!(f, ", agent {agent}")?;
        }
        write!(f, ": {what} is {recorded} in the record, and {made} made again")
    }
}

/// What is decided of an answer: its name, its bits, and how it is told.
type Field = (&'static str, fn(&ActionMsg) -> u64, fn(&ActionMsg) -> String);
const FIELDS: [Field; 5] = [
    ("the action", |it| it.action.into(), |it| it.action.to_string()),
    ("the subtask", |it| it.task.into(), |it| it.task.to_string()),
    ("the utility", |it| it.q.to_bits().into(), |it| format!("{} ({:08x})", it.q, it.q.to_bits())),
    (
        "the allocation acted on",
        |it| u64::from(it.alloc_term) << 32 | u64::from(it.alloc_epoch),
        |it| format!("{} of term {}", it.alloc_epoch, it.alloc_term),
    ),
    (
        "the set of flags",
        |it| (it.flags & DECIDED).into(),
        |it| format!("{:#x}", it.flags & DECIDED),
    ),
];

/// In what two answers differ, if they do.
fn different(recorded: &ActionMsg, made: Option<&ActionMsg>, episode: u32) -> Option<Difference> {
    let (tick, agent) = (recorded.tick as u32, Some(recorded.agent));
    let Some(made) = made else {
        let (recorded, made) = ("there".to_owned(), "missing".to_owned());
        return Some(Difference { tick, episode, agent, what: "the answer", recorded, made });
    };
    let (what, _, told) = FIELDS.iter().find(|(_, bits, _)| bits(recorded) != bits(made))?;
    let (recorded, made) = (told(recorded), told(made));
    Some(Difference { tick, episode, agent, what, recorded, made })
}
