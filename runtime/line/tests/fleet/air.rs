//! What is between the hosts: datagrams on their way, in virtual time.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use sortie_line::{Carrier, Hear};

use super::network::Losses;
use super::random::Random;
use super::setup::{MICROSECOND, MILLISECOND};

/// An end of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum End {
    /// The team's, of the line of this number.
    Home(usize),
    /// A runner's, by its process.
    Away(u32),
}

struct Datagram {
    visible_ns: u64,
    number: u64,
    to: End,
    from: u32,
    bytes: Vec<u8>,
}

/// All lines. Its carriers are shared with the ends, and those may be shared between threads, of which here is one.
pub(crate) struct Air(Mutex<State>);

struct State {
    now_ns: u64,
    random: Random,
    losses: Losses,
    /// Until when each line is cut.
    cut_until_ns: BTreeMap<usize, u64>,
    sent: u64,
    on_the_way: Vec<Datagram>,
    /// When what was sent last to an end is seen there.
    last_visible_ns: BTreeMap<End, u64>,
    /// Who hears at home.
    ears: BTreeMap<usize, Arc<Hear>>,
    /// For the scheduler: when something comes, and where.
    arrivals: Vec<(u64, End)>,
    /// Processes at home that have something to read.
    woken: Vec<u32>,
    /// How many datagrams a process sends before it dies.
    operations_left: BTreeMap<u32, u32>,
    /// When each runner heard something.
    heard_ns: BTreeMap<u32, u64>,
    /// What is said at home reaches all runners of the line.
    is_told_to_all: bool,
    /// The runners of each line.
    runners: BTreeMap<usize, Vec<u32>>,
}

impl Air {
    pub(crate) fn new(random: Random, is_told_to_all: bool) -> Arc<Self> {
        Arc::new(Self(Mutex::new(State {
            is_told_to_all,
            runners: BTreeMap::new(),
            now_ns: 0,
            random,
            losses: Losses::default(),
            cut_until_ns: BTreeMap::new(),
            sent: 0,
            on_the_way: Vec::new(),
            last_visible_ns: BTreeMap::new(),
            ears: BTreeMap::new(),
            arrivals: Vec::new(),
            woken: Vec::new(),
            operations_left: BTreeMap::new(),
            heard_ns: BTreeMap::new(),
        })))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().expect("nobody panics with it")
    }

    pub(crate) fn set_time(&self, now_ns: u64) {
        self.state().now_ns = now_ns;
    }

    pub(crate) fn set_losses(&self, losses: Losses) {
        self.state().losses = losses;
    }

    pub(crate) fn cut(&self, line: usize, until_ns: u64) {
        self.state().cut_until_ns.insert(line, until_ns);
    }

    /// The process dies at this one of its next datagrams.
    pub(crate) fn kill_after(&self, pid: u32, operations: u32) {
        self.state().operations_left.insert(pid, operations);
    }

    pub(crate) fn is_dead(&self, pid: u32) -> bool {
        self.state().operations_left.get(&pid) == Some(&0)
    }

    pub(crate) fn take_arrivals(&self) -> Vec<(u64, End)> {
        std::mem::take(&mut self.state().arrivals)
    }

    pub(crate) fn wake(&self, pid: u32) {
        self.state().woken.push(pid);
    }

    pub(crate) fn take_woken(&self) -> Vec<u32> {
        std::mem::take(&mut self.state().woken)
    }

    /// When this runner heard something last.
    pub(crate) fn heard_ns(&self, pid: u32) -> Option<u64> {
        self.state().heard_ns.get(&pid).copied()
    }

    /// Whoever hears at home is told what has come.
    pub(crate) fn deliver(&self, line: usize) {
        loop {
            let mut state = self.state();
            let Some(Datagram { from, bytes, .. }) = state.next(End::Home(line)) else { return };
            let ear = state.ears.get(&line).cloned();
            // It answers at once.
            drop(state);
            if let Some(hear) = ear {
                hear(&bytes, Some(address(from)));
            }
        }
    }
}

impl State {
    /// The next datagram that can be seen there by now.
    fn next(&mut self, to: End) -> Option<Datagram> {
        let seen = self.on_the_way.iter().enumerate();
        let seen = seen.filter(|(_, one)| one.to == to && one.visible_ns <= self.now_ns);
        let (index, _) = seen.min_by_key(|(_, one)| (one.visible_ns, one.number))?;
        Some(self.on_the_way.remove(index))
    }

