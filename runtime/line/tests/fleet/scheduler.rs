//! The fleet in one process: a scheduler that plays kernel, supervisor and misfortune.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;
use std::sync::Arc;

use sortie_core::roles::Poll;
use sortie_core::wire::Role;

use super::air::{Air, End};
use super::hosts::{FarProcess, StandIn};
use super::link::SimulatedLink;
use super::network::{Losses, Network, Shared};
use super::oracle::{Coverage, Invariant, Oracle, Violation};
use super::process::{self, Body, Polled, Process, Wake};
use super::random::Random;
use super::setup::{MICROSECOND, MILLISECOND, Setup, Weather};

/// A process that waits looks up this often.
const HEARTBEAT_NS: u64 = 100 * MILLISECOND;
/// How long a storm lasts.
const STORM_NS: u64 = 250 * MILLISECOND;
/// How long everything is watched after it has recovered.
const WATCHED_NS: u64 = 300 * MILLISECOND;
/// Allocations that a leader leaves unanswered before it is asked to step down, and before it is killed.
const STEP_DOWN_AFTER: u32 = 3;
const KILL_AFTER: u32 = 5;

/// A place in the team that the supervisor keeps filled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Seat {
    World,
    /// Where that one is on another host: who stands in for it.
    Runner(usize),
    Away(usize),
    Rival(usize),
    Allocator(usize),
}

#[derive(Clone, Copy, Debug)]
enum Event {
    Start(Seat),
    Wake { pid: u32, plan: u64, wake: Wake },
    Ring(u32),
    Arrival(End),
    GrantLock,
    Misfortune,
    Storm,
    Calm,
    ShutDown,
    End,
}

/// What came of a seed.
pub(crate) struct Outcome {
    pub(crate) violation: Option<Violation>,
    pub(crate) coverage: Coverage,
    pub(crate) trace: Vec<String>,
}

/// Runs the fleet of a setup to its end, or to the first violation.
pub(crate) fn run(setup: Setup, traces: bool) -> Outcome {
    let mut fleet = Fleet::new(setup, traces);
    fleet.run();
    let Fleet { network, processes, .. } = fleet;
    drop(processes);
    let network = Rc::into_inner(network).expect("every link is closed").into_inner();
    let oracle = network.oracle;
    Outcome {
        violation: oracle.violation.clone(),
        coverage: oracle.coverage,
        trace: oracle.into_trace(),
    }
}

struct Fleet {
    setup: Setup,
    network: Shared,
    air: Arc<Air>,
    random: Random,
    events: BTreeMap<(u64, u64), Event>,
    planned: u64,
    now_ns: u64,
    is_storm: bool,
    is_ending: bool,
    seats: BTreeMap<Seat, u32>,
    processes: BTreeMap<u32, Process>,
    next_pid: u32,
    /// The kernel's locks: who leads, and the terms in their files.
    lock_holder: Option<u32>,
    allocator_term: u32,
    world_term: u32,
}

impl Fleet {
    fn new(setup: Setup, traces: bool) -> Self {
        let mut random = Random::new(setup.seed);
        let oracle = Oracle::new(setup.clone(), traces);
        let network = Network::new(Random::new(random.next()), setup.weather, oracle);
        let mut fleet = Self {
            network: Rc::new(RefCell::new(network)),
            air: Air::new(Random::new(setup.seed ^ 0xa1), setup.has_rivals),
            random,
            events: BTreeMap::new(),
            planned: 0,
            now_ns: 0,
            is_storm: false,
            is_ending: false,
            seats: BTreeMap::new(),
            processes: BTreeMap::new(),
            next_pid: 100,
            lock_holder: None,
            allocator_term: 0,
            world_term: 0,
            setup,
        };
        let runners = (0..fleet.setup.runners.len()).map(Seat::Runner);
        let seats = runners.chain((0..fleet.setup.allocators).map(Seat::Allocator));
        let away = (0..fleet.setup.away.len()).filter(|line| fleet.setup.away[*line]);
        let away: Vec<usize> = away.collect();
        let rivals = away.iter().copied().filter(|_| fleet.setup.has_rivals).map(Seat::Rival);
        let rivals: Vec<Seat> = rivals.collect();
        let seats = seats.chain(away.into_iter().map(Seat::Away)).chain(rivals);
        for seat in seats.chain([Seat::World]).collect::<Vec<_>>() {
            let after = fleet.random.below(20 * MILLISECOND);
            fleet.plan(after, Event::Start(seat));
        }
        let pause = 45 * MILLISECOND + fleet.setup.recovery_ns() + WATCHED_NS;
        for storm in 0..u64::from(fleet.setup.storms) {
            fleet.plan(pause + storm * (STORM_NS + pause), Event::Storm);
            fleet.plan(pause + storm * (STORM_NS + pause) + STORM_NS, Event::Calm);
        }
        let end = pause + u64::from(fleet.setup.storms) * (STORM_NS + pause) + 120 * MILLISECOND;
        fleet.plan(end, Event::ShutDown);
        fleet.plan(end + 150 * MILLISECOND, Event::End);
        fleet
    }

