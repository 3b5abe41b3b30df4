//! Runs are watched, inspected and compared.

use std::fs;
use std::path::Path;

use crate::support::{self, assert_fails, json, output};

/// A run with a made-up curve that ends with this success after 200,000 steps.
fn made_up_run(folder: &Path, success: f64) {
    fs::create_dir_all(folder).expect("the run's folder");
    let line = |steps: u32, success: f64| {
        let seconds = steps / 1000;
        format!(
            "{{\"env_steps\":{steps},\"wall_s\":{seconds},\"cpu_s\":{seconds},\"success\":{success}}}\n"
        )
    };
    let curve = line(100_000, success / 2.0) + &line(200_000, success);
    fs::write(folder.join("curve.json"), curve).expect("the run's curve");
}

#[test]
fn runs_are_grouped_by_label_and_pattern() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| place.path().join(name).display().to_string();
    for (name, success) in [("a-s1", 0.5), ("a-s2", 0.7), ("b-s1", 0.9)] {
        made_up_run(&place.path().join(name), success);
    }
    let (out, label) = (path("out"), format!("B, best={}", path("b-s*")));
    let title = ["--title", "Made up"];
    let mut arguments = vec!["compare"];
    let (first, second) = (path("a-s1"), path("a-s2"));
    arguments.extend([&first, &second, &second, "--label", &label, "--out", &out, "--json"]);
    arguments.extend(title);
    let report = json(&arguments);
    assert_eq!(report["title"], "Made up");
    let labels: Vec<_> = report["groups"].as_array().expect("groups").iter().collect();
    assert_eq!((&labels[0]["label"], &labels[0]["runs"]), (&"a".into(), &2.into()));
    assert_eq!((&labels[1]["label"], &labels[1]["runs"]), (&"B, best".into(), &1.into()));
    assert_eq!(labels[0]["success"]["mean"], 0.6);
    assert_eq!(labels[0]["until"]["0.60"]["reached"], 1);
    for name in ["curves-steps.svg", "curves-cpu.svg", "table.md", "table.csv", "table.json"] {
        let text = fs::read_to_string(Path::new(&out).join(name)).expect(name);
        assert!(text.contains("B, best"), "{name}: {text}");
    }
}

#[test]
fn runs_of_other_settings_are_not_averaged_and_one_run_counts_once() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| place.path().join(name).display().to_string();
    for (name, seed, width) in [("mix-s1", 1, 64), ("mix-s2", 2, 64), ("mix-s3", 3, 32)] {
        let folder = place.path().join(name);
        made_up_run(&folder, 0.5);
        let text = format!(
            "method = \"alma\"\nversion = \"0.{seed}.0\"\nseed = {seed}\nthreads = {seed}\n[network]\nwidth = {width}\n"
        );
        fs::write(folder.join("train.toml"), text).expect("its settings");
    }
    let out = path("out");
    let [first, second, third] = ["mix-s1", "mix-s2", "mix-s3"].map(path);
    let refused = output(&["compare", &first, &second, &third, "--out", &out]);
    let words = ["runs of `mix` differ", "`network.width` is 64", "32 in", "mix-s3", "--label"];
    assert_fails(&refused, 2, &words);
    assert!(!Path::new(&out).exists());
    let around = place.path().join("mix-s2/../mix-s1").display().to_string();
    let report = json(&["compare", &first, &around, &second, "--out", &out, "--json"]);
    assert_eq!(report["groups"][0]["runs"], 2);
}

#[test]
fn what_cannot_be_compared_is_named() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let out = place.path().join("out").display().to_string();
    let nothing = place.path().join("nothing-s*").display().to_string();
    let missing = output(&["compare", &nothing, "--out", &out]);
    assert_fails(&missing, 66, &["nothing-s*", "curve.json"]);
    let broken = place.path().join("broken");
    fs::create_dir(&broken).expect("the run's folder");
    fs::write(broken.join("curve.json"), "{}\n").expect("a curve");
    let broken = broken.display().to_string();
    assert_fails(&output(&["compare", &broken, "--out", &out]), 65, &["line 1", "env_steps"]);
    assert_eq!(output(&["compare", "--label", "name", "--out", &out]).status.code(), Some(2));
    assert_eq!(output(&["compare", "--out", &out]).status.code(), Some(2));
    assert!(!Path::new(&out).exists());
}

#[test]
fn a_run_leaves_its_curve_in_every_form() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let run = place.path().join("small-s1");
    let folder = run.display().to_string();
    let mut arguments = vec!["train", "alma", "--out", &folder, "--steps", "2000", "-q"];
    for assignment in [
        "run.evaluate_every=1000",
        "run.evaluate_episodes=10",
        "run.final_episodes=20",
        "network.width=32",
    ] {
        arguments.extend(["--set", assignment]);
    }
    let trained = output(&arguments);
    assert!(trained.status.success(), "{}", support::stderr(&trained));

    let inspected = json(&["inspect", &folder, "--json"]);
    let points = inspected["curve"].as_array().expect("its curve").len();
    assert_eq!(points, 2);
    assert_eq!(inspected["configuration"]["network"]["width"], 32);
    let table = fs::read_to_string(run.join("curve.csv")).expect("curve.csv");
    assert_eq!(table.lines().count(), points + 1);
    assert!(table.starts_with("env_steps,"), "{table}");
    let names = fs::read_dir(&run).expect("the run's folder").flatten();
    let names: Vec<String> =
        names.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    let events = names.iter().filter(|name| name.starts_with("events.out.tfevents."));
    assert_eq!(events.count(), 1, "{names:?}");

    let out = place.path().join("out").display().to_string();
    let compared = json(&["compare", &folder, "--out", &out, "--json"]);
    assert_eq!(compared["groups"][0]["success_from"], "result");
    assert_eq!(compared["files"].as_array().map(Vec::len), Some(7), "{compared}");
    let text = output(&["inspect", &folder]);
    let text = String::from_utf8_lossy(&text.stdout).into_owned();
    for part in ["network", "95 % interval", "1.0 ┤", "final evaluation: success"] {
        assert!(text.contains(part), "no `{part}` in {text}");
    }
    // As a run is before its first evaluation.
    for name in ["curve.json", "result.json"] {
        fs::remove_file(run.join(name)).expect(name);
    }
    let begun = output(&["inspect", &folder]);
    let text = String::from_utf8_lossy(&begun.stdout).into_owned();
    assert!(text.contains("network.width=32") && text.contains("not evaluated yet"), "{text}");
    assert_eq!(json(&["inspect", &folder, "--json"])["configuration"]["network"]["width"], 32);
}
