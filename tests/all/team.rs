//! The shipped team as real processes: played to the end, interrupted, and killed.

use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::PathBuf;
use std::process::{Child, ChildStderr, Output, Stdio};

use crate::support::{
    self, BUNDLE, Ending as _, TestDomain, assert_fails, interrupt, json, sortie, wait_until,
};

fn play(domain: &TestDomain, more: &[&str]) -> serde_json::Value {
    let mut arguments = vec!["run", BUNDLE, "--json", "--domain", &domain.id];
    arguments.extend(more);
    json(&arguments)
}

/// A run that goes on until it is ended, already playing.
struct Endless {
    child: Child,
    stderr: BufReader<ChildStderr>,
}

impl Endless {
    fn start(domain: &TestDomain) -> Self {
        let arguments = ["run", BUNDLE, "--domain", &domain.id, "--episodes", "100000"];
        let mut child = sortie(&arguments)
            .args(["--isolate", "--rate", "500", "--patience", "1"])
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the command line starts");
        let mut stderr = BufReader::new(child.stderr.take().expect("standard error"));
        let mut line = String::new();
        stderr.read_line(&mut line).expect("a line");
        assert!(line.starts_with("episode   1"), "{line}");
        Self { child, stderr }
    }

    /// Process ids of its processes, which end with it.
    fn team(&self) -> Vec<u32> {
        ["runner", "allocator"].iter().flat_map(|role| self.processes(role)).collect()
    }

    /// Waits for its end.
    fn output(mut self) -> Output {
        let mut stderr = Vec::new();
        self.stderr.read_to_end(&mut stderr).expect("its standard error");
        let status = self.child.ended();
        Output { status, stdout: Vec::new(), stderr }
    }

    /// Process ids of its processes of one role.
    fn processes(&self, role: &str) -> Vec<u32> {
        let path = format!("/proc/{0}/task/{0}/children", self.child.id());
        let children = fs::read_to_string(path).unwrap_or_default();
        let has_role = |pid: &u32| {
            let line = fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
            line.split(|byte| *byte == 0).any(|word| word == role.as_bytes())
        };
        children.split_whitespace().filter_map(|pid| pid.parse().ok()).filter(has_role).collect()
    }
}

fn is_gone(pid: u32) -> bool {
    !fs::exists(format!("/proc/{pid}")).unwrap_or(true)
}

#[test]
fn a_team_plays_over_shared_memory_and_leaves_nothing() {
    let domain = TestDomain::new("plays");
    let report = play(&domain, &["--episodes", "3"]);
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
    let grouped = play(&domain, &["--episodes", "3", "--seed", "5"]);
    let isolated = play(&domain, &["--episodes", "3", "--seed", "5", "--isolate"]);
    let in_process = play(&domain, &["--episodes", "3", "--seed", "5", "--in-process"]);
    let tract =
        play(&domain, &["--episodes", "3", "--seed", "5", "--in-process", "--backend", "tract"]);
    assert_eq!(isolated["processes"], 7);
    assert_eq!(in_process["processes"], 1);
    for key in ["success", "return_mean", "decisions", "ticks", "by_team"] {
        assert_eq!(grouped[key], isolated[key], "{key}");
        assert_eq!(grouped[key], in_process[key], "{key}");
        assert_eq!(grouped[key], tract[key], "{key}");
    }
}

#[test]
fn a_learned_allocator_allocates_in_its_own_process_as_in_one_thread() {
    let domain = TestDomain::new("learned");
    let play = |more: &[&str]| play(&domain, &[&["--seed", "5"][..], more].concat());
    let processes = play(&["--episodes", "3"]);
    assert_eq!(processes["allocation"], "learned");
    let in_process = play(&["--episodes", "3", "--in-process"]);
    let tract = play(&["--in-process", "--backend", "tract", "--episodes", "1"]);
    let one = play(&["--episodes", "1"]);
    for key in ["success", "return_mean", "decisions", "ticks", "by_team"] {
        assert_eq!(processes[key], in_process[key], "{key}");
        assert_eq!(one[key], tract[key], "{key}");
    }
    let by_rule = play(&["--episodes", "1", "--allocation", "coordinated"]);
    assert_eq!(by_rule["allocation"], "coordinated");
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn ctrl_c_ends_every_process_and_leaves_nothing() {
    let domain = TestDomain::new("ctrlc");
    let run = Endless::start(&domain);
    let team = run.team();
    assert_eq!(team.len(), 6);
    interrupt(&run.child);
    assert_eq!(run.output().status.code(), Some(130));
    for pid in team {
        assert!(is_gone(pid), "process {pid} is left");
    }
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn a_killed_runner_ends_the_run_and_is_named() {
    let domain = TestDomain::new("kill");
    let run = Endless::start(&domain);
    support::kill(run.processes("runner")[2]);
    assert_fails(&run.output(), 69, &["runner of agent 2"]);
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn a_stopped_runner_misses_its_patience_and_is_named() {
    let domain = TestDomain::new("stop");
    let run = Endless::start(&domain);
    support::stop(run.processes("runner")[1]);
    assert_fails(&run.output(), 69, &["agent 1", "in time"]);
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn a_killed_allocator_ends_the_run_and_is_named() {
    let domain = TestDomain::new("alloc");
    let run = Endless::start(&domain);
    support::kill(run.processes("allocator")[0]);
    assert_fails(&run.output(), 69, &["allocator"]);
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn a_killed_world_takes_its_team_with_it() {
    let domain = TestDomain::new("world");
    let run = Endless::start(&domain);
    let team = run.team();
    support::kill(run.child.id());
    run.output();
    wait_until("the team has ended", || team.iter().all(|pid| is_gone(*pid)));
    let again = play(&domain, &["--episodes", "1"]);
    assert_eq!(again["episodes"], 1);
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}