    fn plan(&mut self, after_ns: u64, event: Event) {
        self.planned += 1;
        self.events.insert((self.now_ns + after_ns, self.planned), event);
    }

    fn note(&self, line: impl FnOnce() -> String) {
        self.network.borrow_mut().oracle.note(self.now_ns, line);
    }

    fn violate(&self, invariant: Invariant, detail: String) {
        self.network.borrow_mut().oracle.violate(invariant, self.now_ns, detail);
    }

    fn disturb(&self, until_ns: u64) {
        self.network.borrow_mut().oracle.disturb(until_ns);
    }

    fn run(&mut self) {
        while let Some(((now_ns, _), event)) = self.events.pop_first() {
            self.now_ns = now_ns;
            self.network.borrow_mut().now_ns = now_ns;
            self.air.set_time(now_ns);
            if matches!(event, Event::End) {
                return self.check_end();
            }
            self.handle(event);
            self.deliver_rings();
            let mut network = self.network.borrow_mut();
            if !self.is_ending {
                network.oracle.check_time(now_ns);
            }
            if network.oracle.violation.is_some() {
                return;
            }
        }
    }

    fn handle(&mut self, event: Event) {
        match event {
            Event::Start(seat) => self.start(seat),
            Event::Wake { pid, plan, wake } => self.wake(pid, plan, wake),
            Event::Ring(pid) => {
                if self.processes.get(&pid).is_some_and(|process| process.is_asleep) {
                    let takes = self.random.between(2, 20) * MICROSECOND;
                    self.plan_wake(pid, takes, Wake::Rung);
                }
            }
            Event::Arrival(End::Away(pid)) => self.plan(0, Event::Ring(pid)),
            Event::Arrival(End::Home(line)) => self.arrive(line),
            Event::GrantLock => self.grant_lock(),
            Event::Misfortune if self.is_storm => {
                self.misfortune();
                let after = self.random.between(MILLISECOND, 40 * MILLISECOND);
                self.plan(after, Event::Misfortune);
            }
            Event::Misfortune => {}
            Event::Storm => {
                self.note(|| "the storm begins".into());
                self.is_storm = true;
                let losses = self.losses(self.setup.weather);
                self.network.borrow_mut().losses = losses;
                if self.setup.has_hosts() {
                    let losses = self.losses(Weather::Radio);
                    self.air.set_losses(losses);
                }
                self.disturb(self.now_ns + STORM_NS);
                self.plan(0, Event::Misfortune);
            }
            Event::Calm => {
                self.note(|| "the storm is over".into());
                self.is_storm = false;
                self.network.borrow_mut().losses = Losses::default();
                self.air.set_losses(Losses::default());
                let late = if self.setup.has_hosts() { 45 } else { 15 };
                self.disturb(self.now_ns + late * MILLISECOND);
            }
            Event::ShutDown => {
                self.is_ending = true;
                if let Some(world) = self.process(Seat::World) {
                    // A world that has been killed says nothing.
                    let _ = world.leave();
                }
            }
            Event::End => {}
        }
    }

    fn losses(&mut self, weather: Weather) -> Losses {
        let mut up_to = |most| self.random.below(most);
        match weather {
            Weather::Shared => Losses::default(),
            Weather::Radio => Losses {
                lost: up_to(150),
                doubled: up_to(150),
                late: up_to(150),
                damaged: up_to(50),
            },
            Weather::Hostile => Losses {
                lost: up_to(50),
                doubled: up_to(100),
                late: up_to(100),
                damaged: up_to(300),
            },
        }
    }

    fn deliver_rings(&mut self) {
        let rings = std::mem::take(&mut self.network.borrow_mut().rings);
        for (at_ns, pid) in rings {
            self.plan(at_ns - self.now_ns, Event::Ring(pid));
        }
        for (at_ns, end) in self.air.take_arrivals() {
            self.plan(at_ns - self.now_ns, Event::Arrival(end));
        }
        for pid in self.air.take_woken() {
            self.plan(0, Event::Ring(pid));
        }
    }

