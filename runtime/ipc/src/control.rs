//! Telling the processes of a running domain what to do.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use sortie_core::roles::Identity;
use sortie_core::wire::{Command, ControlReq, ControlStatus, Role};

use crate::domain::Domain;
use crate::error::Error;
use crate::iox::{IoxControl, LinkSetup};

/// How long answers are waited for. A process looks for requests whenever it is woken, or after 100 ms.
const PATIENCE: Duration = Duration::from_secs(1);
/// The same for what takes a process longer: networks may have to be compiled.
const LOADING_PATIENCE: Duration = Duration::from_secs(30);

/// What the processes of a domain are told.
#[derive(Clone, Copy, Debug)]
pub struct Order {
    /// What to do.
    pub command: Command,
    /// The process that is meant; `None` = every one that serves the command. Of allocators only one leads
    /// and can step down.
    pub process: Option<u32>,
    /// A number for the command: the level of [`Command::SetLogLevel`].
    pub number: u64,
    /// A text for the command, zero padded: the key of [`Command::ReloadModel`].
    pub text: [u8; 32],
}

impl Order {
    /// An order without number and text, to all whom it concerns.
    pub fn new(command: Command) -> Self {
        Self { command, process: None, number: 0, text: [0; 32] }
    }

    /// The same with a text, of which 32 bytes are kept.
    pub fn with_text(mut self, text: &str) -> Self {
        for (to, from) in self.text.iter_mut().zip(text.bytes()) {
            *to = from;
        }
        self
    }
}

/// What a process answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Answer {
    /// Who it is.
    pub process: ProcessInfo,
    /// What became of the order; `None` = a number that only a later version knows.
    pub status: Option<ControlStatus>,
    /// The newest tick that it knows.
    pub tick: u64,
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
    /// First 16 bytes of its model's id; zeros where it has none.
    pub model: [u8; 16],
    /// The term that it leads its role in, if it leads.
    pub term: Option<u32>,
    /// A world that stands still.
    pub is_paused: bool,
    /// A world whose agents have had no allocation for too long.
    pub is_degraded: bool,
}

impl ProcessInfo {
    /// A process that acts for nobody, leads nothing and has nothing to report.
    pub(crate) fn new(role: Role, identity: &Identity) -> Self {
        let Identity { pid, model, .. } = *identity;
        Self { role, pid, agents: 0, model, term: None, is_paused: false, is_degraded: false }
    }
}

/// Gives an order in `domain`, and returns who answered: first worlds, then runners and allocators, by
/// process id. Those whom it does not concern are left out.
///
/// # Errors
/// Nothing runs in the domain, or it cannot be used.
pub fn control(domain: &Domain, order: &Order) -> Result<Vec<Answer>, Error> {
    let nobody = || Error::NoWorld { domain: domain.id().to_string() };
    if !domain.is_alive()? {
        return Err(nobody());
    }
    let membership = domain.enter()?;
    let facts = membership.facts()?.ok_or_else(nobody)?;
    let format = facts.format()?;
    let name = format!("control/{}", std::process::id());
    let setup =
        LinkSetup { domain, format, name: &name, bell: facts.bell(), linger: Duration::ZERO };
    let mut link: IoxControl = {
        let _starting = membership.lock_start()?;
        IoxControl::open(&setup)?
    };
    if order.command == Command::StepDown && order.process.is_none() {
        // Who leads is asked first: told to all, the next leader would step down as well.
        let answers = ask(&mut link, format.schema, &Order::new(Command::Info))?;
        let leads =
            |process: &ProcessInfo| process.role == Role::Allocator && process.term.is_some();
        let mut processes = answers.iter().map(|answer| answer.process);
        let Some(leader) = processes.find(leads) else { return Ok(Vec::new()) };
        return ask(&mut link, format.schema, &Order { process: Some(leader.pid), ..*order });
    }
    ask(&mut link, format.schema, order)
}

fn ask(link: &mut IoxControl, schema: u64, order: &Order) -> Result<Vec<Answer>, Error> {
    let request = ControlReq {
        arg: order.process.unwrap_or(0),
        arg64: order.number,
        text: order.text,
        token: u64::from(std::process::id()),
        ..ControlReq::new(schema, order.command)
    };
    let loads = order.command == Command::ReloadModel;
    let patience = if loads { LOADING_PATIENCE } else { PATIENCE };
    let answers = link.ask(&request, patience)?.into_iter();
    let of_this = answers.filter(|rep| rep.fits(schema) && rep.token == request.token);
    let mut answers: Vec<Answer> = of_this
        .filter_map(|rep| {
            let status = ControlStatus::from_number(rep.status);
            Some(Answer { process: rep.text().parse().ok()?, status, tick: rep.tick })
        })
        .filter(|answer| answer.status != Some(ControlStatus::NotMine))
        .collect();
    answers.sort_by_key(|answer| (answer.process.role as u8, answer.process.pid));
    Ok(answers)
}

impl fmt::Display for ProcessInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { role, pid, agents, model, .. } = *self;
        let model = u128::from_be_bytes(model);
        write!(f, "role={} pid={pid} agents={agents:x} model={model:032x}", role.name())?;
        if let Some(term) = self.term {
            write!(f, " term={term}")?;
        }
        if self.is_paused {
            f.write_str(" paused")?;
        }
        if self.is_degraded {
            f.write_str(" degraded")?;
        }
        Ok(())
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
        let hex = |key| value(key).and_then(|value| u128::from_str_radix(value, 16).ok());
        Ok(Self {
            role: roles.find(|known| known.name() == role).ok_or(NotAProcess)?,
            pid: value("pid").and_then(|pid| pid.parse().ok()).ok_or(NotAProcess)?,
            agents: hex("agents").and_then(|agents| agents.try_into().ok()).unwrap_or(0),
            model: hex("model").unwrap_or(0).to_be_bytes(),
            term: value("term").and_then(|term| term.parse().ok()),
            is_paused: words().any(|word| word == "paused"),
            is_degraded: words().any(|word| word == "degraded"),
        })
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
            model: [0xAB; 16],
            term: Some(u32::MAX),
            is_paused: true,
            is_degraded: true,
        };
        let text = widest.to_string();
        assert!(text.len() <= 224, "{}", text.len());
        assert_eq!(text.parse(), Ok(widest));
        let least = ProcessInfo { term: None, is_paused: false, is_degraded: false, ..widest };
        assert_eq!(format!("{least} later=5 words").parse(), Ok(least));
        for text in ["", "role=world", "pid=5", "role=cook pid=5", "role=world pid=x"] {
            assert_eq!(text.parse::<ProcessInfo>(), Err(NotAProcess), "{text}");
        }
    }
}
