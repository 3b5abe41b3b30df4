//! Keeps the processes of a domain alive: starts them, starts them again when they die, and keeps
//! the domain's services open, so that nothing is lost while others come and go.
//!
//! It is on no path between frame and action: a supervisor that is killed changes nothing for the
//! others, and one that is started again takes over as they die.

mod charge;

use std::collections::BTreeSet;
use std::os::fd::OwnedFd;
use std::process::ExitStatus;
use std::sync::Arc;
use std::time::{Duration, Instant};

use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use rustix::io::{read, write};
use rustix::process::Signal;
use sortie_core::link::{AllocRx, StatRx};
use sortie_core::wire::{Role, StatMsg};

use crate::domain::{Domain, Membership};
use crate::error::{Error, ending};
use crate::iox::{IoxWatcher, LinkSetup};
use crate::stop::{Stop, Waker};
use charge::{After, Kept, OwnStatus, Vigil};

pub use charge::Charge;

/// Longest pause between two looks at what passes.
const HEARTBEAT: Duration = Duration::from_millis(100);
/// How long processes may take to leave.
const GOODBYE_PATIENCE: Duration = Duration::from_secs(2);

/// When a process that died is started again.
#[derive(Clone, Copy, Debug)]
pub struct RestartPolicy {
    /// Never.
    pub never: bool,
    /// A process that lived shorter died at once: the pause before its next start doubles.
    pub immediate: Duration,
    /// Times in a row that a process may die at once.
    pub give_up_after: u32,
}

impl Default for RestartPolicy {
    /// Always, until it died ten times in a row within its first second.
    fn default() -> Self {
        Self { never: false, immediate: Duration::from_secs(1), give_up_after: 10 }
    }
}

/// What a supervisor tells.
#[derive(Clone, Copy, Debug)]
pub enum SupervisorEvent<'a> {
    /// A process was started.
    Started {
        /// What it is.
        name: &'a str,
        /// Its id.
        pid: u32,
    },
    /// Another process has its place: it waits for that to end.
    StandsBy {
        /// What it is.
        name: &'a str,
        /// The other process; 0 = unknown.
        pid: u64,
    },
    /// A process said hello.
    Joined {
        /// What it is.
        name: &'a str,
        /// Its id.
        pid: u32,
    },
    /// An allocator leads from now on.
    Leads {
        /// What it is.
        name: &'a str,
        /// Its id.
        pid: u32,
    },
    /// A process has ended.
    Ended {
        /// What it was.
        name: &'a str,
        /// Its id.
        pid: u32,
        /// How it ended.
        status: ExitStatus,
        /// After which pause it is started again, if it is.
        again: Option<Duration>,
    },
    /// The leading allocator was asked five times in vain, and is killed.
    LeaderSilent {
        /// What it is.
        name: &'a str,
        /// Its id.
        pid: u32,
    },
}

impl std::fmt::Display for SupervisorEvent<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match *self {
            Self::Started { name, pid } => write!(f, "{name} started as process {pid}"),
            Self::StandsBy { name, pid } => write!(f, "{name} stands by behind process {pid}"),
            Self::Joined { name, pid } => write!(f, "{name} joined, process {pid}"),
            Self::Leads { name, pid } => write!(f, "{name} leads the allocators, process {pid}"),
            Self::LeaderSilent { name, pid } => {
                write!(f, "{name} leads but does not answer, process {pid} is killed")
            }
            Self::Ended { name, pid, ref status, again } => {
                let how = if status.success() { "has ended".to_string() } else { ending(status) };
                write!(f, "{name} {how}, process {pid}")?;
                match again {
                    Some(pause) => write!(f, "; starts again in {} ms", pause.as_millis()),
                    None => Ok(()),
                }
            }
        }
    }
}

/// What a supervisor did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Supervision {
    /// Processes started, again ones included.
    pub starts: u64,
    /// Processes that ended other than with success.
    pub deaths: u64,
}

/// Keeps `charges` alive in `domain` until the world among them, or all of them, have done their work,
/// or `stop` is set. None of them outlives this call.
///
/// Processes started by hand take part as well: where one has a charge's place, the charge stands by behind it.
///
/// # Errors
/// A process ends with an exit code that would come again, or dies at once too often; the domain
/// cannot be used; or a signal came.
pub fn supervise(
    domain: &Domain,
    charges: Vec<Charge>,
    policy: &RestartPolicy,
    tell: &mut dyn FnMut(&SupervisorEvent<'_>),
    stop: &Stop,
) -> Result<Supervision, Error> {
    let wake = eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)
        .map_err(|error| Error::io("create", "eventfd")(error.into()))?;
    let wake = Arc::new(wake);
    stop.wakes(waker(&wake));
    let mut supervisor = Supervisor {
        membership: domain.enter()?,
        watcher: None,
        kept: charges.into_iter().map(Kept::new).collect(),
        joined: BTreeSet::new(),
        leader: None,
        vigil: Vigil::default(),
        own: OwnStatus::default(),
        schema: 0,
        done: Supervision::default(),
    };
    supervisor.run(policy, tell, stop, &wake).map(|()| supervisor.done)
}

