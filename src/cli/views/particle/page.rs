//! An episode of the particle world as a page.

use sortie_envs::Environment;
use sortie_learn::Act;
use sortie_stage::particle::Plane;

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
        include_str!("web/plane.css"),
        style::LANES,
        style::PLAYBACK,
        style::AGENT,
        style::HEAT,
        style::DIALOG,
    ],
    map: "Plane",
    panels: include_str!("web/panels.html"),
    scripts: &[
        script::SUMS,
        script::NUMBERS,
        script::ELEMENTS,
        script::ACTS,
        include_str!("web/names.js"),
        include_str!("web/plane.js"),
        include_str!("web/agent.js"),
        include_str!("web/looks.js"),
        script::LANES,
        include_str!("web/timeline.js"),
        script::PLAYER,
    ],
    deeds: Deeds {
        hint: "Drag an agent, a treasure or a landmark elsewhere.",
        controls: "",
        keys: "",
        script: include_str!("web/deeds.js"),
    },
};

/// The page of an episode that the subject plays.
pub(super) fn played(wanted: &Wanted<'_>, subject: &Subject) -> Result<Page, Failure> {
    let note = match subject {
        Subject::Scripted => "The scripted team has no network: no scores, no attention.",
        _ => "Critics are not deployed: whom they look at is shown of runs.",
    };
    let (env, captured) = flat::played(wanted, subject)?;
    Ok(page(wanted, env, &[note], captured))
}

/// The page of an episode that a team plays, which may tell what it thinks.
pub(super) fn acted(
    wanted: &Wanted<'_>,
    env: String,
    world: &dyn Environment,
    team: &mut dyn Act,
) -> Result<Page, Failure> {
    Ok(page(wanted, env, &[], flat::acted(wanted, world, team)?))
}

fn page(
    wanted: &Wanted<'_>,
    env: String,
    notes: &[&'static str],
    captured: Captured<Plane>,
) -> Page {
    const TRUTH: &str = "What agents hold is shown as it is; agents see it one step later.";
    let is_hunt = !captured.facts.kinds.is_empty();
    let notes = [if is_hunt { &[TRUTH][..] } else { &[] }, notes].concat();
    page::page(&WEB, wanted, (env, notes), captured)
}
