//! A state as lines of text: its picture, and beside it what everybody and everything does and is.

use std::iter;

use console::{Color, Style};
use sortie_envs::picture::{Bar, Cell, Disc, Field};
use sortie_envs::{Picture, Spec, UNASSIGNED};

/// One state that is drawn.
#[derive(Clone, Copy, Debug)]
pub struct Scene<'a> {
    /// What the environment says of itself.
    pub spec: &'a Spec,
    /// The state.
    pub picture: &'a Picture,
    /// Subtask of every agent, [`UNASSIGNED`] for none.
    pub allocation: &'a [u8],
    /// Last action of every agent, by index.
    pub actions: &'a [u16],
}

/// Where it is drawn.
#[derive(Clone, Copy, Debug)]
pub struct Canvas {
    /// Characters of a line.
    pub width: usize,
    /// Lines.
    pub lines: usize,
    /// Whether there is more than ASCII.
    pub is_unicode: bool,
}

/// A picture of characters.
#[derive(Clone, Debug)]
pub struct Drawing {
    /// Without line ends.
    pub lines: Vec<String>,
    /// What signs mean, at the foot.
    pub legend: String,
}

/// Characters between the map and the list.
const GAP: usize = 2;
/// Least characters of the list beside the map.
const LIST: usize = 36;
/// Characters of the frame, in a line and in a column.
const FRAME: usize = 2;
/// Fewer columns of a plane show nothing.
const LEAST: usize = 16;
/// Characters of a bar.
const BAR: usize = 6;
/// Characters of an agent where there are too many for a line each.
const NARROW: usize = 16;
/// Characters that are kept free behind the legend: whoever shows it says there what a person can do.
const HINT: usize = 36;

const COLOURS: [Color; 6] =
    [Color::Cyan, Color::Red, Color::Yellow, Color::Magenta, Color::Green, Color::Blue];

/// A state as lines of text.
pub fn draw(scene: &Scene<'_>, canvas: Canvas) -> Drawing {
    let picture = scene.picture;
    let mut map = picture.field.and_then(|field| Map::fitting(field, canvas));
    if let Some(map) = &mut map {
        picture.cells.iter().for_each(|cell| map.put_cell(cell));
        picture.things.iter().chain(&picture.agents).for_each(|disc| map.put_disc(disc));
    }
    let left = map.map(Map::lines).unwrap_or_default();
    let across = left.first().map_or(0, |line| console::measure_text_width(line) + GAP);
    let list = List { scene, canvas, width: canvas.width - across.min(canvas.width) };
    let list = list.lines(canvas.lines);
    let blank = " ".repeat(across - GAP.min(across));
    let lines = (0..left.len().max(list.len())).map(|line| {
        let (left, right) = (left.get(line).unwrap_or(&blank), list.get(line));
        let gap = if across == 0 { "" } else { "  " };
        format!("{left}{gap}{}", right.map_or("", String::as_str)).trim_end().to_owned()
    });
    let legend = legend(picture).join(", ");
    Drawing { lines: lines.collect(), legend: fitting(legend, canvas.width.saturating_sub(HINT)) }
}

/// What is written on the first of each kind.
fn legend(picture: &Picture) -> Vec<String> {
    let mut kinds: Vec<&str> = Vec::new();
    let discs = picture.agents.iter().chain(&picture.things);
    let discs = discs.filter(|disc| disc.place.is_some()).map(|disc| (sign(disc), disc.kind));
    let cells = picture.cells.iter().map(|cell| (&cell.label[..], &cell.kind[..]));
    let mut told = Vec::new();
    for (sign, kind) in discs.chain(cells.filter(|(sign, _)| !sign.is_empty())) {
        if !kinds.contains(&kind) {
            kinds.push(kind);
            told.push(format!("{sign} {kind}"));
        }
    }
    told
}

/// What is written on a disc.
fn sign(disc: &Disc) -> &str {
    if disc.label.is_empty() { &disc.name } else { &disc.label }
}

fn style(colour: Option<u8>) -> Style {
    let colour = colour.map(|colour| COLOURS[usize::from(colour) % COLOURS.len()]);
    colour.map_or(Style::new(), |colour| Style::new().fg(colour))
}

/// A line that is no longer than this.
fn fitting(text: String, width: usize) -> String {
    console::truncate_str(&text, width, "+").into_owned()
}

