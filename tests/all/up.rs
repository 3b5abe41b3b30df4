//! A supervised team through the command line: whoever is killed comes back, and the others go on.

use std::io::{BufRead, BufReader, Read};
use std::path::PathBuf;
use std::process::{Child, ChildStderr, Stdio};

use crate::support::{
    BUNDLE, Ending as _, TestDomain, assert_fails, interrupt, json, kill, output, resume, sortie,
    stderr, stop, terminate, wait_until,
};

/// A team that is up, and what it tells.
struct Up {
    child: Child,
    lines: BufReader<ChildStderr>,
    /// Lines that nobody has waited for yet: their order is not always the same.
    unclaimed: Vec<String>,
}

impl Up {
    fn start(domain: &TestDomain, more: &[&str]) -> Self {
        let mut child = sortie(&["up", BUNDLE, "--domain", &domain.id])
            .args(more)
            .arg("--episodes=60")
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the command line starts");
        let lines = BufReader::new(child.stderr.take().expect("standard error"));
        Self { child, lines, unclaimed: Vec::new() }
    }

    /// The first line with all of these words that was not waited for before.
    fn await_line(&mut self, words: &[&str]) -> String {
        loop {
            let has_all = |line: &String| words.iter().all(|word| line.contains(word));
            if let Some(index) = self.unclaimed.iter().position(has_all) {
                return self.unclaimed.remove(index);
            }
            let mut line = String::new();
            let read = self.lines.read_line(&mut line).expect("a line");
            assert!(read > 0, "no line with {words:?}: {:?}", self.unclaimed);
            self.unclaimed.push(line);
        }
    }

    /// Lines so far that have all of these words.
    fn lines_with(&self, words: &[&str]) -> usize {
        let has_all = |line: &&String| words.iter().all(|word| line.contains(word));
        self.unclaimed.iter().filter(has_all).count()
    }

    /// Interrupts the supervisor, and waits for its end.
    fn end(mut self) -> Option<i32> {
        interrupt(&self.child);
        self.lines.read_to_end(&mut Vec::new()).expect("its standard error");
        self.child.ended().code()
    }
}

/// The process that a line names last.
fn pid(line: &str) -> u32 {
    let digits = line.rsplit(|c: char| !c.is_ascii_digit()).find(|digits| !digits.is_empty());
    digits.and_then(|digits| digits.parse().ok()).expect("a process id")
}

