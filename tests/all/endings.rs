//! However it ends: two signals in a row, nobody who reads, a world that dies late. Nothing stays behind.

use std::fs::{self, OpenOptions};
use std::io::{BufRead, BufReader, Read};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process_group};
use serde_json::Value;

use crate::support::{
    BUNDLE, SMALL, TestDomain, assert_fails, interrupt, kill, output, resume, sortie, stderr, stop,
    wait_until,
};

/// Two signals to the whole group, milliseconds apart, as `timeout` and terminals send them.
fn interrupt_twice(child: &Child) {
    let group = Pid::from_child(child);
    kill_process_group(group, Signal::INT).expect("the signal is sent");
    let first = Instant::now();
    while first.elapsed() < Duration::from_millis(3) {
        std::hint::spin_loop();
    }
    // The group may have ended in between.
    let _ = kill_process_group(group, Signal::INT);
}

/// The writing end of a pipe that nobody reads.
fn unread() -> Stdio {
    let (reader, writer) = std::io::pipe().expect("a pipe");
    drop(reader);
    writer.into()
}

fn full() -> Stdio {
    OpenOptions::new().write(true).open("/dev/full").expect("a device that is always full").into()
}

/// The end of a program, which must come: a team that hangs is killed, and named.
fn ended(mut child: Child) -> Output {
    let until = Instant::now() + Duration::from_secs(60);
    while child.try_wait().expect("its status").is_none() {
        if Instant::now() > until {
            child.kill().expect("it is killed");
            panic!("it does not end: {}", stderr(&child.wait_with_output().expect("its output")));
        }
        std::thread::park_timeout(Duration::from_millis(5));
    }
    child.wait_with_output().expect("its output")
}

/// Starts a program in a group of its own, and waits until it has told a line with this word.
fn started(mut command: Command, word: &str) -> (Child, BufReader<std::process::ChildStderr>) {
    let mut child = command
        .process_group(0)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the command line starts");
    let mut lines = BufReader::new(child.stderr.take().expect("standard error"));
    let mut line = String::new();
    while !line.contains(word) {
        line.clear();
        assert!(lines.read_line(&mut line).expect("a line") > 0, "no line with `{word}`");
    }
    (child, lines)
}

#[test]
fn two_signals_in_a_row_end_a_team_as_one_does() {
    for (index, more) in [&["run"][..], &["run", "--isolate"], &["up"]].iter().enumerate() {
        let domain = TestDomain::new(&format!("twice{index}"));
        let mut command = sortie(more);
        command.args([BUNDLE, "--domain", &domain.id, "--episodes", "100000", "--rate", "500"]);
        let (child, mut lines) = started(command, "episode ");
        interrupt_twice(&child);
        let mut told = String::new();
        lines.read_to_string(&mut told).expect("its standard error");
        assert_eq!(ended(child).status.code(), Some(130), "{more:?}");
        assert!(told.contains("error: interrupted"), "{more:?}: {told}");
        assert_eq!(domain.leftovers(), Vec::<PathBuf>::new(), "{more:?}");
    }
}

/// What learns on until it is stopped.
fn training(run: &Path) -> Command {
    let mut command = sortie(&["train", "alma", "--steps", "10000000", "--threads", "1"]);
    command.args(SMALL).arg("--out").arg(run);
    command
}

#[test]
fn two_signals_in_a_row_leave_a_training_its_checkpoint() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let run = place.path().join("run");
    let mut child = training(&run)
        .process_group(0)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the command line starts");
    let mut lines = BufReader::new(child.stdout.take().expect("standard output"));
    lines.read_line(&mut String::new()).expect("an evaluation");
    interrupt_twice(&child);
    let told = ended(child);
    assert_fails(&told, 130, &["stopped", "--resume"]);
    assert!(stderr(&told).contains("stopping after this update"), "{}", stderr(&told));
    let names: Vec<String> = fs::read_dir(run.join("checkpoints"))
        .expect("its checkpoints")
        .map(|entry| entry.expect("a checkpoint").file_name().to_string_lossy().into_owned())
        .collect();
    assert!(!names.is_empty());
    assert!(names.iter().all(|name| !name.contains("unfinished")), "{names:?}");
    let opened = output(&["inspect", &run.display().to_string()]);
    assert!(opened.status.success(), "{}", stderr(&opened));
}

