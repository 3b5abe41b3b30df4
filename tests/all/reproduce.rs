//! `sortie reproduce`: what is missing is learned, what is finished is read, and the published values stand beside.

use std::fs;
use std::path::Path;

use crate::support::{
    Ending as _, assert_fails, interrupt, json, output, sortie, stderr, wait_until,
};

/// Two methods in two cases, whose runs take a moment; maps differ by seed in one.
const RECIPES: &str = r#"
[[figure]]
name = "small"
about = "A small figure"
state = "partly"
why = "It is small."
seeds = "3..4"
words = "--steps STEPS --set run.evaluate_every=STEPS --set run.evaluate_episodes=4 --set run.final_episodes=4"
cases = [
    { name = "Task 2", words = "--env gridworld/task2-2" },
    { name = "Flip", words = "--env gridworld/flip-2 --set environment.settings.map_seed={seed}" },
]
measures = [
    { name = "twice frozen", key = "treasures", factor = 2, digits = 1 },
    { name = "learning", key = "training_treasures" },
    { name = "elsewhere", key = "treasures", eval = "--episodes 3 --seed 9" },
]
methods = [
    { name = "multi", words = "ma-exp", published = { "Task 2" = "1.83 ± 0.41" } },
    { name = "none", words = "ma-exp --set heads.intrinsic=none" },
]

[[figure]]
name = "missing"
about = "Nothing"
state = "not yet"
why = "The environment is not there."
"#;

/// A file with the recipes, and a folder for what is learned.
fn place(steps: &str) -> (tempfile::TempDir, String, String) {
    let place = tempfile::tempdir().expect("a temporary folder");
    let file = place.path().join("recipes.toml");
    fs::write(&file, RECIPES.replace("STEPS", steps)).expect("a file");
    let out = place.path().join("out");
    (place, file.display().to_string(), out.display().to_string())
}

#[test]
fn a_figure_is_learned_once_and_laid_beside_what_was_published() {
    let (_place, recipes, out) = place("60000");
    let arguments = ["reproduce", "small", "--recipes", &recipes, "--out", &out];
    let came = json(&[&arguments[..], &["--json"]].concat());
    let rows = came["rows"].as_array().expect("rows");
    let names: Vec<_> =
        rows.iter().map(|row| (row["case"].as_str(), row["method"].as_str())).collect();
    let [task, flip, multi, none] = ["Task 2", "Flip", "multi", "none"].map(Some);
    assert_eq!(names, [(task, multi), (task, none), (flip, multi), (flip, none)]);
    assert_eq!(
        (&rows[0]["published"], &rows[1]["published"]),
        (&"1.83 ± 0.41".into(), &None::<&str>.into())
    );
    let folder = Path::new(&out).join("small");
    for (row, path) in rows.iter().zip(["task-2/multi", "task-2/none", "flip/multi", "flip/none"]) {
        for (place, seed) in [3, 4].into_iter().enumerate() {
            let run = folder.join(format!("{path}-s{seed}"));
            let text = fs::read_to_string(run.join("result.json")).expect("a result");
            let result: serde_json::Value = serde_json::from_str(&text).expect("JSON");
            let treasures = result["treasures"].as_f64().expect("a number");
            assert_eq!(
                row["measures"][0]["seeds"][place].as_f64(),
                Some(2.0 * treasures),
                "{path}"
            );
        }
        let curve =
            fs::read_to_string(folder.join(format!("{path}-s4/curve.json"))).expect("a curve");
        let last = curve.lines().last().expect("a point");
        let point: serde_json::Value = serde_json::from_str(last).expect("JSON");
        let learning = &row["measures"][1]["seeds"][1];
        assert!(learning.is_f64() && *learning == point["training_treasures"], "{path}: {row}");
        let means = row["measures"][0]["seeds"].as_array().expect("seeds");
        let mean = means.iter().filter_map(serde_json::Value::as_f64).sum::<f64>() / 2.0;
        assert_eq!(row["measures"][0]["mean"].as_f64(), Some(mean), "{path}");
    }
    let map = |seed: u64| {
        let text = fs::read_to_string(folder.join(format!("flip/multi-s{seed}/train.toml")));
        text.expect("a description").contains(&format!("map_seed = {seed}\n"))
    };
    assert!(map(3) && map(4), "each seed has its map");
    let table = fs::read_to_string(folder.join("table.md")).expect("a table");
    assert!(
        table.lines().any(
            |line| line.starts_with("| Task 2 | multi | ") && line.ends_with("| 1.83 ± 0.41 |")
        ),
        "{table}"
    );
    assert!(
        table.contains("sortie train ma-exp --set heads.intrinsic=none --env gridworld/flip-2"),
        "{table}"
    );
    for picture in ["picture.svg", "flip/comparison/curves-steps.svg"] {
        let text = fs::read_to_string(folder.join(picture)).expect("a picture");
        assert!(text.contains("multi") && text.contains("none"), "{picture}");
    }
    let picture = fs::read_to_string(folder.join("picture.svg")).expect("a picture");
    assert!(picture.contains("Task 2") && picture.contains("Flip"));

    // As if it had been asked for by hand.
    let run = folder.join("task-2/multi-s3").display().to_string();
    let by_hand = json(&["eval", &run, "--episodes", "3", "--seed", "9", "--json"]);
    assert!(by_hand["treasures"].is_f64(), "{by_hand}");
    assert_eq!(rows[0]["measures"][2]["seeds"][0], by_hand["treasures"]);

    // What is finished is only read: a changed result shows in the table.
    for (file, treasures) in [("result", 100.0), ("eval-episodes-3-seed-9", 70.0)] {
        let result = folder.join(format!("task-2/multi-s3/{file}.json"));
        let text = fs::read_to_string(&result).expect("a result");
        let mut changed: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        changed["treasures"] = treasures.into();
        fs::write(&result, changed.to_string()).expect("a file");
    }
    let again = output(&[&arguments[..], &["-q"]].concat());
    let text = String::from_utf8_lossy(&again.stdout).into_owned();
    let shows = text.contains("to 200.0)") && text.contains("to 70.00)");
    assert!(again.status.success() && shows, "{text}");
    let listed = output(&["reproduce", "--list", "--recipes", &recipes, "--out", &out]);
    let text = String::from_utf8_lossy(&listed.stdout).into_owned();
    assert!(text.contains("8 of 8") && text.contains("The environment is not there."), "{text}");

    // Another recipe does not take these runs for its own, whatever lies beside them.
    fs::write(&recipes, RECIPES.replace("STEPS", "70000")).expect("a file");
    fs::remove_file(folder.join("task-2/multi.toml")).expect("the configuration of two runs");
    assert_fails(&output(&arguments), 2, &["multi-s3 has `run.steps`", "60000", "70000"]);
}