#[test]
fn killed_runners_and_allocators_take_their_places_again() {
    let domain = TestDomain::new("up");
    let mut up = Up::start(&domain, &["--isolate"]);
    let runner = pid(&up.await_line(&["the runner of agent 2 joined"]));
    let leader = up.await_line(&["leads the allocators"]);
    kill(runner);
    up.await_line(&["the runner of agent 2 was killed by signal 9", "starts again"]);
    assert_ne!(pid(&up.await_line(&["the runner of agent 2 joined"])), runner);
    kill(pid(&leader));
    let next = up.await_line(&["leads the allocators"]);
    assert_ne!(pid(&next), pid(&leader));
    assert_eq!(up.end(), Some(130));
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn a_killed_world_is_followed_by_another_for_the_same_team() {
    let domain = TestDomain::new("upworld");
    let mut up = Up::start(&domain, &[]);
    up.await_line(&["the runner of agent", "joined"]);
    let world = pid(&up.await_line(&["the world joined"]));
    kill(world);
    up.await_line(&["the world was killed by signal 9", "starts again"]);
    assert_ne!(pid(&up.await_line(&["the world joined"])), world);
    // The team of the dead world is that of the next.
    assert_eq!(up.lines_with(&["the runner of agent", "started"]), 1);
    assert_eq!(up.end(), Some(130));
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn a_killed_supervisor_leaves_a_team_that_the_next_one_looks_after() {
    let domain = TestDomain::new("upnext");
    let mut first = Up::start(&domain, &["--standbys", "0"]);
    let started = ["the world", "the runner of agent", "allocator 0"]
        .map(|name| pid(&first.await_line(&[name, "started"])));
    first.await_line(&["the world joined"]);
    first.await_line(&["the runner of agent", "joined"]);
    kill(first.child.id());
    first.child.ended();
    let mut second = Up::start(&domain, &["--standbys", "0"]);
    // Its own runner finds the seats taken, until they are free.
    let behind = second.await_line(&["the runner of agent", "stands by behind process"]);
    assert_eq!(pid(&behind), started[1]);
    kill(started[1]);
    let runner = pid(&second.await_line(&["the runner of agent", "joined"]));
    assert_ne!(runner, started[1]);
    assert_eq!(second.end(), Some(130));
    for pid in [started[0], started[2]] {
        terminate(pid);
    }
    wait_until("all have left", || domain.leftovers().is_empty());
}

#[test]
fn a_second_team_stands_by_says_so_once_and_takes_over() {
    let domain = TestDomain::new("upsecond");
    let mut first = Up::start(&domain, &["--rate", "200"]);
    first.await_line(&["the world joined"]);
    first.await_line(&["the runner of agent", "joined"]);
    for (rate, words) in
        [("50", "this one would at 50 Hz"), ("0", "this one would as fast as it acts")]
    {
        let refused = output(&["up", BUNDLE, "--domain", &domain.id, "--rate", rate]);
        assert_fails(&refused, 75, &["has a team that runs at 200 Hz", words, "--domain NAME"]);
        assert!(!stderr(&refused).contains("started"), "at once: {}", stderr(&refused));
    }
    let mut second = Up::start(&domain, &["--rate", "200"]);
    second.await_line(&["the world stands by behind process"]);
    second.await_line(&["the runner of agent", "stands by behind process"]);
    // Nothing of a place that is taken, however long that is so.
    first.await_line(&["episode   4 of 60"]);
    json(&["control", "shut-down", "--domain", &domain.id, "--json"]);
    second.await_line(&["the world started"]);
    second.await_line(&["the world joined"]);
    for words in [&["stands by"][..], &["exit code"], &["error: "]] {
        assert_eq!(second.lines_with(words), 0, "{:?}", second.unclaimed);
    }
    assert_eq!(first.child.ended().code(), Some(0));
    assert_eq!(second.end(), Some(130));
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn whom_world_and_supervisor_left_are_ended_by_control() {
    let domain = TestDomain::new("uporphans");
    let mut up = Up::start(&domain, &["--rate", "200"]);
    let world = pid(&up.await_line(&["the world joined"]));
    up.await_line(&["the runner of agent", "joined"]);
    up.await_line(&["leads the allocators"]);
    kill(up.child.id());
    kill(world);
    up.child.ended();
    let other = ["run", BUNDLE, "--domain", &domain.id, "--episodes", "1"];
    let words = ["has a team that runs at 200 Hz", "sortie control shut-down"];
    assert_fails(&output(&other), 75, &words);
    let told = json(&["control", "shut-down", "--domain", &domain.id, "--json"]);
    let processes = told["processes"].as_array().expect("processes");
    assert_eq!(processes.iter().filter(|process| process["role"] == "allocator").count(), 2);
    assert!(processes.iter().any(|process| process["role"] == "runner"), "{told}");
    assert!(processes.iter().all(|process| process["outcome"] == "done"), "{told}");
    wait_until("all have left", || domain.leftovers().is_empty());
}

#[test]
fn a_stopped_supervisor_stops_nobody() {
    let domain = TestDomain::new("upstop");
    let mut up = Up::start(&domain, &[]);
    up.await_line(&["the world joined"]);
    stop(up.child.id());
    // The world plays on: its episodes are told on the same standard error.
    up.await_line(&["episode   3 of 60"]);
    resume(up.child.id());
    assert_eq!(up.end(), Some(130));
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn pinning_needs_a_core_for_each_process() {
    let domain = TestDomain::new("uppin");
    let arguments = ["up", BUNDLE, "--domain", &domain.id, "--isolate", "--pin"];
    let cores = std::thread::available_parallelism().expect("the number of cores").get();
    // A world and two runners at least, of the smallest team.
    let refused = output(&[&arguments[..], &["--episodes", "1", "--rate", "0"]].concat());
    match cores {
        1..=5 => assert_fails(&refused, 2, &["leave out --pin"]),
        _ => assert_eq!(refused.status.code(), Some(0), "{}", stderr(&refused)),
    }
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn a_team_of_real_time_and_pinned_processes_plays() {
    let domain = TestDomain::new("uprt");
    let more = ["--rt", "1", "--pin", "--episodes", "1", "--rate", "0", "--json"];
    let played = output(&[&["up", BUNDLE, "--domain", &domain.id][..], &more].concat());
    // Where the system refuses, it says what to raise.
    match played.status.code() {
        Some(0) => {}
        _ => assert_fails(&played, 77, &["exit code 77"]),
    }
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn a_team_that_is_up_plays_its_episodes_and_reports() {
    let domain = TestDomain::new("upend");
    let report =
        json(&["up", BUNDLE, "--domain", &domain.id, "--episodes", "2", "--rate", "0", "--json"]);
    assert_eq!(report["episodes"], 2);
    assert!(report["decisions"].as_u64() > Some(0), "{report}");
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn agents_that_get_only_what_they_see_decide_the_same() {
    let play = |mode: &str| {
        let domain = TestDomain::new("upprivate");
        let more = ["--episodes", "2", "--rate", "0", "--json", mode];
        let report = json(&[&["up", BUNDLE, "--domain", &domain.id][..], &more].concat());
        assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
        ["episodes", "success", "return_mean", "decisions"].map(|key| report[key].clone())
    };
    assert_eq!(play("--private"), play("--isolate"));
}

#[test]
fn a_world_that_fills_all_seats_plays_as_the_team_does() {
    let play = |domain: &TestDomain, verb: &[&str]| {
        let more = ["--domain", &domain.id, "--episodes", "2", "--rate", "0", "--json"];
        let report = json(&[verb, &more].concat());
        ["success", "return_mean", "decisions", "fallbacks"].map(|key| report[key].clone())
    };
    let domain = TestDomain::new("upfill");
    let mut allocator = sortie(&["process", "allocator", BUNDLE, "--domain", &domain.id])
        .args(["--allocation", "learned"])
        .spawn()
        .expect("the command line starts");
    let filled = play(&domain, &["process", "world", BUNDLE, "--fill", "--allocation", "learned"]);
    assert!(allocator.ended().success());
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
    assert_eq!(filled, play(&domain, &["up", BUNDLE]));
}

#[test]
fn a_doctor_names_what_is_missing() {
    let domain = TestDomain::new("doctor");
    let idle = json(&["doctor", "--domain", &domain.id, "--json"]);
    assert_eq!(idle["problems"], 0, "{idle}");
    let mut up = Up::start(&domain, &["--restart", "never", "--isolate", "--standbys", "0"]);
    let runner = pid(&up.await_line(&["the runner of agent 1 joined"]));
    up.await_line(&["leads the allocators"]);
    let stopped = pid(&up.await_line(&["the runner of agent 2 joined"]));
    stop(stopped);
    let examined = output(&["doctor", "--domain", &domain.id]);
    let told = String::from_utf8_lossy(&examined.stdout).into_owned();
    assert!(told.contains(&format!("process {stopped} has the seats of agents 2, ")), "{told}");
    resume(stopped);
    kill(runner);
    up.await_line(&["the runner of agent 1 was killed by signal 9"]);
    wait_until("agent 1 is absent", || {
        let told = json(&["control", "info", "--domain", &domain.id, "--json"]);
        told["processes"][0]["absent"] == serde_json::json!([1])
    });
    let examined = output(&["doctor", "--domain", &domain.id]);
    let told = String::from_utf8_lossy(&examined.stdout).into_owned();
    assert!(told.contains("nobody acts for agents 1\n"), "{told}");
    assert!(told.contains("absent agents        1, since tick "), "{told}");
    assert!(told.contains("one leads, none stands by"), "{told}");
    assert!(told.contains("supervisor ") && told.contains(", version 0."), "{told}");
    assert_fails(&examined, 1, &["problem"]);
    assert_eq!(up.end(), Some(130));
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn a_team_plays_without_an_agent_and_its_report_names_it() {
    let domain = TestDomain::new("absent");
    let play = |verb: &[&str]| {
        let more = ["--domain", &domain.id, "--episodes=2", "--rate=0", "--json", "--absent=4"];
        json(&[verb, &more].concat())
    };
    for verb in [&["up", BUNDLE][..], &["run", BUNDLE], &["run", BUNDLE, "--in-process"]] {
        let report = play(verb);
        let absent = serde_json::json!([{ "agent": 4, "episode": 1, "step": 0 }]);
        assert_eq!(report["absent"], absent, "{verb:?}");
        assert_eq!(report["episodes"], 2, "{verb:?}");
        assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
    }
    let refused = |more: &[&str]| output(&[&["up", BUNDLE, "--episodes=1"][..], more].concat());
    assert_fails(&refused(&["--absent=5"]), 2, &["no agent 5", "5 from 0 on"]);
    assert_eq!(refused(&["--absent=4", "--fill"]).status.code(), Some(2));
}

#[test]
fn a_seat_that_is_taken_is_refused_by_name() {
    let domain = TestDomain::new("seat");
    let mut up = Up::start(&domain, &["--isolate"]);
    let runner = pid(&up.await_line(&["the runner of agent 0 joined"]));
    let arguments = ["process", "runner", BUNDLE, "--domain", &domain.id, "--agents", "0"];
    let second = output(&arguments);
    assert_fails(&second, 75, &["agent 0", &runner.to_string()]);
    let beyond = output(&[&arguments[..6], &["99"]].concat());
    assert_fails(&beyond, 2, &["no such agents: [99]"]);
    assert_eq!(up.end(), Some(130), "{}", stderr(&second));
}