    /// Something has come for who stands in: a process that is stopped hears it when it runs on.
    fn arrive(&mut self, line: usize) {
        let now_ns = self.now_ns;
        let stopped = self.process(Seat::Runner(line)).map_or(0, |one| one.stopped_until_ns);
        match stopped.checked_sub(now_ns).filter(|left| *left > 0) {
            Some(left) => self.plan(left, Event::Arrival(End::Home(line))),
            None => self.air.deliver(line),
        }
    }

    fn process(&mut self, seat: Seat) -> Option<&mut Process> {
        self.processes.get_mut(self.seats.get(&seat)?)
    }

    fn plan_wake(&mut self, pid: u32, after_ns: u64, wake: Wake) {
        let Some(process) = self.processes.get_mut(&pid) else { return };
        process.plan += 1;
        process.is_asleep = wake == Wake::Timeout;
        let plan = process.plan;
        self.plan(after_ns, Event::Wake { pid, plan, wake });
    }

    /// The supervisor starts a process.
    fn start(&mut self, seat: Seat) {
        if self.is_ending || self.seats.contains_key(&seat) {
            return;
        }
        let pid = self.next_pid;
        self.next_pid += 1;
        let (role, body) = match seat {
            Seat::World => {
                self.world_term += 1;
                let mut network = self.network.borrow_mut();
                network.oracle.world_runs(self.now_ns);
                network.oracle.coverage.worlds += 1;
                (Role::World, process::world(&self.setup, self.world_term))
            }
            Seat::Runner(line) if self.setup.away[line] => {
                self.network.borrow_mut().oracle.stands_in(pid, self.setup.runners[line]);
                let (air, waking) = (Arc::clone(&self.air), Arc::clone(&self.air));
                let wake = move || waking.wake(pid);
                let stand_in = StandIn::open(&self.setup, (air, line, pid), wake);
                (Role::Runner, Body::StandIn(Box::new(stand_in)))
            }
            Seat::Away(line) | Seat::Rival(line) => {
                let (network, air) = (self.network.clone(), Arc::clone(&self.air));
                // Up to 400 millionths, which is more than a bad quartz.
                let drift = self.random.below(400);
                let away = FarProcess::new(&self.setup, network, (air, line, pid), drift);
                (Role::Runner, Body::Away(Box::new(away)))
            }
            Seat::Runner(index) => {
                let agents = self.setup.runners[index];
                (Role::Runner, Body::Runner(Box::new(process::runner(&self.setup, pid, agents))))
            }
            Seat::Allocator(_) => {
                let role = process::allocator(&self.setup, pid);
                (Role::Allocator, Body::Allocator(Box::new(role)))
            }
        };
        self.note(|| format!("{seat:?} starts as {pid}"));
        self.disturb(self.now_ns);
        let bytes = self.setup.format.layout.payload_bytes();
        let network = self.network.clone();
        let link = match seat {
            Seat::Away(_) | Seat::Rival(_) => SimulatedLink::none(network, pid),
            _ => SimulatedLink::open(network, pid, role, bytes),
        };
        let mut process = Process::new(pid, body, link, &self.setup);
        process.join().expect("a new process is alive");
        self.processes.insert(pid, process);
        self.seats.insert(seat, pid);
        self.plan_wake(pid, 0, Wake::Busy);
        if let Seat::Allocator(_) = seat {
            self.plan(0, Event::GrantLock);
        }
    }

    /// The kernel gives a free lock to an allocator that waits for it and is not stopped.
    fn grant_lock(&mut self) {
        let is_held = self.lock_holder.is_some_and(|holder| self.processes.contains_key(&holder));
        if is_held {
            return;
        }
        let waiting: Vec<u32> = self
            .processes
            .values()
            .filter(|one| {
                matches!(one.body, Body::Allocator(_)) && one.stopped_until_ns <= self.now_ns
            })
            .map(|one| one.pid)
            .collect();
        if waiting.is_empty() {
            // Whoever is stopped takes it once it runs on.
            return;
        }
        let pid = waiting[self.random.below(waiting.len() as u64) as usize];
        self.allocator_term += 1;
        let term = self.allocator_term;
        self.lock_holder = Some(pid);
        self.network.borrow_mut().oracle.leads(self.now_ns, pid, term);
        if let Some(Body::Allocator(role)) = self.processes.get_mut(&pid).map(|one| &mut one.body) {
            role.lead(term);
        }
        // The thread that waited for the lock rings its own process's bell.
        self.plan(0, Event::Ring(pid));
    }

