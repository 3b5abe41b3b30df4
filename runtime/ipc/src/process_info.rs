//! Who a process is, as it answers those who ask, and which version of this crate it runs.

use std::fmt;
use std::str::FromStr;

use sortie_core::roles::Identity;
use sortie_core::wire::{ControlStatus, Role};

/// Where the ids of processes of other hosts begin: Linux gives none so large.
const PID_BITS: u32 = 22;

/// A process of a team, on whichever host: messages know it by one number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HostProcess {
    /// 0: the world's.
    pub host: u16,
    /// Its id there.
    pub pid: u32,
}

impl HostProcess {
    /// The process that messages know by this number.
    pub fn of(id: u32) -> Self {
        Self { host: (id >> PID_BITS) as u16, pid: id & ((1 << PID_BITS) - 1) }
    }

    /// What messages know it by.
    pub fn id(self) -> u32 {
        u32::from(self.host) << PID_BITS | self.pid
    }
}

impl fmt::Display for HostProcess {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.host {
            0 => write!(f, "{}", self.pid),
            host => write!(f, "{} on host {host}", self.pid),
        }
    }
}

/// Who answers, as `key=value` words and flags.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProcessInfo {
    /// What it is.
    pub role: Role,
    /// Its process id.
    pub pid: u32,
    /// Bit a: it acts for agent a. Of a world: a process does.
    pub agents: u64,
    /// Bit a: of a world: nobody acts for agent a, who is left out of allocations.
    pub absent: u64,
    /// The tick of the world after which the first of these became so; 0 where it was so from the beginning.
    pub absent_since: u64,
    /// First 16 bytes of its model's id; zeros where it has none.
    pub model: [u8; 16],
    /// The term that it leads its role in, if it leads.
    pub term: Option<u32>,
    /// A world that stands still.
    pub is_paused: bool,
    /// A world whose agents have had no allocation for too long.
    pub is_degraded: bool,
    /// A runner that serves a policy to a robot's program. Its tick is the number of an observation.
    pub serves: bool,
    /// It runs a network's graph, which allocates and promises nothing about bits or time.
    pub is_graph: bool,
    /// How often its team has changed its bundle, as the newest frame says.
    pub generation: u16,
    /// The bundle that it has opened beside the one in use.
    pub candidate: Candidate,
}

/// What became of the bundle that a process was told to prepare.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Candidate {
    /// It was told nothing.
    #[default]
    None,
    /// It is being opened.
    Loading,
    /// It is ready to decide.
    Ready {
        /// First 4 bytes of its id.
        model: [u8; 4],
    },
    /// It cannot be used.
    Refused {
        /// Why.
        status: ControlStatus,
    },
}

impl Candidate {
    /// The bundle of this id.
    pub(crate) fn ready([a, b, c, d, ..]: [u8; 16]) -> Self {
        Self::Ready { model: [a, b, c, d] }
    }

    fn from_word(word: &str) -> Option<Self> {
        if word == "loading" {
            return Some(Self::Loading);
        }
        if let Some(number) = word.strip_prefix("refused") {
            let status = number.parse().ok().and_then(ControlStatus::from_number)?;
            return Some(Self::Refused { status });
        }
        let model = u32::from_str_radix(word, 16).ok()?.to_be_bytes();
        Some(Self::Ready { model })
    }
}

impl ProcessInfo {
    /// A process that acts for nobody, leads nothing and has nothing to report.
    pub(crate) fn new(role: Role, identity: &Identity) -> Self {
        let Identity { pid, model, is_graph, .. } = *identity;
        Self {
            role,
            pid,
            agents: 0,
            absent: 0,
            absent_since: 0,
            model,
            term: None,
            is_paused: false,
            is_degraded: false,
            serves: false,
            is_graph,
            generation: 0,
            candidate: Candidate::None,
        }
    }
}

/// The words of what is so or not.
const FLAGS: [&str; 4] = ["paused", "degraded", "serves", "graph"];

