//! Several seeds in one command: a process each, stopped together, continued by the same command.

use std::fs;
use std::path::Path;

use crate::support::{Ending as _, SMALL, interrupt, json, output, sortie, stderr, wait_until};

/// `sortie train alma --seeds 1..3` into folders that begin with `out`.
fn sweep<'a>(out: &'a str, steps: &'a str, last: &'a str) -> Vec<&'a str> {
    let mut arguments = vec!["train", "alma", "--seeds", "1..3", "--out", out, "--steps", steps];
    arguments.extend(SMALL);
    arguments.push(last);
    arguments
}

/// The success that a finished run reports.
fn reported(out: &str, seed: u64) -> Option<f64> {
    let text = fs::read_to_string(format!("{out}-s{seed}/result.json")).ok()?;
    serde_json::from_str::<serde_json::Value>(&text).ok()?["success"].as_f64()
}

#[test]
fn every_seed_gets_its_run_and_the_summary_tells_all() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let out = place.path().join("sweep").display().to_string();
    let trained = output(&sweep(&out, "1000", "--json"));
    assert!(trained.status.success(), "{}", stderr(&trained));
    let lines = String::from_utf8(trained.stdout).expect("text");
    let summary = lines.lines().last().expect("a summary");
    let summary: serde_json::Value = serde_json::from_str(summary).expect("JSON");
    assert_eq!(summary["seeds"], 3);
    for seed in 1..=3 {
        let run = &summary["runs"][seed as usize - 1];
        assert_eq!(
            (run["seed"].as_u64(), run["success"].as_f64()),
            (Some(seed), reported(&out, seed))
        );
        let told = format!("\"run_seed\":{seed}");
        assert!(lines.contains(&told), "no line of seed {seed}");
        let facts = json(&["inspect", &format!("{out}-s{seed}"), "--json"]);
        assert_eq!(facts["seed"], seed, "{facts}");
    }
    assert!(Path::new(&format!("{out}.toml")).exists(), "the configuration lies beside the runs");
}

#[test]
fn a_stopped_sweep_goes_on_with_the_same_command() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let out = place.path().join("sweep").display().to_string();
    let mut child = sortie(&sweep(&out, "2400", "-q")).spawn().expect("the command line starts");
    wait_until("a run has measured once", || {
        (1..=3).any(|seed| {
            let curve = fs::metadata(format!("{out}-s{seed}/curve.json"));
            curve.is_ok_and(|file| file.len() > 0)
        })
    });
    interrupt(&child);
    assert_eq!(child.ended().code(), Some(130));
    assert!((1..=3).any(|seed| reported(&out, seed).is_none()), "something is left to do");

    let finished = output(&sweep(&out, "2400", "-q"));
    assert!(finished.status.success(), "{}", stderr(&finished));
    for seed in 1..=3 {
        assert!(reported(&out, seed).is_some(), "seed {seed}");
        let facts = json(&["inspect", &format!("{out}-s{seed}"), "--json"]);
        let last = facts["curve"].as_array().and_then(|curve| curve.last());
        assert_eq!(last.and_then(|point| point["env_steps"].as_u64()), Some(2400), "{facts}");
    }
}