    fn release_lock(&mut self, pid: u32) {
        if self.lock_holder == Some(pid) {
            self.lock_holder = None;
            self.network.borrow_mut().oracle.leader_is_gone(pid);
            let takes = self.random.between(100, 500) * MICROSECOND;
            self.plan(takes, Event::GrantLock);
        }
    }

    /// Everything of a process that is dead or has left is gone; the supervisor starts another.
    fn bury(&mut self, pid: u32, restarts: bool) {
        self.processes.remove(&pid);
        if let Some(endpoint) = self.network.borrow_mut().endpoints.get_mut(&pid) {
            endpoint.is_dead = true;
        }
        self.release_lock(pid);
        let seat = self.seats.iter().find(|(_, one)| **one == pid).map(|(seat, _)| *seat);
        let Some(seat) = seat else { return };
        self.seats.remove(&seat);
        if seat == Seat::World {
            self.network.borrow_mut().oracle.world_is_gone();
        }
        if restarts {
            let after = self.random.between(2 * MILLISECOND, 60 * MILLISECOND);
            self.disturb(self.now_ns + after);
            self.plan(after, Event::Start(seat));
        }
    }

    fn wake(&mut self, pid: u32, plan: u64, wake: Wake) {
        let Some(process) = self.processes.get_mut(&pid).filter(|one| one.plan == plan) else {
            return;
        };
        if let Some(left) =
            process.stopped_until_ns.checked_sub(self.now_ns).filter(|&left| left > 0)
        {
            return self.plan_wake(pid, left, Wake::Continued);
        }
        if wake == Wake::Timeout && self.setup.weather == Weather::Shared {
            let missed = self.network.borrow().missed_wake_up(pid);
            if missed {
                let detail = format!("process {pid} finds by chance what came long ago");
                let oracle = &mut self.network.borrow_mut().oracle;
                oracle.violate(Invariant::WokenAfterData, self.now_ns, detail);
            }
        }
        let mut polled = process.poll(&self.setup, &self.network);
        if self.air.is_dead(pid) {
            polled = Polled::Killed;
        }
        match polled {
            Polled::Next(Poll::Again | Poll::Answered) => {
                let takes = self.random.between(2, 20) * MICROSECOND;
                self.plan_wake(pid, takes, Wake::Busy);
            }
            Polled::Next(Poll::Wait { until_ns }) => {
                let wait = until_ns.saturating_sub(self.now_ns).clamp(1, HEARTBEAT_NS);
                self.plan_wake(pid, wait, Wake::Timeout);
            }
            Polled::Next(Poll::Ended) => {
                self.note(|| format!("process {pid} has ended"));
                self.bury(pid, !self.is_ending);
            }
            Polled::Killed => {
                self.note(|| format!("process {pid} was killed at work"));
                self.bury(pid, true);
            }
            Polled::Failed(error) => self.failed(pid, &error),
        }
        self.watch_leader();
    }

    fn failed(&mut self, pid: u32, error: &str) {
        // Allocators refuse what damaged frames show them.
        let is_world = self.seats.get(&Seat::World) == Some(&pid);
        if self.setup.weather == Weather::Hostile && !is_world {
            self.bury(pid, true);
        } else {
            self.violate(Invariant::NoFailure, format!("process {pid}: {error}"));
        }
    }

    /// The world and the supervisor deal with a leader that does not allocate.
    fn watch_leader(&mut self) {
        let missed = self.network.borrow().allocations_missed;
        let Some(holder) = self.lock_holder.filter(|_| missed >= STEP_DOWN_AFTER) else { return };
        self.network.borrow_mut().allocations_missed = 0;
        let Some(process) = self.processes.get_mut(&holder) else { return };
        let is_stopped = process.stopped_until_ns > self.now_ns;
        if is_stopped && missed >= KILL_AFTER {
            self.note(|| format!("the supervisor kills the leader {holder}"));
            self.bury(holder, true);
        } else if is_stopped {
            self.network.borrow_mut().allocations_missed = missed;
        } else if let Body::Allocator(role) = &mut process.body {
            role.stand_by();
            self.network.borrow_mut().oracle.note(self.now_ns, || "the leader steps down".into());
            self.network.borrow_mut().oracle.coverage.step_downs += 1;
            self.disturb(self.now_ns);
            self.release_lock(holder);
        }
    }

