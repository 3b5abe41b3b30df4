//! A storm, in short: long ones are a measurement.

use std::fs;
use std::process::{Command, Stdio};

use serde_json::Value;

#[test]
fn nothing_is_torn_wrong_or_leaked_in_a_storm() {
    let storm = Command::new(env!("CARGO_BIN_EXE_sortie-tools"))
        .args(["bench", "faults", "--runner-kills", "40", "--allocator-kills", "10", "--json"])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let domain = format!("faults-{}", storm.id());
    let output = storm.wait_with_output().expect("it ends");
    let found: Value = serde_json::from_slice(&output.stdout).expect("a report");
    assert!(output.status.success(), "{found}");
    assert_eq!([&found["rejoins"], &found["takeovers"]], [40, 10], "{found}");
    assert!(found["ticks_with_fallback"].as_u64() > Some(0), "{found}");
    for fault in ["torn_frames", "wrong_assignments", "old_terms", "leaked_segments"] {
        assert_eq!(found[fault], 0, "{fault}: {found}");
    }
    let objects = fs::read_dir("/dev/shm").expect("shared memory").flatten();
    let names = objects.map(|object| object.file_name().to_string_lossy().into_owned());
    let left: Vec<String> = names.filter(|name| name.contains(&domain)).collect();
    assert!(left.is_empty(), "{left:?}");
}
