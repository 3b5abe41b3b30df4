//! The shipped team as real processes: played to the end, interrupted, and killed.

mod support;

use std::fs;
use std::path::PathBuf;
use std::process::Child;

use support::{BUNDLE, TestDomain, assert_fails, interrupt, json, sortie, wait_until};

fn run(domain: &TestDomain, more: &[&str]) -> serde_json::Value {
    let mut arguments = vec!["run", BUNDLE, "--json", "--domain", &domain.id];
    arguments.extend(more);
    json(&arguments)
}

/// A run that goes on until it is ended.
fn endless(domain: &TestDomain) -> Child {
    let arguments = ["run", BUNDLE, "--domain", &domain.id, "--episodes", "100000", "-q"];
    let child = sortie(&arguments)
        .args(["--isolate", "--rate", "50", "--patience", "1"])
        .stderr(std::process::Stdio::piped())
        .spawn()
        .expect("the command line starts");
    wait_until("all agents have joined", || processes(&child, "runner").len() == 5);
    wait_until("the last agent's seat is taken", || {
        fs::exists(format!("/dev/shm/sortie-{}/{}/agent-4.lock", uid(), domain.id)).unwrap_or(false)
    });
    child
}

fn uid() -> u32 {
    std::os::unix::fs::MetadataExt::uid(&fs::metadata("/proc/self").expect("this process"))
}

/// Process ids of the children of a run that have this role.
fn processes(parent: &Child, role: &str) -> Vec<u32> {
    let path = format!("/proc/{0}/task/{0}/children", parent.id());
    let children = fs::read_to_string(path).unwrap_or_default();
    let has_role = |pid: &u32| {
        let line = fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        line.split(|byte| *byte == 0).any(|word| word == role.as_bytes())
    };
    children.split_whitespace().filter_map(|pid| pid.parse().ok()).filter(has_role).collect()
}

#[test]
fn a_team_plays_over_shared_memory_and_leaves_nothing() {
    let domain = TestDomain::new("plays");
    let report = run(&domain, &["--episodes", "3"]);
    assert_eq!(report["episodes"], 3);
    for key in ["success", "return_mean"] {
        assert!(report[key].is_number(), "{key}: {report}");
    }
    assert!(report["decisions"].as_u64() > Some(0));
    for latency in ["decide_us", "tick_us"] {
        assert!(report[latency]["p50"].as_f64() > Some(0.0), "{latency}: {report}");
    }
    assert!(report["processes"].as_u64() >= Some(3), "{report}");
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn processes_and_one_thread_play_the_same_episodes() {
    let domain = TestDomain::new("same");
    let grouped = run(&domain, &["--episodes", "3", "--seed", "5"]);
    let isolated = run(&domain, &["--episodes", "3", "--seed", "5", "--isolate"]);
    let in_process = run(&domain, &["--episodes", "3", "--seed", "5", "--in-process"]);
    let tract =
        run(&domain, &["--episodes", "3", "--seed", "5", "--in-process", "--backend", "tract"]);
    assert_eq!(isolated["processes"], 7);
    assert_eq!(in_process["processes"], 1);
    for key in ["success", "return_mean", "decisions", "ticks", "by_team"] {
        assert_eq!(grouped[key], isolated[key], "{key}");
        assert_eq!(grouped[key], in_process[key], "{key}");
        assert_eq!(grouped[key], tract[key], "{key}");
    }
}

#[test]
fn ctrl_c_ends_every_process_and_leaves_nothing() {
    let domain = TestDomain::new("ctrlc");
    let mut child = endless(&domain);
    let team: Vec<u32> =
        ["runner", "allocator"].iter().flat_map(|role| processes(&child, role)).collect();
    assert_eq!(team.len(), 6);
    interrupt(&child);
    assert_eq!(child.wait().expect("its status").code(), Some(130));
    for pid in team {
        assert!(!fs::exists(format!("/proc/{pid}")).unwrap_or(true), "process {pid} is left");
    }
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn a_killed_runner_ends_the_run_and_is_named() {
    let domain = TestDomain::new("kill");
    let child = endless(&domain);
    support::kill(processes(&child, "runner")[2]);
    let output = child.wait_with_output().expect("its output");
    assert_fails(&output, 69, &["runner of agents 2"]);
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn a_stopped_runner_misses_its_patience_and_is_named() {
    let domain = TestDomain::new("stop");
    let child = endless(&domain);
    let runner = processes(&child, "runner")[1];
    support::stop(runner);
    let output = child.wait_with_output().expect("its output");
    assert_fails(&output, 69, &["agent 1", "in time"]);
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn a_killed_allocator_ends_the_run_and_is_named() {
    let domain = TestDomain::new("alloc");
    let child = endless(&domain);
    support::kill(processes(&child, "allocator")[0]);
    let output = child.wait_with_output().expect("its output");
    assert_fails(&output, 69, &["allocator"]);
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn a_killed_world_takes_its_team_with_it() {
    let domain = TestDomain::new("world");
    let mut child = endless(&domain);
    let team: Vec<u32> =
        ["runner", "allocator"].iter().flat_map(|role| processes(&child, role)).collect();
    child.kill().expect("a kill");
    child.wait().expect("its status");
    wait_until("the team has ended", || {
        team.iter().all(|pid| !fs::exists(format!("/proc/{pid}")).unwrap_or(true))
    });
    let again = run(&domain, &["--episodes", "1"]);
    assert_eq!(again["episodes"], 1);
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}
