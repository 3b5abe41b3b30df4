//! An episode of Group Matching as a page.

mod capture;
mod data;

use sortie_envs::{Environment, Split};
use sortie_learn::Act;
use sortie_learn::play::{PolicyTeam, Start};

use crate::environment::check_fits;
use crate::failure::{Exit, Failure};
use crate::policy::{Backend, DeployedPolicy};
use crate::scripted::Scripted;
use crate::subject::Subject;
use crate::views::mind::{DeployedMind, Diary};
use crate::views::page::{Web, html, script, style};
use crate::views::{Page, Wanted};
use capture::{capture, give_thoughts};
use data::{Captured, Data};

const WEB: Web = Web {
    styles: &[
        include_str!("web/colours.css"),
        style::BASICS,
        style::LAYOUT,
        include_str!("web/desk.css"),
        style::RESULT,
        include_str!("web/ring.css"),
        style::PLAYBACK,
        style::AGENT,
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
        include_str!("web/timeline.js"),
        script::PLAYER,
    ],
};

/// The page of an episode that the subject plays.
pub(super) fn played(wanted: &Wanted<'_>, subject: &Subject) -> Result<Page, Failure> {
    let set = wanted.set.clone().unwrap_or_default();
    if let Some(asked) = wanted.allocation {
        return Err(asked.of_no_use());
    }
    let (env, world) = (set.to_string(), set.open(Split::Test)?);
    match subject {
        Subject::Scripted => {
            let mut team = Scripted::of(&set, &*world, wanted.seed)?;
            let note = "The scripted team has no network: no utilities, no attention.";
            Ok(page(wanted, env, &[note], play(wanted, &*world, &mut team)?))
        }
        Subject::Bundle(bundle) => {
            check_fits(bundle, &set)?;
            let mut deployed = DeployedPolicy::open(bundle, Backend::Plan)?;
            let mut mind = DeployedMind::new(bundle, deployed.team()?)?;
            let mut diary = Diary::new(&mut mind);
            let mut captured = play(wanted, &*world, &mut PolicyTeam::new(&mut diary))?;
            give_thoughts(&mut captured.states, diary.thoughts);
            Ok(page(wanted, env, &[], captured))
        }
        Subject::Run(_) => {
            let subject = wanted.subject.display();
            let message = format!("`{subject}` has learned in another environment than `{set}`");
            Err(Failure::new(Exit::Mismatch, message))
        }
    }
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
    let data = Data {
        format: data::FORMAT,
        subject: wanted.subject.display().to_string(),
        allocation: None,
        env,
        episode: Some((wanted.seed, wanted.episode)),
        notes: [&[TRUTH], notes].concat(),
        captured,
    };
    Page { html: html(&WEB, &data), steps }
}
