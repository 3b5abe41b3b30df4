//! `sortie view`: what a page holds, and how it behaves in a browser.

mod crafting;
mod gridworld;
mod particle;

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::chromium::Browser;
use crate::support::{self, BUNDLE, SMALL, assert_fails, json, output, wait_until};

const EPISODE: &str = "tests/golden/save-the-city/043-3a-BFG-random-end-on-burn.json";
/// WebDriver's names of keys.
const RIGHT: &str = "\u{E014}";
const LEFT: &str = "\u{E012}";
const HOME: &str = "\u{E011}";
const END: &str = "\u{E010}";

/// A bundle with a learned allocator, and the run that it is made of, in this folder. It plays badly.
fn learned_bundle(place: &Path) -> (String, String) {
    let path = |name: &str| place.join(name).display().to_string();
    let (run, bundle) = (path("run"), path("bundle"));
    let mut arguments = vec!["train", "alma", "--out", &run, "--steps", "1500", "-q"];
    arguments.extend(SMALL);
    let trained = output(&arguments);
    assert!(trained.status.success(), "{}", support::stderr(&trained));
    let exported = output(&["export", &run, "--out", &bundle, "--episodes", "10", "-q"]);
    assert!(exported.status.success(), "{}", support::stderr(&exported));
    (run, bundle)
}

/// A page in a folder of its own.
struct Page {
    folder: tempfile::TempDir,
}

impl Page {
    fn of(arguments: &[&str]) -> Self {
        let page = Self { folder: tempfile::tempdir().expect("a temporary folder") };
        let file = page.file().display().to_string();
        let report = json(&[&["view", "--json", "-o", &file], arguments].concat());
        assert_eq!(report["file"], file);
        assert_eq!(report["steps"], page.data()["steps"].as_array().expect("steps").len());
        page
    }

    fn file(&self) -> PathBuf {
        self.folder.path().join("page.html")
    }

    fn text(&self) -> String {
        fs::read_to_string(self.file()).expect("the page")
    }

    /// The data that the page's script reads.
    fn data(&self) -> Value {
        let text = self.text();
        let (_, rest) = text.split_once("id=\"episode\">").expect("a data element");
        let (data, _) = rest.split_once("</script>").expect("its end");
        serde_json::from_str(data).expect("data is JSON")
    }
}

fn list(value: &Value) -> &Vec<Value> {
    value.as_array().expect("a list")
}

fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

#[test]
fn a_page_shows_the_episode_that_an_evaluation_records() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let place = folder.path().display().to_string();
    json(&["eval", BUNDLE, "--episodes", "3", "--episodes-out", &place, "--json"]);
    let file = folder.path().join("00002.json");
    let recorded: Value = serde_json::from_slice(&fs::read(&file).expect("the recording"))
        .expect("recordings are JSON");
    let played = Page::of(&[BUNDLE, "--episode", "2"]).data();
    let replayed = Page::of(&[&file.display().to_string(), "--policy", BUNDLE]).data();
    assert_eq!(list(&played["steps"]).len(), list(&recorded["steps"]).len());
    for (shown, step) in list(&played["steps"]).iter().zip(list(&recorded["steps"])) {
        assert_eq!(shown["actions"], step["actions"]);
        assert!((number(&shown["reward"]) - number(&step["reward"])).abs() < 1e-4);
    }
    assert_same_episode(&played, &replayed);
}

/// A recording's label names who allocated, so that even the allocation comes out the same.
fn assert_same_episode(played: &Value, replayed: &Value) {
    assert_eq!(played["allocation"], replayed["allocation"]);
    for part in ["states", "steps", "events", "agents", "result"] {
        assert_eq!(played[part], replayed[part], "{part}");
    }
}

#[test]
fn a_run_and_its_bundle_show_what_was_learned() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (run, bundle) = learned_bundle(folder.path());
    assert_run_and_bundle_agree(&run, &bundle);
    for subject in [&run, &bundle] {
        assert_learned_allocation_is_computed_again(subject, folder.path());
    }
}

