//! An episode of Group Matching as a page.

mod capture;
mod data;

use sortie_envs::Split;
use sortie_learn::random::{Purpose, generator};

use crate::environment::check_fits;
use crate::failure::{Exit, Failure};
use crate::policy::{Backend, DeployedPolicy};
use crate::subject::Subject;
use crate::views::acting::Actors;
use crate::views::mind::DeployedMind;
use crate::views::page::{Web, html, script, style};
use crate::views::{Page, Wanted};
use capture::{Team, capture};
use data::Data;

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
    if let Some(asked) = wanted.allocation {
        return Err(asked.of_no_use());
    }
    let set = wanted.set.clone().unwrap_or_default();
    // As evaluations number them.
    let random = generator(wanted.seed, Purpose::Evaluation, wanted.episode as u64);
    let world = set.open(Split::Test)?;
    let shape = world.spec().shape;
    let mut notes = vec![
        "The oracle's groups are shown; no agent is told its group mates but by what it sees.",
    ];
    let captured = match subject {
        Subject::Scripted => {
            notes.push("The scripted team has no network: no utilities, no attention.");
            let own = generator(wanted.seed, Purpose::Evaluation, u64::MAX);
            capture(world, random, &mut Team::Script(own))?
        }
        Subject::Bundle(bundle) => {
            check_fits(bundle, &set)?;
            let mut deployed = DeployedPolicy::open(bundle, Backend::Plan)?;
            let mut mind = DeployedMind::new(bundle, deployed.policy()?)?;
            capture(world, random, &mut Team::Actors(Actors::new(&mut mind, &shape)))?
        }
        Subject::Run(_) => {
            let message = format!(
                "`{}` is a run: only bundles and `scripted` can be viewed in `{set}`; \
                 export it first",
                wanted.subject.display()
            );
            return Err(Failure::new(Exit::Usage, message));
        }
    };
    let steps = captured.steps.len();
    let data = Data {
        format: data::FORMAT,
        subject: wanted.subject.display().to_string(),
        allocation: None,
        env: set.to_string(),
        episode: Some((wanted.seed, wanted.episode)),
        notes,
        captured,
    };
    Ok(Page { html: html(&WEB, &data), steps })
}
