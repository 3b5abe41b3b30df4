//! Starts of real processes: in any order, killed half-way, and on machines that are not fit for them.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, getuid, kill_process};
use sortie_core::roles::{TickReport, WorldObserver};
use sortie_ipc::{Domain, Error, Stop, WorldSettings, world_process};

use crate::processes::{await_nothing_left, child, running};
use crate::toy::{self, ToyWorld, Watchdog};

/// A generator of pauses and orders, by seed.
struct Random(u64);

impl Random {
    fn below(&mut self, end: u64) -> u64 {
        self.0 = toy::mix(self.0, 1);
        (self.0 >> 33) % end
    }

    fn shuffle<T>(&mut self, items: &mut [T]) {
        for last in (1..items.len()).rev() {
            items.swap(last, self.below(last as u64 + 1) as usize);
        }
    }
}

/// Lets time pass without a sleep that the system rounds up.
fn pass(time: Duration) {
    let until = Instant::now() + time;
    while Instant::now() < until {
        thread::yield_now();
    }
}

#[test]
fn teams_start_in_any_order() {
    let _watchdog = Watchdog::new();
    let mut random = Random(1);
    for _ in 0..20 {
        let domain = toy::domain();
        let agents = ["0", "1", "2", "3", "4", "5", "6", "7"];
        let mut roles = [&agents[..], &["allocator"; 2], &["world of eight"]].concat();
        random.shuffle(&mut roles);
        let mut team = Vec::new();
        let mut world = None;
        for role in roles {
            let mut command = child(&domain, role);
            match role {
                "world of eight" => world = Some(command.stdout(Stdio::piped()).spawn().unwrap()),
                _ => team.push(command.spawn().unwrap()),
            }
            pass(Duration::from_millis(random.below(10)));
        }
        // It acts when all eight runners and an allocator have joined.
        let mut world = running(world.unwrap());
        kill_process(Pid::from_child(&world), Signal::TERM).unwrap();
        assert_eq!(world.wait().unwrap().code(), Some(130));
        for mut process in team {
            // A standby may have come when the world had said goodbye: it would wait for the next.
            kill_process(Pid::from_child(&process), Signal::TERM).unwrap();
            assert!(matches!(process.wait().unwrap().code(), Some(0 | 130)));
        }
        assert_eq!(toy::leftovers(&domain), [""; 0]);
    }
}

/// Counts ticks, those that the runner who stays missed, and ends the world when another agent acts
/// after all kills.
struct Holder {
    ticks: u64,
    missed: u64,
    /// Ticks after all kills in which the other agent acted.
    acted: u64,
    kills_done: Stop,
    enough: Stop,
}

impl WorldObserver for Holder {
    fn tick(&mut self, report: &TickReport<'_>) {
        self.ticks += 1;
        let acts = |agent| report.answers().any(|answer| answer.agent == agent);
        let must_act = report.actions[1] != sortie_core::NO_ACTION;
        self.missed += u64::from(must_act && !acts(1));
        self.acted += u64::from(self.kills_done.is_set() && acts(0));
        // The first answer may be that of the last one that was killed: who comes after the world's end would wait for another.
        if self.acted == 2 {
            self.enough.stop();
        }
    }
}

