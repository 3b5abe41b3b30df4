//! Agents of a team that another host acts for: here another process, which knows nothing of the team's domain.

use std::io::{BufRead, BufReader};
use std::net::{SocketAddr, UdpSocket};
use std::path::Path;
use std::process::{Child, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use serde_json::Value;

use crate::support::{
    BUNDLE, Ending as _, TestDomain, assert_fails, interrupt, json, output, resume, sortie, stop,
    wait_until,
};

/// An address that nobody listens at.
fn free_address() -> String {
    let socket = UdpSocket::bind("127.0.0.1:0").expect("a socket");
    socket.local_addr().expect("its address").to_string()
}

/// A line that can be cut: whoever is away sends to its address, and it passes on what both ends say.
struct Line {
    address: String,
    is_cut: Arc<AtomicBool>,
}

impl Line {
    fn to(home: &str) -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a socket");
        let address = socket.local_addr().expect("its address").to_string();
        let home: SocketAddr = home.parse().expect("an address");
        let is_cut = Arc::new(AtomicBool::new(false));
        let cut = Arc::clone(&is_cut);
        // It ends with the test's process.
        std::thread::spawn(move || {
            let (mut away, mut buffer) = (None, vec![0; 65_536]);
            while let Ok((len, from)) = socket.recv_from(&mut buffer) {
                let to = match from == home {
                    true => away,
                    false => {
                        away = Some(from);
                        Some(home)
                    }
                };
                if let Some(to) = to.filter(|_| !cut.load(Ordering::Relaxed)) {
                    let _ = socket.send_to(&buffer[..len], to);
                }
            }
        });
        Self { address, is_cut }
    }

    fn cut(&self, is_cut: bool) {
        self.is_cut.store(is_cut, Ordering::Relaxed);
    }
}

/// A runner or an allocator elsewhere, and what it tells.
struct Away {
    child: Child,
    lines: Receiver<String>,
}

impl Away {
    fn join(address: &str, key: &str) -> Self {
        Self::start(&["join", address, BUNDLE, "--agents", "3,4", "--key", key])
    }

    fn start(words: &[&str]) -> Self {
        let mut child =
            sortie(words).stderr(Stdio::piped()).spawn().expect("the command line starts");
        let told = BufReader::new(child.stderr.take().expect("standard error"));
        let (tell, lines) = channel();
        std::thread::spawn(move || {
            told.lines().map_while(Result::ok).try_for_each(|line| tell.send(line))
        });
        Self { child, lines }
    }

    /// Its next line, which has these words.
    fn says(&self, words: &str) {
        let line = self.lines.recv_timeout(Duration::from_secs(60)).expect("it says something");
        assert!(line.contains(words), "{line:?} is without {words:?}");
    }
}

impl Drop for Away {
    /// It would look for its team for ever where a test fails.
    fn drop(&mut self) {
        let _ = self.child.kill();
    }
}

/// Waits until the team has played so many ticks more.
fn ticks_pass(domain: &TestDomain, ticks: u64) {
    let tick = || {
        let told = json(&["control", "info", "--domain", &domain.id, "--json"]);
        told["processes"][0]["tick"].as_u64().expect("a tick")
    };
    let first = tick();
    wait_until("ticks pass", || tick() > first + ticks);
}

#[test]
fn agents_on_another_host_act_through_cuts_and_restarts() {
    let domain = TestDomain::new("hosts");
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let (key, record, address) = (path("line.key"), path("run.mcap"), free_address());
    let mut up = sortie(&["up", BUNDLE, "--rate", "100", "--quiet", "--domain", &domain.id])
        .args(["--away", "3,4", "--listen", &address, "--key", &key])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the command line starts");
    wait_until("there is a secret", || Path::new(&key).exists());
    let line = Line::to(&address);
    let mut away = Away::join(&line.address, &key);
    away.says("acting for agents 3, 4; a round trip takes");
    wait_until("a process acts for every agent", || {
        let told = output(&["doctor", "--domain", &domain.id]);
        let told = String::from_utf8_lossy(&told.stdout).into_owned();
        told.contains("a process acts for every agent")
            && told.contains(" on host 4, model ")
            && !told.contains("version 0.0")
    });
    let told = json(&["top", "--domain", &domain.id, "--for", "0.5", "--json"]);
    let hosts = (0..5).map(|agent| told["agents"][agent]["host"].as_u64());
    assert!(hosts.eq([0, 0, 0, 4, 4].map(Some)), "{told}");
    let recorder = ["record", BUNDLE, "--output", &record, "--domain", &domain.id, "--json"];
    let mut recorder =
        sortie(&recorder).stdout(Stdio::null()).spawn().expect("the command line starts");
    wait_until("it records", || std::fs::metadata(&record).is_ok_and(|it| it.len() > 1_500_000));
    line.cut(true);
    away.says("cut off: nothing is heard of the team, and nothing is done");
    ticks_pass(&domain, 20);
    line.cut(false);
    away.says("the team is heard again");
    // One that is killed gives way to the next.
    away.child.kill().expect("it lives");
    away.child.ended();
    let mut next = Away::join(&line.address, &key);
    next.says("acting for agents 3, 4");
    ticks_pass(&domain, 60);
    json(&["control", "shut-down", "--domain", &domain.id, "--json"]);
    assert_eq!(up.ended().code(), Some(0));
    assert_eq!(next.child.ended().code(), Some(0));
    assert_eq!(recorder.ended().code(), Some(0));
    wait_until("all have left", || domain.leftovers().is_empty());
    // What was decided elsewhere is made again here, bit for bit.
    let remade = json(&["remake", &record, "--json"]);
    assert_eq!(remade["different"], 0, "{remade}");
    assert!(remade["actions"].as_u64() > Some(500), "{remade}");
}

