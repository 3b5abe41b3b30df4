//! Pages of the particle world.

use std::path::Path;

use serde_json::Value;

use super::{END, Page, assert_best, assert_thoughts_agree, assert_title, list, number};
use crate::chromium::Browser;
use crate::support::{self, assert_fails, json, output, wait_until};

/// A run of `maac` that has learned next to nothing.
fn learned_pairs(folder: &Path) -> String {
    let run = folder.join("run").display().to_string();
    let sets = [
        "run.final_episodes=1",
        "run.evaluate_episodes=1",
        "replay.first=200",
        "environment.instances=4",
    ];
    let set = "particle/rover-tower-4";
    let mut arguments = vec!["train", "maac", "--env", set, "--steps", "1000", "-q", "--out", &run];
    arguments.extend(sets.iter().flat_map(|set| ["--set", set]));
    let trained = output(&arguments);
    assert!(trained.status.success(), "{}", support::stderr(&trained));
    run
}

#[test]
fn a_run_shows_the_plane_its_scores_and_whom_critics_look_at() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let page = Page::of(&[&learned_pairs(folder.path())]);
    let data = page.data();
    let states = list(&data["states"]);
    assert_eq!((states.len(), list(&data["agents"]).len()), (26, 4));
    for (state, step) in states.iter().zip(list(&data["steps"])) {
        for (agent, thought) in list(&state["thoughts"]).iter().enumerate() {
            let scores: Vec<f64> = list(&thought["utilities"]).iter().map(number).collect();
            let taken = step["actions"][agent].as_u64().expect("an action");
            assert_best(&scores, taken as usize, (1 << scores.len()) - 1);
            assert_eq!(list(&thought["attention"]).len(), 3);
            assert_thoughts_agree(thought, thought);
        }
    }
    assert!(states[25]["thoughts"].is_null(), "nobody acts in the final state");
    // What a tower does in a step it has said in the state behind it.
    let said = format!("said {}", data["steps"][3]["actions"][2]);
    let about = states[4]["agents"][2]["about"].as_str().expect("a text");
    assert!(about.ends_with(&said), "{about}");

    let browser = Browser::start();
    browser.open(&page.file());
    browser.press("2");
    assert_title(&browser, &data, 2);
    assert!(browser.text("#agent-title").contains("tower"));
    browser.click(".people .person:nth-child(1)");
    assert!(browser.text("#agent-title").contains("rover"));
    let pair = list(&states[0]["links"]).iter().find(|link| link["name"] == "pair");
    let partner = &pair.expect("a pair")["to"];
    assert!(browser.text("#agent-text").contains(&format!("led by {partner}")));
    assert!(browser.text("#utilities").contains("taken"));
    assert!(browser.text("#attention").contains(&format!("{partner} (pair)")));
    assert_percents(&browser, "#looks td.heat", 4);
    let lines = browser.evaluate("return document.querySelectorAll('#map .attention').length");
    assert_eq!(lines, 3, "to each of the others");
    browser.click("#looks tr:nth-child(4) th");
    assert_title(&browser, &data, 2);
    browser.press(END);
    assert!(browser.text("#result").contains("return"), "{}", browser.text("#result"));
    assert_eq!(browser.console(), Vec::<Value>::new());
}

/// Checks that numbers in percent are those of so many whole things, but for rounding.
fn assert_percents(browser: &Browser, selector: &str, wholes: usize) {
    let script = format!(
        "return [...document.querySelectorAll('{selector}')].map((cell) => Number(cell.textContent))"
    );
    let numbers: Vec<f64> = list(&browser.evaluate(&script)).iter().map(number).collect();
    let (sum, wanted) = (numbers.iter().sum::<f64>(), 100.0 * wholes as f64);
    assert!((sum - wanted).abs() <= 0.5 * numbers.len() as f64, "{selector}: {numbers:?}");
}

#[test]
fn treasures_are_shown_where_they_lie_and_in_whose_hands() {
    let page = Page::of(&["scripted", "--env", "particle/treasure-8"]);
    let data = page.data();
    let events = list(&data["events"]);
    let tells = |event: &&Value, what: &str| event["text"].as_str().unwrap().contains(what);
    let taken = events.iter().find(|event| tells(event, "holds a")).expect("somebody takes one");
    let [at, of] = ["at", "of"].map(|key| taken[key].as_u64().expect("a number") as usize);
    let states = list(&data["states"]);
    assert_eq!(states[at - 1]["agents"][of]["status"], "holds nothing");
    assert_eq!(states[at]["agents"][of]["status"], "holds a");
    assert!(events.iter().any(|event| tells(&event, "holds nothing")), "and delivers it");

    let browser = Browser::start();
    browser.open(&page.file());
    let things = |at: usize| {
        browser.evaluate(&format!("location.hash = '#{at},{of}'"));
        wait_until("the step is shown", || browser.text("#step").starts_with(&format!("{at} /")));
        browser.evaluate("return document.querySelectorAll('#map .thing .body').length")
    };
    let lies = |thing: &&Value| !thing["place"].is_null();
    let lie = |at: usize| list(&states[at]["things"]).iter().filter(lies).count();
    assert_eq!(things(0), lie(0));
    assert_eq!(things(at), lie(at));
    assert!(lie(at) < lie(0), "what was taken is gone");
    assert!(browser.text("#agent-text").contains("holds"));
    let name = browser.text(&format!(".people .person:nth-child({})", of + 1));
    assert_eq!(name, format!("{of}a"));
    assert!(browser.text("#utilities-text").contains("none known"));
    assert_eq!(browser.evaluate("return document.getElementById('looks').hidden"), true);
    assert_eq!(browser.console(), Vec::<Value>::new());
}

#[test]
fn attention_is_told_of_companions_and_of_others() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let run = learned_pairs(folder.path());
    let report = json(&["eval", &run, "--episodes", "20", "--attention", "--json"]);
    let attention = &report["attention"];
    let weights = list(&attention["weights"]);
    for (agent, of) in weights.iter().enumerate() {
        let of: Vec<f64> = list(of).iter().map(number).collect();
        assert!((of.iter().sum::<f64>() - 1.0).abs() < 1e-5 && of[agent] == 0.0, "{of:?}");
    }
    // Each of two rovers had each of two towers, for 500 steps together; the parts are the whole.
    let parts: Vec<&Value> =
        list(&attention["by_companion"]).iter().filter(|part| part["agent"] == 0).collect();
    assert_eq!(parts.iter().map(|part| &part["companion"]).collect::<Vec<_>>(), [2, 3]);
    let steps: Vec<f64> = parts.iter().map(|part| number(&part["steps"])).collect();
    assert_eq!(steps.iter().sum::<f64>(), 500.0);
    let whole = parts.iter().zip(&steps).map(|(part, steps)| number(&part["weights"][3]) * steps);
    assert!((whole.sum::<f64>() / 500.0 - number(&weights[0][3])).abs() < 1e-9);
    for entropy in list(&attention["entropy"]).iter().flat_map(list) {
        assert!((0.0..=3.0_f64.ln() + 1e-6).contains(&number(entropy)), "{entropy}");
    }
    let text = output(&["eval", &run, "--episodes", "2", "--attention"]);
    let text = String::from_utf8_lossy(&text.stdout);
    assert!(text.contains("each other of its role") && !text.contains("success"), "{text}");
    let refused = output(&["eval", "scripted", "--env", "particle", "--attention"]);
    assert_fails(&refused, 2, &["--attention", "maac"]);
}
