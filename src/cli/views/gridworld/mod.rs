//! The gridworld as it is shown.

mod page;
mod terminal;

use sortie_bundle::Bundle;
use sortie_envs::gridworld::{ENTRY, picture_of};
use sortie_envs::{Environment, Episode, Spec};
use sortie_learn::Act;
use sortie_stage::gridworld::Maze;
use sortie_stage::lettered;

use super::live::live;
use super::{Canvas, Drawing, Figures, Live, Page, Scene, View, Wanted};
use crate::failure::Failure;
use crate::subject::Subject;
use crate::worlds::tally::Tally;

/// How it is found.
pub(super) const VIEW: (&str, &dyn View) = (ENTRY.name, &Shown);

struct Shown;

impl View for Shown {
    fn outcome(&self, spec: &Spec, episode: &Episode) -> String {
        let values = spec.metrics.iter().zip(&episode.metrics);
        told(
            &values
                .filter_map(|(metric, value)| Some((metric.name, (*value)?)))
                .collect::<Vec<_>>(),
        )
    }

    fn figures(&self, spec: &Spec, tally: &Tally) -> Figures {
        Figures::of_means(spec, tally, told)
    }

    fn draw(&self, scene: &Scene<'_>, canvas: Canvas) -> Drawing {
        match picture_of(scene.spec, scene.state) {
            Ok(picture) => terminal::draw(&picture, scene, canvas),
            Err(error) => Drawing { lines: vec![error.to_string()], legend: String::new() },
        }
    }

    fn played(&self, wanted: &Wanted<'_>, subject: &Subject) -> Result<Page, Failure> {
        page::played(wanted, subject)
    }

    fn acted(
        &self,
        wanted: &Wanted<'_>,
        env: String,
        world: &dyn Environment,
        team: &mut dyn Act,
    ) -> Result<Page, Failure> {
        page::acted(wanted, env, world, team)
    }

    fn live(
        &self,
        wanted: &Wanted<'_>,
        bundle: &Bundle,
        program: Option<&[u8]>,
    ) -> Result<Live, Failure> {
        live::<Maze>((&page::WEB, &[page::PITS]), wanted, bundle, program)
    }
}

/// Metrics in words; means have two decimals.
fn told(metrics: &[(&str, f64)]) -> String {
    let told = metrics.iter().map(|(name, value)| {
        let number = if value.fract() == 0.0 { value.to_string() } else { format!("{value:.2}") };
        let ending = if *value == 1.0 { "" } else { "s" };
        match *name {
            "treasures" => format!("{number} treasure{ending} found"),
            "tiers" => format!("{number} tier{ending} finished"),
            name => format!("{number} {name}"),
        }
    });
    told.collect::<Vec<_>>().join(", ")
}

/// The letters of treasures, given as bits.
fn letters(treasures: u8) -> String {
    sortie_envs::members(treasures.into()).map(lettered).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::views::tests::episode;

    #[test]
    fn episodes_are_told_in_their_own_words() {
        let (spec, played) = episode(ENTRY.name, &[("treasures", 2.0), ("tiers", 1.0)]);
        assert_eq!(Shown.outcome(&spec, &played), "2 treasures found, 1 tier finished");
        let mut tally = Tally::default();
        tally.add(played);
        tally.add(episode(ENTRY.name, &[("treasures", 1.0), ("tiers", 1.0)]).1);
        let figures = Shown.figures(&spec, &tally);
        assert_eq!(figures.text, "1.50 treasures found, 1 tier finished");
        assert_eq!(figures.fields[0].1["treasures"], 1.5);
    }
}