/// Both compute the same utilities, attention and values of teams; the utilities explain the actions.
fn assert_run_and_bundle_agree(run: &str, bundle: &str) {
    let page = |subject: &str| Page::of(&[subject, "--allocation", "coordinated"]);
    let (run_page, bundle_page) = (page(run), page(bundle));
    let (by_run, by_bundle) = (run_page.data(), bundle_page.data());
    assert_eq!(by_run["steps"], by_bundle["steps"]);
    let states = list(&by_run["states"]).iter().zip(list(&by_bundle["states"]));
    for ((one, other), step) in states.zip(list(&by_run["steps"])) {
        assert_values_agree(&one["values"], &other["values"]);
        let thoughts = list(&one["thoughts"]).iter().zip(list(&other["thoughts"]));
        for (agent, (one_thought, other_thought)) in thoughts.enumerate() {
            assert_thoughts_agree(one_thought, other_thought);
            let closed = list(&one["unavailable"][agent]).iter().filter_map(Value::as_u64);
            let available = closed.fold(u64::MAX, |all, action| all & !(1 << action));
            let utilities = list(&one_thought["utilities"]).iter().map(number);
            let taken = step["actions"][agent].as_u64().expect("an action");
            assert_best(&utilities.collect::<Vec<f64>>(), taken as usize, available);
        }
    }
    assert_values_are_shown(&bundle_page);
}

/// Whoever learned an allocator plays under it, and so is a recording of it shown.
fn assert_learned_allocation_is_computed_again(subject: &str, folder: &Path) {
    let place = folder.join("episodes").display().to_string();
    json(&["eval", subject, "--episodes", "2", "--episodes-out", &place, "--json"]);
    let file = format!("{place}/00001.json");
    let played = Page::of(&[subject, "--episode", "1"]).data();
    assert_eq!(played["allocation"], "learned");
    assert!(list(&played["states"])[0]["values"].is_array());
    assert_same_episode(&played, &Page::of(&[&file, "--policy", subject]).data());
    // Without the team, nobody knows what it allocated.
    assert!(Page::of(&[&file]).data()["allocation"].is_null());
}

#[test]
fn agents_without_the_subtask_mask_are_refused() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let sets = [
        "run.final_episodes=1",
        "run.evaluate_episodes=1",
        "network.width=32",
        "allocation.coordinated=1",
        "allocation.learned=0",
    ];
    let run = path("run");
    let mut arguments = vec!["train", "flat", "--steps", "1000", "-q", "--out", &run];
    arguments.extend(sets.iter().flat_map(|set| ["--set", set]));
    let trained = output(&arguments);
    assert!(trained.status.success(), "{}", support::stderr(&trained));
    let refused = output(&["view", &path("run"), "-o", &path("page.html")]);
    assert_fails(&refused, 2, &["subtask mask"]);
}

/// The values of teams, the same but for rounding.
fn assert_values_agree(one: &Value, other: &Value) {
    let (one, other) = (list(one), list(other));
    assert_eq!(one.len(), other.len());
    let close = |one: &Value, other: &Value| {
        assert!((number(one) - number(other)).abs() < 3e-4, "{one} against {other}");
    };
    for (one, other) in one.iter().zip(other) {
        assert_eq!(one.is_null(), other.is_null(), "closed buildings have no values");
        if one.is_null() {
            continue;
        }
        close(&one["chosen"], &other["chosen"]);
        close(&one["nobody"], &other["nobody"]);
        let (one, other) = (list(&one["others"]), list(&other["others"]));
        assert_eq!(one.len(), other.len());
        one.iter().zip(other).for_each(|(one, other)| close(&one[1], &other[1]));
    }
}

/// The page shows what the allocator expects of teams.
fn assert_values_are_shown(page: &Page) {
    let browser = Browser::start();
    browser.open(&page.file());
    let team = browser.text("#things button[aria-pressed=true] .chips").replace('\n', " ");
    let values = browser.text("#values");
    assert!(values.contains(&format!("{team} chosen")), "{values}");
    assert!(values.contains("nobody"), "{values}");
    assert_eq!(browser.console(), Vec::<Value>::new());
}