fn waker(wake: &Arc<OwnedFd>) -> Waker {
    let wake = Arc::clone(wake);
    Waker::new(move || {
        // A count that is full wakes as well.
        let _ = write(&*wake, &1_u64.to_ne_bytes());
    })
}

struct Supervisor {
    membership: Membership,
    /// Opened as soon as a world has stated what the domain is.
    watcher: Option<IoxWatcher>,
    kept: Vec<Kept>,
    /// Processes that were heard of, by id.
    joined: BTreeSet<u32>,
    leader: Option<u32>,
    vigil: Vigil,
    own: OwnStatus,
    /// The domain's, once it is known.
    schema: u64,
    done: Supervision,
}

type Tell<'a> = &'a mut dyn FnMut(&SupervisorEvent<'_>);

impl Supervisor {
    fn run(
        &mut self,
        policy: &RestartPolicy,
        tell: Tell<'_>,
        stop: &Stop,
        wake: &OwnedFd,
    ) -> Result<(), Error> {
        loop {
            if stop.is_set() {
                return Err(Error::Interrupted);
            }
            self.reap(policy, tell)?;
            if is_done(&self.kept) {
                return Ok(());
            }
            self.start_due(tell)?;
            self.open_watcher()?;
            self.watch(tell)?;
            self.wait(wake);
        }
    }

    fn reap(&mut self, policy: &RestartPolicy, tell: Tell<'_>) -> Result<(), Error> {
        let now = Instant::now();
        for kept in &mut self.kept {
            let Some((pid, status, after)) = kept.reap(policy, now) else { continue };
            self.done.deaths += u64::from(!status.success());
            self.joined.remove(&pid);
            let Charge { name, role, agents, .. } = &kept.charge;
            let again = if let After::Again(pause) = after { Some(pause) } else { None };
            tell(&SupervisorEvent::Ended { name, pid, status, again });
            if let (Role::Runner, Some(watcher)) = (role, &mut self.watcher) {
                watcher.bury_runner(pid, *agents)?;
            }
            if let After::GiveUp(error) = after {
                return Err(error);
            }
        }
        Ok(())
    }

    fn start_due(&mut self, tell: Tell<'_>) -> Result<(), Error> {
        let now = Instant::now();
        let is_world = |kept: &Kept| kept.charge.role == Role::World;
        let mut serves_another = self.kept.iter().any(|kept| is_world(kept) && kept.stands_by());
        let Self { membership, kept, done, .. } = self;
        let due: Vec<&mut Kept> = kept.iter_mut().filter(|kept| kept.is_due(now)).collect();
        // All are asked for before any is started, which keeps others waiting while it joins.
        let holder = |kept: &&mut Kept| membership.holder_of(kept.charge.role, kept.charge.agents);
        let holders = due.iter().map(holder).collect::<Result<Vec<_>, _>>()?;
        for (kept, holder) in due.into_iter().zip(holders) {
            if is_world(kept) {
                serves_another = holder.is_some();
            }
            if let Some(pid) = holder {
                if kept.stand_by(pid, now) {
                    tell(&SupervisorEvent::StandsBy { name: &kept.charge.name, pid });
                }
                continue;
            }
            let pid = kept.start(now, serves_another)?;
            done.starts += 1;
            tell(&SupervisorEvent::Started { name: &kept.charge.name, pid });
        }
        Ok(())
    }

    /// From here on the services outlive every other process of the domain.
    fn open_watcher(&mut self) -> Result<(), Error> {
        if self.watcher.is_some() {
            return Ok(());
        }
        let Some(facts) = self.membership.facts()? else { return Ok(()) };
        let (domain, format, bell) = (self.membership.domain(), facts.format()?, facts.bell());
        let name = format!("supervisor/{}", std::process::id());
        let _starting = self.membership.lock_start()?;
        let setup = LinkSetup { domain, format, name: &name, bell, linger: Duration::ZERO };
        self.schema = format.schema;
        self.watcher = Some(match facts.has_private_frames() {
            true => IoxWatcher::open_private(&setup)?,
            false => IoxWatcher::open(&setup)?,
        });
        Ok(())
    }

    /// Takes in what has passed since the last look.
    fn watch(&mut self, tell: Tell<'_>) -> Result<(), Error> {
        let Some(watcher) = &mut self.watcher else { return Ok(()) };
        let restarts = self.done.starts.saturating_sub(self.kept.len() as u64);
        self.own.tell(watcher, self.schema, restarts)?;
        let (kept, joined, leader) = (&self.kept, &mut self.joined, &mut self.leader);
        watcher.receive_statuses(&mut |status| {
            let Some(name) = name_of(kept, status.pid) else { return };
            let is_news = !status.has(StatMsg::BYE) && joined.insert(status.pid);
            if is_news {
                tell(&SupervisorEvent::Joined { name, pid: status.pid });
            }
            let leads_allocators =
                status.role == Role::Allocator as u8 && status.has(StatMsg::LEADER);
            if leads_allocators && *leader != Some(status.pid) {
                *leader = Some(status.pid);
                tell(&SupervisorEvent::Leads { name, pid: status.pid });
            }
        })?;
        let (vigil, now) = (&mut self.vigil, Instant::now());
        watcher.receive_allocations(&mut |allocation| vigil.answered(allocation.tick))?;
        if let Some(frame) = watcher.newest_frame()? {
            vigil.asked(frame.decision_tick, now);
        }
        if vigil.is_silent(now)
            && let Some(pid) = *leader
            && let Some(allocator) = kept.iter().find(|kept| kept.pid() == Some(pid))
        {
            tell(&SupervisorEvent::LeaderSilent { name: &allocator.charge.name, pid });
            allocator.signal(Signal::KILL);
            *vigil = Vigil::default();
        }
        Ok(())
    }

    /// Waits for the end of a process, for a start that is due, for a signal, or for a heartbeat.
    fn wait(&self, wake: &OwnedFd) {
        let now = Instant::now();
        let due = self.kept.iter().filter_map(Kept::due).min();
        let left = due.map_or(HEARTBEAT, |due| due.saturating_duration_since(now).min(HEARTBEAT));
        let mut descriptors: Vec<PollFd<'_>> = self
            .kept
            .iter()
            .filter_map(Kept::ended)
            .map(|fd| PollFd::new(fd, PollFlags::IN))
            .collect();
        descriptors.push(PollFd::new(wake, PollFlags::IN));
        if let Ok(left) = Timespec::try_from(left) {
            // What ended it is looked at anew in any case.
            let _ = poll(&mut descriptors, Some(&left));
        }
        let _ = read(wake, &mut [0_u8; 8]);
    }

    /// Tells all to end, and kills those that take too long.
    fn end_all(&mut self) {
        let until = Instant::now() + GOODBYE_PATIENCE;
        self.kept.iter().for_each(|kept| kept.signal(Signal::TERM));
        while Instant::now() < until && self.kept.iter().any(is_running) {
            await_end(self.kept.iter().filter_map(Kept::ended), until);
            for kept in &mut self.kept {
                kept.reap(
                    &RestartPolicy { never: true, ..RestartPolicy::default() },
                    Instant::now(),
                );
            }
        }
        for kept in &mut self.kept {
            kept.signal(Signal::KILL);
            kept.wait();
        }
    }
}

impl Drop for Supervisor {
    fn drop(&mut self) {
        self.end_all();
        if let Some(watcher) = &mut self.watcher {
            // Nobody may be left to hear it.
            let _ = self.own.leave(watcher, self.schema);
        }
    }
}

/// Whether the world has done its work, or all have where there is none.
fn is_done(kept: &[Kept]) -> bool {
    match kept.iter().find(|kept| kept.charge.role == Role::World) {
        Some(world) => world.is_over(),
        None => kept.iter().all(Kept::is_over),
    }
}

fn is_running(kept: &Kept) -> bool {
    kept.ended().is_some()
}

fn await_end<'a>(running: impl Iterator<Item = &'a OwnedFd>, until: Instant) {
    let mut descriptors: Vec<PollFd<'_>> =
        running.map(|fd| PollFd::new(fd, PollFlags::IN)).collect();
    if let Ok(left) = Timespec::try_from(until.saturating_duration_since(Instant::now())) {
        let _ = poll(&mut descriptors, Some(&left));
    }
}

fn name_of(kept: &[Kept], pid: u32) -> Option<&str> {
    let kept = kept.iter().find(|kept| kept.pid() == Some(pid))?;
    Some(&kept.charge.name)
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;

    /// Charges of which these are over.
    fn kept(charges: &[(Role, bool)]) -> Vec<Kept> {
        let kept = |&(role, is_over): &(Role, bool)| {
            let command = Command::new("true");
            let mut kept = Kept::new(Charge { name: String::new(), role, agents: 0, command });
            if is_over {
                kept.wait();
            }
            kept
        };
        charges.iter().map(kept).collect()
    }

    #[test]
    fn a_team_has_done_its_work_with_its_world_or_all_together() {
        use Role::{Allocator, Runner, World};
        for (charges, done) in [
            (&[(Runner, false), (World, true), (Allocator, false)][..], true),
            (&[(Runner, true), (World, false), (Allocator, true)], false),
            (&[(Runner, true), (Allocator, false)], false),
            (&[(Runner, true), (Allocator, true)], true),
        ] {
            assert_eq!(is_done(&kept(charges)), done, "{charges:?}");
        }
    }
}