#[test]
fn what_was_stopped_goes_on() {
    let (_place, recipes, out) = place("400000");
    let arguments =
        ["reproduce", "small", "--recipes", &recipes, "--out", &out, "--seeds", "3..3", "-q"];
    let mut child = sortie(&arguments).spawn().expect("the command line starts");
    let runs = || ["multi-s3", "none-s3"].map(|run| Path::new(&out).join("small/task-2").join(run));
    wait_until("a run has begun", || runs().iter().any(|run| run.join("train.toml").exists()));
    interrupt(&child);
    assert_eq!(child.ended().code(), Some(130));
    assert!(!Path::new(&out).join("small/table.md").exists());
    let again = output(&arguments);
    assert!(again.status.success(), "{}", stderr(&again));
    assert!(Path::new(&out).join("small/table.md").exists());
}

#[test]
fn figures_that_cannot_be_redone_say_why() {
    let (_place, recipes, out) = place("6000");
    let ask = |figure| output(&["reproduce", figure, "--recipes", &recipes, "--out", &out]);
    assert_fails(&ask("missing"), 2, &["not yet", "The environment is not there."]);
    assert_fails(&ask("figure-9.9"), 2, &["no figure `figure-9.9`", "small"]);
    assert_fails(&output(&["reproduce", "figure-3.5"]), 2, &["not yet", "no recipe gathers it"]);
    assert_fails(&output(&["reproduce", "small", "--recipes", "no.toml"]), 66, &["no.toml"]);
    assert_eq!(output(&["reproduce"]).status.code(), Some(2));
    let listed = output(&["reproduce", "--list", "--json"]);
    let lines = String::from_utf8(listed.stdout).expect("text");
    let figures: Vec<serde_json::Value> =
        lines.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    let table = figures.iter().find(|figure| figure["figure"] == "table-4.1").expect("a table");
    assert_eq!((table["runs"].as_u64(), table["state"].as_str()), (Some(168), Some("partly")));
    assert!(!Path::new(&out).exists(), "nothing was learned");
}
