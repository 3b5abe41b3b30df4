//! The grammar of the command line: what is refused, and how it is said.

use std::ffi::OsStr;
use std::fs;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

use serde_json::Value;

use crate::support::{BUNDLE, assert_fails, copied_bundle, json, output, sortie, stderr};

#[test]
fn a_negative_number_is_the_value_of_its_flag() {
    for (arguments, flag) in [
        (&["eval", "scripted", "--seed", "-1"][..], "--seed"),
        (&["eval", "scripted", "--episodes", "-5"], "--episodes"),
        (&["view", "scripted", "-o", "x.html", "--episode", "-1"], "--episode"),
        (&["train", "alma", "--out", "x", "--steps", "-5"], "--steps"),
        (&["run", BUNDLE, "--rate", "-1"], "--rate"),
    ] {
        let refused = output(arguments);
        assert_fails(&refused, 2, &["invalid value '-", flag]);
        assert!(!stderr(&refused).contains("tip:"), "{}", stderr(&refused));
    }
}

#[test]
fn flags_that_would_do_nothing_are_refused() {
    for (arguments, words) in [
        (&["eval", BUNDLE, "--proposals", "5"][..], "--proposals"),
        (&["run", BUNDLE, "--proposals", "5", "--in-process"], "--proposals"),
        (&["run", BUNDLE, "--allocation", "random", "--proposals", "5"], "--proposals"),
        (&["eval", "scripted", "--backend", "tract"], "--backend tract"),
        (&["eval", "scripted", "--profile", "fused"], "--profile"),
        (&["bench", "faults", "--runner-kills", "0", "--allocator-kills", "0"], "nothing to kill"),
    ] {
        assert_fails(&output(arguments), 2, &[words]);
    }
}

#[test]
fn an_interpreter_that_was_named_and_is_not_there_is_no_mere_note() {
    let arguments = ["verify", BUNDLE, "--inputs", "4", "--python", "/nowhere/python3"];
    assert_fails(&output(&arguments), 69, &["/nowhere/python3"]);
    let mut command = sortie(&arguments[..4]);
    let verified = command.env("ORT_DYLIB_PATH", "/nowhere/lib.so").output().expect("it starts");
    assert_fails(&verified, 69, &["/nowhere/lib.so"]);
}

#[test]
fn a_path_need_not_be_text() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let name = place.path().join(OsStr::from_bytes(b"caf\xe9"));
    let bundle = copied_bundle();
    std::os::unix::fs::symlink(bundle.path(), &name).expect("a link");
    let evaluated = sortie(&["eval", "--episodes", "1", "--json"]).arg(&name).output();
    let evaluated = evaluated.expect("it starts");
    assert!(evaluated.status.success(), "{}", stderr(&evaluated));
    let page = place.path().join(OsStr::from_bytes(b"page\xff.html"));
    let viewed = sortie(&["view"]).arg(&name).arg("-o").arg(&page).output().expect("it starts");
    assert!(viewed.status.success(), "{}", stderr(&viewed));
    assert!(page.exists());
    let nowhere = place.path().join(OsStr::from_bytes(b"no\xff"));
    let mut compare = sortie(&["compare", "--out", "x"]);
    assert_fails(&compare.arg(&nowhere).output().expect("it starts"), 66, &["names no run"]);
}

#[test]
fn what_is_no_bundle_is_explained() {
    assert_fails(&output(&["inspect", "/nowhere"]), 66, &["`/nowhere` does not exist"]);
    let named = output(&["inspect", "/nowhere", "--output", "actions"]);
    assert_fails(&named, 66, &["`/nowhere` does not exist"]);
    let steps = output(&["train", "alma", "--steps=-5"]);
    assert_fails(&steps, 2, &["expected a whole number from 0"]);
    let advice = ["`/nowhere` does not exist", "lie in `models/`", "`sortie export RUN` makes one"];
    assert_fails(&output(&["run", "/nowhere"]), 66, &advice);
    assert_fails(&output(&["run", "models"]), 66, &["models/save-the-city,", "name one of"]);
    assert_fails(&output(&["run", "docs"]), 66, &["docs", "bundle.toml"]);
}