#[test]
fn a_team_whose_report_nobody_reads_is_done_all_the_same() {
    let up = |domain: &TestDomain| {
        let mut command = sortie(&["up", BUNDLE, "--domain", &domain.id]);
        command.args(["--episodes", "1", "--rate", "0"]).stderr(Stdio::piped());
        command
    };
    for (name, stdout, code) in [("unread", unread(), 141), ("full", full(), 74)] {
        let domain = TestDomain::new(name);
        let ended = ended(up(&domain).stdout(stdout).spawn().expect("it starts"));
        let told = stderr(&ended);
        assert_eq!(ended.status.code(), Some(code), "{told}");
        assert_eq!(told.matches("the world started").count(), 1, "{told}");
        assert_eq!(told.matches("error: ").count(), usize::from(code == 74), "{told}");
        assert!(!told.contains("panicked") && !told.contains("error: the runner"), "{told}");
        assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
    }
}

#[test]
fn a_team_goes_on_when_the_readers_of_its_words_have_gone() {
    let domain = TestDomain::new("deaf");
    let mut command = sortie(&["up", BUNDLE, "--domain", &domain.id]);
    command.args(["--episodes", "2", "--rate", "0"]);
    let deaf = ended(command.stderr(unread()).stdout(Stdio::piped()).spawn().expect("it starts"));
    assert_eq!(deaf.status.code(), Some(0));
    assert!(String::from_utf8_lossy(&deaf.stdout).contains("over 2 episodes"));
    let mute = ended(command.stderr(unread()).stdout(unread()).spawn().expect("it starts"));
    assert_eq!(mute.status.code(), Some(141));
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

/// The last JSON object that a program printed.
fn report(output: &Output) -> Value {
    let text = String::from_utf8_lossy(&output.stdout);
    serde_json::from_str(text.lines().last().unwrap_or_default()).expect("a report")
}

/// The newest episode that a team has told of, and how many so far.
fn await_episodes(lines: &mut impl BufRead, count: usize) {
    let mut episodes = 0;
    let mut line = String::new();
    while episodes < count {
        line.clear();
        assert!(lines.read_line(&mut line).expect("a line") > 0, "it has ended");
        episodes += usize::from(line.starts_with("episode "));
    }
}

#[test]
fn the_world_that_follows_a_dead_one_goes_on_counting() {
    let domain = TestDomain::new("count");
    let mut command = sortie(&["up", BUNDLE, "--domain", &domain.id]);
    command.args(["--episodes", "12", "--rate", "1000"]);
    let (child, mut lines) = started(command, "the world started as process");
    let world = processes(&domain, "world");
    await_episodes(&mut lines, 4);
    kill(world[0]);
    let mut told = String::new();
    lines.read_to_string(&mut told).expect("its standard error");
    let ended = ended(child);
    let text = String::from_utf8_lossy(&ended.stdout).into_owned();
    assert_eq!(ended.status.code(), Some(0), "{told}");
    assert!(text.contains("over 12 episodes"), "{text}");
    assert!(text.contains("a world died: of the first"), "{text}");
    assert_eq!(told.matches("episode   1 of 12").count(), 0, "{told}");
    assert_eq!(told.matches("episode  12 of 12").count(), 1, "{told}");
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

/// The processes of a domain with this role.
fn processes(domain: &TestDomain, role: &str) -> Vec<u32> {
    let has_words = |pid: &u32| {
        let line = fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        let words: Vec<&[u8]> = line.split(|byte| *byte == 0).collect();
        words.contains(&role.as_bytes()) && words.contains(&domain.id.as_bytes())
    };
    let mut found = Vec::new();
    wait_until("the process runs", || {
        let names = fs::read_dir("/proc").expect("the processes").flatten();
        let pids = names.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
        found = pids.filter(has_words).collect();
        !found.is_empty()
    });
    found
}

#[test]
fn a_run_that_is_interrupted_reports_what_was_played() {
    let domain = TestDomain::new("partly");
    let arguments = ["run", BUNDLE, "--domain", &domain.id, "--episodes", "100000"];
    let mut command = sortie(&arguments);
    command.args(["--rate", "1000"]);
    let (child, mut lines) = started(command, "episode   1");
    await_episodes(&mut lines, 2);
    interrupt(&child);
    let told = ended(child);
    assert_eq!(told.status.code(), Some(130));
    let text = String::from_utf8_lossy(&told.stdout).into_owned();
    assert!(text.contains("\nsuccess ") && text.contains("whole tick"), "{text}");
    let mut command = sortie(&arguments);
    command.args(["--rate", "1000"]);
    let (child, mut lines) = started(command, "episode   3");
    kill(processes(&domain, "runner")[0]);
    let mut error = String::new();
    lines.read_to_string(&mut error).expect("its standard error");
    let told = ended(child);
    assert_eq!(told.status.code(), Some(69), "{error}");
    let text = String::from_utf8_lossy(&told.stdout).into_owned();
    assert!(text.contains("\nsuccess "), "{text}");
    let mut command = sortie(&arguments);
    command.args(["--in-process", "--json"]).stdout(Stdio::piped()).stderr(Stdio::null());
    let child = command.process_group(0).spawn().expect("it starts");
    // Silent: whoever plays 100,000 episodes has played some after a while.
    wait_until("it has played", || cpu_ticks(child.id()) > 30);
    interrupt(&child);
    let told = ended(child);
    assert_eq!(told.status.code(), Some(130));
    assert!(report(&told)["episodes"].as_u64() > Some(0));
}

/// The number that stands before these words.
fn number_before(text: &str, words: &str) -> f64 {
    let before = text.split(words).next().unwrap_or_default();
    let number = before.split_whitespace().next_back().and_then(|word| word.parse().ok());
    number.unwrap_or_else(|| panic!("no number before `{words}`: {text}"))
}

#[test]
fn a_world_that_stood_still_tells_for_how_long_and_what_was_skipped() {
    let domain = TestDomain::new("late");
    let mut command = sortie(&["run", BUNDLE, "--domain", &domain.id, "--episodes", "3"]);
    command.args(["--rate", "200"]);
    let (child, mut lines) = started(command, "episode   1");
    stop(child.id());
    let stopped = Instant::now();
    // A second: the world does not answer.
    output(&["control", "info", "--domain", &domain.id]);
    let stood_ms = stopped.elapsed().as_secs_f64() * 1000.0;
    resume(child.id());
    let mut told = String::new();
    lines.read_to_string(&mut told).expect("its standard error");
    let ended = ended(child);
    assert_eq!(ended.status.code(), Some(0), "{told}");
    let text = String::from_utf8_lossy(&ended.stdout).into_owned();
    // It may have stopped a little after it was told to.
    assert!(number_before(&text, " periods skipped") > stood_ms / 5.0 / 2.0, "{text}");
    assert!(
        number_before(&text, " s, pace 200 ticks a second") > stood_ms / 1000.0 / 2.0,
        "{text}"
    );
    for row in ["frame after due", "frame to frame"] {
        let row = text.lines().find(|line| line.starts_with(row)).expect("a row of latencies");
        let max_us = row.split_whitespace().rev().nth(1).and_then(|max| max.parse().ok());
        assert!(max_us > Some(stood_ms * 1000.0 / 2.0), "{row}");
    }
}

/// Processor time of a process, in hundredths of a second.
fn cpu_ticks(pid: u32) -> u64 {
    let line = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    let after_name = line.rsplit_once(')').map_or("", |(_, rest)| rest);
    after_name.split_whitespace().nth(11).and_then(|ticks| ticks.parse().ok()).unwrap_or(0)
}