/// No available action has a higher utility; rounded ones may be equal.
fn assert_best(utilities: &[f64], taken: usize, available: u64) {
    assert!(available >> taken & 1 == 1, "action {taken} is not available");
    let allowed = utilities.iter().enumerate().filter(|(action, _)| available >> action & 1 == 1);
    let better = allowed.filter(|(_, utility)| **utility > utilities[taken]);
    assert_eq!(better.count(), 0, "action {taken} of {utilities:?}");
}

fn assert_thoughts_agree(one: &Value, other: &Value) {
    for (one, other) in list(&one["utilities"]).iter().zip(list(&other["utilities"])) {
        assert!((number(one) - number(other)).abs() < 3e-4, "{one} against {other}");
    }
    let seen = list(&one["attention"]);
    assert_eq!(seen.len(), list(&other["attention"]).len());
    let heads = seen.first().map_or(0, |entity| list(&entity["weights"]).len());
    for head in 0..heads {
        let weight = |entity: &Value| number(&entity["weights"][head]);
        let sum: f64 = seen.iter().map(weight).sum();
        assert!((sum - 1.0).abs() < 1e-2, "head {head} sums to {sum}");
        for entity in seen {
            let same = |other: &&Value| other["entity"] == entity["entity"];
            let twin = list(&other["attention"]).iter().find(same).expect("the same entities");
            assert!((weight(entity) - weight(twin)).abs() < 3e-4, "{entity} against {twin}");
        }
    }
}

#[test]
fn a_page_needs_nothing_but_itself() {
    let text = Page::of(&[BUNDLE]).text();
    for foreign in ["http:", "https:", "src=", "@import", "url(", "fetch(", "import("] {
        assert!(!text.contains(foreign), "{foreign}");
    }
    assert!(text.contains("default-src 'none'"), "the page forbids itself to load anything");
}

#[test]
fn text_from_outside_stays_text() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let hostile = "</script><script>document.title = 'broken'</script>";
    let file = renamed(folder.path(), hostile).display().to_string();
    let page = Page::of(&[&file]);
    assert!(!page.text().contains(hostile));
    assert_eq!(page.data()["subject"], hostile);

    let browser = Browser::start();
    browser.open(&page.file());
    assert_eq!(browser.text("h1"), hostile);
    assert_eq!(browser.console(), Vec::<Value>::new());
}

/// A recorded episode under another name.
fn renamed(folder: &Path, name: &str) -> PathBuf {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join(EPISODE);
    let text = fs::read_to_string(source).expect("the recorded episode");
    let mut episode: Value = serde_json::from_str(&text).expect("it is JSON");
    episode["name"] = name.into();
    let file = folder.join("episode.json");
    fs::write(&file, episode.to_string()).expect("a copy");
    file
}

#[test]
fn wrong_use_and_broken_recordings_are_named() {
    let fails = |arguments: &[&str], code, words: &[&str]| {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let page = folder.path().join("page.html");
        let file = page.display().to_string();
        let all = [&["view", "-o", &file], arguments].concat();
        assert_fails(&output(&all), code, words);
        assert!(!page.exists());
    };
    fails(&["no/such/thing"], 66, &["no/such/thing"]);
    fails(&[EPISODE, "--allocation", "random"], 2, &["random"]);
    fails(&[EPISODE, "--allocation", "learned"], 2, &["--policy"]);
    fails(&["scripted", "--allocation", "learned"], 2, &["scripted", "learned"]);
    fails(&[EPISODE, "--episode", "1"], 2, &["--episode"]);
    fails(&[BUNDLE, "--policy", BUNDLE], 2, &["--policy"]);
    fails(&["README.md"], 65, &["README.md", "not JSON"]);
    fails(&[BUNDLE, "--env", "save-the-city/24a_24b"], 78, &["24a_24b"]);
}