    fn send(&mut self, line: usize, from: u32, to: End, bytes: &[u8]) {
        if let Some(left) = self.operations_left.get_mut(&from) {
            *left = left.saturating_sub(1);
            if *left == 0 {
                return;
            }
        }
        if self.cut_until_ns.get(&line).is_some_and(|until_ns| self.now_ns < *until_ns) {
            return;
        }
        let Losses { lost, doubled, late, damaged } = self.losses;
        let takes = self.random.between(20, 200) * MICROSECOND;
        let last = self.last_visible_ns.entry(to).or_default();
        *last = (self.now_ns + takes).max(*last);
        let in_order = *last;
        let copies = if self.random.chance(doubled) { 2 } else { 1 };
        for _ in 0..copies {
            self.sent += 1;
            if self.random.chance(lost) {
                continue;
            }
            let is_late = self.random.chance(late);
            let delay = if is_late { self.random.between(0, 40 * MILLISECOND) } else { 0 };
            let mut bytes = bytes.to_vec();
            if self.random.chance(damaged) {
                let at = self.random.below(bytes.len() as u64) as usize;
                bytes[at] ^= self.random.between(1, 255) as u8;
            }
            let visible_ns = in_order + delay;
            self.arrivals.push((visible_ns, to));
            self.on_the_way.push(Datagram { visible_ns, number: self.sent, to, from, bytes });
        }
    }
}

/// Where a process says things from.
fn address(pid: u32) -> SocketAddr {
    SocketAddr::from(([10, 0, 0, 1], u16::try_from(pid).expect("there are few processes")))
}

/// One process's end of a line.
pub(crate) struct SimulatedCarrier {
    air: Arc<Air>,
    line: usize,
    pid: u32,
    is_home: bool,
    /// When the host's clock was 0.
    began: Instant,
    /// How much faster the host's clock goes, in millionths.
    drift: u64,
}

impl SimulatedCarrier {
    pub(crate) fn home(air: Arc<Air>, line: usize, pid: u32) -> Arc<Self> {
        Arc::new(Self { air, line, pid, is_home: true, began: Instant::now(), drift: 0 })
    }

    /// A runner's, on a host with a clock of its own.
    pub(crate) fn away(air: Arc<Air>, line: usize, pid: u32, drift: u64) -> Arc<Self> {
        let mut state = air.state();
        let runners = state.runners.entry(line).or_default();
        if !runners.contains(&pid) {
            runners.push(pid);
        }
        drop(state);
        Arc::new(Self { air, line, pid, is_home: false, began: Instant::now(), drift })
    }
}

impl Carrier for SimulatedCarrier {
    fn send(&self, datagram: &[u8], to: Option<SocketAddr>) {
        let mut state = self.air.state();
        let to = match (self.is_home, to) {
            (true, Some(_)) if state.is_told_to_all => {
                for runner in state.runners.get(&self.line).cloned().unwrap_or_default() {
                    state.send(self.line, self.pid, End::Away(runner), datagram);
                }
                return;
            }
            (true, Some(to)) => End::Away(to.port().into()),
            (true, None) => return,
            (false, _) => End::Home(self.line),
        };
        state.send(self.line, self.pid, to, datagram);
    }

    fn receive(&self, room: &mut [u8]) -> Option<(usize, Option<SocketAddr>)> {
        let mut state = self.air.state();
        let datagram = state.next(End::Away(self.pid))?;
        let now_ns = state.now_ns;
        state.heard_ns.insert(self.pid, now_ns);
        room[..datagram.bytes.len()].copy_from_slice(&datagram.bytes);
        Some((datagram.bytes.len(), None))
    }

    /// The scheduler waits for the processes.
    fn wait(&self, _: Duration) {}

    fn address(&self) -> String {
        format!("line {}", self.line)
    }

    fn now(&self) -> Instant {
        let now_ns = self.air.state().now_ns;
        self.began + Duration::from_nanos(now_ns + now_ns / 1_000_000 * self.drift)
    }

    fn call(&self, hear: Hear) -> Result<(), Hear> {
        if !self.is_home {
            return Err(hear);
        }
        self.air.state().ears.insert(self.line, Arc::new(hear));
        Ok(())
    }
}
