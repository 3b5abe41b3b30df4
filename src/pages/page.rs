//! One file with everything in it: markup, style, script and data.

use serde::Serialize;

use crate::capture::Captured;

const SKELETON: &str = include_str!("web/page.html");
const STYLE: &str = include_str!("web/page.css");
/// What all pages draw, in the order in which it builds on each other.
const DRAWING: [&str; 5] = [
    include_str!("web/elements.js"),
    include_str!("web/picture.js"),
    include_str!("web/panels.js"),
    include_str!("web/timeline.js"),
    include_str!("web/player.js"),
];
/// What an episode is: one that was played before, or is played in the page, before all others.
const EPISODE: &str = include_str!("web/episode.js");
const PROGRAM: &str = include_str!("web/program.js");
/// What a page has in which a team plays, behind all others.
const DEEDS: &str = include_str!("web/deeds.js");
const DEEDS_STYLE: &str = include_str!("web/deeds.css");

/// Version of what was captured; the page's script and its types change together.
const FORMAT: u32 = 3;

/// What a page says of its episode.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Heading {
    /// Who plays: a run, a bundle, `scripted` or the name of a recording.
    pub subject: String,
    /// What is played.
    pub env: String,
    /// Who assigned agents; none where nobody did, or it is not known.
    pub allocation: Option<String>,
    /// Seed and number of the episode, as evaluations count.
    pub episode: Option<(u64, usize)>,
    /// What the reader must know about where figures come from.
    pub notes: Vec<String>,
}

#[derive(Serialize)]
struct Data<'a> {
    format: u32,
    #[serde(flatten)]
    heading: &'a Heading,
    #[serde(flatten)]
    captured: &'a Captured,
}

/// The page of an episode that was played before.
pub fn page(heading: &Heading, captured: &Captured) -> String {
    let data = Data { format: FORMAT, heading, captured };
    filled(&[
        ("<!-- PERMIT -->", ""),
        ("/* STYLE */", STYLE),
        ("\"DATA\"", &json(&data)),
        ("<!-- KIND -->", ""),
        ("/* SCRIPT */", &code(&[&[EPISODE], &DRAWING[..]].concat())),
    ])
}

/// The page in which a team plays, by a script that runs a program of WebAssembly; `data` is what it knows before.
pub fn live_page(data: &impl Serialize) -> String {
    filled(&[
        ("<!-- PERMIT -->", " 'wasm-unsafe-eval'"),
        ("/* STYLE */", &[STYLE, DEEDS_STYLE].concat()),
        ("\"DATA\"", &json(data)),
        ("<!-- KIND -->", " type=\"module\""),
        ("/* SCRIPT */", &code(&[&[PROGRAM], &DRAWING[..], &[DEEDS]].concat())),
    ])
}

/// Scripts without the lines that are remarks alone: those are for whoever reads the sources, a tenth of every page's own code.
fn code(scripts: &[&str]) -> String {
    let is_remark = |line: &&str| {
        let line = line.trim_start();
        line.starts_with("//") || line.starts_with("/**") && line.ends_with("*/")
    };
    let lines = scripts.iter().flat_map(|script| script.lines());
    lines.filter(|line| !is_remark(line)).flat_map(|line| [line, "\n"]).collect()
}

/// The skeleton with these parts in their places.
fn filled(parts: &[(&str, &str)]) -> String {
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
fn json(data: &impl Serialize) -> String {
    let data = serde_json::to_string(data).expect("pages have string keys only");
    data.replace('<', "\\u003c")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scripts_lose_their_remarks_and_nothing_else() {
        let script =
            "// Why.\n/** What. */\nconst a = 1; // here\n  // Because.\n  call(`/${a}`);\n";
        assert_eq!(code(&[script, "b();\n"]), "const a = 1; // here\n  call(`/${a}`);\nb();\n");
        // A remark that goes on in the next line would leave its end.
        let all = [&DRAWING[..], &[EPISODE, PROGRAM, DEEDS]].concat();
        let opens = |line: &&str| line.trim_start().starts_with("/*") && !line.ends_with("*/");
        assert_eq!(all.iter().flat_map(|script| script.lines()).filter(opens).count(), 0);
    }
}
