//! `sortie view --live`: a page in which the team plays, with the bits of this machine.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::chromium::Browser;
use crate::support::{BUNDLE, assert_fails, json, output, wait_until};

const TEAMS: [&str; 11] = [
    BUNDLE,
    "models/save-the-city-wide",
    "models/save-the-city-large",
    "models/crafting-iron",
    "models/treasure-8",
    "models/rover-tower-8",
    "models/group-matching",
    "models/gridworld",
    "models/skirmish",
    "models/base-defence",
    "models/routing",
];
/// Teams that nobody assigns to subtasks, and what their pages show of the selected agent and of the rest.
const UNASSIGNED: [(&str, &[&str]); 6] = [
    ("models/crafting-iron", &["#milestones", "#team"]),
    ("models/treasure-8", &["#team"]),
    ("models/rover-tower-8", &["#team"]),
    ("models/group-matching", &["#attention", "#things"]),
    ("models/gridworld", &["#team"]),
    ("models/skirmish", &["#attention", "#things"]),
];
/// What all pages show.
const EVERYWHERE: [&str; 6] =
    ["#map-text", "#agent-title", "#agent-text", "#utilities", "#happening", "#return"];
/// Most steps that are compared.
const STEPS: u64 = 40;
const RIGHT: &str = "\u{E014}";
const HOME: &str = "\u{E011}";
/// Another build of the page's program, packed: `.ci/browser` tests its own.
const PROGRAM: &str = "SORTIE_PAGE_PROGRAM";
/// A file for the milliseconds until pages have drawn their first state, a line each.
const FIRST_FRAMES: &str = "SORTIE_FIRST_FRAMES";
/// Most bytes of a page.
const LARGEST: usize = 2_000_000;

/// A page in a folder of its own, and what its command says.
struct Page {
    folder: tempfile::TempDir,
    report: Value,
}

impl Page {
    fn of(bundle: &str) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("team.html").display().to_string();
        let program = std::env::var(PROGRAM).ok();
        let program: Vec<&str> =
            program.iter().flat_map(|program| ["--program", program.as_str()]).collect();
        let arguments = [&["view", bundle, "--live", "--json", "-o", &file][..], &program];
        Self { report: json(&arguments.concat()), folder }
    }

    fn file(&self) -> PathBuf {
        self.folder.path().join("team.html")
    }

    fn open(&self, browser: &Browser, address: &str) {
        browser.open_at(&self.file(), address);
        wait_until("the team plays", || browser.text("#golden").contains("bits"));
        let drawn = || browser.evaluate("return document.documentElement.dataset.firstFrame");
        wait_until("it has drawn a frame", || drawn().is_string());
        if let Ok(file) = std::env::var(FIRST_FRAMES) {
            let log = fs::OpenOptions::new().append(true).create(true).open(file);
            let line = format!("{}\n", drawn().as_str().expect("milliseconds"));
            log.and_then(|mut log| log.write_all(line.as_bytes())).expect("a line more");
        }
    }
}

fn count(browser: &Browser, selector: &str) -> Value {
    browser.evaluate(&format!("return document.querySelectorAll('{selector}').length"))
}

fn hash(report: &Value, name: &str) -> String {
    report["hashes"][name].as_str().expect("a hash").to_owned()
}

fn newest(browser: &Browser) -> String {
    browser.text("#step")
}

/// Where an agent is, by the map's words: `F0 at 3, 4`.
fn place_of(browser: &Browser, agent: &str) -> String {
    let map = browser.evaluate("return document.getElementById('map-text').textContent");
    let map = map.as_str().expect("the map in words").to_owned();
    let (_, rest) = map.split_once(&format!(" {agent} at ")).expect("the agent is on the map");
    rest.split(", ").take(2).collect::<Vec<_>>().join(", ")
}