/// A team with a runner and an allocator elsewhere, which hear of its end however it ends.
fn whoever_is_away_hears_of_the_end(name: &str, code: i32, end: impl Fn(&TestDomain, &Child)) {
    let domain = TestDomain::new(name);
    let folder = tempfile::tempdir().expect("a folder");
    let key = folder.path().join("line.key").to_string_lossy().into_owned();
    let (listen, allocator_listen) = (free_address(), free_address());
    let mut up = sortie(&["up", BUNDLE, "--rate", "100", "--quiet", "--domain", &domain.id])
        .args(["--away", "3,4", "--listen", &listen, "--key", &key])
        .args(["--allocator-listen", &allocator_listen])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the command line starts");
    wait_until("there is a secret", || Path::new(&key).exists());
    let mut runner = Away::join(&listen, &key);
    runner.says("acting for agents 3, 4");
    let join = ["join", &allocator_listen, BUNDLE, "--allocator", "--key", &key];
    let mut allocator = Away::start(&join);
    allocator.says("allocating");
    end(&domain, &up);
    assert_eq!(up.ended().code(), Some(code));
    assert_eq!(runner.child.ended().code(), Some(0));
    assert_eq!(allocator.child.ended().code(), Some(0));
}

#[test]
fn a_signal_to_the_team_reaches_who_stands_in_before_the_worlds_end_does() {
    whoever_is_away_hears_of_the_end("hosts-signal", 130, |_, up| interrupt(up));
}

#[test]
fn who_stands_in_runs_again_only_when_the_world_has_ended_and_it_is_told_to_end() {
    whoever_is_away_hears_of_the_end("hosts-late", 0, |domain, _| {
        let told = json(&["control", "info", "--domain", &domain.id, "--json"]);
        let processes = told["processes"].as_array().expect("a list");
        let pids = |is_one: &dyn Fn(&Value) -> bool| -> Vec<u32> {
            let pids = processes.iter().filter(|one| is_one(one)).map(|one| one["pid"].as_u64());
            pids.map(|pid| pid.expect("a process id") as u32).collect()
        };
        let world = pids(&|one| one["role"] == "world")[0];
        let late = pids(&|one| one["role"] != "world");
        late.iter().for_each(|&pid| stop(pid));
        // Nobody else answers: those that are stopped cannot.
        output(&["control", "shut-down", "--domain", &domain.id]);
        wait_until("the world has ended", || !Path::new(&format!("/proc/{world}")).exists());
        late.iter().for_each(|&pid| resume(pid));
    });
}

/// Who leads the allocators, and in which term; none where nobody says so.
fn leader(domain: &TestDomain) -> Option<(u64, u64)> {
    let told = json(&["control", "info", "--domain", &domain.id, "--json"]);
    let mut processes = told["processes"].as_array().expect("a list").iter();
    let leader = processes.find(|one| one["role"] == "allocator" && one["leads"] == true)?;
    Some((leader["pid"].as_u64()?, leader["term"].as_u64()?))
}