/// Characters and their looks, row by row, the first at the top.
struct Map {
    field: Field,
    /// Characters of a column: a cell of a grid has two.
    wide: usize,
    is_unicode: bool,
    rows: Vec<Vec<(char, Style)>>,
}

impl Map {
    /// An empty one; none where there is no room for it.
    fn fitting(field: Field, canvas: Canvas) -> Option<Self> {
        let [width, height] = [0, 1].map(|axis| (field.to[axis] - field.from[axis]).abs());
        let room = canvas.lines.saturating_sub(FRAME);
        let (columns, rows, wide) = if field.is_grid {
            (width.round() as usize, height.round() as usize, 2)
        } else {
            let columns = canvas.width.saturating_sub(LIST + GAP + FRAME).min(2 * room);
            (columns, columns / 2, 1)
        };
        let fits = rows <= room && columns * wide + FRAME <= canvas.width;
        let has_room = field.is_grid || columns >= LEAST;
        let free = if canvas.is_unicode { '·' } else { '.' };
        let mut row = vec![(' ', Style::new()); columns * wide];
        if field.is_grid {
            row.iter_mut().skip(1).step_by(2).for_each(|at| *at = (free, Style::new().dim()));
        }
        let is_unicode = canvas.is_unicode;
        (fits && has_room).then(|| Self { field, wide, is_unicode, rows: vec![row; rows] })
    }

    fn put_cell(&mut self, cell: &Cell) {
        let solid = if self.is_unicode { "██" } else { "##" };
        let text = if cell.is_solid { solid } else { &cell.label };
        self.put(cell.place, text, style(cell.colour));
    }

    fn put_disc(&mut self, disc: &Disc) {
        if let Some(place) = disc.place {
            self.put(place, sign(disc), style(disc.colour).bold());
        }
    }

    /// Writes a text where something is, at the edge where that is outside.
    fn put(&mut self, place: [f64; 2], text: &str, looks: Style) {
        let Field { from, to, .. } = self.field;
        let along = |axis: usize, count: usize| {
            let share = (place[axis] - from[axis]) / (to[axis] - from[axis]);
            let at = (share * count as f64).floor().max(0.0) as usize;
            at.min(count.saturating_sub(1))
        };
        let row = along(1, self.rows.len());
        let Some(row) = self.rows.get_mut(row) else { return };
        let column = self.wide * along(0, row.len() / self.wide);
        // In a grid neighbours begin behind two characters.
        let count = if self.wide > 1 { self.wide } else { text.chars().count() };
        let column = column.min(row.len().saturating_sub(count));
        let text = text.chars().chain(iter::repeat(' '));
        for (at, sign) in row[column..].iter_mut().take(count).zip(text) {
            *at = (sign, looks.clone());
        }
    }

    /// The lines, in a frame.
    fn lines(self) -> Vec<String> {
        let [across, along, corners] =
            if self.is_unicode { ["─", "│", "┌┐└┘"] } else { ["-", "|", "++++"] };
        let corners: Vec<char> = corners.chars().collect();
        let edge = across.repeat(self.rows.first().map_or(0, Vec::len));
        let mut lines = vec![format!("{}{edge}{}", corners[0], corners[1])];
        lines.extend(self.rows.iter().map(|row| {
            let row = row.iter().map(|(sign, looks)| looks.apply_to(sign).to_string());
            format!("{along}{}{along}", row.collect::<String>())
        }));
        lines.push(format!("{}{edge}{}", corners[2], corners[3]));
        lines
    }
}

/// The list of all agents and things.
struct List<'a> {
    scene: &'a Scene<'a>,
    canvas: Canvas,
    /// Characters of a line.
    width: usize,
}