#[test]
fn a_reader_steps_through_an_episode() {
    let page = Page::of(&[BUNDLE, "--episode", "7"]);
    let data = page.data();
    let last = list(&data["steps"]).len();
    let browser = Browser::start();
    browser.open(&page.file());
    let step = || browser.text("#step");
    let at = |step: usize| format!("{step} / {last}");
    assert_eq!(step(), at(0));
    // Whoever gets the page need not know the folders above.
    assert_eq!(browser.text("h1"), "save-the-city");
    let opening = browser.text("#opening");
    assert!(opening.contains("save-the-city/2-5a_2-5b, played by save-the-city"), "{opening}");

    // Keys.
    browser.press(RIGHT);
    browser.press(RIGHT);
    browser.press(LEFT);
    assert_eq!(step(), at(1));
    browser.press(END);
    assert_eq!(step(), at(last));
    assert_eq!(browser.text("#happening").contains("complete"), data["result"] == "solved");
    browser.press(HOME);
    browser.press("n");
    let later = |event: &&Value| event["at"] != 0;
    let event = list(&data["events"]).iter().find(later).expect("an event after the start");
    assert_eq!(step(), at(event["at"].as_u64().expect("a state") as usize));
    let told = browser.text("#happening");
    assert!(told.contains(event["text"].as_str().expect("its text")), "{told}");

    // Agents by digit, by button and on the map, buildings likewise.
    browser.press("2");
    assert_title(&browser, &data, 2);
    browser.click("#agents button:nth-child(2)");
    assert_title(&browser, &data, 1);
    browser.click(".people .person:nth-child(1)");
    assert_title(&browser, &data, 0);
    browser.click("#map .things .thing:nth-child(3)");
    assert!(browser.text("#thing-title").starts_with("building c"));
    browser.click("#things button:nth-child(2)");
    assert!(browser.text("#thing-title").starts_with("building b"));
    assert!(browser.text("#utilities").contains("taken"));
    assert!(browser.text("#attention").contains("(itself)"));

    // Scrubber and list of events.
    browser.evaluate(
        "const scrubber = document.getElementById('scrubber'); scrubber.value = 5; \
         scrubber.dispatchEvent(new Event('input'));",
    );
    assert_eq!(step(), at(5));
    let wanted: f64 = list(&data["steps"])[..5].iter().map(|step| number(&step["reward"])).sum();
    let shown: f64 = browser.text("#return").replace('−', "-").parse().expect("a number");
    assert!((shown - wanted).abs() < 0.006, "{shown} against {wanted}");
    browser.click("#jump option:last-child");
    assert_ne!(step(), at(5));
    browser.click("#timeline");
    let middle = browser.text("#step").split_once(" /").map(|(step, _)| step.parse::<usize>());
    assert!(middle.is_some_and(|step| step.is_ok_and(|step| step.abs_diff(last / 2) <= 2)));

    // It plays by itself, and stops when asked.
    browser.press(HOME);
    browser.click("#play");
    wait_until("it has played on", || !step().starts_with("0 "));
    browser.click("#play");
    assert_eq!(browser.text("#play"), "Play");
    assert_eq!(browser.console(), Vec::<Value>::new());
}

#[test]
fn the_address_follows_the_step_and_leads_back_to_it() {
    let page = Page::of(&[BUNDLE]);
    let browser = Browser::start();
    browser.open(&page.file());
    let address = || browser.evaluate("return location.hash").as_str().map(str::to_owned);
    browser.press(RIGHT);
    browser.press(RIGHT);
    browser.press("1");
    wait_until("the address has followed", || address().as_deref() == Some("#2,1"));
    browser.press(HOME);
    wait_until("the address has followed", || address().as_deref() == Some("#0,1"));
    browser.evaluate("location.hash = '#2,1'");
    wait_until("the page has followed", || browser.text("#step").starts_with("2 /"));
    assert_eq!(browser.console(), Vec::<Value>::new());
}

fn assert_title(browser: &Browser, data: &Value, agent: usize) {
    let name = data["agents"][agent]["name"].as_str().expect("a name");
    assert!(browser.text("#agent-title").starts_with(name), "{name}");
}

#[test]
fn pages_fit_a_phone() {
    let browser = Browser::start();
    for arguments in [
        &[BUNDLE][..],
        &["scripted", "--env", "save-the-city/24a_24b"],
        &["scripted", "--env", "particle/treasure-64"],
    ] {
        let page = Page::of(arguments);
        browser.set_width(360);
        browser.open(&page.file());
        let width = browser.evaluate("return document.documentElement.scrollWidth");
        assert_eq!(width, 360, "{arguments:?}");
    }
    assert_eq!(browser.console(), Vec::<Value>::new());
}