#[test]
fn an_allocator_on_another_host_leads_while_it_is_heard() {
    let domain = TestDomain::new("hosts-allocator");
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let (key, record, address) = (path("line.key"), path("run.mcap"), free_address());
    let mut up = sortie(&["up", BUNDLE, "--rate", "50", "--quiet", "--domain", &domain.id])
        .args(["--standbys", "0", "--allocator-listen", &address, "--key", &key])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the command line starts");
    wait_until("there is a secret", || Path::new(&key).exists());
    wait_until("the team plays", || {
        output(&["control", "info", "--domain", &domain.id]).status.success()
    });
    let line = Line::to(&address);
    let join = ["join", &line.address, BUNDLE, "--allocator", "--key", &key];
    let other = output(&[&join[..], &["--seed", "2"]].concat());
    assert_fails(
        &other,
        78,
        &["refuses: the contract (by --allocation, --seed and --proposals, too)"],
    );
    let mut away = Away::start(&join);
    away.says("allocating; a round trip takes");
    wait_until("somebody at home leads", || leader(&domain).is_some());
    let home = leader(&domain).expect("somebody leads");
    // Who leads steps down, and the one away is the only other candidate.
    json(&["control", "step-down", "--domain", &domain.id, "--json"]);
    let leads_next = |before: (u64, u64)| {
        wait_until("another one leads", || {
            leader(&domain).is_some_and(|(pid, term)| pid != before.0 && term > before.1)
        });
        leader(&domain).expect("somebody leads")
    };
    let stand_in = leads_next(home);
    let recorder = ["record", BUNDLE, "--output", &record, "--domain", &domain.id, "--json"];
    let mut recorder =
        sortie(&recorder).stdout(Stdio::null()).spawn().expect("the command line starts");
    ticks_pass(&domain, 100);
    line.cut(true);
    away.says("cut off");
    let again = leads_next(stand_in);
    assert_eq!(again.0, home.0, "the one at home leads again");
    ticks_pass(&domain, 20);
    line.cut(false);
    away.says("the team is heard again");
    json(&["control", "step-down", "--domain", &domain.id, "--json"]);
    assert_eq!(leads_next(again).0, stand_in.0);
    ticks_pass(&domain, 50);
    json(&["control", "shut-down", "--domain", &domain.id, "--json"]);
    assert_eq!(up.ended().code(), Some(0));
    assert_eq!(away.child.ended().code(), Some(0));
    assert_eq!(recorder.ended().code(), Some(0));
    wait_until("all have left", || domain.leftovers().is_empty());
    // What was allocated elsewhere is what is allocated here.
    let remade = json(&["remake", &record, "--json"]);
    assert_eq!(remade["different"], 0, "{remade}");
    assert!(remade["allocations"].as_u64() > Some(20), "{remade}");
}

#[test]
fn who_does_not_fit_is_refused_by_what_differs() {
    let domain = TestDomain::new("hosts-no");
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let (key, other, address) = (path("line.key"), path("other.key"), free_address());
    let line = ["--away", "3,4", "--listen", &address];
    let up = |more: &[&str]| {
        output(&[&["up", BUNDLE, "--domain", &domain.id], &line[..], more].concat())
    };
    assert_fails(&up(&[]), 2, &["--key", "--plain"]);
    let absent = up(&["--absent", "3", "--plain"]);
    assert_fails(&absent, 2, &["no agent 3 to be away"]);
    let mut team = sortie(&["up", BUNDLE, "--domain", &domain.id, "--quiet", "--key", &key]);
    let team = team.args(line).stdout(Stdio::null()).stderr(Stdio::null());
    let mut team = team.spawn().expect("the command line starts");
    wait_until("somebody stands in", || {
        let told = output(&["control", "info", "--domain", &domain.id]);
        String::from_utf8_lossy(&told.stdout).contains("agents 3 4")
    });
    let join = |bundle: &str, agents: &str, key: &str| {
        output(&["join", &address, bundle, "--agents", agents, "--key", key])
    };
    let large = format!("{BUNDLE}-large");
    assert_fails(&join(&large, "3,4", &key), 78, &["refuses: the bundle is", " here, "]);
    assert_fails(
        &join(BUNDLE, "3", &key),
        78,
        &["refuses: the set of agents is 3,4 here, 3 there"],
    );
    assert_fails(&join("models/routing", "3,4", &key), 78, &["refuses: the contract is"]);
    assert_fails(&join(BUNDLE, "3,4", &other), 66, &["other.key"]);
    std::fs::write(&other, [7; 32]).expect("there is room");
    assert_fails(&join(BUNDLE, "3,4", &other), 77, &["chmod 600"]);
    assert_fails(
        &output(&["join", "nobody", BUNDLE, "--agents", "3", "--plain"]),
        2,
        &["no address"],
    );
    // A team with agents away keeps its bundle: nobody here can open theirs.
    let reload = output(&["control", "reload", &large, "--domain", &domain.id]);
    assert_fails(&reload, 69, &["the team keeps what it has", "can change to no other bundle"]);
    json(&["control", "shut-down", "--domain", &domain.id, "--json"]);
    assert_eq!(team.ended().code(), Some(0));
}
