//! An episode of Group Matching as a page.

use sortie_envs::Environment;
use sortie_learn::Act;
use sortie_stage::group_matching::Groups;

use crate::failure::Failure;
use crate::subject::Subject;
use crate::views::captured::Captured;
use crate::views::page::{self, Deeds, Web, script, style};
use crate::views::{Page, Wanted, flat};

pub(super) const WEB: Web = Web {
    styles: &[
        style::COLOURS,
        style::BASICS,
        style::LAYOUT,
        style::DESK,
        style::RESULT,
        style::DISCS,
        include_str!("web/ring.css"),
        style::LANES,
        style::PLAYBACK,
        style::AGENT,
        style::HEAT,
        include_str!("web/groups.css"),
        style::DIALOG,
    ],
    map: "Ring",
    panels: include_str!("web/panels.html"),
    scripts: &[
        script::SUMS,
        script::NUMBERS,
        script::ELEMENTS,
        script::ACTS,
        include_str!("web/names.js"),
        include_str!("web/ring.js"),
        include_str!("web/agent.js"),
        include_str!("web/groups.js"),
        script::LANES,
        include_str!("web/timeline.js"),
        script::PLAYER,
    ],
    deeds: Deeds {
        hint: "Drag an agent to another cell.",
        controls: "",
        keys: "",
        script: include_str!("web/deeds.js"),
    },
};

pub(super) const TRUTH: &str = "Groups are shown as they are; agents know of them what they see.";

/// The page of an episode that the subject plays.
pub(super) fn played(wanted: &Wanted<'_>, subject: &Subject) -> Result<Page, Failure> {
    let notes: &[&str] = match subject {
        Subject::Scripted => &["The scripted team has no network: no utilities, no attention."],
        _ => &[],
    };
    let (env, captured) = flat::played(wanted, subject)?;
    Ok(page(wanted, env, notes, captured))
}

/// The page of an episode that a team plays which tells nothing of its thoughts.
pub(super) fn acted(
    wanted: &Wanted<'_>,
    env: String,
    world: &dyn Environment,
    team: &mut dyn Act,
) -> Result<Page, Failure> {
    const NOTE: &str = "Utilities and attention are shown of bundles: export the run.";
    Ok(page(wanted, env, &[NOTE], flat::acted(wanted, world, team)?))
}

fn page(
    wanted: &Wanted<'_>,
    env: String,
    notes: &[&'static str],
    captured: Captured<Groups>,
) -> Page {
    let notes = [&[TRUTH], notes].concat();
    page::page(&WEB, wanted, (env, notes), captured)
}
