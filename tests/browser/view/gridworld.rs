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
    let cells = list(&states[0]["cells"]).iter().map(|cell| &cell[1]);
    let walls: Vec<usize> =
        cells.filter(|cell| cell["kind"] == "wall").map(|wall| cell_of(&wall["place"])).collect();
    for agent in 0..2 {
        let visits: Vec<f64> = list(&data["visits"][agent]).iter().map(number).collect();
        // A visit for each of 60,000 steps, and for each start of an episode.
        assert!(
            (60_000.0..62_000.0).contains(&visits.iter().sum()),
            "{}",
            visits.iter().sum::<f64>()
        );
        assert!(walls.iter().all(|wall| visits[*wall] == 0.0), "nobody was in a wall");
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
    assert_eq!(browser.text("#agent-title"), "1, agent");
    browser.click(".people .person:nth-child(1)");
    assert_eq!(browser.text("#agent-title"), "0, agent");
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

/// The number of the cell at a place.
fn cell_of(place: &Value) -> usize {
    20 * number(&place[1]) as usize + number(&place[0]) as usize
}

/// What heads pay is what follows from visits: the independent one for cells that were visited rarely.
fn assert_heads_pay(data: &Value, state: &Value, agent: usize, heads: &[Value]) {
    let cell = cell_of(&state["agents"][agent]["place"]);
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
fn finds_and_doors_are_shown() {
    let page = Page::of(&["scripted", "--env", "gridworld/flip-4"]);
    let data = page.data();
    let (states, events) = (list(&data["states"]), list(&data["events"]));
    let found = events.iter().find(|event| event["of"].is_u64()).expect("a treasure is found");
    let [at, of] = ["at", "of"].map(|key| found[key].as_u64().expect("a number") as usize);
    let status = |at: usize| states[at]["agents"][of]["status"].as_str().expect("a status");
    assert!(status(at - 1) != status(at) && status(at).starts_with("found"));
    assert!(found["text"].as_str().is_some_and(|text| text.ends_with(status(at))), "{found}");
    let tiers = |at: usize| number(&states[at]["metrics"][1]);
    let opens =
        (1..states.len()).find(|at| tiers(*at) > tiers(at - 1)).expect("a tier is finished");

    let browser = Browser::start();
    browser.open(&page.file());
    let count = |at: usize, kind: &str| {
        browser.evaluate(&format!("go({at})"));
        let cells = "return cellsOf(view.at).filter(({ kind }) => kind === ";
        browser.evaluate(&format!("{cells}'{kind}').length")).as_u64().expect("a number")
    };
    let doors = count(opens - 1, "door");
    assert!(doors > 0 && count(opens - 1, "open door") == 0);
    assert_eq!(count(opens, "door") + count(opens, "open door"), doors);
    assert!(count(opens, "open door") > 0);
    // The picture goes back as well as on.
    assert_eq!(count(0, "open door"), 0);
    assert!(browser.text("#utilities-text").contains("none known"));
    assert_eq!(browser.evaluate("return document.getElementById('heads').hidden"), true);
    let letters = |agent: &Value| agent["status"].as_str().expect("a status")[6..].to_owned();
    let all: Vec<String> = list(&states[opens]["agents"]).iter().map(letters).collect();
    let all: std::collections::BTreeSet<char> =
        all.iter().filter(|found| *found != "nothing").flat_map(|found| found.chars()).collect();
    assert_eq!(count(opens, "treasure, found"), all.len() as u64);
    assert_eq!(browser.console(), Vec::<Value>::new());
}