impl List<'_> {
    /// As much as there is room for; what is left out is counted.
    fn lines(&self, room: usize) -> Vec<String> {
        let Picture { agents, things, .. } = self.scene.picture;
        let named = things.iter().filter(|thing| has_more(thing));
        let things: Vec<String> = named.map(|thing| self.thing(thing)).collect();
        let mut lines = if agents.len() + things.len() <= room {
            (0..agents.len()).map(|agent| self.agent(agent)).collect()
        } else {
            self.many_agents()
        };
        lines.extend(things);
        if lines.len() > room {
            let hidden = lines.len() - room + 1;
            lines.truncate(room.saturating_sub(1));
            lines.push(fitting(format!("({hidden} more in a taller window)"), self.width));
        }
        lines
    }

    fn agent(&self, agent: usize) -> String {
        let disc = &self.scene.picture.agents[agent];
        let (task, action) = self.work(agent);
        let task = task.map_or(String::new(), |task| format!("at {task:3} "));
        let more = [&disc.status[..], &disc.about].join(" ");
        // Where nobody is anything else it need not be said.
        let kind = if disc.kind == "agent" { String::new() } else { format!("{:11} ", disc.kind) };
        let text = format!("{:4} {kind}{task}{action:8} {}", sign(disc), more.trim());
        style(disc.colour).apply_to(fitting(text.trim_end().to_owned(), self.width)).to_string()
    }

    /// Several agents a line.
    fn many_agents(&self) -> Vec<String> {
        let narrow = |agent: usize| {
            let (task, action) = self.work(agent);
            let task = task.map_or(String::new(), |task| format!("{task} "));
            let text = format!("{} {task}{action}", sign(&self.scene.picture.agents[agent]));
            format!("{:1$}", fitting(text, NARROW - 1), NARROW)
        };
        let agents: Vec<String> = (0..self.scene.picture.agents.len()).map(narrow).collect();
        let across = (self.width / NARROW).max(1);
        agents.chunks(across).map(|line| fitting(line.concat(), self.width)).collect()
    }

    fn thing(&self, thing: &Disc) -> String {
        let team = thing.task.map(|task| self.team(task)).unwrap_or_default();
        let bars = thing.bars.iter().map(|bar| self.bar(bar)).collect::<Vec<_>>().join(" ");
        let about = if thing.bars.is_empty() { &thing.about[..] } else { "" };
        let parts = [&thing.status[..], &bars, &team, about];
        let parts: Vec<&str> = parts.into_iter().filter(|part| !part.is_empty()).collect();
        let text = format!("{:4} {}", sign(thing), parts.join(" "));
        style(thing.colour).apply_to(fitting(text.trim_end().to_owned(), self.width)).to_string()
    }

    fn bar(&self, bar: &Bar) -> String {
        let full = ((bar.share * BAR as f64).round() as usize).min(BAR);
        let [whole, empty] = if self.canvas.is_unicode { ["█", "░"] } else { ["#", "."] };
        format!("{} {}{}", bar.name, whole.repeat(full), empty.repeat(BAR - full))
    }

    /// Who is assigned to a subtask.
    fn team(&self, task: usize) -> String {
        let agents = self.scene.picture.agents.iter().zip(self.scene.allocation);
        let own = agents.filter(|(_, own)| usize::from(**own) == task);
        own.map(|(agent, _)| &agent.name[..]).collect::<Vec<_>>().join(" ")
    }

    /// What an agent is assigned to, and what it does.
    fn work(&self, agent: usize) -> (Option<&str>, &str) {
        let Scene { spec, picture, allocation, actions } = self.scene;
        let task = allocation.get(agent).filter(|task| **task != UNASSIGNED);
        let is_own = |thing: &&Disc| thing.task == task.map(|task| usize::from(*task));
        let task = task.and_then(|_| picture.things.iter().find(is_own));
        let names = spec.actions_of(agent);
        let action = actions.get(agent).and_then(|action| names.get(usize::from(*action)));
        (task.map(|task| &task.name[..]), action.map_or("-", String::as_str))
    }
}

/// Whether a thing has more to tell than where it is.
fn has_more(thing: &Disc) -> bool {
    !thing.status.is_empty() || !thing.bars.is_empty() || !thing.about.is_empty()
}

#[cfg(test)]
mod tests {
    use sortie_envs::picture::Outline;
    use sortie_envs::random::generator;
    use sortie_envs::{Split, open};

    use super::*;

    const CANVAS: Canvas = Canvas { width: 79, lines: 12, is_unicode: false };

    fn at(name: &str, kind: &'static str, place: [f64; 2]) -> Disc {
        Disc { name: name.into(), kind, place: Some(place), ..Disc::default() }
    }

    fn drawn(picture: &Picture, allocation: &[u8], canvas: Canvas) -> Drawing {
        console::set_colors_enabled(false);
        let actions = ["up", "down"].map(str::to_owned).to_vec();
        let spec = Spec { actions, ..Spec::default() };
        draw(&Scene { spec: &spec, picture, allocation, actions: &[1, 0] }, canvas)
    }

