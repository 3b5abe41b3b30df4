//! The page of an agent that runs options.

use serde_json::Value;

use super::{Page, list};
use crate::chromium::Browser;

#[test]
fn options_and_what_they_reach_are_shown() {
    let page = Page::of(&["models/crafting-iron"]);
    let data = page.data();
    let events = list(&data["events"]);
    let first = events.first().expect("a milestone is reached");
    let at = first["at"].as_u64().expect("a state");

    let browser = Browser::start();
    browser.open(&page.file());
    let option = &data["states"][0]["thoughts"][0]["option"];
    let name = |milestone: &Value| {
        let place = milestone.as_u64().expect("a milestone") as usize;
        data["milestones"][place].as_str().expect("a name").to_owned()
    };
    // Nothing is carried at first.
    let told = browser.text("#agent-text");
    let goal = format!("carries nothing; goes for {}, step 1 of", name(&option["goal"]));
    assert!(told.starts_with(&goal), "{told}");
    assert!(browser.text("#milestones tr.goal").starts_with(&name(&option["goal"])));
    browser.evaluate(&format!("go({at})"));
    let happens = first["text"].as_str().expect("a text");
    assert_eq!(browser.text("#happening"), happens);
    // No two kinds of objects have the same sign, and names of lanes are all to be read.
    let signs =
        "return [...document.querySelectorAll('#legend .sign')].map((sign) => sign.textContent)";
    let signs = list(&browser.evaluate(signs)).clone();
    let unlike: std::collections::BTreeSet<&str> = signs.iter().filter_map(Value::as_str).collect();
    assert!(signs.len() > 3 && unlike.len() == signs.len(), "{signs:?}");
    let cut = "return [...document.querySelectorAll('#timeline .lane-name')].filter((name) => name.getBoundingClientRect().left < document.getElementById('timeline').getBoundingClientRect().left).length";
    assert_eq!(browser.evaluate(cut), 0, "names that are cut off");
    assert_eq!(browser.console(), Vec::<Value>::new());
}
