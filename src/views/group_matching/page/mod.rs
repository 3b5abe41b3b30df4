//! An episode of Group Matching as a page.

mod capture;
mod data;

use sortie_envs::Environment;
use sortie_learn::Act;
use sortie_learn::play::Start;

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
        include_str!("web/ring.css"),
        style::LANES,
        style::PLAYBACK,
        style::AGENT,
        style::HEAT,
        include_str!("web/groups.css"),
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
        include_str!("web/ring.js"),
        include_str!("web/agent.js"),
        include_str!("web/groups.js"),
        script::LANES,
        include_str!("web/timeline.js"),
        script::PLAYER,
    ],
};

/// The page of an episode that the subject plays.
pub(super) fn played(wanted: &Wanted<'_>, subject: &Subject) -> Result<Page, Failure> {
    let notes: &[&str] = match subject {
        Subject::Scripted => &["The scripted team has no network: no utilities, no attention."],
        _ => &[],
    };
    let capture = |world: &dyn Environment, team: &mut dyn Act| play(wanted, world, team);
    let (env, captured) = flat::played(wanted, subject, capture, |captured, thoughts| {
        give_thoughts(&mut captured.states, thoughts)
    })?;
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
    Ok(page(wanted, env, &[NOTE], play(wanted, world, team)?))
}

fn play(
    wanted: &Wanted<'_>,
    world: &dyn Environment,
    team: &mut dyn Act,
) -> Result<Captured, Failure> {
    // As evaluations number them.
    capture(world, Start::of(wanted.seed, wanted.episode), team)
}

fn page(wanted: &Wanted<'_>, env: String, notes: &[&'static str], captured: Captured) -> Page {
    const TRUTH: &str = "Groups are shown as they are; agents know of them what they see.";
    let steps = captured.steps.len();
    let notes = [&[TRUTH], notes].concat();
    page::page(&WEB, wanted, (env, notes), (FORMAT, captured, steps))
}
