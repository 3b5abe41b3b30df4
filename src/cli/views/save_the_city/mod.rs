//! SaveTheCity as it is shown.

mod page;
mod terminal;

use sortie_bundle::Bundle;
use sortie_envs::save_the_city::{ENTRY, with_city};
use sortie_envs::{Episode, Spec};
use sortie_stage::save_the_city::City;

use super::live::live;
use super::{Canvas, Drawing, Figures, Live, Page, Scene, View, Wanted};
use crate::failure::Failure;
use crate::subject::Subject;
use crate::worlds::tally::Tally;

pub(super) const VIEW: (&str, &dyn View) = (ENTRY.name, &Shown);

struct Shown;

impl View for Shown {
    fn outcome(&self, spec: &Spec, episode: &Episode) -> String {
        let count = |name| {
            let place = spec.metrics.iter().position(|metric| metric.name == name);
            place.and_then(|place| episode.metrics[place]).unwrap_or(0.0)
        };
        let (saved, all) = (count(SAVED), count(ALL));
        format!("{saved} of {all} buildings saved in {} steps", episode.steps)
    }

    fn figures(&self, spec: &Spec, tally: &Tally) -> Figures {
        let [saved, all] = [SAVED, ALL].map(|name| tally.metric(spec, name).sum as u64);
        Figures {
            text: format!("buildings saved {saved} of {all}"),
            fields: vec![("buildings_saved", saved.into()), ("buildings", all.into())],
        }
    }

    fn draw(&self, scene: &Scene<'_>, canvas: Canvas) -> Drawing {
        let Scene { state, allocation, actions, .. } = *scene;
        with_city(state, |city| {
            terminal::draw(&terminal::Scene { city, allocation, actions }, canvas)
        })
    }

    fn played(&self, wanted: &Wanted<'_>, subject: &Subject) -> Result<Page, Failure> {
        page::played(wanted, subject)
    }

    fn live(
        &self,
        wanted: &Wanted<'_>,
        bundle: &Bundle,
        program: Option<&[u8]>,
    ) -> Result<Live, Failure> {
        live::<City>((&page::WEB, &[]), wanted, bundle, program)
    }

    fn recorded(&self, wanted: &Wanted<'_>, text: &str) -> Result<Page, Failure> {
        page::recorded(wanted, text)
    }
}

/// The metrics that tell of buildings.
const SAVED: &str = "buildings_completed";
const ALL: &str = "buildings";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::views::tests::episode;

    #[test]
    fn episodes_are_told_in_their_own_words() {
        let values = [("buildings_completed", 2.0), ("buildings", 3.0)];
        let (spec, played) = episode(&format!("{}/{}", ENTRY.name, "2-5a_2-5b"), &values);
        assert_eq!(Shown.outcome(&spec, &played), "2 of 3 buildings saved in 7 steps");
        let mut tally = Tally::default();
        tally.add(played.clone());
        tally.add(played);
        let figures = Shown.figures(&spec, &tally);
        assert_eq!(figures.text, "buildings saved 4 of 6");
        assert_eq!(figures.fields, [("buildings_saved", 4.into()), ("buildings", 6.into())]);
    }
}
