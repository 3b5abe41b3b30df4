//! The live picture of the plane: where everybody and everything is, and beside it what everybody does.

use console::{Color, Style};
use sortie_envs::particle::{Disc, Drawn, Picture, Thing};

use crate::views::{Canvas, Drawing, Scene, fitting};
use sortie_stage::lettered;
use sortie_stage::particle::{kind_name, role_of};

/// Half of the side that is drawn: agents may leave the square in which everything starts.
const HALF: f64 = 1.15;
/// Characters of the list beside the plane, and of the gap before it.
const LIST: usize = 37;
const GAP: usize = 1;
/// Characters of the frame, in a line and in a column.
const FRAME: usize = 2;
/// Fewer columns show nothing.
const LEAST: usize = 16;

/// Colours of kinds, in turn; letters tell them apart.
const COLOURS: [Color; 6] =
    [Color::Cyan, Color::Yellow, Color::Magenta, Color::Green, Color::Blue, Color::Red];

/// The plane as lines of text, without line ends.
pub(super) fn draw(picture: &Picture, scene: &Scene<'_>, canvas: Canvas) -> Drawing {
    let rows = canvas.lines.saturating_sub(FRAME);
    let columns = canvas.width.saturating_sub(LIST + GAP + FRAME).min(2 * rows);
    let list = list(picture, scene, canvas);
    let legend = legend(picture);
    if columns < LEAST {
        return Drawing { lines: list, legend };
    }
    let mut plane = Plane::new(columns, columns / 2);
    for (number, thing) in picture.things.iter().enumerate() {
        plane.put_thing(number, thing);
    }
    for (number, agent) in picture.agents.iter().enumerate() {
        plane.put_agent(number, agent);
    }
    let blank = " ".repeat(columns + FRAME);
    let mut lines = plane.lines(canvas.is_unicode);
    lines.resize(lines.len().max(list.len()), blank);
    let mut list = list.into_iter();
    let beside = |line: String| match list.next() {
        None => line,
        Some(agent) => format!("{line}{}{agent}", " ".repeat(GAP)),
    };
    Drawing { lines: lines.into_iter().map(beside).collect(), legend }
}

fn legend(picture: &Picture) -> String {
    let (treasures, leads) = (
        picture.things.iter().any(|thing| thing.kind.is_some()),
        picture.agents.iter().any(|agent| agent.partner.is_some()),
    );
    let text = match (treasures, leads) {
        (true, _) => "3: agent, 3a: holds a, 6A: bank of a, $a: treasure",
        (_, true) => "0: rover, +A: landmark; towers stand nowhere",
        _ => "0: agent, +A: landmark",
    };
    text.to_owned()
}

/// A line for every agent: what it is, what it holds or where it leads, what it did last.
fn list(picture: &Picture, scene: &Scene<'_>, canvas: Canvas) -> Vec<String> {
    let line = |(number, agent): (usize, &Drawn)| {
        let action = scene.actions.get(number).copied().unwrap_or(u16::MAX);
        let action = scene.spec.actions_of(number).get(usize::from(action));
        let (role, what) = (role_of(scene.spec, number), what(agent));
        let action = action.map_or("-", String::as_str);
        let text = format!("{number:2} {role:9} {what:17} {action}");
        let kind = agent.holds.or(agent.takes);
        style(kind).apply_to(fitting(text, LIST.min(canvas.width))).to_string()
    };
    let mut lines: Vec<String> = picture.agents.iter().enumerate().map(line).collect();
    if lines.len() > canvas.lines {
        let hidden = lines.len() - canvas.lines + 1;
        lines.truncate(canvas.lines.saturating_sub(1));
        let more = format!("({hidden} more in a taller window)");
        lines.push(fitting(more, canvas.width));
    }
    lines
}

fn what(agent: &Drawn) -> String {
    let Drawn { disc, takes, holds, partner, goal, .. } = agent;
    if let (Some(partner), Some(goal)) = (partner, goal) {
        let leads = if disc.is_some() { "led by" } else { "leads" };
        return format!("{leads} {partner} to {}", lettered(*goal));
    }
    match (takes, holds) {
        (Some(kind), _) => format!("takes {}", kind_name(*kind)),
        (_, Some(kind)) => format!("holds {}", kind_name(*kind)),
        _ => String::new(),
    }
}

fn style(kind: Option<u8>) -> Style {
    kind.map_or(Style::new(), |kind| Style::new().fg(COLOURS[usize::from(kind) % COLOURS.len()]))
}

/// Characters and their looks, row by row, the first at the top.
struct Plane {
    rows: Vec<Vec<(char, Style)>>,
}

impl Plane {
    fn new(columns: usize, rows: usize) -> Self {
        Self { rows: vec![vec![(' ', Style::new()); columns]; rows] }
    }

    fn put_thing(&mut self, number: usize, thing: &Thing) {
        let (sign, kind) = match thing.kind {
            Some(kind) => (format!("${}", kind_name(kind)), Some(kind)),
            None => (format!("+{}", lettered(number)), None),
        };
        self.put(thing.disc, &sign, style(kind));
    }

    fn put_agent(&mut self, number: usize, agent: &Drawn) {
        let letter = match (agent.takes, agent.holds) {
            (Some(kind), _) => lettered(kind.into()),
            (_, Some(kind)) => kind_name(kind),
            _ => String::new(),
        };
        let looks = style(agent.holds.or(agent.takes)).bold();
        self.put(agent.disc, &format!("{number}{letter}"), looks);
    }

