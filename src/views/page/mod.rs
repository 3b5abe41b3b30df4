//! One file with everything in it: markup, style, script and data.
//!
//! Every page has a picture, a slider with its keys, and panels. An environment adds what its own looks like: its script
//! has `createMap`, `createAgentPanel`, `createBuildingPanel` (for whatever agents work on or belong to) and
//! `createTimeline`, and its data the agents' names, `states`, `steps` with rewards, `events` and a `result`.

use serde::Serialize;
pub(super) use sortie_stage::rounded;

use super::{Page, Wanted};

const SKELETON: &str = include_str!("web/page.html");

/// Parts of a style that all pages share.
pub(super) mod style {
    pub(in crate::views) const COLOURS: &str = include_str!("web/colours.css");
    pub(in crate::views) const BASICS: &str = include_str!("web/basics.css");
    pub(in crate::views) const LAYOUT: &str = include_str!("web/layout.css");
    pub(in crate::views) const DESK: &str = include_str!("web/desk.css");
    pub(in crate::views) const DISCS: &str = include_str!("web/discs.css");
    pub(in crate::views) const LANES: &str = include_str!("web/lanes.css");
    pub(in crate::views) const HEAT: &str = include_str!("web/heat.css");
    pub(in crate::views) const RESULT: &str = include_str!("web/result.css");
    pub(in crate::views) const PLAYBACK: &str = include_str!("web/playback.css");
    pub(in crate::views) const AGENT: &str = include_str!("web/agent.css");
    pub(in crate::views) const DIALOG: &str = include_str!("web/dialog.css");
}

/// Parts of a script that all pages share.
pub(super) mod script {
    pub(in crate::views) const EPISODE: &str = include_str!("web/episode.js");
    pub(in crate::views) const SUMS: &str = include_str!("web/sums.js");
    pub(in crate::views) const NUMBERS: &str = include_str!("web/numbers.js");
    pub(in crate::views) const ELEMENTS: &str = include_str!("web/elements.js");
    pub(in crate::views) const LANES: &str = include_str!("web/lanes.js");
    pub(in crate::views) const PLAYER: &str = include_str!("web/player.js");
}

/// What a page is made of beside its data.
pub(super) struct Web {
    /// In the order of the cascade.
    pub(super) styles: &'static [&'static str],
    /// The panel of the picture.
    pub(super) map: &'static str,
    /// The panels behind the slider.
    pub(super) panels: &'static str,
    /// In the order in which they build on each other.
    pub(super) scripts: &'static [&'static str],
}

/// What the page of an episode knows in which nobody assigns agents.
#[derive(Debug, Serialize)]
struct Data<C> {
    /// Version of what was captured; the page's script and its types change together.
    format: u32,
    /// What was viewed: a run, a bundle or `scripted`.
    subject: String,
    allocation: Option<String>,
    /// `ENV/SET`.
    env: String,
    /// Seed and number.
    episode: (u64, usize),
    /// What the reader must know about where figures come from.
    notes: Vec<&'static str>,
    #[serde(flatten)]
    captured: C,
}

/// The page of an episode of so many steps in which nobody assigned agents, with what was captured of it in a format.
pub(super) fn page<C: Serialize>(
    web: &Web,
    wanted: &Wanted<'_>,
    (env, notes): (String, Vec<&'static str>),
    (format, captured, steps): (u32, C, usize),
) -> Page {
    let (subject, episode) = (wanted.subject.display().to_string(), (wanted.seed, wanted.episode));
    let data = Data { format, subject, allocation: None, env, episode, notes, captured };
    Page { html: html(web, &data), steps }
}

/// The page as HTML.
pub(super) fn html(web: &Web, data: &impl Serialize) -> String {
    filled(web, data, ["", "", ""])
}

/// The page as HTML, of a script that runs a program of WebAssembly, with keys of its own for the list.
pub(super) fn html_with_program(web: &Web, data: &impl Serialize, keys: &str) -> String {
    filled(web, data, [" 'wasm-unsafe-eval'", keys, " type=\"module\""])
}

fn filled(web: &Web, data: &impl Serialize, [permit, keys, kind]: [&str; 3]) -> String {
    let data = serde_json::to_string(data).expect("pages have string keys only");
    let parts = [
        ("<!-- PERMIT -->", permit.to_string()),
        ("/* STYLE */", web.styles.concat()),
        ("<!-- MAP -->", web.map.to_string()),
        ("<!-- PANELS -->", web.panels.to_string()),
        ("<!-- KEYS -->", keys.to_string()),
        ("\"DATA\"", escape(&data)),
        ("<!-- KIND -->", kind.to_string()),
        ("/* SCRIPT */", web.scripts.concat()),
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
