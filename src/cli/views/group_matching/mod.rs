//! Group Matching as it is shown.

use sortie_bundle::Bundle;
use sortie_envs::group_matching::{ACTION_NAMES, ENTRY, Parameters, Ring, ring_of, sizes};
use sortie_envs::{Environment, Episode, Spec, members};
use sortie_learn::Act;
use sortie_stage::group_matching::Groups;
use sortie_stage::lettered;

use super::captured::{self, Captured};
use super::live::live;
use super::page::{self, Deeds, Web, script, style};
use super::{Canvas, Drawing, Figures, Live, Page, Scene, View, Wanted, fitting};
use crate::failure::Failure;
use crate::subject::Subject;
use crate::worlds::tally::Tally;

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
            Ok(ring) => draw(ring, &sizes, scene, canvas),
            Err(error) => Drawing { lines: vec![error.to_string()], legend: String::new() },
        }
    }

    fn played(&self, wanted: &Wanted<'_>, subject: &Subject) -> Result<Page, Failure> {
        let notes: &[&str] = match subject {
            Subject::Scripted => &["The scripted team has no network: no utilities, no attention."],
            _ => &[],
        };
        let (env, captured) = captured::played(wanted, subject)?;
        Ok(page(wanted, env, notes, captured))
    }

    fn acted(
        &self,
        wanted: &Wanted<'_>,
        env: String,
        world: &dyn Environment,
        team: &mut dyn Act,
    ) -> Result<Page, Failure> {
        const NOTE: &str = "Utilities and attention are shown of bundles: export the run.";
        Ok(page(wanted, env, &[NOTE], captured::acted(wanted, world, team)?))
    }

    fn live(
        &self,
        wanted: &Wanted<'_>,
        bundle: &Bundle,
        program: Option<&[u8]>,
    ) -> Result<Live, Failure> {
        live::<Groups>((&WEB, &[TRUTH]), wanted, bundle, program)
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
        include_str!("web/ring.css"),
        style::LANES,
        style::PLAYBACK,
        style::AGENT,
        style::HEAT,
        include_str!("web/groups.css"),
        style::DIALOG,
    ],
    map: "Ring",
    panels: include_str!("web/panels.html"),
    scripts: &[
        script::SUMS,
        script::NUMBERS,
        script::ELEMENTS,
        script::ACTS,
        include_str!("web/names.js"),
        include_str!("web/ring.js"),
        include_str!("web/agent.js"),
        include_str!("web/groups.js"),
        script::LANES,
        include_str!("web/timeline.js"),
        script::PLAYER,
    ],
    deeds: Deeds {
        hint: "Drag an agent to another cell.",
        controls: "",
        keys: "",
        script: include_str!("web/deeds.js"),
    },
};

const TRUTH: &str = "Groups are shown as they are; agents know of them what they see.";

