//! Signals, one and several, sent to a real process: this test binary again, running the test `child`.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use sortie_ipc::Stop;

use crate::toy::Watchdog;

const CHILD: &str = "SORTIE_TEST_SIGNALS";
const READY: &str = "ready";

/// Not a test of its own: a process that answers every line with whether it was told to stop.
#[test]
fn child() {
    if std::env::var_os(CHILD).is_none() {
        return;
    }
    let stop = Stop::on_signals().unwrap();
    // A line of its own, after what the test harness prints.
    println!("\n{READY}");
    for _line in std::io::stdin().lines() {
        println!("{}", stop.is_set());
    }
    std::process::exit(0);
}

struct Signalled {
    child: Child,
    questions: ChildStdin,
    answers: BufReader<ChildStdout>,
}

impl Signalled {
    fn start() -> Self {
        Self::start_by(&mut Command::new("/proc/self/exe"))
    }

    fn start_by(command: &mut Command) -> Self {
        let mut child = command
            .args(["signals::child", "--exact", "--nocapture"])
            .env(CHILD, "")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let questions = child.stdin.take().unwrap();
        let mut answers = BufReader::new(child.stdout.take().unwrap());
        let mut line = String::new();
        while line.trim_end() != READY {
            line.clear();
            assert_ne!(answers.read_line(&mut line).unwrap(), 0, "it ended");
        }
        Self { child, questions, answers }
    }

    fn send(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal).unwrap();
    }

    /// Whether it was told to stop; `None` if it has ended.
    fn is_told(&mut self) -> Option<bool> {
        writeln!(self.questions).ok()?;
        let mut line = String::new();
        self.answers.read_line(&mut line).unwrap();
        line.trim_end().parse().ok()
    }

    /// Waits until it was told to stop.
    fn await_told(&mut self) {
        while self.is_told() == Some(false) {
            std::thread::yield_now();
        }
    }

    fn end(mut self) -> ExitStatus {
        self.child.wait().unwrap()
    }
}

/// Longer than two signals may be apart that mean the same.
const LATER: Duration = Duration::from_millis(700);

#[test]
fn signals_in_a_row_are_one_wish_and_a_later_one_ends_at_once() {
    let _watchdog = Watchdog::new();
    for second in [Signal::INT, Signal::TERM] {
        let mut child = loop {
            let mut child = Signalled::start();
            let first = Instant::now();
            child.send(Signal::INT);
            child.await_told();
            child.send(second);
            // On a machine that was too slow just now the two are two wishes.
            if first.elapsed() < LATER / 3 {
                break child;
            }
        };
        let sent = Instant::now();
        while sent.elapsed() < LATER {
            assert_eq!(child.is_told(), Some(true), "it has ended");
            std::thread::park_timeout(Duration::from_millis(10));
        }
        child.send(second);
        assert_eq!(child.end().code(), Some(130));
    }
}

#[test]
fn a_hang_up_that_is_ignored_stays_ignored() {
    let _watchdog = Watchdog::new();
    let mut shell = Command::new("sh");
    shell.args(["-c", "trap '' HUP; exec \"$0\" \"$@\""]).arg(std::env::current_exe().unwrap());
    let mut child = Signalled::start_by(&mut shell);
    let sent = Instant::now();
    while sent.elapsed() < LATER {
        child.send(Signal::HUP);
        assert_eq!(child.is_told(), Some(false));
        std::thread::park_timeout(Duration::from_millis(10));
    }
    child.send(Signal::TERM);
    child.await_told();
}