    fn any_process(&mut self) -> Option<u32> {
        // The leader and the world are worth more than one of the runners.
        match self.random.below(10) {
            0 | 1 => self.seats.get(&Seat::World).copied(),
            2 | 3 => self.lock_holder.filter(|pid| self.processes.contains_key(pid)),
            _ => {
                let pids: Vec<u32> = self.processes.keys().copied().collect();
                let index = self.random.below(pids.len() as u64) as usize;
                pids.get(index).copied()
            }
        }
    }

    fn misfortune(&mut self) {
        if self.setup.has_hosts() && self.random.chance(250) {
            return self.cut();
        }
        let kind = self.random.below(10);
        if kind == 0 {
            return self.jump();
        }
        let Some(pid) = self.any_process() else { return };
        self.disturb(self.now_ns);
        match kind {
            1..5 => self.kill(pid),
            5..8 => self.stop(pid),
            _ => self.send_away(pid),
        }
    }

    /// SIGKILL: now, or in the middle of the next work.
    fn kill(&mut self, pid: u32) {
        if self.random.chance(500) {
            self.note(|| format!("process {pid} is killed"));
            return self.bury(pid, true);
        }
        let operations = self.random.between(1, 12) as u32;
        self.note(|| format!("process {pid} will be killed after {operations} operations"));
        match self.network.borrow_mut().endpoints.get_mut(&pid) {
            Some(endpoint) => endpoint.operations_left = Some(operations),
            None => self.air.kill_after(pid, operations),
        }
        self.disturb(self.now_ns + HEARTBEAT_NS);
    }

    /// SIGSTOP, and SIGCONT some time later.
    fn stop(&mut self, pid: u32) {
        let stopped_ns = self.random.between(MILLISECOND, 120 * MILLISECOND);
        self.stop_for(pid, stopped_ns);
        self.note(|| format!("process {pid} is stopped for {:.3} ms", stopped_ns as f64 / 1e6));
    }

    fn stop_for(&mut self, pid: u32, stopped_ns: u64) {
        let until = self.now_ns + stopped_ns;
        let Some(process) = self.processes.get_mut(&pid) else { return };
        process.stopped_until_ns = process.stopped_until_ns.max(until);
        let until = process.stopped_until_ns;
        if let Body::Away(away) = &mut process.body {
            away.since_ns = away.since_ns.max(until);
        }
        if matches!(process.body, Body::Allocator(_)) {
            // A lock that became free meanwhile is taken then.
            self.plan(until - self.now_ns + 1, Event::GrantLock);
        }
        self.plan_wake(pid, until - self.now_ns, Wake::Continued);
        let is_world = self.seats.get(&Seat::World) == Some(&pid);
        let oracle = &mut self.network.borrow_mut().oracle;
        oracle.disturb(until);
        oracle.leader_runs(pid, until);
        if is_world {
            oracle.world_runs(until);
        }
    }

    /// SIGTERM: it says goodbye.
    fn send_away(&mut self, pid: u32) {
        self.note(|| format!("process {pid} leaves"));
        if let Some(process) = self.processes.get_mut(&pid) {
            // One that was about to be killed may be killed while it says so.
            let _ = process.leave();
        }
        self.bury(pid, true);
    }

    /// The line to another host is cut.
    fn cut(&mut self) {
        let lines: Vec<usize> =
            (0..self.setup.away.len()).filter(|&one| self.setup.away[one]).collect();
        let line = lines[self.random.below(lines.len() as u64) as usize];
        let until_ns = self.now_ns + self.random.between(5 * MILLISECOND, 700 * MILLISECOND);
        self.note(|| format!("line {line} is cut until {:.3} ms", until_ns as f64 / 1e6));
        self.air.cut(line, until_ns);
        self.disturb(until_ns);
    }

    /// The whole machine stands still, and its clock goes on.
    fn jump(&mut self) {
        let jumped = self.random.between(MILLISECOND, 300 * MILLISECOND);
        self.note(|| format!("time jumps by {:.3} ms", jumped as f64 / 1e6));
        let pids: Vec<u32> = self.processes.keys().copied().collect();
        for pid in pids {
            self.stop_for(pid, jumped);
        }
    }

    fn check_end(&mut self) {
        // A rival that never acted hears no last words; a person ends it.
        let may_stay = |one: &Process| self.setup.has_rivals && matches!(one.body, Body::Away(_));
        let left = self.processes.values().filter(|one| !may_stay(one));
        let left: Vec<u32> = left.map(|one| one.pid).collect();
        if !left.is_empty() && self.setup.weather != Weather::Hostile {
            self.violate(Invariant::Ends, format!("processes {left:?} go on without a world"));
        }
    }
}
