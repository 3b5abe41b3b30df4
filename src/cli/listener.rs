//! Who listens to a running team: all that is said in a domain, and how much of it was missed.

use std::collections::HashMap;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use sortie_core::link::Clock;
use sortie_ipc::{
    Domain, DomainFacts, Error, Heard, IoxRecorder, LinkSetup, Membership, MonotonicClock,
};

use crate::failure::{Failure, Outcome};

/// How long a team may be silent before it is taken for gone: paused ones tell of themselves ten times a second.
const SILENCE: Duration = Duration::from_secs(30);

/// The priority of those who wait for all others.
const LAST: i32 = 19;

/// Somebody who listens, has no part in the team, and whom nobody waits for.
pub(crate) struct Listener {
    link: IoxRecorder,
    facts: DomainFacts,
    /// The state of the bell before the newest look.
    token: u32,
    looked_ns: u64,
    heard_ns: u64,
    /// Left last.
    _membership: Membership,
}

impl Listener {
    /// Begins to listen, under a name that says what for.
    pub(crate) fn enter(domain: &Domain, purpose: &str) -> Result<Self, Failure> {
        let nobody = || Failure::from(Error::NoWorld { domain: domain.id().to_owned() });
        // Whoever enters creates the domain's folder.
        if !domain.is_alive()? {
            return Err(nobody());
        }
        let membership = domain.enter()?;
        let facts = membership.facts()?.ok_or_else(nobody)?;
        let link = open_link(&membership, &facts, purpose)?;
        // What is said is kept for a while: who listens lets those who work go first. Where that is not permitted it is no
        // worse off than they are.
        let _ = rustix::process::setpriority_process(None, LAST);
        let now_ns = MonotonicClock.now_ns();
        let token = link.token();
        Ok(Self {
            link,
            facts,
            token,
            looked_ns: now_ns,
            heard_ns: now_ns,
            _membership: membership,
        })
    }

    pub(crate) fn facts(&self) -> &DomainFacts {
        &self.facts
    }

    /// Takes what was said since the last look, with the time of the domain's clock at which it is read.
    pub(crate) fn look(&mut self, take: &mut dyn FnMut(Heard<'_>, u64)) -> Outcome {
        self.token = self.link.token();
        let now_ns = MonotonicClock.now_ns();
        self.looked_ns = now_ns;
        let heard_ns = &mut self.heard_ns;
        self.link.receive(&mut |heard| {
            *heard_ns = now_ns;
            take(heard, now_ns);
        })?;
        Ok(())
    }

    /// When the last look was, by the domain's clock.
    pub(crate) fn looked_ns(&self) -> u64 {
        self.looked_ns
    }

    /// Whether nobody has said anything for so long that the team is taken for gone.
    pub(crate) fn is_alone(&self) -> bool {
        u128::from(self.looked_ns - self.heard_ns) > SILENCE.as_nanos()
    }

    /// Sleeps until more is said than the last look took, but no longer than this.
    pub(crate) fn wait(&mut self, most: Duration) {
        // A look every few hundred years is none.
        let most_ns = u64::try_from(most.as_nanos()).unwrap_or(u64::MAX);
        self.link.wait_until(self.token, self.looked_ns.saturating_add(most_ns));
    }
}

fn open_link(
    membership: &Membership,
    facts: &DomainFacts,
    purpose: &str,
) -> Result<IoxRecorder, Failure> {
    let (domain, format, bell) = (membership.domain(), facts.format()?, facts.bell());
    let name = format!("{purpose}/{}", std::process::id());
    let _starting = membership.lock_start()?;
    let setup = LinkSetup { domain, format, name: &name, bell, linger: Duration::ZERO };
    Ok(IoxRecorder::open(&setup)?)
}

/// How much more the time since 1970 is than that of the domain's clock.
pub(crate) fn wall_clock_ahead_ns() -> u64 {
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    (since_1970.as_nanos() as u64).saturating_sub(MonotonicClock.now_ns())
}

/// Messages that came and went before they were read, as far as later ones of their senders show.
#[derive(Debug, Default)]
pub(crate) struct Missed {
    /// The last number of each sender, by what it sends.
    last: HashMap<(u8, u32), u64>,
    count: u64,
}

impl Missed {
    /// Counts what is missing before this message. Returns whether it is the first of its kind from its sender.
    pub(crate) fn note(&mut self, heard: Heard<'_>) -> bool {
        let (kind, sender, number) = match heard {
            Heard::Frame(header, _) => (0, header.world_term, header.seq),
            Heard::Allocation(it) => (1, it.term, it.seq),
            Heard::Action(it) => (2, it.runner, it.seq),
            Heard::Status(it) => (3, it.pid, it.seq),
        };
        let last = self.last.insert((kind, sender), number);
        if let Some(last) = last {
            self.count += number.saturating_sub(last.saturating_add(1));
        }
        last.is_none()
    }

    pub(crate) fn count(&self) -> u64 {
        self.count
    }
}
