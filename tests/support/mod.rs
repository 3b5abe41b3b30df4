//! Starts the command line as users do.
#![allow(dead_code, reason = "every test file uses its own part of this")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

/// The shipped bundle.
pub(crate) const BUNDLE: &str = "models/save-the-city";

/// What helps where tests find no onnxruntime to compare with.
pub(crate) const NO_ONNXRUNTIME: &str = "tests compare with onnxruntime: `python3 -m venv target/onnxruntime && \
    target/onnxruntime/bin/pip install onnxruntime`, then `export VIRTUAL_ENV=$PWD/target/onnxruntime`";

/// The command line, started in the project's folder.
///
/// `cargo test --workspace` builds what it starts in its place for tract; `cargo test -p sortie` does not.
pub(crate) fn sortie(arguments: &[&str]) -> Command {
    let program = Path::new(env!("CARGO_BIN_EXE_sortie"));
    let linked = program.with_file_name("sortie-tools");
    assert!(linked.exists(), "{} is missing: `cargo build -p sortie-tools`", linked.display());
    let mut command = Command::new(program);
    command.current_dir(env!("CARGO_MANIFEST_DIR")).args(arguments);
    command
}

/// The Python that has what tests compare with.
pub(crate) fn python() -> PathBuf {
    match std::env::var_os("VIRTUAL_ENV") {
        Some(folder) => Path::new(&folder).join("bin/python"),
        None => PathBuf::from("python3"),
    }
}

/// Runs to the end.
pub(crate) fn output(arguments: &[&str]) -> Output {
    sortie(arguments).output().expect("the command line starts")
}

/// Runs to success and reads the last JSON object on standard output.
pub(crate) fn json(arguments: &[&str]) -> Value {
    let output = output(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
    let text = String::from_utf8_lossy(&output.stdout);
    serde_json::from_str(text.lines().last().unwrap_or_default()).expect("standard output is JSON")
}

/// Standard error as text.
pub(crate) fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Checks that the verb failed with this code, on one line that has all of these words.
pub(crate) fn assert_fails(output: &Output, code: i32, words: &[&str]) {
    let text = stderr(output);
    assert_eq!(output.status.code(), Some(code), "{text}");
    let errors: Vec<&str> = text.lines().filter(|line| line.starts_with("error: ")).collect();
    assert_eq!(errors.len(), 1, "one line of error: {text}");
    for word in words {
        assert!(errors[0].contains(word), "`{word}` in: {}", errors[0]);
    }
}

/// A domain of its own for each test, and what it may leave behind.
pub(crate) struct TestDomain {
    pub(crate) id: String,
}

impl TestDomain {
    /// Short, so that paths have the id in them: the system limits those of sockets. Counted, since tests run side by side
    /// and no id may be a part of another.
    pub(crate) fn new(name: &str) -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        Self { id: format!("t{count}-{name}-{}", std::process::id() % 10_000) }
    }

    /// Everything in shared memory that carries the domain's name.
    pub(crate) fn leftovers(&self) -> Vec<PathBuf> {
        let mut found = Vec::new();
        collect(Path::new("/dev/shm"), &self.id, &mut found);
        found
    }
}

fn collect(folder: &Path, name: &str, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if entry.file_name().to_string_lossy().contains(name) {
            found.push(path);
        } else if path.is_dir() {
            collect(&path, name, found);
        }
    }
}

/// A team, each agent in a process of its own, that plays until it is told to end, or until its test fails.
pub(crate) struct Playing(pub(crate) Child);

impl Playing {
    pub(crate) fn new(domain: &TestDomain) -> Self {
        Self::with(domain, &["--rate", "100"])
    }

    /// At another rate, or otherwise different.
    pub(crate) fn with(domain: &TestDomain, more: &[&str]) -> Self {
        Self::of(BUNDLE, domain, more)
    }

    /// By another bundle of as many agents.
    pub(crate) fn of(bundle: &str, domain: &TestDomain, more: &[&str]) -> Self {
        let mut up = sortie(&["up", bundle, "--domain", &domain.id, "--quiet", "--isolate"]);
        up.args(more);
        let up = up.stdout(Stdio::null()).stderr(Stdio::null()).spawn();
        let up = Self(up.expect("the command line starts"));
        wait_until("everybody is there", || {
            let told = output(&["control", "info", "--domain", &domain.id, "--json"]);
            let answer: Value = serde_json::from_slice(&told.stdout).unwrap_or_default();
            answer["processes"].as_array().is_some_and(|processes| processes.len() == 8)
        });
        up
    }

    /// Ends it; whoever else is in the domain leaves by itself.
    pub(crate) fn end(mut self, domain: &TestDomain) {
        json(&["control", "shut-down", "--domain", &domain.id, "--json"]);
        assert_eq!(self.0.ended().code(), Some(0));
    }

    /// Ends it as the last ones there.
    pub(crate) fn shut_down(self, domain: &TestDomain) {
        self.end(domain);
        assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
    }
}

impl Drop for Playing {
    fn drop(&mut self) {
        // One that was shut down has ended.
        if matches!(self.0.try_wait(), Ok(None)) {
            // A test may have stopped it.
            resume(self.0.id());
            interrupt(&self.0);
            let _ = self.0.wait();
        }
    }
}

/// Settings of a run of both levels that takes seconds.
pub(crate) const SMALL: [&str; 12] = [
    "--set",
    "run.evaluate_every=1000",
    "--set",
    "run.evaluate_episodes=10",
    "--set",
    "replay.warm_up=300",
    "--set",
    "replay.batch=64",
    "--set",
    "network.width=32",
    "--set",
    "run.final_episodes=10",
];

/// A copy of the shipped bundle that a test may break.
pub(crate) fn copied_bundle() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join(BUNDLE);
    for entry in fs::read_dir(source).expect("the bundle").flatten() {
        if entry.path().is_file() {
            fs::copy(entry.path(), folder.path().join(entry.file_name())).expect("a copy");
        }
    }
    folder
}

/// Polls until `done`, for at most two minutes.
pub(crate) fn wait_until(what: &str, mut done: impl FnMut() -> bool) {
    let until = Instant::now() + Duration::from_secs(120);
    while !done() {
        assert!(Instant::now() < until, "in 120 s: {what}");
        std::thread::park_timeout(Duration::from_millis(5));
    }
}

/// A process that comes to its end by itself.
pub(crate) trait Ending {
    /// How it ended. One that does not, for two minutes, fails its test and not the whole run of tests.
    fn ended(&mut self) -> ExitStatus;
}

impl Ending for Child {
    fn ended(&mut self) -> ExitStatus {
        let mut status = None;
        wait_until("a process ends", || {
            status = self.try_wait().expect("its status");
            status.is_some()
        });
        status.expect("it has ended")
    }
}

/// What Ctrl-C sends.
pub(crate) fn interrupt(child: &Child) {
    signal(child.id(), Signal::INT);
}

/// Ends a process without any warning.
pub(crate) fn kill(pid: u32) {
    signal(pid, Signal::KILL);
}

/// Asks a process to end.
pub(crate) fn terminate(pid: u32) {
    signal(pid, Signal::TERM);
}

/// Lets a stopped process go on.
pub(crate) fn resume(pid: u32) {
    signal(pid, Signal::CONT);
}

/// Stops a process as a debugger would.
pub(crate) fn stop(pid: u32) {
    signal(pid, Signal::STOP);
}

fn signal(pid: u32, signal: Signal) {
    let pid = i32::try_from(pid).ok().and_then(Pid::from_raw).expect("a process id");
    kill_process(pid, signal).expect("the signal is sent");
}
