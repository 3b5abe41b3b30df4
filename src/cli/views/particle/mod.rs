//! The particle world as it is shown.

mod terminal;

use sortie_bundle::Bundle;
use sortie_envs::particle::{ENTRY, picture_of};
use sortie_envs::{Environment, Episode, Spec};
use sortie_learn::Act;
use sortie_stage::particle::Plane;

use super::captured::{self, Captured};
use super::live::live;
use super::page::{self, Deeds, Web, script, style};
use super::{Canvas, Drawing, Figures, Live, Page, Scene, View, Wanted};
use crate::failure::Failure;
use crate::subject::Subject;
use crate::worlds::tally::Tally;

pub(super) const VIEW: (&str, &dyn View) = (ENTRY.name, &Shown);

struct Shown;

impl View for Shown {
    fn outcome(&self, spec: &Spec, episode: &Episode) -> String {
        let values = spec.metrics.iter().zip(&episode.metrics);
        let told = values.filter_map(|(metric, value)| Some(told(metric.name, (*value)?)));
        told.collect::<Vec<_>>().join(", ")
    }

    fn figures(&self, spec: &Spec, tally: &Tally) -> Figures {
        Figures::of_means(spec, tally, |means| {
            let told = means.iter().map(|(name, mean)| told(name, *mean));
            told.collect::<Vec<_>>().join(", ")
        })
    }

    fn draw(&self, scene: &Scene<'_>, canvas: Canvas) -> Drawing {
        match picture_of(scene.spec, scene.state) {
            Ok(picture) => terminal::draw(&picture, scene, canvas),
            Err(error) => Drawing { lines: vec![error.to_string()], legend: String::new() },
        }
    }

    fn played(&self, wanted: &Wanted<'_>, subject: &Subject) -> Result<Page, Failure> {
        let note = match subject {
            Subject::Scripted => "The scripted team has no network: no scores, no attention.",
            _ => "Critics are not deployed: whom they look at is shown of runs.",
        };
        let (env, captured) = captured::played(wanted, subject)?;
        Ok(page(wanted, env, &[note], captured))
    }

    fn acted(
        &self,
        wanted: &Wanted<'_>,
        env: String,
        world: &dyn Environment,
        team: &mut dyn Act,
    ) -> Result<Page, Failure> {
        Ok(page(wanted, env, &[], captured::acted(wanted, world, team)?))
    }

    fn live(
        &self,
        wanted: &Wanted<'_>,
        bundle: &Bundle,
        program: Option<&[u8]>,
    ) -> Result<Live, Failure> {
        live::<Plane>((&WEB, &[]), wanted, bundle, program)
    }
}

/// A metric in words; means have a decimal.
fn told(metric: &str, value: f64) -> String {
    let number = if value.fract() == 0.0 { value.to_string() } else { format!("{value:.1}") };
    match metric {
        "treasures" => format!("{number} treasures taken"),
        "deliveries" => format!("{number} delivered"),
        "near" => format!("rovers near their goals for {number} steps"),
        "uncovered" => format!("landmarks uncovered by {value:.2}"),
        name => format!("{number} {name}"),
    }
}

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::views::tests::episode;

    #[test]
    fn episodes_are_told_in_their_own_words() {
        let told = |set: &str, values: &[(&str, f64)]| {
            let (spec, played) = episode(&format!("{}/{set}", ENTRY.name), values);
            let mut tally = Tally::default();
            tally.add(played.clone());
            (Shown.outcome(&spec, &played), Shown.figures(&spec, &tally))
        };
        let values = [("treasures", 12.0), ("deliveries", 9.0), ("collisions", 2.5)];
        let (outcome, figures) = told("treasure-8", &values);
        assert_eq!(outcome, "12 treasures taken, 9 delivered, 2.5 collisions");
        assert_eq!((figures.text, &figures.fields[0].1["deliveries"]), (outcome, &9.0.into()));
        let (outcome, _) = told("rover-tower-8", &[("near", 7.25)]);
        assert_eq!(outcome, "rovers near their goals for 7.2 steps");
        let (outcome, _) = told("navigation-3", &[("uncovered", 1.0), ("collisions", 3.0)]);
        assert_eq!(outcome, "landmarks uncovered by 1.00, 3 collisions");
    }
}
