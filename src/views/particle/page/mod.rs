//! An episode of the particle world as a page.

mod capture;
mod data;
mod events;

use sortie_envs::Environment;
use sortie_learn::Act;

use crate::failure::Failure;
use crate::subject::Subject;
use crate::views::page::{self, Web, script, style};
use crate::views::{Page, Wanted, flat};
use capture::{capture, give_thoughts};
use data::{Captured, FORMAT};

const WEB: Web = Web {
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
    map: include_str!("web/map.html"),
    panels: include_str!("web/panels.html"),
    scripts: &[
        script::EPISODE,
        script::SUMS,
        script::NUMBERS,
        script::ELEMENTS,
        include_str!("web/names.js"),
        include_str!("web/plane.js"),
        include_str!("web/agent.js"),
        include_str!("web/looks.js"),
        script::LANES,
        include_str!("web/timeline.js"),
        script::PLAYER,
    ],
};

/// The page of an episode that the subject plays.
pub(super) fn played(wanted: &Wanted<'_>, subject: &Subject) -> Result<Page, Failure> {
    let note = match subject {
        Subject::Scripted => "The scripted team has no network: no scores, no attention.",
        _ => "Critics are not deployed: whom they look at is shown of runs.",
    };
    let capture = |world: &dyn Environment, team: &mut dyn Act| play(wanted, world, team);
    let (env, captured) = flat::played(wanted, subject, capture, give_thoughts)?;
    Ok(page(wanted, env, &[note], captured))
}

/// The page of an episode that a team plays, which may tell what it thinks.
pub(super) fn acted(
    wanted: &Wanted<'_>,
    env: String,
    world: &dyn Environment,
    team: &mut dyn Act,
) -> Result<Page, Failure> {
    Ok(page(wanted, env, &[], play(wanted, world, team)?))
}

fn play(
    wanted: &Wanted<'_>,
    world: &dyn Environment,
    team: &mut dyn Act,
) -> Result<Captured, Failure> {
    capture(world, (wanted.seed, wanted.episode), team)
}

fn page(wanted: &Wanted<'_>, env: String, notes: &[&'static str], captured: Captured) -> Page {
    const TRUTH: &str = "What agents hold is shown as it is; agents see it one step later.";
    let is_hunt = !captured.kinds.is_empty();
    let steps = captured.steps.len();
    let notes = [if is_hunt { &[TRUTH][..] } else { &[] }, notes].concat();
    page::page(&WEB, wanted, (env, notes), (FORMAT, captured, steps))
}
