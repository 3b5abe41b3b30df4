//! Who a process is, as it answers those who ask, which version of this crate it runs, and models that it can change to.

use std::fmt;
use std::str::FromStr;

use sortie_core::Shape;
use sortie_core::roles::Identity;
use sortie_core::wire::{ControlStatus, Role};

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
        })
    }
}

/// This version: major, minor and patch in the upper byte, the next, and the lower half.
pub(crate) const BUILD: u32 = number(env!("CARGO_PKG_VERSION_MAJOR")) << 24
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

/// Where a process finds other models, by name.
pub trait Registry {
    /// Loads the model of `key`, checked and ready to be bound, and keeps it for the caller of the process. The one in
    /// use stays as it is. The process stands still meanwhile.
    ///
    /// # Errors
    /// [`ControlStatus::BadArgument`]: there is none under this key, or it cannot be read. A model of another contract,
    /// or too small for the domain, is refused by the process as [`ControlStatus::Foreign`].
    fn load(&mut self, key: &str) -> Result<LoadedModel, ControlStatus>;
}

/// A model as far as its process has to know it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LoadedModel {
    /// Hash of the contract that it was trained for.
    pub contract: u64,
    /// First 16 bytes of its id.
    pub id: [u8; 16],
    /// Most entities that it takes.
    pub entities_max: usize,
    /// Most subtasks that it takes.
    pub tasks_max: usize,
}

impl LoadedModel {
    fn fits(&self, contract: u64, shape: Shape) -> bool {
        self.contract == contract
            && shape.entities <= self.entities_max
            && shape.tasks <= self.tasks_max
    }
}

/// What a process that works with a model ended with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// The world has ended, or the process was told to.
    WithWorld,
    /// It is to go on with the model that its registry loaded last.
    ForNextModel,
}

/// What is needed to judge and to change models while a process runs.
pub(crate) struct Reloading<'a> {
    pub(crate) registry: Option<&'a mut dyn Registry>,
    pub(crate) contract: u64,
    pub(crate) shape: Shape,
    /// A model has been loaded that is to be bound.
    pub(crate) is_due: bool,
}

impl Reloading<'_> {
    /// Loads the model of `key`: its id, or what to answer.
    pub(crate) fn load(&mut self, key: &str) -> Result<[u8; 16], ControlStatus> {
        let registry = self.registry.as_mut().ok_or(ControlStatus::NotSupported)?;
        let model = registry.load(key)?;
        if !model.fits(self.contract, self.shape) {
            return Err(ControlStatus::Foreign);
        }
        self.is_due = true;
        Ok(model.id)
    }

    pub(crate) fn ended(&self) -> Ended {
        if self.is_due { Ended::ForNextModel } else { Ended::WithWorld }
    }
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
