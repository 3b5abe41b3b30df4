//! Who is killed when, and how long it takes until somebody has taken the place.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{self, Sender};
use std::time::Duration;

use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use rustix::process::{Pid, Signal, kill_process};
use sortie_core::link::Clock;
use sortie_core::roles::{TickReport, WorldObserver};
use sortie_core::wire::{AllocMsg, Role, StatMsg};
use sortie_ipc::{Domain, MonotonicClock, Stop};

use super::team::{AGENTS, Checks};
use super::{StormReport, StormSettings};

/// Ticks in a row that all have to answer before the next blow.
const CALM: u32 = 5;
/// Such ticks before the first blow: ports that send rarely connect at their next heartbeat.
const FIRST_CALM: u32 = 250;
/// Ticks at the end in which what the dead left has to be cleaned up.
const LAST_CALM: u32 = 5_000;
/// Of these, those after which a standby that may have led is replaced by a fresh one.
const FRESH_STANDBY: u32 = 1_500;

/// A process to kill after a pause.
struct Blow {
    pid: u32,
    pause: Duration,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Awaited {
    Calm,
    /// Another process than this one, for this agent.
    Runner {
        pid: u32,
        agent: u16,
    },
    /// An allocation of a later term than this.
    Leader {
        term: u32,
    },
    /// Nothing any more but that the dead are cleaned up.
    CleanUp {
        ticks: u32,
    },
    Done,
}

/// Watches the world of a storm, and strikes.
pub(super) struct Blows {
    domain: Domain,
    checks: Checks,
    awaited: Awaited,
    calm: u32,
    runner_kills: u32,
    allocator_kills: u32,
    random: SplitMix64,
    period: Duration,
    leader: Option<u32>,
    /// A lone leader that is killed leaves nobody who could take over.
    standby: Option<u32>,
    term: u32,
    /// Objects in shared memory of a team that is complete.
    objects: Option<u64>,
    struck_ns: Arc<AtomicU64>,
    blows: Sender<Blow>,
    stop: Stop,
    over: Stop,
}

impl Blows {
    pub(super) fn new(
        domain: &Domain,
        settings: &StormSettings,
        checks: Checks,
        [stop, over]: [Stop; 2],
    ) -> Self {
        let struck_ns = Arc::new(AtomicU64::new(0));
        let (blows, orders) = mpsc::channel::<Blow>();
        let struck = Arc::clone(&struck_ns);
        std::thread::spawn(move || {
            for Blow { pid, pause } in orders {
                std::thread::sleep(pause);
                struck.store(MonotonicClock.now_ns(), Ordering::SeqCst);
                kill(pid);
            }
        });
        Self {
            domain: domain.clone(),
            checks,
            awaited: Awaited::Calm,
            calm: 0,
            runner_kills: settings.runner_kills,
            allocator_kills: settings.allocator_kills,
            random: SplitMix64::seed_from_u64(settings.seed),
            period: settings.period,
            leader: None,
            standby: None,
            term: 0,
            objects: None,
            struck_ns,
            blows,
            stop,
            over,
        }
    }

    /// What ends the world.
    pub(super) fn stop(&self) -> Stop {
        self.stop.clone()
    }

    /// Ends the supervisor.
    pub(super) fn end(&self) {
        self.over.stop();
    }

    pub(super) fn is_done(&self) -> bool {
        self.awaited == Awaited::Done
    }

    pub(super) fn report(mut self) -> StormReport {
        self.checks.found.takeover_ns.sort_unstable();
        self.checks.found.rejoin_ns.sort_unstable();
        self.checks.found
    }

    fn objects(&self) -> u64 {
        self.domain.shared_memory().map_or(0, |objects| objects.len() as u64)
    }

