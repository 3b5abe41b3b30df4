//! One file with everything in it: markup, style, script and data.
//!
//! Every page has a picture, a slider with its keys, and panels. An environment adds what its own looks like: its script
//! has `createMap`, `createAgentPanel`, `createBuildingPanel` (for whatever agents work on or belong to) and
//! `createTimeline`, and its data the agents' names, `states`, `steps` with rewards, `events` and a `result`.

use serde::Serialize;
use sortie_stage::Show;

use super::captured::Captured;
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
    pub(super) const LIVE: &str = include_str!("../live/web/live.css");
}

/// Parts of a script that all pages share.
pub(super) mod script {
    pub(in crate::views) const SUMS: &str = include_str!("web/sums.js");
    pub(in crate::views) const NUMBERS: &str = include_str!("web/numbers.js");
    pub(in crate::views) const ELEMENTS: &str = include_str!("web/elements.js");
    pub(in crate::views) const ACTS: &str = include_str!("web/acts.js");
    pub(in crate::views) const LANES: &str = include_str!("web/lanes.js");
    pub(in crate::views) const PLAYER: &str = include_str!("web/player.js");
    /// What an episode is: one that was recorded, before all others.
    pub(super) const EPISODE: &str = include_str!("web/episode.js");
    /// The same of one that is played in the page.
    pub(super) const PROGRAM: &str = include_str!("../live/web/program.js");
    /// What else such a page has, behind all others and the environment's own.
    pub(super) const LIVE: [&str; 3] = [
        include_str!("../live/web/deeds.js"),
        include_str!("../live/web/bits.js"),
        include_str!("../live/web/begin.js"),
    ];
}

/// What a page is made of beside its data.
pub(super) struct Web {
    /// In the order of the cascade.
    pub(super) styles: &'static [&'static str],
    /// What the picture is called.
    pub(super) map: &'static str,
    /// The panels behind the slider.
    pub(super) panels: &'static str,
    /// In the order in which they build on each other.
    pub(super) scripts: &'static [&'static str],
    pub(super) deeds: Deeds,
}

/// What somebody can do to a team that plays in the page, beside what can be done to all.
pub(super) struct Deeds {
    /// What can be dragged, in words.
    pub(super) hint: &'static str,
    /// Buttons.
    pub(super) controls: &'static str,
    /// Their keys, for the list.
    pub(super) keys: &'static str,
    /// Where things are, in the program's numbers, and what the controls do.
    pub(super) script: &'static str,
}

/// Version of what was captured; the page's script and its types change together.
pub(super) const FORMAT: u32 = 2;

/// What the page of an episode knows in which nobody assigns agents.
#[derive(Serialize)]
struct Data<C> {
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

/// The page of an episode in which nobody assigned agents, with what was captured of it.
pub(super) fn page<S: Show>(
    web: &Web,
    wanted: &Wanted<'_>,
    (env, notes): (String, Vec<&'static str>),
    captured: Captured<S>,
) -> Page {
    let (subject, episode) = (wanted.name(), (wanted.seed, wanted.episode));
    let steps = captured.steps.len();
    let data = Data { format: FORMAT, subject, allocation: None, env, episode, notes, captured };
    Page { html: html(web, &data), steps }
}

pub(super) fn html(web: &Web, data: &impl Serialize) -> String {
    let scripts = [script::EPISODE, &web.scripts.concat()].concat();
    let parts = Parts {
        permit: "",
        styles: web.styles.concat(),
        deeds: "",
        more_panels: "",
        keys: "",
        kind: "",
        scripts,
    };
    filled(web, data, parts)
}

/// The page as HTML, of a script that runs a program of WebAssembly.
pub(super) fn html_with_program(web: &Web, data: &impl Serialize) -> String {
    const DEEDS: &str = include_str!("../live/web/deeds.html");
    const KEYS: &str = include_str!("../live/web/keys.html");
    let Deeds { hint, controls, keys, script: own } = web.deeds;
    let deeds = DEEDS.replace("<!-- CONTROLS -->", controls).replace("<!-- HINT -->", hint);
    let scripts = [&[script::PROGRAM], web.scripts, &[own], &script::LIVE].concat();
    let parts = Parts {
        permit: " 'wasm-unsafe-eval'",
        styles: web.styles.concat() + style::LIVE,
        deeds: &deeds,
        more_panels: include_str!("../live/web/panel.html"),
        keys: &(keys.to_owned() + KEYS),
        kind: " type=\"module\"",
        scripts: scripts.concat(),
    };
    filled(web, data, parts)
}

/// What differs between a page of an episode, and one in which a team plays.
struct Parts<'a> {
    permit: &'a str,
    styles: String,
    deeds: &'a str,
    more_panels: &'a str,
    keys: &'a str,
    kind: &'a str,
    scripts: String,
}

fn filled(web: &Web, data: &impl Serialize, own: Parts<'_>) -> String {
    let data = serde_json::to_string(data).expect("pages have string keys only");
    let parts = [
        ("<!-- PERMIT -->", own.permit),
        ("/* STYLE */", &own.styles),
        ("<!-- MAP -->", web.map),
        ("<!-- DEEDS -->", own.deeds),
        ("<!-- PANELS -->", &[web.panels, own.more_panels].concat()),
        ("<!-- KEYS -->", own.keys),
        ("\"DATA\"", &escape(&data)),
        ("<!-- KIND -->", own.kind),
        ("/* SCRIPT */", &own.scripts),
    ];
    let mut html = String::new();
    let mut rest = SKELETON;
    for (place, part) in parts {
        let (before, after) = rest.split_once(place).expect("the skeleton has a place for it");
        html.push_str(before);
        html.push_str(part);
        rest = after;
    }
    html.push_str(rest);
    html
}

/// Inside a script element only `<` could end it, or begin a comment. JSON has it in texts alone.
fn escape(json: &str) -> String {
    json.replace('<', "\\u003c")
}
