//! What people see: lines that fit, a live view that listens to keys and leaves the terminal as it was.

use std::io::{Read, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

use crate::support::{BUNDLE, Playing, SMALL, TestDomain, output, sortie, stderr, wait_until};

/// What hides and what shows the cursor.
const CURSOR: [&str; 2] = ["\x1b[?25l", "\x1b[?25h"];

/// A shell on a terminal of 80 columns, by `script` of util-linux.
struct Terminal {
    script: Child,
    keys: ChildStdin,
    shown: Arc<Mutex<String>>,
}

impl Terminal {
    /// Runs a verb, then tells its exit code and the modes of the terminal.
    fn running(arguments: &[&str], variables: &[(&str, &str)]) -> Self {
        let program = env!("CARGO_BIN_EXE_sortie");
        // Ctrl-C reaches the shell as well, which some shells survive only with a trap.
        let line = format!(
            "trap : INT; stty cols 80 rows 24; {program} {}; ended=$?; echo; echo ended with $ended; stty -a; \
             echo that is all",
            arguments.join(" ")
        );
        let mut command = Command::new("script");
        command.args(["-q", "-c", &line, "/dev/null"]).current_dir(env!("CARGO_MANIFEST_DIR"));
        command
            .env("SHELL", "/bin/sh")
            .env("TERM", "xterm")
            .env_remove("LC_ALL")
            .env_remove("NO_COLOR")
            .envs(variables.to_vec());
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::inherit());
        let mut script = command.spawn().expect("`script` of util-linux starts");
        let keys = script.stdin.take().expect("a pipe");
        let mut screen = script.stdout.take().expect("a pipe");
        let shown = Arc::new(Mutex::new(String::new()));
        let sink = Arc::clone(&shown);
        thread::spawn(move || {
            let mut bytes = [0; 4096];
            while let Ok(count @ 1..) = screen.read(&mut bytes) {
                let text = String::from_utf8_lossy(&bytes[..count]).into_owned();
                sink.lock().unwrap_or_else(PoisonError::into_inner).push_str(&text);
            }
        });
        Self { script, keys, shown }
    }

    fn shown(&self) -> String {
        self.shown.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn wait_for(&self, text: &str) {
        wait_until(text, || self.shown().contains(text));
    }

    fn press(&mut self, keys: &str) {
        self.keys.write_all(keys.as_bytes()).expect("the terminal takes keys");
        self.keys.flush().expect("the terminal takes keys");
    }

    /// All that was shown until the shell ended.
    fn end(mut self) -> String {
        self.wait_for("that is all");
        let _ = self.script.wait();
        self.shown()
    }
}

fn run_arguments<'a>(domain: &'a str, episodes: &'a str) -> [&'a str; 6] {
    ["run", BUNDLE, "--domain", domain, "--episodes", episodes]
}

/// Checks that the shell has its terminal back.
fn assert_restored(shown: &str) {
    let modes = shown.rsplit("ended with").next().unwrap_or_default();
    assert!(modes.contains(" icanon") && modes.contains(" echo "), "{modes}");
    assert!(modes.contains("susp = ^Z"), "{modes}");
    let [hidden, visible] = CURSOR.map(|code| shown.rfind(code).expect(code));
    assert!(hidden < visible, "the cursor is shown again");
}

#[test]
fn space_pauses_the_live_view_and_q_ends_it() {
    let domain = TestDomain::new("keys");
    let mut terminal = Terminal::running(&run_arguments(&domain.id, "1000"), &[]);
    terminal.wait_for("space pauses, q quits");
    terminal.press(" ");
    terminal.wait_for("PAUSED: space goes on, q quits");
    let paused = terminal.shown().len();
    terminal.press(" ");
    wait_until("going on", || terminal.shown()[paused..].contains("space pauses, q quits"));
    terminal.press("q");
    let shown = terminal.end();
    assert!(shown.contains("ended with 0"), "{shown}");
    // In the first episode as well.
    assert!(shown.contains("whole tick") && !shown.contains("error: "), "{shown}");
    assert_restored(&shown);
    assert_eq!(domain.leftovers(), [""; 0].map(std::path::PathBuf::from));
}

#[test]
fn a_team_is_watched_and_held_still_and_left_by_keys() {
    let domain = TestDomain::new("watched");
    let up = Playing::new(&domain);
    let mut terminal = Terminal::running(&["top", "--domain", &domain.id], &[]);
    terminal.wait_for("space holds, q quits");
    wait_until("who leads is shown", || {
        let shown = terminal.shown();
        shown.contains(" leads, term 1: ") && shown.contains("world ") && shown.contains("fallback")
    });
    terminal.press(" ");
    terminal.wait_for("HELD: space goes on");
    // What is held is drawn again, the same.
    let held = || {
        let shown = terminal.shown();
        let drawn = shown.split("domain ").filter(|drawn| drawn.contains("HELD"));
        drawn.map(str::to_owned).collect::<Vec<_>>()
    };
    wait_until("it is drawn several times", || held().len() > 4);
    let held = held();
    assert!(held[..4].iter().all(|drawn| *drawn == held[0]), "{held:?}");
    let before = terminal.shown().len();
    terminal.press(" ");
    wait_until("going on", || terminal.shown()[before..].contains("space holds"));
    terminal.press("q");
    let shown = terminal.end();
    assert!(shown.contains("ended with 0") && !shown.contains("error: "), "{shown}");
    assert_restored(&shown);
    up.shut_down(&domain);
}

#[test]
fn a_paused_live_view_ends_by_ctrl_c() {
    let domain = TestDomain::new("pause");
    let mut terminal = Terminal::running(&run_arguments(&domain.id, "1000"), &[]);
    terminal.wait_for("space pauses");
    terminal.press(" ");
    terminal.wait_for("PAUSED");
    terminal.press("\x03");
    let shown = terminal.end();
    assert!(shown.contains("ended with 130"), "{shown}");
    assert_restored(&shown);
}