    /// The team is complete: whom to kill, as often as is left to do.
    fn strike(&mut self, report: &TickReport<'_>) {
        let left = u64::from(self.runner_kills) + u64::from(self.allocator_kills);
        if left == 0 {
            self.awaited = Awaited::CleanUp { ticks: 0 };
            return;
        }
        let is_runner = self.random.next_u64() % left < u64::from(self.runner_kills);
        let agent = (self.random.next_u64() % AGENTS as u64) as usize;
        let pause = self.random.next_u64() % (self.period.as_nanos() as u64).max(1);
        let pid = if is_runner {
            let Some(answer) = report.answers().nth(agent) else { return };
            self.runner_kills -= 1;
            self.awaited = Awaited::Runner { pid: answer.runner, agent: answer.agent };
            answer.runner
        } else {
            let (Some(leader), Some(_)) = (self.leader.take(), self.standby.take()) else { return };
            self.allocator_kills -= 1;
            self.awaited = Awaited::Leader { term: self.term };
            leader
        };
        self.calm = 0;
        // The thread lives as long as this.
        let _ = self.blows.send(Blow { pid, pause: Duration::from_nanos(pause) });
    }

    /// Compares with what a complete team had before the first blow.
    fn clean_up(&mut self, ticks: u32) {
        let leaked = self.objects().saturating_sub(self.objects.unwrap_or(0));
        self.awaited = Awaited::CleanUp { ticks: ticks + 1 };
        if leaked > 0 && ticks == FRESH_STANDBY {
            // Who led before keeps its connections, which no standby had when objects were counted.
            self.standby.take().into_iter().for_each(kill);
        }
        if leaked == 0 || ticks >= LAST_CALM {
            self.checks.found.leaked = leaked;
            self.awaited = Awaited::Done;
            self.stop.stop();
        }
    }
}

impl WorldObserver for Blows {
    fn status(&mut self, status: &StatMsg) {
        if status.role != Role::Allocator as u8 || status.has(StatMsg::BYE) {
            return;
        }
        if status.has(StatMsg::LEADER) {
            self.leader = Some(status.pid);
        } else if self.leader != Some(status.pid) {
            self.standby = Some(status.pid);
        }
        if self.standby == self.leader {
            self.standby = None;
        }
    }

    fn episode_started(&mut self, _episode: u32) {
        self.checks.episode_started();
    }

    fn allocated(&mut self, allocation: &AllocMsg) {
        self.checks.allocated(allocation);
        if let Awaited::Leader { term } = self.awaited
            && allocation.term > term
        {
            let struck_ns = self.struck_ns.load(Ordering::SeqCst);
            self.checks.found.takeover_ns.push(allocation.t_ns.saturating_sub(struck_ns));
            self.awaited = Awaited::Calm;
        }
        self.term = allocation.term;
    }

    fn tick(&mut self, report: &TickReport<'_>) {
        self.checks.tick(report);
        let is_complete = report.answered == (1 << AGENTS) - 1;
        self.calm = if is_complete { self.calm + 1 } else { 0 };
        match self.awaited {
            Awaited::Runner { pid, agent } => {
                let successor =
                    report.answers().find(|answer| answer.agent == agent && answer.runner != pid);
                if let Some(answer) = successor {
                    let struck_ns = self.struck_ns.load(Ordering::SeqCst);
                    let rejoined_ns = answer.t_ns.saturating_sub(struck_ns);
                    self.checks.found.rejoin_ns.push(rejoined_ns);
                    self.awaited = Awaited::Calm;
                }
            }
            Awaited::Calm
                if self.calm >= CALM && self.leader.is_some() && self.standby.is_some() =>
            {
                if self.objects.is_some() {
                    self.strike(report);
                } else if self.calm >= FIRST_CALM {
                    self.objects = Some(self.objects());
                }
            }
            Awaited::CleanUp { ticks } => self.clean_up(ticks),
            Awaited::Calm | Awaited::Leader { .. } | Awaited::Done => {}
        }
    }
}

fn kill(pid: u32) {
    if let Some(pid) = i32::try_from(pid).ok().and_then(Pid::from_raw) {
        // The storm alone kills, and it kills nobody twice.
        let _ = kill_process(pid, Signal::KILL);
    }
}