    /// Writes a sign where something is, at the edge where that is outside.
    fn put(&mut self, disc: Option<Disc>, sign: &str, looks: Style) {
        let Some(Disc { place: [x, y], .. }) = disc else { return };
        let along = |share: f64, count: usize| {
            let place = (share * count as f64).floor().max(0.0) as usize;
            place.min(count.saturating_sub(1))
        };
        let row = along((HALF - y) / (2.0 * HALF), self.rows.len());
        let Some(row) = self.rows.get_mut(row) else { return };
        let column = along((x + HALF) / (2.0 * HALF), row.len());
        let column = column.min(row.len().saturating_sub(sign.len()));
        for (cell, sign) in row[column..].iter_mut().zip(sign.chars()) {
            *cell = (sign, looks.clone());
        }
    }

    /// The lines, in a frame.
    fn lines(&self, is_unicode: bool) -> Vec<String> {
        let [across, along, corners] =
            if is_unicode { ["─", "│", "┌┐└┘"] } else { ["-", "|", "++++"] };
        let corners: Vec<char> = corners.chars().collect();
        let columns = self.rows.first().map_or(0, Vec::len);
        let edge = |left, right| format!("{left}{}{right}", across.repeat(columns));
        let mut lines = vec![edge(corners[0], corners[1])];
        lines.extend(self.rows.iter().map(|row| {
            let cells = row.iter().map(|(sign, looks)| looks.apply_to(sign).to_string());
            format!("{along}{}{along}", cells.collect::<String>())
        }));
        lines.push(edge(corners[2], corners[3]));
        lines
    }
}

#[cfg(test)]
mod tests {
    use sortie_envs::{Split, open};

    use super::*;

    fn at(x: f64, y: f64) -> Drawn {
        Drawn { disc: Some(Disc { place: [x, y], radius: 0.05 }), ..Drawn::default() }
    }

    fn thing(x: f64, y: f64, kind: Option<u8>) -> Thing {
        Thing { disc: Some(Disc { place: [x, y], radius: 0.025 }), kind }
    }

    fn drawn(set: &str, picture: &Picture, actions: &[u16], canvas: Canvas) -> Drawing {
        console::set_colors_enabled(false);
        let name = format!("particle/{set}");
        let world = open(&name, Split::Train, 1, &Default::default()).expect("it opens");
        let scene = Scene { spec: world.spec(), state: &[], allocation: &[], actions };
        draw(picture, &scene, canvas)
    }

    const CANVAS: Canvas = Canvas { width: 79, lines: 12, is_unicode: false };

    fn hunt() -> Picture {
        let holder = Drawn { holds: Some(0), ..at(0.0, 0.05) };
        let bank = Drawn { takes: Some(0), ..at(-1.0, -1.0) };
        let gone = Thing { disc: None, kind: Some(0) };
        Picture {
            agents: vec![at(5.0, 0.9), holder, at(1.0, -1.0), bank],
            things: vec![thing(-0.9, 0.9, Some(0)), gone],
        }
    }

    #[test]
    fn the_plane_shows_who_is_where_and_holds_what() {
        let drawing = drawn("treasure-4", &hunt(), &[1, 0, 4, u16::MAX], CANVAS);
        let expected = "\
+--------------------+  0 collector                   right
|                    |  1 collector holds a           none
|  $a               0|  2 collector                   down
|                    |  3 bank      takes a           -
|                    |
|          1a        |
|                    |
|                    |
|                    |
|                    |
| 3A               2 |
+--------------------+";
        let lines: Vec<&str> = drawing.lines.iter().map(|line| line.trim_end()).collect();
        assert_eq!(lines.join("\n"), expected, "\n{}", lines.join("\n"));
        assert!(drawing.legend.contains("$a: treasure"));
    }

    #[test]
    fn towers_are_listed_with_what_they_say() {
        let rover = Drawn { partner: Some(1), goal: Some(2), ..at(0.0, 0.0) };
        let tower = Drawn { disc: None, partner: Some(0), says: Some(3), ..rover };
        let picture = Picture { agents: vec![rover, tower], things: vec![thing(0.5, 0.5, None)] };
        let drawing = drawn("rover-tower-2", &picture, &[3, 3], CANVAS);
        let text = drawing.lines.join("\n");
        assert!(text.contains(" 0 rover     led by 1 to C     up"), "{text}");
        assert!(text.contains(" 1 tower     leads 0 to C      say-3"), "{text}");
        assert!(text.contains("+A") && drawing.legend.contains("landmark"), "{text}");
    }

    #[test]
    fn the_picture_fits_its_canvas() {
        let agents = vec![at(0.3, -0.4); 64];
        let crowd = Picture { agents, things: hunt().things };
        for (width, lines) in [(79, 21), (200, 60), (60, 8), (40, 10), (12, 3)] {
            let canvas = Canvas { width, lines, is_unicode: true };
            let shown = drawn("treasure-64", &crowd, &[1; 64], canvas).lines;
            assert!(shown.len() <= lines, "{} lines of {lines}", shown.len());
            let wide = shown.iter().find(|line| line.chars().count() > width);
            assert_eq!(wide, None, "{width}");
        }
    }
}