#[test]
fn a_live_view_that_plays_to_its_end_leaves_the_terminal_as_it_was() {
    let arguments = ["run", BUNDLE, "--in-process", "--episodes", "1", "--rate", "0"];
    let shown = Terminal::running(&arguments, &[]).end();
    assert!(shown.contains("ended with 0"), "{shown}");
    assert!(shown.contains('█') && shown.contains("\x1b[K"), "{shown}");
    assert_restored(&shown);
}

#[test]
fn a_locale_without_unicode_gets_plain_characters() {
    let arguments = ["run", BUNDLE, "--in-process", "--episodes", "1", "--rate", "0"];
    let shown = Terminal::running(&arguments, &[("LC_ALL", "C")]).end();
    assert!(shown.contains("space pauses") && shown.is_ascii(), "{shown}");
}

#[test]
fn a_dumb_terminal_gets_lines() {
    let arguments = ["run", BUNDLE, "--in-process", "--episodes", "1", "--rate", "0"];
    let shown = Terminal::running(&arguments, &[("TERM", "dumb")]).end();
    assert!(shown.contains("episode   1 of 1"), "{shown}");
    assert!(!shown.contains('\x1b'), "{shown}");
}

#[test]
fn colours_are_a_matter_of_choice() {
    let arguments = ["run", BUNDLE, "--in-process", "--episodes", "1", "--rate", "0"];
    let colour = "\x1b[36m";
    let shown = |extra: &[&str], variables| {
        Terminal::running(&[&arguments, extra].concat(), variables).end()
    };
    assert!(shown(&[], &[]).contains(colour));
    assert!(!shown(&["--color", "never"], &[]).contains(colour));
    assert!(!shown(&[], &[("NO_COLOR", "1")]).contains(colour));
    assert!(shown(&["--color=always"], &[("NO_COLOR", "1")]).contains(colour));
}

/// Checks that everything printed fits a terminal of 80 columns.
fn assert_fits(text: &str) {
    assert!(!text.is_empty());
    for line in text.lines() {
        assert!(line.chars().count() <= 80, "{} characters: {line}", line.chars().count());
    }
}

#[test]
fn what_verbs_print_fits_80_columns() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let run = place.path().join("run").display().to_string();
    let train = ["train", "alma", "--out", &run, "--steps", "400", "-q"];
    let trained = output(&[&train[..], &SMALL].concat());
    assert!(trained.status.success(), "{}", stderr(&trained));
    let onnx = format!("{BUNDLE}/agent.onnx");
    let plan = place.path().join("agent.plan").display().to_string();
    let compiled = output(&["compile", &onnx, "-o", &plan]);
    assert!(compiled.status.success(), "{}", stderr(&compiled));
    for arguments in [
        &["inspect", BUNDLE][..],
        &["inspect", &onnx],
        &["inspect", &run],
        &["verify", BUNDLE, "--inputs", "4"],
        &["eval", "scripted", "--episodes", "4", "--seeds", "1..2"],
        &["bench", "env", "--seconds", "0.01", "--pin", "0"],
    ] {
        let printed = output(arguments);
        assert!(printed.status.success(), "{arguments:?}: {}", stderr(&printed));
        assert_fits(&String::from_utf8_lossy(&printed.stdout));
    }
}

#[test]
fn commands_that_up_tells_fit_and_can_be_pasted() {
    let domain = TestDomain::new("paste");
    let up = output(&["up", BUNDLE, "--domain", &domain.id, "--episodes", "1", "--rate", "0"]);
    let told = stderr(&up);
    let joined = told.replace(" \\\n      ", " ");
    let program = env!("CARGO_BIN_EXE_sortie");
    let processes: Vec<&str> =
        joined.lines().filter(|line| line.trim().starts_with(program)).collect();
    assert!(processes.len() >= 4, "{told}");
    assert!(processes.iter().all(|line| line.contains("--domain")), "{told}");
    for line in told.lines().filter(|line| line.starts_with("  ")) {
        assert!(line.len() <= 80 || line.contains(program), "{line}");
    }
}

#[test]
fn facts_are_found_by_their_names() {
    let printed = output(&["inspect", BUNDLE]);
    let text = String::from_utf8_lossy(&printed.stdout).into_owned();
    let value = |name: &str| {
        let line = text.lines().find(|line| line.split_whitespace().next() == Some(name));
        line.and_then(|line| line.split_whitespace().nth(1)).unwrap_or_default().to_owned()
    };
    assert_eq!(value("fact"), "value");
    assert_eq!(value("bundle"), BUNDLE);
    assert_eq!(value("id").len(), 64);
    assert_eq!(value("actions"), "12");
}

#[test]
fn the_result_is_printed_however_quiet() {
    let domain = TestDomain::new("quiet");
    for arguments in [
        &["run", BUNDLE, "--in-process", "--episodes", "1", "-q"][..],
        &["up", BUNDLE, "--domain", &domain.id, "--episodes", "1", "--rate", "0", "-q"],
        &["eval", "scripted", "--episodes", "2", "-q"],
        &["verify", "models/group-matching", "--inputs", "4", "--against", "golden", "-q"],
        &["replay", "tests/golden/save-the-city/043-3a-BFG-random-end-on-burn.json", "-q"],
    ] {
        let quiet = sortie(arguments).output().expect("the command line starts");
        assert!(quiet.status.success(), "{arguments:?}: {}", stderr(&quiet));
        assert!(!quiet.stdout.is_empty(), "{arguments:?}");
        assert_eq!(stderr(&quiet), "", "{arguments:?}");
    }
}
