//! A team of eight processes at 1 kHz for as long as one likes: what it misses, and what it holds.
//!
//! A tick that takes more than 80 % of the period misses it. On each core a witness of the same
//! priority does nothing but look at the clock: a miss while no witness was late is the team's own.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use rustix::process::{Pid, getpid};
use rustix::thread::{CpuSet, Timespec, clock_nanosleep_absolute, sched_setaffinity};
use rustix::time::ClockId;
use sortie_core::link::Clock;
use sortie_core::roles::{TickReport, WorldObserver};
use sortie_ipc::{BellKind, MonotonicClock, WorldSettings};

use super::{AGENTS, run_team};

const PERIOD: Duration = Duration::from_millis(1);
/// Of the period, the time in which the actions must be in.
const ACT_NS: u64 = 800_000;
/// Time between two looks of a witness.
const LOOK_NS: u64 = 250_000;
/// A witness that wakes so much later than it should has seen a stall.
const STALL_NS: u64 = 200_000;
/// Ticks before what counts, in which connections are made and caches filled.
const WARM_UP: usize = 2_000;

/// Records for which there is memory from the start, so that only the team's own memory could grow.
const RECORDS: usize = 1 << 20;

/// Times of the domain's clock, in nanoseconds: from, to.
type Span = (u64, u64);

struct Soak {
    seconds: usize,
    ticks: usize,
    misses: Vec<Span>,
    longest_ns: u64,
    /// KiB that all processes hold, after the warm-up and every tenth of the time.
    resident: Vec<u64>,
}

impl WorldObserver for Soak {
    fn tick(&mut self, report: &TickReport<'_>) {
        self.ticks += 1;
        if self.ticks <= WARM_UP {
            return;
        }
        self.longest_ns = self.longest_ns.max(report.tick_ns);
        if report.tick_ns > ACT_NS {
            self.misses.push((report.published_ns, report.published_ns + report.tick_ns));
        }
        if (self.ticks - WARM_UP - 1).is_multiple_of((self.seconds * 100).max(1)) {
            self.resident.push(resident());
        }
    }
}

/// Runs the team for so long and prints what happened.
pub(crate) fn soak(seconds: usize) {
    let ticks = seconds * 1_000 + WARM_UP;
    let mut soak = Soak {
        seconds,
        ticks: 0,
        misses: touched(RECORDS),
        longest_ns: 0,
        resident: Vec::with_capacity(16),
    };
    let is_over = AtomicBool::new(false);
    let stalls = Mutex::new(touched(RECORDS));
    let started = Instant::now();
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let settings = WorldSettings {
        episodes: Some(1),
        bell: BellKind::Doorbell,
        tick_interval: PERIOD,
        ..WorldSettings::default()
    };
    let alone: Vec<String> = (0..AGENTS).map(|agent| agent.to_string()).collect();
    let counters = std::thread::scope(|scope| {
        for core in 0..cores {
            let (is_over, stalls) = (&is_over, &stalls);
            scope.spawn(move || witness(core, is_over, stalls));
        }
        let name = format!("soak{}", std::process::id());
        let counters = run_team(&name, &alone, &settings, ticks, &mut soak);
        is_over.store(true, Ordering::Relaxed);
        counters
    });
    let stalls = stalls.into_inner().unwrap();
    let is_unseen = |miss: &&Span| stalled_ns(miss, &stalls) == 0;
    let is_longer = |miss: &&Span| miss.1 - miss.0 > ACT_NS + stalled_ns(miss, &stalls);
    let [unseen, longer] = [
        soak.misses.iter().filter(is_unseen).count(),
        soak.misses.iter().filter(is_longer).count(),
    ];
    let stalled: u64 = stalls.iter().map(|stall| stall.1 - stall.0).sum();
    let share = stalled as f64 / (seconds * cores) as f64 * 1e-7;
    let rate = ticks as f64 / started.elapsed().as_secs_f64();
    println!("{AGENTS} processes, {ticks} ticks paced at 1 kHz ({rate:.0} a second):");
    println!("  stalls seen             {} ({share:.2} % of the cores' time)", stalls.len());
    println!("  ticks over {} us       {}", ACT_NS / 1_000, soak.misses.len());
    println!("  ... without a stall     {unseen}");
    println!("  ... beyond the stalls   {longer}");
    println!("  longest tick            {} us", soak.longest_ns / 1_000);
    println!("  missed wake-ups         {}", counters.missed_wake_ups);
    println!("  fallback actions        {}", counters.fallbacks);
    println!("  resident, KiB           {:?}", soak.resident);
}

/// An empty list whose memory is there already.
fn touched(records: usize) -> Vec<Span> {
    let mut records = vec![(1, 1); records];
    records.clear();
    records
}

/// The time of a miss in which witnesses were late.
fn stalled_ns(miss: &Span, stalls: &[Span]) -> u64 {
    let overlap = |stall: &Span| stall.1.min(miss.1).saturating_sub(stall.0.max(miss.0));
    stalls.iter().map(overlap).sum()
}

/// Looks at the clock, on one core, until it is over; notes when it could not.
fn witness(core: usize, is_over: &AtomicBool, stalls: &Mutex<Vec<Span>>) {
    let mut cores = CpuSet::new();
    cores.set(core);
    sched_setaffinity(None, &cores).unwrap();
    let mut due = MonotonicClock.now_ns();
    while !is_over.load(Ordering::Relaxed) {
        due += LOOK_NS;
        let until = Timespec {
            tv_sec: (due / 1_000_000_000) as i64,
            tv_nsec: (due % 1_000_000_000) as i64,
        };
        let _ = clock_nanosleep_absolute(ClockId::Monotonic, &until);
        let now = MonotonicClock.now_ns();
        if now > due + STALL_NS {
            stalls.lock().unwrap().push((due, now));
            due = now;
        }
    }
}

/// KiB of memory that this process and its children hold, shared pages counted for each.
fn resident() -> u64 {
    let own = getpid();
    let thread = own.as_raw_pid();
    let children = std::fs::read_to_string(format!("/proc/{thread}/task/{thread}/children"));
    let children = children.unwrap_or_default();
    let pids = children.split_whitespace().filter_map(|pid| Pid::from_raw(pid.parse().ok()?));
    pids.chain([own]).map(resident_of).sum()
}

fn resident_of(process: Pid) -> u64 {
    let path = format!("/proc/{}/status", process.as_raw_pid());
    let status = std::fs::read_to_string(path).unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.and_then(|line| line.split_whitespace().next()?.parse().ok()).unwrap_or(0)
}