#[test]
fn runners_killed_while_they_start_take_nothing_from_those_that_run() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let (kills_done, enough) = (Stop::new(), Stop::new());
    let (kills, end) = (kills_done.clone(), enough.clone());
    let mut holder = Holder { ticks: 0, missed: 0, acted: 0, kills_done: kills, enough: end };
    let settings = WorldSettings {
        required: 0b010,
        allocator: true,
        strict: false,
        period: Duration::from_millis(10),
        ..WorldSettings::default()
    };
    let steady = ["1", "allocator"].map(|role| child(&domain, role).spawn().unwrap());
    let (starting, done) = (domain.clone(), kills_done.clone());
    let killer = thread::spawn(move || {
        let mut random = Random(2);
        for _ in 0..200 {
            let mut starter = child(&starting, "0,2").spawn().unwrap();
            pass(Duration::from_micros(random.below(25_000)));
            starter.kill().unwrap();
            starter.wait().unwrap();
        }
        done.stop();
        child(&starting, "0,2").spawn().unwrap()
    });
    let (contract, mut world) = (toy::contract(), ToyWorld::new());
    let start = |_: &mut _| Ok(());
    let ended =
        world_process(&domain, &contract, &mut world, &settings, start, &mut holder, &enough);
    assert!(matches!(ended, Err(Error::Interrupted)), "{ended:?}");
    let last = killer.join().unwrap();
    for mut process in steady.into_iter().chain([last]) {
        assert!(process.wait().unwrap().success());
    }
    // The machine may be busy with other things; a team that is disturbed misses nearly all.
    assert!(holder.ticks > 100, "{}", holder.ticks);
    assert!(holder.missed * 5 < holder.ticks, "{} of {}", holder.missed, holder.ticks);
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}

/// `command` where shared memory is this large.
fn with_shared_memory(size: &str, command: &Command) -> Command {
    let mut confined = Command::new("unshare");
    let script = format!("mount -t tmpfs -o size={size} tmpfs /dev/shm && exec \"$@\"");
    if !getuid().is_root() {
        confined.arg("--map-root-user");
    }
    confined.args(["--mount", "sh", "-c", &script, "sh"]);
    confined.arg(std::env::current_exe().unwrap()).args(command.get_args());
    for (name, value) in command.get_envs() {
        confined.env(name, value.unwrap_or_default());
    }
    confined
}

#[test]
fn shared_memory_that_is_too_small_is_refused_and_not_run_into() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let small = with_shared_memory("256k", &child(&domain, "world without team"));
    let refused = { small }.stderr(Stdio::piped()).output().unwrap();
    let told = String::from_utf8_lossy(&refused.stderr);
    assert_eq!(refused.status.code(), Some(74), "{told}");
    assert!(told.contains(" KiB free, the domain needs "), "{told}");
    // What passes the check runs to its end.
    let enough = with_shared_memory("8m", &child(&domain, "one episode"));
    assert!({ enough }.stdout(Stdio::null()).status().unwrap().success());
}

#[test]
fn a_bus_error_is_explained() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let mut world = child(&domain, "world");
    let world = running(world.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap());
    kill_process(Pid::from_child(&world), Signal::BUS).unwrap();
    let ended = world.wait_with_output().unwrap();
    let told = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(74), "{told}");
    assert!(told.contains("/dev/shm is full"), "{told}");
    await_nothing_left(&domain);
}

#[test]
fn a_domain_of_another_user_is_refused() {
    let _watchdog = Watchdog::new();
    let parent = tempfile::Builder::new().prefix("sortie-other-").tempdir_in("/dev/shm").unwrap();
    fs::set_permissions(parent.path(), fs::Permissions::from_mode(0o755)).unwrap();
    let domain = Domain::under(parent.path(), "theirs").unwrap();
    let _member = domain.enter().unwrap();
    let mut joins = child(&domain, "allocator");
    if getuid().is_root() {
        joins.uid(65_534).gid(65_534);
    } else {
        // Only the superuser can be somebody else: what is closed to oneself is as good.
        fs::set_permissions(domain.base(), fs::Permissions::from_mode(0o500)).unwrap();
        fs::set_permissions(domain.base().join("init.lock"), fs::Permissions::from_mode(0o0))
            .unwrap();
    }
    let refused = joins.env("SORTIE_BASE", parent.path()).stderr(Stdio::piped()).output().unwrap();
    fs::set_permissions(domain.base(), fs::Permissions::from_mode(0o700)).unwrap();
    let told = String::from_utf8_lossy(&refused.stderr);
    assert_eq!(refused.status.code(), Some(74), "{told}");
    let reason = if getuid().is_root() { "belongs to user 0" } else { "Permission denied" };
    assert!(told.contains(reason), "{told}");
}