impl fmt::Display for ProcessInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { role, pid, agents, model, .. } = *self;
        let model = u128::from_be_bytes(model);
        write!(f, "role={} pid={pid} agents={agents:x} model={model:032x}", role.name())?;
        if let Some(term) = self.term {
            write!(f, " term={term}")?;
        }
        if self.absent != 0 {
            write!(f, " absent={:x} absent_since={:x}", self.absent, self.absent_since)?;
        }
        if self.generation != 0 {
            write!(f, " generation={}", self.generation)?;
        }
        match self.candidate {
            Candidate::None => {}
            Candidate::Loading => f.write_str(" next=loading")?,
            Candidate::Ready { model } => {
                write!(f, " next={:08x}", u32::from_be_bytes(model))?;
            }
            Candidate::Refused { status } => write!(f, " next=refused{}", status as i32)?,
        }
        let Self { is_paused, is_degraded, serves, is_graph, .. } = *self;
        let flags = [is_paused, is_degraded, serves, is_graph];
        let set = FLAGS.into_iter().zip(flags).filter(|(_, is_set)| *is_set);
        set.into_iter().try_for_each(|(word, _)| write!(f, " {word}"))
    }
}

/// A text that does not say which process answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotAProcess;

impl FromStr for ProcessInfo {
    type Err = NotAProcess;

    /// Words of later versions are passed over.
    fn from_str(text: &str) -> Result<Self, NotAProcess> {
        let words = || text.split_whitespace();
        let value = |key: &str| {
            let mut pairs = words().filter_map(|word| word.split_once('='));
            pairs.find(|(name, _)| *name == key).map(|(_, value)| value)
        };
        let mut roles = (0..=u8::MAX).map_while(Role::from_number);
        let role = value("role").ok_or(NotAProcess)?;
        let [is_paused, is_degraded, serves, is_graph] =
            FLAGS.map(|flag| words().any(|word| word == flag));
        let hex = |key| value(key).and_then(|value| u128::from_str_radix(value, 16).ok());
        let hex64 = |key| hex(key).and_then(|number| number.try_into().ok()).unwrap_or(0);
        Ok(Self {
            role: roles.find(|known| known.name() == role).ok_or(NotAProcess)?,
            pid: value("pid").and_then(|pid| pid.parse().ok()).ok_or(NotAProcess)?,
            agents: hex64("agents"),
            absent: hex64("absent"),
            absent_since: hex64("absent_since"),
            model: hex("model").unwrap_or(0).to_be_bytes(),
            term: value("term").and_then(|term| term.parse().ok()),
            is_paused,
            is_degraded,
            serves,
            is_graph,
            generation: value("generation").and_then(|number| number.parse().ok()).unwrap_or(0),
            candidate: value("next").and_then(Candidate::from_word).unwrap_or_default(),
        })
    }
}

/// This version: major, minor and patch in the upper byte, the next, and the lower half.
pub const BUILD: u32 = number(env!("CARGO_PKG_VERSION_MAJOR")) << 24
    | number(env!("CARGO_PKG_VERSION_MINOR")) << 16
    | number(env!("CARGO_PKG_VERSION_PATCH"));

const fn number(digits: &str) -> u32 {
    match u32::from_str_radix(digits, 10) {
        Ok(number) => number,
        Err(_) => panic!("cargo writes versions in digits"),
    }
}

/// A version as people write it.
pub(crate) fn version(build: u32) -> String {
    format!("{}.{}.{}", build >> 24, build >> 16 & 0xFF, build & 0xFFFF)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_answers_fits_an_answer_and_comes_back() {
        let widest = ProcessInfo {
            role: Role::Supervisor,
            pid: u32::MAX,
            agents: u64::MAX,
            absent: u64::MAX,
            absent_since: u64::MAX,
            model: [0xAB; 16],
            term: Some(u32::MAX),
            is_paused: true,
            is_degraded: true,
            serves: true,
            is_graph: true,
            generation: u16::MAX,
            candidate: Candidate::Ready { model: [0xAB; 4] },
        };
        let text = widest.to_string();
        assert!(text.len() <= 224, "{}", text.len());
        assert_eq!(text.parse(), Ok(widest));
        let least = ProcessInfo { term: None, is_paused: false, serves: false, ..widest };
        assert_eq!(format!("{least} later=5 words").parse(), Ok(least));
        for text in ["", "role=world", "pid=5", "role=cook pid=5", "role=world pid=x"] {
            assert_eq!(text.parse::<ProcessInfo>(), Err(NotAProcess), "{text}");
        }
    }

    #[test]
    fn the_version_comes_back() {
        assert_eq!(version(BUILD), env!("CARGO_PKG_VERSION"));
    }
}
