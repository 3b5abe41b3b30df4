//! Pages of the gridworld.

use serde_json::Value;

use super::{END, Page, assert_best, list, number};
use crate::chromium::Browser;
use crate::support::{self, output};

/// The page of a run that has explored for a while.
fn explored() -> Page {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let run = folder.path().join("run").display().to_string();
    let train = ["train", "ma-exp", "-q", "--env", "gridworld/task3-2", "--steps", "60000"];
    let short = ["--set", "run.evaluate_every=60000", "--set", "run.final_episodes=1"];
    let trained = output(&[&train[..], &short, &["--out", &run]].concat());
    assert!(trained.status.success(), "{}", support::stderr(&trained));
    Page::of(&[&run])
}

#[test]
fn a_run_shows_its_maze_its_visits_and_what_its_heads_would_pay() {
    let page = explored();
    let data = page.data();
    let states = list(&data["states"]);
    let map: String = list(&data["map"]).iter().map(|row| row.as_str().expect("a row")).collect();
    for agent in 0..2 {
        let visits: Vec<f64> = list(&data["visits"][agent]).iter().map(number).collect();
        // A visit for each of 60,000 steps, and for each start of an episode.
        assert!(
            (60_000.0..62_000.0).contains(&visits.iter().sum()),
            "{}",
            visits.iter().sum::<f64>()
        );
        let wall = map.bytes().zip(&visits).find(|(sign, visits)| *sign == b'#' && **visits > 0.0);
        assert_eq!(wall, None, "nobody was in a wall");
    }
    for (state, step) in states.iter().zip(list(&data["steps"])) {
        for (agent, thought) in list(&state["thoughts"]).iter().enumerate() {
            let utilities: Vec<f64> = list(&thought["utilities"]).iter().map(number).collect();
            let taken = step["actions"][agent].as_u64().expect("an action");
            assert_best(&utilities, taken as usize, 0b11111);
            assert_heads_pay(&data, state, agent, list(&thought["heads"]));
            for head in list(&thought["heads"]).iter().filter(|head| head["acts"] == true) {
                assert_eq!((&head["name"], &head["likes"]), (&"none".into(), &taken.into()));
            }
        }
    }
    assert!(states.last().expect("a state")["thoughts"].is_null());

    let browser = Browser::start();
    browser.open(&page.file());
    browser.press("1");
    assert_eq!(browser.text("#agent-title"), "agent 1");
    browser.click(".people .person:nth-child(1)");
    assert_eq!(browser.text("#agent-title"), "agent 0");
    assert!(browser.text("#utilities").contains("taken"));
    assert!(browser.text("#heads tr:nth-child(2) th").contains("minimum"));
    assert!(browser.text("#heads tr:nth-child(6) th").contains("in use"));
    let shades = browser.evaluate("return document.querySelectorAll('#map .visits rect').length");
    let visited = list(&data["visits"][0]).iter().filter(|visits| number(visits) > 0.0).count();
    assert_eq!(shades, visited);
    browser.press(END);
    assert!(browser.text("#agent-text").contains("the episode is over"));
    assert_eq!(browser.console(), Vec::<Value>::new());
}

/// What heads pay is what follows from visits: the independent one for cells that were visited rarely.
fn assert_heads_pay(data: &Value, state: &Value, agent: usize, heads: &[Value]) {
    let cell = state["cells"][agent].as_u64().expect("a cell") as usize;
    let novelty = |agent: usize| number(&data["visits"][agent][cell]).max(1.0).powf(-0.7);
    let pays = |name: &str| {
        heads.iter().find(|head| head["name"] == name).map(|head| number(&head["pays"]))
    };
    let own = novelty(agent);
    let least = novelty(0).min(novelty(1));
    for (name, wanted) in [("independent", own), ("minimum", least), ("none", 0.0)] {
        let found = pays(name).unwrap_or(wanted);
        assert!((found - wanted).abs() < 1e-4, "{name}: {found} instead of {wanted}");
    }
}

#[test]
fn finds_falls_and_doors_are_shown() {
    let page = Page::of(&["scripted", "--env", "gridworld/flip-4"]);
    let data = page.data();
    let (states, events) = (list(&data["states"]), list(&data["events"]));
    let found = events.iter().find(|event| event["kind"] == "found").expect("a treasure is found");
    let [at, of] = ["at", "of"].map(|key| found[key].as_u64().expect("a number") as usize);
    assert_ne!(states[at - 1]["found"][of], states[at]["found"][of]);
    let tier = events.iter().find(|event| event["kind"] == "tier").expect("a tier is finished");
    let opens = tier["at"].as_u64().expect("a state");
    for fall in events.iter().filter(|event| event["kind"] == "fall") {
        let [at, of] = ["at", "of"].map(|key| fall[key].as_u64().expect("a number") as usize);
        assert_eq!(states[at]["cells"][of], states[0]["cells"][of], "who falls starts again");
    }

    let browser = Browser::start();
    browser.open(&page.file());
    let open_doors = |at: u64| {
        browser.evaluate(&format!("go({at})"));
        browser.evaluate("return document.querySelectorAll('#map .door.open').length")
    };
    let doors = browser.evaluate("return document.querySelectorAll('#map .door').length");
    assert_eq!((open_doors(opens - 1), open_doors(opens)), (0.into(), doors));
    assert!(browser.text("#utilities-text").contains("not known"));
    assert_eq!(browser.evaluate("return document.getElementById('heads').hidden"), true);
    let pale = browser.evaluate("return document.querySelectorAll('#map .treasure.found').length");
    let found = list(&states[opens as usize]["found"]).iter().filter_map(Value::as_u64);
    assert_eq!(pale, found.fold(0, |all, own| all | own).count_ones());
    assert_eq!(browser.console(), Vec::<Value>::new());
}
