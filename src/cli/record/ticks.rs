//! A line a tick, for people and their tools.

use serde::Serialize;
use sortie_core::wire::{ActionMsg, AllocMsg, FrameHeader, FrameKind};
use sortie_core::{NO_ACTION, UNASSIGNED};

/// What a line holds, in JSON's own language of schemas.
pub(super) const SCHEMA: &str = r#"{
  "type": "object",
  "properties": {
    "tick": {"type": "integer", "description": "count of the world's frames"},
    "world_term": {"type": "integer", "description": "one more with every world"},
    "episode": {"type": "integer"},
    "begins": {"type": "boolean", "description": "first frame of the episode"},
    "ends": {"type": "boolean", "description": "last frame of the episode, which asks for no action"},
    "allocation": {"type": "array", "items": {"type": ["integer", "null"]}, "description": "newest subtask of each agent"},
    "agents": {"type": "array", "items": {"type": "object", "properties": {
      "agent": {"type": "integer"},
      "action": {"type": ["integer", "null"]},
      "task": {"type": ["integer", "null"], "description": "subtask acted for"},
      "utility": {"type": ["number", "null"]},
      "fallback": {"type": "boolean", "description": "there where the policy refused"},
      "guarded": {"type": "boolean", "description": "there where a guard refused what the agent observed"},
      "late": {"type": "boolean", "description": "there where it was sent after the deadline"},
      "answered_us": {"type": "number", "description": "from the frame to the action"}
    }}}
  }
}
"#;

/// What is said of a tick.
#[derive(Serialize)]
struct Line<'a> {
    tick: u32,
    world_term: u32,
    episode: u32,
    begins: bool,
    ends: bool,
    allocation: &'a [Option<u8>],
    agents: &'a [Answer],
}

/// An agent's action of the tick.
#[derive(Clone, Copy, Serialize)]
struct Answer {
    agent: u16,
    action: Option<u16>,
    task: Option<u8>,
    /// None where it is no number.
    utility: Option<f32>,
    /// Of an hour's lines, what is nearly always false would be a tenth.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    fallback: bool,
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    guarded: bool,
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    late: bool,
    answered_us: f64,
}

/// Gathers what belongs to the newest frame.
pub(super) struct Ticks {
    frame: Option<FrameHeader>,
    /// `[A]`
    allocation: Vec<Option<u8>>,
    answers: Vec<Answer>,
    count: u64,
}

impl Ticks {
    pub(super) fn new(agents: usize) -> Self {
        Self { frame: None, allocation: vec![None; agents], answers: Vec::new(), count: 0 }
    }

    pub(super) fn count(&self) -> u64 {
        self.count
    }

    pub(super) fn begin(&mut self, header: &FrameHeader) {
        if header.kind != FrameKind::WarmUp as u16 {
            self.frame = Some(*header);
            self.count += 1;
        }
    }

    pub(super) fn allocate(&mut self, allocation: &AllocMsg) {
        for (to, task) in self.allocation.iter_mut().zip(allocation.task) {
            *to = Some(task).filter(|task| *task != UNASSIGNED);
        }
    }

    pub(super) fn act(&mut self, action: &ActionMsg) {
        let Some(frame) = self.frame.filter(|frame| frame.tick == action.tick) else { return };
        if action.flags & ActionMsg::BYE != 0 {
            return;
        }
        self.answers.push(Answer {
            agent: action.agent,
            action: Some(action.action).filter(|action| *action != NO_ACTION),
            task: Some(action.task).filter(|task| *task != UNASSIGNED),
            utility: Some(action.q).filter(|utility| utility.is_finite()),
            fallback: action.has(ActionMsg::FALLBACK),
            guarded: action.has(ActionMsg::GUARD),
            late: action.has(ActionMsg::LATE),
            answered_us: action.t_ns.saturating_sub(frame.t_ns) as f64 / 1e3,
        });
    }

    /// The line of the newest frame, with its tick and when it was sent; none where there is none yet.
    pub(super) fn end(&mut self) -> Option<(u64, u64, String)> {
        let frame = self.frame.take()?;
        self.answers.sort_by_key(|answer| answer.agent);
        let line = Line {
            // Its upper half is the world's term.
            tick: frame.tick as u32,
            world_term: frame.world_term,
            episode: frame.episode,
            begins: frame.has(FrameHeader::EPISODE_START),
            ends: frame.has(FrameHeader::EPISODE_END),
            allocation: &self.allocation,
            agents: &self.answers,
        };
        // Plain numbers and names: there is nothing that could not be written.
        let text = serde_json::to_string(&line).unwrap_or_default();
        self.answers.clear();
        Some((frame.tick, frame.t_ns, text))
    }
}
