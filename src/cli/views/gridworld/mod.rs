//! The gridworld as it is shown.

use console::{Color, Style};
use sortie_bundle::Bundle;
use sortie_envs::gridworld::{Cell, ENTRY, Picture, SIDE, picture_of};
use sortie_envs::{Environment, Episode, Spec};
use sortie_learn::Act;
use sortie_stage::gridworld::Maze;
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
            Ok(picture) => draw(&picture, scene, canvas),
            Err(error) => Drawing { lines: vec![error.to_string()], legend: String::new() },
        }
    }

    fn played(&self, wanted: &Wanted<'_>, subject: &Subject) -> Result<Page, Failure> {
        let note = match subject {
            Subject::Scripted => "The scripted team has no values.",
            _ => "Heads that explore are not deployed: what they pay is shown of runs.",
        };
        let (env, captured) = captured::played(wanted, subject)?;
        Ok(page(wanted, env, vec![PITS, note], captured))
    }

    fn acted(
        &self,
        wanted: &Wanted<'_>,
        env: String,
        world: &dyn Environment,
        team: &mut dyn Act,
    ) -> Result<Page, Failure> {
        let captured = captured::acted(wanted, world, team)?;
        Ok(page(wanted, env, vec![PITS], captured))
    }

    fn live(
        &self,
        wanted: &Wanted<'_>,
        bundle: &Bundle,
        program: Option<&[u8]>,
    ) -> Result<Live, Failure> {
        live::<Maze>((&WEB, &[PITS]), wanted, bundle, program)
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

const WEB: Web = Web {
    styles: &[
        style::COLOURS,
        style::BASICS,
        style::LAYOUT,
        style::DESK,
        style::RESULT,
        style::DISCS,
        include_str!("web/maze.css"),
        style::LANES,
        style::PLAYBACK,
        style::AGENT,
        style::HEAT,
        style::DIALOG,
    ],
    map: "Maze",
    panels: include_str!("web/panels.html"),
    scripts: &[
        script::SUMS,
        script::NUMBERS,
        script::ELEMENTS,
        script::ACTS,
        include_str!("web/names.js"),
        include_str!("web/maze.js"),
        include_str!("web/agent.js"),
        include_str!("web/team.js"),
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

const PITS: &str = "A pit is shown as it was when an agent last looked at it.";

fn page(
    wanted: &Wanted<'_>,
    env: String,
    notes: Vec<&'static str>,
    captured: Captured<Maze>,
) -> Page {
    page::page(&WEB, wanted, (env, notes), captured)
}

/// Characters of a cell, and of the gap beside the maze.
const CELL: usize = 2;
const GAP: usize = 2;
const COLOURS: [Color; 4] = [Color::Cyan, Color::Yellow, Color::Magenta, Color::Green];

/// The maze as lines of text, without line ends.
fn draw(picture: &Picture, scene: &Scene<'_>, canvas: Canvas) -> Drawing {
    let list = list(picture, scene, canvas);
    let legend = "0: agent, A: treasure, o: pit, O: open pit, =: shut door".to_owned();
    if canvas.width < CELL * SIDE || canvas.lines < SIDE {
        return Drawing { lines: list, legend };
    }
    let signs = signs(picture, scene, canvas.is_unicode);
    let maze = signs.chunks(SIDE).map(|row| row.concat());
    let beside = canvas.width - CELL * SIDE > GAP;
    let mut list = list.into_iter().filter(|_| beside);
    let room = canvas.width.saturating_sub(CELL * SIDE + GAP);
    let line = |maze: String| match list.next() {
        None => maze,
        Some(agent) => format!("{maze}{}{}", " ".repeat(GAP), fitting(agent, room)),
    };
    Drawing { lines: maze.map(line).collect(), legend }
}

/// Two characters for every cell.
fn signs(picture: &Picture, scene: &Scene<'_>, is_unicode: bool) -> Vec<String> {
    let mut pits = picture.pits.iter();
    let all_found = picture.found.iter().fold(0, |all, own| all | own);
    let mut signs: Vec<String> = Cell::all(scene.spec)
        .map(|cell| match cell {
            Cell::Free => "  ".to_owned(),
            Cell::Wall => if is_unicode { "██" } else { "##" }.to_owned(),
            Cell::Pit if pits.next().is_some_and(|pit| pit.is_open) => "O ".to_owned(),
            Cell::Pit => "o ".to_owned(),
            Cell::Door(tier) if tier <= picture.tiers => "  ".to_owned(),
            Cell::Door(_) => "==".to_owned(),
            Cell::Treasure(kind) => {
                let found = all_found >> kind & 1 == 1;
                let style = if found { Style::new().dim() } else { Style::new().bold() };
                style.apply_to(format!("{} ", lettered(kind.into()))).to_string()
            }
        })
        .collect();
    for (agent, cell) in picture.cells.iter().enumerate() {
        if let Some(sign) = signs.get_mut(usize::from(*cell)) {
            *sign = colour(agent).apply_to(format!("{agent} ")).bold().to_string();
        }
    }
    signs
}

/// A line for every agent: what it found, what it did last.
fn list(picture: &Picture, scene: &Scene<'_>, canvas: Canvas) -> Vec<String> {
    let line = |(agent, found): (usize, &u8)| {
        let action = scene.actions.get(agent).copied().unwrap_or(u16::MAX);
        let action = scene.spec.actions_of(agent).get(usize::from(action));
        let found = match found {
            0 => "nothing".to_owned(),
            found => letters(*found),
        };
        let action = action.map_or("-", String::as_str);
        let text = format!("{agent} found {found:8} {action}");
        colour(agent).apply_to(fitting(text, canvas.width)).to_string()
    };
    let mut lines: Vec<String> = picture.found.iter().enumerate().map(line).collect();
    lines.push(fitting(format!("tiers finished: {}", picture.tiers), canvas.width));
    lines.truncate(canvas.lines);
    lines
}

fn colour(agent: usize) -> Style {
    Style::new().fg(COLOURS[agent % COLOURS.len()])
}

#[cfg(test)]
mod tests {
    use sortie_envs::gridworld::Pit;
    use sortie_envs::{Split, open};

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

    fn drawn(cells: Vec<u16>, tiers: u8, canvas: Canvas) -> Drawing {
        console::set_colors_enabled(false);
        let world =
            open("gridworld/flip-2", Split::Train, 1, &Default::default()).expect("it opens");
        let spec = world.spec();
        let count = Cell::all(spec).filter(|cell| *cell == Cell::Pit).count();
        let mut pits = vec![Pit::default(); count];
        pits[count - 1].is_open = true;
        let picture = Picture { cells, found: vec![0b101, 0], tiers, pits };
        let scene = Scene { spec, state: &[], allocation: &[], actions: &[1, u16::MAX] };
        draw(&picture, &scene, canvas)
    }

    const CANVAS: Canvas = Canvas { width: 79, lines: 21, is_unicode: false };

    #[test]
    fn the_maze_shows_who_is_where_and_which_pits_are_open() {
        let shut = drawn(vec![21, 22], 0, CANVAS).lines;
        assert_eq!(shut.len(), SIDE);
        assert!(shut[0].starts_with(&"##".repeat(SIDE)), "{}", shut[0]);
        assert!(shut[0].ends_with("0 found AC       down"), "{}", shut[0]);
        assert!(
            shut[1].starts_with("##0 1 ") && shut[1].ends_with("1 found nothing  -"),
            "{}",
            shut[1]
        );
        assert_eq!(shut[2].split_once("tiers finished").map(|(_, rest)| rest), Some(": 0"));
        let count = |lines: &[String], sign| lines.concat().matches(sign).count();
        assert_eq!(count(&shut, "O "), 1);
        let open = drawn(vec![21, 22], 3, CANVAS).lines;
        assert_eq!((count(&shut, "=="), count(&open, "==")), (6, 0));
    }

    #[test]
    fn the_picture_fits_its_canvas() {
        for (width, lines) in [(79, 21), (200, 60), (41, 20), (30, 10), (12, 2)] {
            let canvas = Canvas { width, lines, is_unicode: true };
            let shown = drawn(vec![21, 22], 0, canvas).lines;
            assert!(shown.len() <= lines, "{} lines of {lines}", shown.len());
            let wide = shown.iter().find(|line| line.chars().count() > width);
            assert_eq!(wide, None, "{width}");
        }
    }
}
