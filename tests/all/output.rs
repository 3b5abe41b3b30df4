//! Output that cannot be written: no panic, the promised exit code, one line.

use std::fs::{File, OpenOptions};
use std::process::{Command, Output, Stdio};

use crate::support::{BUNDLE, sortie, stderr};

/// Verbs whose product is what they print.
const VERBS: [&[&str]; 6] = [
    &["--help"],
    &["help", "run"],
    &["inspect", BUNDLE],
    &["inspect", BUNDLE, "--json"],
    &["eval", "scripted", "--episodes", "2"],
    &["run", BUNDLE, "--in-process", "--episodes", "1", "--rate", "0"],
];

fn full() -> File {
    OpenOptions::new().write(true).open("/dev/full").expect("a device that is always full")
}

/// The writing end of a pipe that nobody reads.
fn unread() -> Stdio {
    let (reader, writer) = std::io::pipe().expect("a pipe");
    drop(reader);
    writer.into()
}

/// Runs `arguments` under a shell that redirects as `redirection` says.
fn redirected(arguments: &[&str], redirection: &str) -> Output {
    let program = sortie(&[]);
    let mut shell = Command::new("sh");
    shell.current_dir(env!("CARGO_MANIFEST_DIR"));
    shell.args(["-c", &format!("exec \"$@\" {redirection}"), "sh"]).arg(program.get_program());
    shell.args(arguments).output().expect("a shell")
}

#[test]
fn a_full_disk_behind_standard_output_is_one_line() {
    for verb in VERBS {
        let ended = sortie(verb).stdout(full()).output().expect("it starts");
        let told = stderr(&ended);
        assert_eq!(ended.status.code(), Some(74), "{verb:?}: {told}");
        let errors: Vec<&str> = told.lines().filter(|line| line.starts_with("error: ")).collect();
        assert_eq!(errors, ["error: standard output: No space left on device (os error 28)"]);
        assert!(!told.contains("panicked"), "{verb:?}: {told}");
    }
}

#[test]
fn a_reader_that_has_gone_is_no_error_to_speak_of() {
    for verb in VERBS {
        let ended = sortie(verb).stdout(unread()).output().expect("it starts");
        let told = stderr(&ended);
        assert_eq!(ended.status.code(), Some(141), "{verb:?}: {told}");
        assert!(!told.contains("error") && !told.contains("panicked"), "{verb:?}: {told}");
    }
}

#[test]
fn nobody_needs_to_read_standard_error() {
    for verb in VERBS {
        for stream in [full().into(), unread()] {
            let ended = sortie(verb).stderr(stream).output().expect("it starts");
            assert_eq!(ended.status.code(), Some(0), "{verb:?}");
            assert!(!ended.stdout.is_empty(), "{verb:?}");
        }
    }
    let refused = sortie(&["inspect", "/nowhere"]).stderr(full()).output().expect("it starts");
    assert_eq!(refused.status.code(), Some(66));
    let wrong = sortie(&["inspect", "--wrong"]).stderr(unread()).output().expect("it starts");
    assert_eq!(wrong.status.code(), Some(2));
}

#[test]
fn closed_descriptors_are_harmless() {
    for verb in VERBS {
        for closed in [">&-", "2>&-", "<&- >&- 2>&-"] {
            assert_eq!(redirected(verb, closed).status.code(), Some(0), "{verb:?} {closed}");
        }
        assert!(!redirected(verb, "2>&-").stdout.is_empty(), "{verb:?}");
    }
}