#[test]
fn every_team_plays_in_the_browser_with_the_bits_of_this_machine() {
    let browser = Browser::start();
    for bundle in TEAMS {
        let page = Page::of(bundle);
        let text = fs::read_to_string(page.file()).expect("the page");
        assert!(text.len() <= LARGEST, "{bundle}: {} bytes", text.len());
        assert!(!text.contains("http://") && !text.contains("https://"), "{bundle}");
        assert!(text.contains("default-src 'none'"), "nothing may be loaded");
        page.open(&browser, "");
        let hashes = json(&["view", bundle, "--live", "--hash", "--json"]);
        assert_eq!(hashes["hashes"], page.report["hashes"], "{bundle}");
        assert_eq!(browser.text("#golden"), format!("{} the same bits", hash(&hashes, "golden")));
        browser.click("#rehearse");
        wait_until("it has played", || browser.text("#played").contains("bits"));
        assert_eq!(browser.text("#played"), format!("{} the same bits", hash(&hashes, "played")));
        assert!(browser.text("#took").ends_with("µs"), "{}", browser.text("#took"));
        assert_eq!(browser.console(), Vec::<Value>::new(), "{bundle}");
    }
}

#[test]
fn the_golden_hash_is_the_one_of_microcontrollers() {
    let table = fs::read_to_string("docs/evidence/firmware.md").expect("the table");
    let row =
        table.lines().find(|line| line.starts_with("| cortex-m4f | save-the-city-wide | exact"));
    let recorded = row.and_then(|row| row.rsplit('|').nth(1)).expect("a hash").trim();
    let hashes = json(&["view", "models/save-the-city-wide", "--live", "--hash", "--json"]);
    assert_eq!(hash(&hashes, "golden"), recorded);
    let other = json(&["view", BUNDLE, "--live", "--hash", "--json", "--seed", "2"]);
    let own = json(&["view", BUNDLE, "--live", "--hash", "--json"]);
    assert_ne!(hash(&other, "played"), hash(&own, "played"));
    assert_eq!(hash(&other, "golden"), hash(&own, "golden"));
    let text =
        String::from_utf8(output(&["view", BUNDLE, "--live", "--hash"]).stdout).expect("text");
    assert!(
        text.contains(&format!("10000 decisions of seed 1: {}", hash(&own, "played"))),
        "{text}"
    );
}

#[test]
fn the_page_says_where_its_bits_are_others() {
    let (page, browser) = (Page::of(BUNDLE), Browser::start());
    let (own, other) = (hash(&page.report, "golden"), "0123456789abcdef");
    let text = fs::read_to_string(page.file()).expect("the page");
    fs::write(page.file(), text.replace(&own, other)).expect("a page that wants other bits");
    browser.open_at(&page.file(), "");
    wait_until("it has compared", || browser.text("#golden").contains(&own));
    let said = browser.text("#golden");
    assert!(said.contains(&format!("OTHER BITS than {other}")), "{said}");
    assert_eq!(count(&browser, "#golden.loss"), 1);
}

#[test]
fn the_page_plays_the_episode_that_view_shows() {
    // A team of the most agents, and a smaller one.
    for number in [7, 0] {
        let parts = ["#attention", "#things", "#values"];
        let (browser, steps) = assert_same_episode(BUNDLE, &number.to_string(), &parts);
        assert_eq!(newest(&browser), format!("{steps} / {steps}"), "nothing follows the end");
        browser.press("f");
        assert!(browser.text("#refusal").contains("over"), "{}", browser.text("#refusal"));
    }
    for (bundle, parts) in UNASSIGNED {
        assert_same_episode(bundle, "0", parts);
    }
}

/// Compares an episode as `view` shows it, step by step, with the same in a page that plays it. Returns the steps that it has.
fn assert_same_episode(bundle: &str, number: &str, parts: &[&str]) -> (Browser, u64) {
    let (live, browser) = (Page::of(bundle), Browser::start());
    let folder = tempfile::tempdir().expect("a temporary folder");
    let played = folder.path().join("played.html");
    let file = played.display().to_string();
    let steps =
        json(&["view", bundle, "--episode", number, "--json", "-o", &file])["steps"].clone();
    let steps = steps.as_u64().expect("steps");
    // Cities are compared to their ends.
    let compared = if bundle == BUNDLE { steps } else { steps.min(STEPS) };
    let parts = [&EVERYWHERE, parts].concat();
    let texts = "return arguments.map((part) => document.querySelector(part).textContent)";
    let script = texts.replace("arguments", &serde_json::to_string(&parts).expect("a list"));
    let shown = || browser.evaluate(&script).as_array().expect("texts").clone();
    let mut recorded = Vec::new();
    browser.open(&played);
    let agents = browser.evaluate("return episode.agents.length").as_u64().expect("agents");
    let agent = u64::from(agents > 1);
    browser.press(&agent.to_string());
    for _ in 0..=compared {
        recorded.push(shown());
        browser.press(RIGHT);
    }
    let result = browser.text("#result");
    live.open(&browser, &format!("#seed=1&episode={number}&agent={agent}"));
    for (at, recorded) in recorded.iter().enumerate() {
        for ((part, live), recorded) in parts.iter().zip(shown()).zip(recorded) {
            assert_eq!(live, *recorded, "{bundle}: {part} at step {at}");
        }
        browser.press(RIGHT);
    }
    if compared == steps {
        assert_eq!(browser.text("#result"), result);
    }
    assert_eq!(browser.console(), Vec::<Value>::new());
    (browser, steps)
}

