//! Telling the processes of a running domain what to do.

use std::time::Duration;

use sortie_core::wire::{Command, ControlReq, ControlStatus, Role};

use crate::domain::{Domain, DomainFacts, Membership};
use crate::error::Error;
use crate::iox::{IoxControl, LinkSetup, ServedSetup};
use crate::policy::ServedFacts;
use crate::process_info::ProcessInfo;

/// How long answers are waited for. A process looks for requests whenever it is woken, or after 100 ms.
const PATIENCE: Duration = Duration::from_secs(1);
/// A world that was killed holds its lock until the system has freed what it had.
const DYING: Duration = Duration::from_millis(250);

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
    /// A text for the command, zero padded: the name of [`Command::PrepareBundle`].
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
    let (team, served) = (membership.facts()?, ServedFacts::read(domain)?);
    if team.is_none() && served.is_none() {
        return Err(nobody());
    }
    let team = team.map_or(Ok(Vec::new()), |facts| tell_team(&membership, &facts, order))?;
    let served = served.map_or(Ok(Vec::new()), |facts| tell_server(&membership, &facts, order))?;
    let mut answers = [team, served].concat();
    answers.sort_by_key(|answer| (answer.process.role as u8, answer.process.pid));
    Ok(answers)
}

/// What the processes of a domain's team say of themselves.
pub(crate) fn team_info(
    membership: &Membership,
    facts: &DomainFacts,
) -> Result<Vec<Answer>, Error> {
    tell_team(membership, facts, &Order::new(Command::Info))
}

fn tell_team(
    membership: &Membership,
    facts: &DomainFacts,
    order: &Order,
) -> Result<Vec<Answer>, Error> {
    let format = facts.format()?;
    let name = format!("control/{}", std::process::id());
    let domain = membership.domain();
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
    if order.command == Command::ShutDown && order.process.is_none() {
        return shut_down(membership, &mut link, format.schema, order);
    }
    ask(&mut link, format.schema, order)
}

/// A world takes its team along. Without one, or with one that does not answer, everybody is told.
fn shut_down(
    membership: &Membership,
    link: &mut IoxControl,
    schema: u64,
    order: &Order,
) -> Result<Vec<Answer>, Error> {
    for patience in [DYING, PATIENCE - DYING] {
        if !membership.has_world()? {
            break;
        }
        let answers = ask_within(link, schema, order, patience)?;
        if answers.iter().any(|answer| answer.status == Some(ControlStatus::Done)) {
            return Ok(answers);
        }
    }
    ask(link, schema, &Order { number: ControlReq::EVERYBODY, ..*order })
}

fn tell_server(
    membership: &Membership,
    facts: &ServedFacts,
    order: &Order,
) -> Result<Vec<Answer>, Error> {
    let (domain, format) = (membership.domain(), facts.schema.format()?);
    let mut link = {
        let _starting = membership.lock_start()?;
        IoxControl::open_served(&ServedSetup { domain, format, linger: Duration::ZERO })?
    };
    ask(&mut link, format.schema(), order)
}

fn ask(link: &mut IoxControl, schema: u64, order: &Order) -> Result<Vec<Answer>, Error> {
    ask_within(link, schema, order, PATIENCE)
}

fn ask_within(
    link: &mut IoxControl,
    schema: u64,
    order: &Order,
    patience: Duration,
) -> Result<Vec<Answer>, Error> {
    let request = ControlReq {
        arg: order.process.unwrap_or(0),
        arg64: order.number,
        text: order.text,
        token: u64::from(std::process::id()),
        ..ControlReq::new(schema, order.command)
    };
    let answers = link.ask(&request, patience)?.into_iter();
    let of_this = answers.filter(|rep| rep.fits(schema) && rep.token == request.token);
    let answers = of_this
        .filter_map(|rep| {
            let status = ControlStatus::from_number(rep.status);
            Some(Answer { process: rep.text().parse().ok()?, status, tick: rep.tick })
        })
        .filter(|answer| answer.status != Some(ControlStatus::NotMine));
    Ok(answers.collect())
}