fn page(
    wanted: &Wanted<'_>,
    env: String,
    notes: &[&'static str],
    captured: Captured<Groups>,
) -> Page {
    let notes = [&[TRUTH], notes].concat();
    page::page(&WEB, wanted, (env, notes), captured)
}

/// The ring as lines of text, without line ends.
fn draw(ring: Ring<'_>, sizes: &Parameters, scene: &Scene<'_>, canvas: Canvas) -> Drawing {
    let cells = cells(ring, sizes, canvas);
    let room = canvas.lines.saturating_sub(cells.len() + 1);
    let header = "group  gathered  agents: cell, last action".to_owned();
    let mut groups = vec![fitting(header, canvas.width)];
    groups.extend(
        ring.groups().enumerate().map(|(group, members)| line(group, members, ring, scene, canvas)),
    );
    if groups.len() > room {
        let hidden = groups.len() - room + 1;
        groups.truncate(room.saturating_sub(1));
        groups.push(format!("({hidden} more lines in a taller window)"));
    }
    Drawing {
        lines: [cells, vec![String::new()], groups].concat(),
        legend: "agents by group and number, cells on a ring".to_owned(),
    }
}

/// A line for every cell with its agents, or, of many cells, for those with agents.
fn cells(ring: Ring<'_>, sizes: &Parameters, canvas: Canvas) -> Vec<String> {
    let nothing = if canvas.is_unicode { "·" } else { "." };
    let agents = |cell: usize| {
        let here = (0..ring.cells.len()).filter(|agent| usize::from(ring.cells[*agent]) == cell);
        here.map(|agent| name(ring, agent)).collect::<Vec<_>>()
    };
    let is_short = sizes.cells + 5 <= canvas.lines;
    let shown = (0..sizes.cells).filter(|cell| is_short || !agents(*cell).is_empty());
    let line = |cell: usize| {
        let agents = agents(cell);
        let text = if agents.is_empty() { nothing.to_owned() } else { agents.join(" ") };
        fitting(format!("cell {cell:3}  {text}"), canvas.width)
    };
    shown.map(line).collect()
}

fn line(group: usize, set: u128, ring: Ring<'_>, scene: &Scene<'_>, canvas: Canvas) -> String {
    let gathered = if ring.is_matched(set) { "yes" } else { "no" };
    let agents = members(set).map(|agent| {
        let action = scene.actions.get(agent).and_then(|action| ACTION_NAMES.get(*action as usize));
        format!("{agent}: {}, {}", ring.cells[agent], action.unwrap_or(&"-"))
    });
    let agents = agents.collect::<Vec<_>>().join("  ");
    let text = fitting(format!("{:5}  {gathered:8}  {agents}", lettered(group)), canvas.width);
    if ring.is_matched(set) { console::style(text).green().to_string() } else { text }
}

/// As pages of `sortie view` call it.
fn name(ring: Ring<'_>, agent: usize) -> String {
    let group = ring.groups().position(|members| members >> agent & 1 == 1).unwrap_or(0);
    format!("{}{agent}", lettered(group))
}

#[cfg(test)]
mod tests {
    use sortie_envs::group_matching::{ring_of, sizes};
    use sortie_envs::{Environment, Split, open};

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

    /// The first two of four agents stand together, the others apart.
    fn state(ring: &dyn Environment) -> Vec<u8> {
        let mut state = Vec::new();
        ring.save(0, &mut state);
        let cells = state.len() - 4 - 2;
        state[1..5].fill(0);
        state[cells..].copy_from_slice(&[2, 2, 0, 5, 0b0011, 0b1100]);
        state
    }

    fn drawn(set: &str, canvas: Canvas) -> Vec<String> {
        console::set_colors_enabled(false);
        let world = open(set, Split::Train, 1, &Default::default()).expect("a ring");
        let (spec, state) = (world.spec(), state(&*world));
        let sizes = sizes(spec);
        let scene = Scene { spec, state: &state, allocation: &[], actions: &[1, 0, 2] };
        draw(ring_of(&sizes, &state).expect("a state"), &sizes, &scene, canvas).lines
    }

    #[test]
    fn agents_stand_in_their_cells_and_groups_say_whether_they_have_gathered() {
        let canvas = Canvas { width: 79, lines: 21, is_unicode: true };
        let shown = drawn("group-matching/4x6x2", canvas);
        assert_eq!(shown[..3], ["cell   0  B2", "cell   1  ·", "cell   2  A0 A1"]);
        assert_eq!(shown[8], "A      yes       0: 2, stay  1: 2, left");
        assert_eq!(shown[9], "B      no        2: 0, right  3: 5, -");
    }

    #[test]
    fn many_cells_leave_empty_ones_out_and_nothing_is_wider_than_the_window() {
        let canvas = Canvas { width: 24, lines: 10, is_unicode: false };
        let shown = drawn("group-matching/4x40x2", canvas);
        assert_eq!(shown[..3], ["cell   0  B2", "cell   2  A0 A1", "cell   5  B3"]);
        assert_eq!(shown[5], "A      yes       0: 2, +");
        assert!(shown.iter().all(|line| line.len() <= 24 && line.is_ascii()), "{shown:?}");
    }
}