#[test]
fn a_visitor_interferes() {
    let (page, browser) = (Page::of(BUNDLE), Browser::start());
    page.open(&browser, "#seed=1&episode=7");
    let disabled =
        |id: &str| browser.evaluate(&format!("return document.getElementById('{id}').hidden"));
    assert_eq!(disabled("touched"), true);
    // Dragged to another cell, and seen there by all.
    let name = browser.evaluate("return document.querySelector('.person text').textContent");
    let name = name.as_str().expect("a name").to_owned();
    let before = place_of(&browser, &name);
    browser.drag("#map .people .person:nth-child(1)", (-60, -90));
    let after = place_of(&browser, &name);
    assert_ne!(before, after);
    assert_eq!(disabled("touched"), false);
    assert_eq!(newest(&browser), "0 / 0", "no step was taken");
    // By keys, one cell at a time, and not where somebody is.
    browser.press("0");
    let column = || {
        let place = place_of(&browser, &name);
        place.split(", ").next().and_then(|x| x.parse::<i32>().ok()).expect("a column")
    };
    let left = column();
    browser.press("d");
    assert_eq!(column(), left + 1);
    browser.press("q");
    assert_eq!(place_of(&browser, &name), after);
    // On fire.
    browser.click("#things button:nth-child(1)");
    browser.click("#disturb");
    assert!(browser.text("#things button:nth-child(1)").contains("burning"));
    assert!(browser.text("#thing-text").contains("100 %"));
    // Dead, and alive again.
    browser.press("k");
    assert_eq!(count(&browser, "#map .person.dead"), 1);
    assert!(browser.text("#kill").starts_with("Revive"));
    assert!(browser.text("#agent-text").contains("no process"), "{}", browser.text("#agent-text"));
    assert_eq!(browser.text("#took"), "nothing to decide");
    browser.press(RIGHT);
    assert_eq!(newest(&browser), "1 / 1", "the world does not wait for the dead");
    browser.click("#kill");
    assert_eq!(count(&browser, "#map .person.dead"), 0);
    assert!(browser.text("#utilities").contains("taken"));
    // Other allocators, and what they do.
    browser.press("a");
    assert_eq!(
        browser.evaluate("return document.getElementById('allocator').value"),
        "coordinated"
    );
    assert!(browser.text("#facts").contains("coordinated allocation"));
    browser.click("#allocator option:nth-child(3)");
    assert!(browser.text("#facts").contains("heuristic allocation"));
    // The past stays as it was.
    browser.click("#next");
    browser.press(HOME);
    assert_eq!(newest(&browser), "0 / 2");
    assert_eq!(count(&browser, "#map .person.dead"), 1);
    browser.click("#play");
    wait_until("it plays on", || !newest(&browser).ends_with("/ 2"));
    browser.click("#play");
    assert_eq!(browser.console(), Vec::<Value>::new());
}

