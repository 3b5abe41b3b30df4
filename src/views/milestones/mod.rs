//! Games of milestones as they are shown: the map, what is carried, and what an agent that runs options thinks.

mod capture;
mod data;

use std::any::Any;
use std::marker::PhantomData;

use sortie_envs::milestones::{Game, Milestones, World};
use sortie_envs::{Environment, Split};

use super::page::{Web, page, script, style};
use super::{Page, View, Wanted, no_page};
use crate::environment::check_fits;
use crate::failure::Failure;
use crate::subject::Subject;
use capture::{Board, capture};
use data::FORMAT;

/// What is shown of such a game.
pub(super) struct Shown<G>(PhantomData<G>);

impl<G> Shown<G> {
    pub(super) const NEW: Self = Self(PhantomData);
}

const WEB: Web = Web {
    styles: &[
        style::COLOURS,
        style::BASICS,
        style::LAYOUT,
        style::DESK,
        style::RESULT,
        style::DISCS,
        include_str!("web/board.css"),
        style::LANES,
        style::PLAYBACK,
        style::AGENT,
        style::DIALOG,
    ],
    map: include_str!("web/map.html"),
    panels: include_str!("web/panels.html"),
    scripts: &[
        script::EPISODE,
        script::SUMS,
        script::NUMBERS,
        script::ELEMENTS,
        include_str!("web/board.js"),
        include_str!("web/options.js"),
        script::LANES,
        include_str!("web/timeline.js"),
        script::PLAYER,
    ],
};

impl<G: Game> View for Shown<G> {
    fn played(&self, wanted: &Wanted<'_>, subject: &Subject) -> Result<Page, Failure> {
        let set = wanted.set.clone().unwrap_or_default();
        let Subject::Bundle(bundle) = subject else { return Err(no_page(wanted)) };
        let Some(options) = bundle.options() else { return Err(no_page(wanted)) };
        if let Some(asked) = wanted.allocation {
            return Err(asked.of_no_use());
        }
        check_fits(bundle, &set)?;
        let world = set.open(Split::Test)?;
        let board = Board { grid: grid::<G>, objects: G::OBJECTS };
        let captured = capture(&*world, (wanted.seed, wanted.episode), (bundle, options), board)?;
        let steps = captured.steps.len();
        let told = "What can be reached is the environment's own answer; the agent is not told.";
        Ok(page(&WEB, wanted, (set.to_string(), vec![told]), (FORMAT, captured, steps)))
    }
}

/// The grid of an instance.
fn grid<G: Game>(environment: &dyn Environment, instance: usize) -> Option<World> {
    let environment: &dyn Any = environment;
    environment.downcast_ref::<Milestones<G>>().map(|world| *world.world(instance))
}
