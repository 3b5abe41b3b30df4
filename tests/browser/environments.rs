//! `--env` for environments of any kind: what each offers, and what is refused with what would fit.

use std::fs;
use std::path::PathBuf;

use serde_json::Value;

use crate::chromium::Browser;
use crate::support::{BUNDLE, TestDomain, assert_fails, json, output, stderr};

const RING: &str = "group-matching/6x5x2";

/// A page of one episode in a folder of its own, and the data that its script reads.
fn page(arguments: &[&str]) -> (tempfile::TempDir, Value) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("page.html");
    let name = file.display().to_string();
    let report = json(&[&["view", "--json", "-o", &name], arguments].concat());
    let text = fs::read_to_string(&file).expect("the page");
    let (_, rest) = text.split_once("id=\"episode\">").expect("a data element");
    let (data, _) = rest.split_once("</script>").expect("its end");
    let data: Value = serde_json::from_str(data).expect("data is JSON");
    assert_eq!(report["steps"], data["steps"].as_array().expect("steps").len());
    (folder, data)
}

fn list(value: &Value) -> &Vec<Value> {
    value.as_array().expect("a list")
}

#[test]
fn an_episode_of_group_matching_is_a_page() {
    let (folder, data) = page(&["scripted", "--env", RING, "--episode", "5"]);
    let (states, steps) = (list(&data["states"]), list(&data["steps"]));
    assert_eq!(states.len(), steps.len() + 1);
    assert_eq!((list(&data["agents"]).len(), list(&states[0]["things"]).len()), (6, 2));
    assert_eq!(data["result"], "solved");
    for step in steps {
        assert!(list(&step["actions"]).iter().all(|action| action.as_u64() < Some(3)));
    }
    let end = &states[steps.len()];
    assert!(list(&end["things"]).iter().all(|group| group["status"] == "together"));
    for group in list(&end["things"]) {
        let own = list(&end["agents"]).iter().filter(|agent| agent["colour"] == group["colour"]);
        let about = |agent: &Value| agent["about"].as_str().expect("a text").to_owned();
        let cells: Vec<String> = own.map(about).collect();
        assert!(cells.windows(2).all(|pair| pair[0] == pair[1]), "{cells:?}");
    }
    let text = fs::read_to_string(folder.path().join("page.html")).expect("the page");
    assert!(text.contains("default-src 'none'"), "the page forbids itself to load anything");

    let browser = Browser::start();
    browser.open(&folder.path().join("page.html"));
    let step = || browser.text("#step");
    assert_eq!(step(), format!("0 / {}", steps.len()));
    browser.press("\u{E010}");
    assert_eq!(step(), format!("{0} / {0}", steps.len()));
    assert!(browser.text("#happening").contains("together"));
    browser.evaluate(
        "const scrubber = document.getElementById('scrubber'); scrubber.value = 1; \
         scrubber.dispatchEvent(new Event('input'));",
    );
    assert_eq!(step(), format!("1 / {}", steps.len()));
    browser.click("#agents button:nth-child(3)");
    let name = data["agents"][2]["name"].as_str().expect("a name");
    assert!(browser.text("#agent-title").starts_with(name));
    assert!(browser.text("#utilities").contains("taken"));
    browser.click(".people .person:nth-child(1)");
    let name = data["agents"][0]["name"].as_str().expect("a name");
    assert!(browser.text("#agent-title").starts_with(name));
    browser.click("#things button:nth-child(2)");
    assert_eq!(browser.text("#thing-title"), "group B");
    assert_eq!(browser.console(), Vec::<Value>::new());
}

#[test]
fn an_episode_of_group_matching_repeats_by_its_seed_and_number() {
    let play =
        |more: &[&str]| page(&[&["scripted", "--env", RING], more].concat()).1["states"].clone();
    assert_eq!(play(&["--seed", "3"]), play(&["--seed", "3", "--episode", "0"]));
    assert_ne!(play(&["--seed", "3"]), play(&["--seed", "4"]));
    assert_ne!(play(&["--seed", "3"]), play(&["--seed", "3", "--episode", "1"]));
}

#[test]
fn the_script_of_group_matching_is_measured_on_the_episodes_that_its_pages_show() {
    let measured = json(&["eval", "scripted", "--env", RING, "--episodes", "40", "--json"]);
    assert_eq!((&measured["env"], &measured["episodes"]), (&RING.into(), &40.into()));
    assert!(measured["success"].as_f64() > Some(0.9), "{measured}");
    let one = json(&["eval", "scripted", "--env", RING, "--episodes", "1", "--json"]);
    let (_folder, data) = page(&["scripted", "--env", RING]);
    assert_eq!(one["length_mean"].as_f64(), Some(list(&data["steps"]).len() as f64));
    let refused = output(&["eval", "scripted", "--env", RING, "--allocation", "random"]);
    assert_fails(&refused, 2, &["--allocation"]);
}

