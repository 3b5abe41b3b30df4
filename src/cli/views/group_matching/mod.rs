//! Group Matching as it is shown.

mod page;
mod terminal;

use sortie_bundle::Bundle;
use sortie_envs::group_matching::{ENTRY, ring_of, sizes};
use sortie_envs::{Environment, Episode, Spec};
use sortie_learn::Act;
use sortie_stage::group_matching::Groups;

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
        let gathered = episode.metrics.first().copied().flatten().unwrap_or(0.0);
        let groups = sizes(spec).groups;
        format!("{gathered} of {groups} groups gathered in {} steps", episode.steps)
    }

    fn figures(&self, spec: &Spec, tally: &Tally) -> Figures {
        let gathered = tally.metric(spec, "matches").sum as u64;
        let groups = sizes(spec).groups * tally.episodes;
        Figures {
            text: format!("groups gathered {gathered} of {groups}"),
            fields: vec![("groups_gathered", gathered.into()), ("groups", groups.into())],
        }
    }

    fn draw(&self, scene: &Scene<'_>, canvas: Canvas) -> Drawing {
        let sizes = sizes(scene.spec);
        match ring_of(&sizes, scene.state) {
            Ok(ring) => terminal::draw(ring, &sizes, scene, canvas),
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
        live::<Groups>((&page::WEB, &[page::TRUTH]), wanted, bundle, program)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::views::tests::episode;

    #[test]
    fn episodes_are_told_in_their_own_words() {
        let values = [("matches", 2.0)];
        let (spec, played) = episode(&format!("{}/{}", ENTRY.name, "6x5x3"), &values);
        assert_eq!(Shown.outcome(&spec, &played), "2 of 3 groups gathered in 7 steps");
        let mut tally = Tally::default();
        tally.add(played.clone());
        tally.add(played);
        let figures = Shown.figures(&spec, &tally);
        assert_eq!(figures.text, "groups gathered 4 of 6");
        assert_eq!(figures.fields, [("groups_gathered", 4.into()), ("groups", 6.into())]);
    }
}