    #[test]
    fn a_plane_shows_who_is_where_and_does_what() {
        let holder =
            Disc { label: "1a".into(), status: "holds a".into(), ..at("1", "collector", [0.0; 2]) };
        let agents = vec![at("0", "collector", [5.0, 0.95]), holder];
        let treasure = Disc { outline: Outline::Diamond, ..at("a", "treasure", [-0.85, 0.95]) };
        let gone = Disc { place: None, ..treasure.clone() };
        let field = Some(Field::plane(1.0, 0.1));
        let things = vec![treasure, gone];
        let drawing = drawn(&Picture { field, agents, things, ..Picture::default() }, &[], CANVAS);
        let expected = "\
+--------------------+  0    collector   down
| a                 0|  1a   collector   up       holds a
|                    |
|                    |
|                    |
|                    |
|          1a        |
|                    |
|                    |
|                    |
|                    |
+--------------------+";
        assert_eq!(drawing.lines.join("\n"), expected, "\n{}", drawing.lines.join("\n"));
        assert_eq!(drawing.legend, "0 collector, a treasure");
    }

    #[test]
    fn a_grid_shows_walls_and_who_works_on_what() {
        let wall =
            Cell { place: [1.0, 0.0], kind: "wall".into(), is_solid: true, ..Cell::default() };
        let pit =
            Cell { place: [2.0, 1.0], kind: "pit".into(), label: "7".into(), ..Cell::default() };
        let bar = |name, share| Bar { name, share };
        let building = Disc {
            label: "a!".into(),
            status: "burning".into(),
            bars: vec![bar("health", 0.5), bar("fire", 1.0)],
            task: Some(0),
            ..at("a", "building", [0.0, 1.0])
        };
        let picture = Picture {
            field: Some(Field::grid(3, 2).upwards()),
            cells: vec![wall, pit],
            agents: vec![at("F0", "firefighter", [0.0, 0.0]), at("B1", "builder", [2.0, 0.0])],
            things: vec![building],
            links: Vec::new(),
        };
        let expected = "\
+------+  F0   firefighter at a   down
|a! .7 |  B1   builder     up
|F0##B1|  a!   burning health ###... fire ###### F0
+------+";
        let shown = drawn(&picture, &[0, UNASSIGNED], CANVAS).lines.join("\n");
        assert_eq!(shown, expected, "\n{shown}");
    }

    #[test]
    fn what_has_no_room_is_counted() {
        let agents = (0..24).map(|number| at(&number.to_string(), "agent", [0.0; 2]));
        let thing = |name: &str| Disc {
            about: "left 0.50".into(),
            place: None,
            ..at(name, "site", [0.0; 2])
        };
        let picture = Picture {
            agents: agents.collect(),
            things: ["a", "b", "c", "d"].map(thing).to_vec(),
            ..Picture::default()
        };
        let shown = drawn(&picture, &[], Canvas { lines: 9, ..CANVAS }).lines;
        // Several agents a line, each by a name of its own; where nothing is drawn the list has the whole width.
        assert!(shown[0].starts_with("0 down") && shown[5].contains("23 -"), "{shown:?}");
        assert_eq!(shown[8], "(2 more in a taller window)");
    }

    #[test]
    fn every_environment_fits_its_canvas() {
        let teams = ["save-the-city/24a_24b", "particle/treasure-64", "group-matching", "crafting"];
        for name in teams.into_iter().chain(["gridworld/flip-4", "particle/rover-tower-8"]) {
            let mut world = open(name, Split::Test, 1, &Default::default()).expect("it opens");
            world.reset(0, &mut generator(1));
            let mut state = Vec::new();
            world.save(0, &mut state);
            let (picture, spec) = (world.picture(&state), world.spec());
            let (allocation, actions) = (vec![0; spec.shape.agents], vec![0; spec.shape.agents]);
            let scene =
                Scene { spec, picture: &picture, allocation: &allocation, actions: &actions };
            for (width, lines) in [(79, 21), (200, 60), (60, 8), (41, 20), (12, 3)] {
                let shown = draw(&scene, Canvas { width, lines, is_unicode: true }).lines;
                assert!(shown.len() <= lines, "{name}: {} lines of {lines}", shown.len());
                let wide = shown.iter().find(|line| line.chars().count() > width);
                assert_eq!(wide, None, "{name}: {width}");
            }
        }
    }
}
