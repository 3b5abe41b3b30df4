//! Games of milestones as they are shown: the map, what is carried, and what an agent that runs options thinks.

mod capture;

use std::marker::PhantomData;

use sortie_bundle::Bundle;
use sortie_envs::Split;
use sortie_stage::milestones::{Board, KnownGame};

use super::live::live;
use super::page::{Deeds, Web, page, script, style};
use super::{Live, Page, View, Wanted, no_page};
use crate::environment::check_fits;
use crate::failure::Failure;
use crate::subject::Subject;
use capture::capture;

/// What is shown of such a game.
pub(super) struct Shown<G>(PhantomData<G>);

impl<G> Shown<G> {
    pub(super) const NEW: Self = Self(PhantomData);
}

const TRUTH: &str = "What can be reached is the environment's own answer; the agent is not told.";

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
    map: "Map",
    panels: include_str!("web/panels.html"),
    scripts: &[
        script::SUMS,
        script::NUMBERS,
        script::ELEMENTS,
        script::ACTS,
        include_str!("web/board.js"),
        include_str!("web/options.js"),
        script::LANES,
        include_str!("web/timeline.js"),
        script::PLAYER,
    ],
    deeds: Deeds {
        hint: "Drag the agent to another empty cell.",
        controls: "",
        keys: "",
        script: include_str!("web/deeds.js"),
    },
};

impl<G: KnownGame> View for Shown<G> {
    fn played(&self, wanted: &Wanted<'_>, subject: &Subject) -> Result<Page, Failure> {
        let set = wanted.set.clone().unwrap_or_default();
        let Subject::Bundle(bundle) = subject else { return Err(no_page(wanted)) };
        let Some(options) = bundle.options() else { return Err(no_page(wanted)) };
        if let Some(asked) = wanted.allocation {
            return Err(asked.of_no_use());
        }
        check_fits(bundle, &set)?;
        let world = set.open(Split::Test)?;
        let captured =
            capture::<Board<G>>(&*world, (wanted.seed, wanted.episode), (bundle, options))?;
        Ok(page(&WEB, wanted, (set.to_string(), vec![TRUTH]), captured))
    }

    fn live(
        &self,
        wanted: &Wanted<'_>,
        bundle: &Bundle,
        program: Option<&[u8]>,
    ) -> Result<Live, Failure> {
        live::<Board<G>>((&WEB, &[TRUTH]), wanted, bundle, program)
    }
}