#[test]
fn a_visitor_interferes_with_teams_that_nobody_assigns() {
    let browser = Browser::start();
    for (bundle, _) in UNASSIGNED {
        let page = Page::of(bundle);
        page.open(&browser, "#seed=1&episode=0");
        let map = || browser.evaluate("return document.getElementById('map-text').textContent");
        let changes = |change: &dyn Fn()| {
            let before = map();
            change();
            assert_eq!(newest(&browser), "0 / 0", "{bundle}: no step is taken");
            map() != before
        };
        // Somewhere nothing is in the way.
        let ways = [(70, 0), (-70, 0), (0, 70), (0, -70), (140, 40), (-140, -40)];
        let drag = |way| changes(&|| browser.drag("#map [data-entity='0']", way));
        assert!(ways.into_iter().any(drag), "{bundle}: nothing is dragged");
        let nudge = |key| changes(&|| browser.press(key));
        assert!(["w", "q", "s", "d"].into_iter().any(nudge), "{bundle}: nothing is moved by keys");
        let touched = browser.evaluate("return document.getElementById('touched').hidden");
        assert_eq!(touched, false, "{bundle}");
        browser.press("k");
        assert_eq!(count(&browser, "#map .dead"), 1, "{bundle}");
        let told = browser.text("#agent-panel");
        assert!(told.contains("no process acts for it"), "{bundle}: {told}");
        assert_eq!(browser.text("#took"), "nothing to decide");
        browser.press(RIGHT);
        assert_eq!(newest(&browser), "1 / 1", "{bundle}: the world does not wait for the dead");
        browser.press("k");
        assert_eq!(count(&browser, "#map .dead"), 0, "{bundle}");
        assert!(!browser.text("#agent-panel").contains("no process"), "{bundle}");
        browser.click("#play");
        wait_until("it plays on", || !newest(&browser).ends_with("/ 1"));
        browser.click("#play");
        assert_eq!(browser.console(), Vec::<Value>::new(), "{bundle}");
    }
}

#[test]
fn a_seed_and_a_step_are_shared_by_the_address() {
    let (page, browser) = (Page::of(BUNDLE), Browser::start());
    page.open(&browser, "#seed=5&episode=3&step=12&agent=1&allocation=heuristic");
    assert_eq!(newest(&browser), "12 / 12");
    assert!(browser.text("#facts").contains("heuristic allocation · episode 3 of seed 5"));
    let places = || browser.evaluate("return document.getElementById('map-text').textContent");
    let shown = places();
    let address = || browser.evaluate("return location.hash").as_str().map(str::to_owned);
    browser.press(RIGHT);
    let wanted = "#seed=5&episode=3&step=13&agent=1&allocation=heuristic";
    wait_until("the address has followed", || address().as_deref() == Some(wanted));
    page.open(&browser, "#seed=5&episode=3&step=12&allocation=learned");
    assert_ne!(places(), shown, "others are sent elsewhere");
    page.open(&browser, "#seed=5&episode=3&step=12&allocation=heuristic");
    assert_eq!(places(), shown);
    browser.press("e");
    wait_until("the next episode", || browser.text("#facts").contains("episode 4 of seed 5"));
    page.open(&browser, "#seed=minus&episode=-1&step=x&agent=99&allocation=nobody");
    assert!(browser.text("#facts").contains("learned allocation · episode 0 of seed 1"));
    let misread = browser.text("#misread");
    assert!(misread.contains("seed “minus”, which is no whole number"), "{misread}");
    assert_eq!(newest(&browser), "0 / 0");
    assert_eq!(browser.console(), Vec::<Value>::new());
}

#[test]
fn the_page_fits_a_phone() {
    let browser = Browser::start();
    browser.set_width(360);
    for bundle in TEAMS {
        Page::of(bundle).open(&browser, "");
        let width = browser.evaluate("return document.documentElement.scrollWidth");
        assert_eq!(width, 360, "{bundle}");
    }
    assert_eq!(browser.console(), Vec::<Value>::new());
}

#[test]
fn a_page_has_the_same_bytes_whenever_it_is_made() {
    let pages = [Page::of(BUNDLE), Page::of(BUNDLE)];
    let [first, second] = pages.map(|page| fs::read(page.file()).expect("the page"));
    assert!(first == second, "the page of {BUNDLE} depends on more than the bundle");
}

#[test]
fn teams_that_no_page_plays_are_refused_by_name() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("page.html").display().to_string();
    let refused = output(&["view", "scripted", "--live", "-o", &file]);
    assert_fails(&refused, 2, &["scripted", "save-the-city", "crafting", "models/"]);
    let asked = ["view", BUNDLE, "--live", "-o", &file, "--allocation", "heuristic"];
    for arguments in [&["view", BUNDLE, "--live"][..], &asked, &["view", BUNDLE, "--hash"]] {
        assert_eq!(output(arguments).status.code(), Some(2), "{arguments:?}");
    }
    let nowhere = output(&["view", BUNDLE, "--live", "-o", &file, "--program", "no/such/file"]);
    assert_fails(&nowhere, 66, &["no/such/file"]);
    assert!(!Path::new(&file).exists());
}