#[test]
fn a_folder_of_episodes_is_replayed() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let folder = place.path().join("episodes").display().to_string();
    json(&["eval", "scripted", "--episodes", "3", "--episodes-out", &folder, "--json"]);
    assert_eq!(json(&["replay", &folder, "--json"])["files"], 3);
    let empty = place.path().display().to_string();
    assert_fails(&output(&["replay", &empty]), 66, &["no recorded episode"]);
}

#[test]
fn several_seeds_are_one_figure() {
    let evaluate = |seeds: &[&str]| -> Value {
        json(&[&["eval", "scripted", "--episodes", "40", "--json"], seeds].concat())
    };
    let (one, two) = (evaluate(&["--seed", "7"]), evaluate(&["--seed", "8"]));
    let both = evaluate(&["--seeds", "7..8"]);
    assert_eq!(both["episodes"], 80);
    assert_eq!(both["seeds"]["success"]["7"], one["success"]);
    assert_eq!(both["seeds"]["success"]["8"], two["success"]);
    let number = |value: &Value, key: &str| value[key].as_f64().expect("a number");
    for key in ["success", "none_burned", "timeouts", "return_mean", "length_mean"] {
        let mean = (number(&one, key) + number(&two, key)) / 2.0;
        assert!((mean - number(&both, key)).abs() < 1e-12, "{key}: {both}");
    }
    // Seeds are a sample of all seeds: of two the deviation is their distance over the root of 2.
    for (key, spread) in [("success", "success_sd"), ("return_mean", "returns_sd")] {
        let apart = (number(&one, key) - number(&two, key)).abs() / 2.0_f64.sqrt();
        assert!(apart > 0.0 && (apart - number(&both["seeds"], spread)).abs() < 1e-12, "{spread}");
    }
    assert!(both.get("seed").is_none());
    assert_fails(&output(&["eval", "scripted", "--seeds", "1..2", "--seed", "3"]), 2, &["--seed"]);
}

#[test]
fn a_team_that_nobody_allocates_plays_the_episodes_of_the_seed() {
    let evaluate = |seeds: &[&str]| -> Value {
        let ring = ["eval", "scripted", "--env", "group-matching/4x3x2", "--episodes", "40"];
        json(&[&ring[..], &["--json"], seeds].concat())
    };
    let (one, two) = (evaluate(&["--seed", "7"]), evaluate(&["--seed", "8"]));
    assert_ne!(one["return_mean"], two["return_mean"]);
    let both = evaluate(&["--seeds", "7..8"]);
    assert_eq!(both["seeds"]["returns"]["7"], one["return_mean"]);
    assert_eq!(both["seeds"]["returns"]["8"], two["return_mean"]);
}

#[test]
fn the_version_tells_the_commit_and_how_it_was_built() {
    let printed = |flag: &str| String::from_utf8_lossy(&output(&[flag]).stdout).into_owned();
    let (short, long) = (printed("-V"), printed("--version"));
    assert!(short.starts_with(&format!("sortie {}", env!("CARGO_PKG_VERSION"))), "{short}");
    assert_eq!(short.lines().count(), 1);
    assert!(long.starts_with(short.trim_end()), "{long}");
    assert!(long.contains("built: "), "{long}");
    if Path::new(env!("CARGO_MANIFEST_DIR")).join(".git").exists() {
        assert!(short.contains('('), "a commit: {short}");
    }
}

#[test]
fn shells_complete_and_readers_have_pages() {
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let script = output(&["completions", shell]);
        assert!(script.status.success(), "{}", stderr(&script));
        let text = String::from_utf8_lossy(&script.stdout).into_owned();
        assert!(text.contains("allocation") && text.contains("doctor"), "{shell}");
    }
    let place = tempfile::tempdir().expect("a temporary folder");
    let folder = place.path().join("man1");
    assert!(output(&["man", &folder.display().to_string()]).status.success());
    let page = fs::read_to_string(folder.join("sortie-train.1")).expect("a page");
    assert!(page.contains("seeds"), "{page}");
    assert!(!folder.join("sortie-process.1").exists(), "no page for what is hidden");
    assert!(folder.join("sortie.1").exists());
}

#[test]
fn help_names_every_exit_code() {
    let help = String::from_utf8_lossy(&output(&["--help"]).stdout).into_owned();
    for code in ["65", "66", "69", "70", "74", "75", "77", "78", "130", "141"] {
        assert!(help.contains(&format!("{code} ")), "{code}: {help}");
    }
}
