//! What a team does, in plain numbers: all that the screen, scripts, the page and Prometheus are told.

use serde::Serialize;

/// A team at one moment.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct Overview {
    pub(super) domain: String,
    pub(super) environment: Option<String>,
    /// Who allocates, where the domain says so.
    pub(super) allocator: Option<String>,
    /// Ticks a second that the world is held to.
    pub(super) rate_hz: Option<f64>,
    /// Seconds that shares, percentiles and what happens a second cover.
    pub(super) window_s: f64,
    pub(super) ticks_per_s: f64,
    /// Ticks since somebody listens, those included of which nothing was heard.
    pub(super) ticks_total: u64,
    /// Messages that came and went before they were read, since somebody listens.
    pub(super) missed_total: u64,
    /// Agents have had no allocation for too long.
    pub(super) degraded: bool,
    /// None where no whole frame is sent.
    pub(super) frame: Option<Moment>,
    /// None before the first.
    pub(super) allocation: Option<Allocated>,
    pub(super) processes: Vec<Process>,
    pub(super) agents: Vec<Agent>,
}

/// Where the newest frame stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub(super) struct Moment {
    pub(super) world_term: u32,
    pub(super) tick: u32,
    pub(super) episode: u32,
    pub(super) step: u32,
    pub(super) paused: bool,
}

/// The newest allocation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(super) struct Allocated {
    pub(super) term: u32,
    pub(super) epoch: u32,
    pub(super) age_s: f64,
    /// From its frame to the newest one.
    pub(super) age_ticks: u64,
    pub(super) decide_us: f64,
    /// What the network that values teams expects of a recent one, and by how much more of the best that its search finds; none
    /// where no bundle tells.
    pub(super) value: Option<f64>,
    pub(super) regret: Option<f64>,
    pub(super) per_s: f64,
    /// Since somebody listens.
    pub(super) total: u64,
}

#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(super) struct Process {
    pub(super) role: &'static str,
    pub(super) pid: u32,
    /// 0: the world's.
    pub(super) host: u16,
    pub(super) agents: Vec<usize>,
    pub(super) model: String,
    /// The term in which it leads its role, if it leads.
    pub(super) leads_in_term: Option<u32>,
    /// An engine runs its network's graph.
    pub(super) graph: bool,
    pub(super) up_s: u64,
    /// Since it has told of itself, which it does ten times a second.
    pub(super) silent_ms: u64,
}

/// Whether an agent can be expected to act.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Standing {
    #[default]
    Plays,
    /// Nobody acts for it: allocators leave it out.
    Absent,
    /// It has no part in the episode.
    Missing,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct Agent {
    pub(super) agent: usize,
    pub(super) standing: Standing,
    /// Who acts for it, and on which host.
    pub(super) process: Option<u32>,
    pub(super) host: Option<u16>,
    pub(super) action: Option<u16>,
    /// Where all agents have the same actions.
    pub(super) action_name: Option<String>,
    /// The subtask that it acts for.
    pub(super) subtask: Option<u8>,
    pub(super) utility: Option<f32>,
    /// Of the ticks that asked it for an action, those in which it did not do what its policy decided.
    pub(super) fallback_share: Option<f64>,
    /// Those that were answered after the deadline.
    pub(super) late_share: Option<f64>,
    /// How long a decision takes.
    pub(super) decide_us: Option<Percentiles>,
    /// Since somebody listens.
    pub(super) asked_total: u64,
    pub(super) fallbacks_total: u64,
    /// Those in which a guard refused what it observed.
    pub(super) guarded_total: u64,
    pub(super) late_total: u64,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(super) struct Percentiles {
    pub(super) p50: f64,
    pub(super) p99: f64,
}
