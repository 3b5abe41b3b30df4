//! An episode of the gridworld as a page.

use sortie_envs::Environment;
use sortie_learn::Act;
use sortie_stage::gridworld::Maze;

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
        include_str!("web/maze.css"),
        style::LANES,
        style::PLAYBACK,
        style::AGENT,
        style::HEAT,
        style::DIALOG,
    ],
    map: "Maze",
    panels: include_str!("web/panels.html"),
    scripts: &[
        script::SUMS,
        script::NUMBERS,
        script::ELEMENTS,
        script::ACTS,
        include_str!("web/names.js"),
        include_str!("web/maze.js"),
        include_str!("web/agent.js"),
        include_str!("web/team.js"),
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

pub(super) const PITS: &str = "A pit is shown as it was when an agent last looked at it.";

/// The page of an episode that the subject plays.
pub(super) fn played(wanted: &Wanted<'_>, subject: &Subject) -> Result<Page, Failure> {
    let note = match subject {
        Subject::Scripted => "The scripted team has no values.",
        _ => "Heads that explore are not deployed: what they pay is shown of runs.",
    };
    let (env, captured) = flat::played(wanted, subject)?;
    Ok(page(wanted, env, vec![PITS, note], captured))
}

/// The page of an episode that a team plays, which may tell what it thinks.
pub(super) fn acted(
    wanted: &Wanted<'_>,
    env: String,
    world: &dyn Environment,
    team: &mut dyn Act,
) -> Result<Page, Failure> {
    let captured = flat::acted(wanted, world, team)?;
    Ok(page(wanted, env, vec![PITS], captured))
}

fn page(
    wanted: &Wanted<'_>,
    env: String,
    notes: Vec<&'static str>,
    captured: Captured<Maze>,
) -> Page {
    page::page(&WEB, wanted, (env, notes), captured)
}
