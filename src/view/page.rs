//! One file with everything in it: markup, style, script and data.

use super::data::Page;

const SKELETON: &str = include_str!("page/page.html");
const STYLE: &str = include_str!("page/page.css");
/// The script, in the order in which its parts build on each other.
const SCRIPTS: [&str; 7] = [
    include_str!("page/episode.js"),
    include_str!("page/drawing.js"),
    include_str!("page/map.js"),
    include_str!("page/agent.js"),
    include_str!("page/building.js"),
    include_str!("page/timeline.js"),
    include_str!("page/player.js"),
];

/// The page as HTML.
pub(super) fn html(page: &Page) -> String {
    let data = serde_json::to_string(page).expect("pages have string keys only");
    let parts = [
        ("/* STYLE */", STYLE.to_string()),
        ("\"DATA\"", escape(&data)),
        ("/* SCRIPT */", SCRIPTS.concat()),
    ];
    let mut html = String::new();
    let mut rest = SKELETON;
    for (place, part) in parts {
        let (before, after) = rest.split_once(place).expect("the skeleton has a place for it");
        html.push_str(before);
        html.push_str(&part);
        rest = after;
    }
    html.push_str(rest);
    html
}

/// Inside a script element only `<` could end it, or begin a comment. JSON has it in texts alone.
fn escape(json: &str) -> String {
    json.replace('<', "\\u003c")
}