#[test]
fn a_team_of_group_matching_is_looked_at_and_deployed() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| place.path().join(name).display().to_string();
    let (run, bundle) = (path("run"), path("bundle"));
    let trained = ["train", "vdn", "--env", RING, "--steps", "3000", "--out", &run, "-q"];
    let trained = output(&trained);
    assert!(trained.status.success(), "{}", stderr(&trained));
    let (_folder, by_run) = page(&[&run, "--episode", "2"]);
    let exported = output(&["export", &run, "--out", &bundle, "--episodes", "10", "-q"]);
    assert!(exported.status.success(), "{}", stderr(&exported));
    let (_folder, by_bundle) = page(&[&bundle, "--episode", "2"]);
    assert_eq!(by_run["steps"], by_bundle["steps"], "both play the same");
    for (state, step) in list(&by_bundle["states"]).iter().zip(list(&by_bundle["steps"])) {
        let thoughts = list(&state["thoughts"]).iter().zip(list(&step["actions"]));
        for (thought, action) in thoughts {
            let utilities =
                list(&thought["utilities"]).iter().map(|value| value.as_f64().expect("a number"));
            let utilities: Vec<f64> = utilities.collect();
            let taken = utilities[action.as_u64().expect("a number") as usize];
            assert!(utilities.iter().all(|utility| *utility <= taken), "{thought}, {action}");
            assert_eq!(list(&thought["attention"]).len(), 6);
        }
    }

    let domain = TestDomain::new("ring");
    let play = |more: &[&str]| {
        let arguments = ["run", &bundle, "--episodes", "2", "--seed", "3", "--json", "--domain"];
        json(&[&arguments, &[domain.id.as_str()][..], more].concat())
    };
    let (processes, in_process) = (play(&["--isolate"]), play(&["--in-process"]));
    for key in ["success", "return_mean", "groups_gathered", "by_team", "decisions"] {
        assert_eq!(processes[key], in_process[key], "{key}");
    }
    assert_eq!((&processes["groups"], &processes["allocation"]), (&4.into(), &"none".into()));
    assert_eq!(
        processes["processes"], 7,
        "a world and a process for each agent, nobody who allocates"
    );
    let up = ["up", &bundle, "--episodes", "2", "--rate", "0", "--json", "--domain", &domain.id];
    assert_eq!(json(&up)["episodes"], 2);
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
    let refused = output(&["run", &bundle, "--allocation", "random", "--in-process"]);
    assert_fails(&refused, 2, &["no subtasks", "random"]);
}

#[test]
fn the_scripts_of_the_particle_world_are_measured() {
    let rovers = ["eval", "scripted", "--env", "particle/rover-tower-8", "--episodes", "100"];
    let measured = json(&[&rovers[..], &["--json"]].concat());
    assert!(measured["return_mean"].as_f64() > Some(110.0), "{measured}");
    assert!(measured["near"].as_f64() > Some(12.0), "{measured}");
    assert_eq!((&measured["timeouts"], &measured["success"]), (&1.0.into(), &0.0.into()));
    let rates = |env: &str| {
        let report = json(&["bench", "env", "--env", env, "--seconds", "0.01", "--json"]);
        let cases = list(&report["rows"]).iter().map(|row| row["case"].clone());
        cases.collect::<Vec<Value>>()
    };
    assert_eq!(rates("particle"), ["particle", "particle, steps alone"]);
    assert_eq!(rates("save-the-city"), ["save-the-city"], "not every action is possible there");
}

#[test]
fn what_an_environment_does_not_offer_is_refused_with_what_would_fit() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let place = folder.path().join("page.html").display().to_string();
    let view = |more: &[&str]| output(&[&["view", "-o", &place], more].concat());
    let ring = ["scripted", "--env", "group-matching", "--allocation", "coordinated"];
    assert_fails(&view(&ring), 2, &["no subtasks", "coordinated"]);
    let sizes = ["scripted", "--env", "group-matching/8x6"];
    assert_fails(&view(&sizes), 2, &["8x6", "8x6x2"]);
    let recording = fs::read_dir("tests/golden/group-matching").expect("recordings").flatten();
    let recording = recording.map(|entry| entry.path().display().to_string()).min();
    assert_fails(&view(&[&recording.expect("a recording")]), 2, &["recording", "played"]);
    for verb in ["run", "up"] {
        let refused = output(&[verb, BUNDLE, "--env", "group-matching", "--episodes", "1"]);
        assert_fails(&refused, 78, &[BUNDLE, "other features"]);
    }
    assert_fails(&view(&[BUNDLE, "--env", "group-matching"]), 78, &[BUNDLE, "other features"]);
}
