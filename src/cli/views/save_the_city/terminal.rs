//! The live picture of a city: its map, and who is assigned where.

use console::{Style, style};
use sortie_core::UNASSIGNED;
use sortie_envs::save_the_city::{ACTION_NAMES, AgentKind, BuildingState, City, SIDE, Status};

use crate::views::{Canvas, Drawing};

/// Characters of one map cell.
const CELL: usize = 2;
/// Characters of the map with its edges.
const MAP: usize = SIDE as usize * CELL + 2;
/// Characters between the map and the tables.
const GAP: usize = 2;
/// Characters of a health bar.
const BAR: usize = 6;
/// Characters of an agent in the table of many agents, the space after it included.
const NARROW_AGENT: usize = 14;

/// All that one picture shows.
pub(super) struct Scene<'a> {
    pub(super) city: City<'a>,
    /// Building of every agent, [`UNASSIGNED`] for none.
    pub(super) allocation: &'a [u8],
    /// Last action of every agent, by index.
    pub(super) actions: &'a [u16],
}

/// The picture as lines of text, without line ends.
pub(super) fn draw(scene: &Scene<'_>, canvas: Canvas) -> Drawing {
    let glyphs = Glyphs::of(canvas);
    let mut left = map(&scene.city, glyphs);
    // Below: what the signs of buildings mean.
    let room = canvas.lines.saturating_sub(1).max(left.len());
    let right = Tables { scene, width: canvas.width.saturating_sub(MAP + GAP), glyphs };
    let right = right.lines(room);
    left.resize(left.len().max(right.len()), " ".repeat(MAP));
    let mut lines = Vec::new();
    for (index, map_line) in left.into_iter().enumerate() {
        let text = right.get(index).map_or("", String::as_str);
        lines.push(format!("{map_line}{:GAP$}{text}", "").trim_end().to_string());
    }
    lines.push(legend(glyphs));
    Drawing { lines, legend: "F firefighter  B builder  G generalist".to_owned() }
}

fn legend(glyphs: &Glyphs) -> String {
    let looks = [Look::Burning, Look::Open, Look::Complete, Look::BurnedDown];
    looks.map(|look| format!("{} {}", look.symbol(glyphs), look.word())).join("  ")
}

/// North is up.
fn map(city: &City<'_>, glyphs: &Glyphs) -> Vec<String> {
    let edge = glyphs.edge.repeat(usize::from(SIDE) * CELL);
    let [upper_left, upper_right, lower_left, lower_right] = glyphs.corners;
    let mut lines = vec![format!("{upper_left}{edge}{upper_right}")];
    for y in (0..SIDE).rev() {
        let row: String = (0..SIDE).map(|x| cell(city, x, y, glyphs)).collect();
        lines.push(format!("{0}{row}{0}", glyphs.side));
    }
    lines.push(format!("{lower_left}{edge}{lower_right}"));
    lines
}

fn cell(city: &City<'_>, x: u8, y: u8, glyphs: &Glyphs) -> String {
    if let Some(index) = city.agents.iter().position(|agent| (agent.x, agent.y) == (x, y)) {
        // Two characters: from ten on the number alone, which no other agent has.
        let name = if index < 10 { agent_name(city, index) } else { index.to_string() };
        return style(name).cyan().bold().to_string();
    }
    if let Some(index) = city.buildings.iter().position(|other| (other.x, other.y) == (x, y)) {
        let look = Look::of(&city.buildings[index]);
        let letter = look.style().apply_to(building_letter(index));
        return format!("{}{letter}", look.symbol(glyphs));
    }
    style(format!(" {}", glyphs.nothing)).dim().to_string()
}

/// The tables of buildings and agents, beside the map.
struct Tables<'a> {
    scene: &'a Scene<'a>,
    glyphs: &'static Glyphs,
    /// Characters of a line.
    width: usize,
}

impl Tables<'_> {
    /// As much as there is room for; what is left out is counted.
    fn lines(&self, room: usize) -> Vec<String> {
        let city = &self.scene.city;
        let all: Vec<usize> = (0..city.buildings.len()).collect();
        let agents = self.agents();
        let mut lines = if all.len() + agents.len() + 2 <= room {
            [self.buildings(&all), vec![String::new()], agents].concat()
        } else {
            let agents = self.many_agents();
            let rest = room.saturating_sub(agents.len() + 1);
            [self.most_urgent_buildings(rest), vec![String::new()], agents].concat()
        };
        if lines.len() > room {
            let hidden = lines.len() - room + 1;
            lines.truncate(room.saturating_sub(1));
            lines.push(format!("({hidden} more lines in a taller window)"));
        }
        lines
    }

    fn buildings(&self, shown: &[usize]) -> Vec<String> {
        let header = format!("building     {:BAR$}  fire  team", "health");
        let lines = shown.iter().map(|&index| self.building(index));
        [header].into_iter().chain(lines).collect()
    }

    /// Buildings that need somebody come first, and are shown in their order.
    fn most_urgent_buildings(&self, room: usize) -> Vec<String> {
        let buildings = self.scene.city.buildings;
        let mut shown: Vec<usize> = (0..buildings.len()).collect();
        shown.sort_by_key(|&index| Look::of(&buildings[index]) as usize);
        // A line for the header, one for what is not shown.
        let hidden = shown.split_off(shown.len().min(room.saturating_sub(2)));
        shown.sort_unstable();
        let mut lines = self.buildings(&shown);
        let looks = [Look::Burning, Look::Open, Look::Complete, Look::BurnedDown];
        let counted = looks.into_iter().filter_map(|look| {
            let is_so = |index: &&usize| Look::of(&buildings[**index]) as usize == look as usize;
            let count = hidden.iter().filter(is_so).count();
            (count > 0).then(|| format!("{count} {}", look.word()))
        });
        if !hidden.is_empty() {
            lines.push(format!("and {}", counted.collect::<Vec<_>>().join(", ")));
        }
        lines
    }

    fn building(&self, index: usize) -> String {
        let Self { scene, glyphs, width } = self;
        let building = &scene.city.buildings[index];
        let look = Look::of(building);
        let full = ((building.health * BAR as f64).round() as usize).min(BAR);
        let bar = format!("{}{}", glyphs.full.repeat(full), glyphs.empty.repeat(BAR - full));
        let before = "xx complete  ".len() + BAR + "  0.00  ".len();
        format!(
            "{}{} {:8}  {bar}  {:4.2}  {}",
            look.symbol(glyphs),
            building_letter(index),
            look.short_word(),
            building.fire,
            self.team(index, width.saturating_sub(before))
        )
    }

    /// Who is assigned to a building; those for whom there is no room are counted.
    fn team(&self, building: usize, width: usize) -> String {
        let Scene { city, allocation, .. } = self.scene;
        let team: Vec<usize> = (0..city.agents.len())
            .filter(|&agent| allocation.get(agent) == Some(&(building as u8)))
            .collect();
        let list = |shown: usize| {
            let names = team[..shown].iter().map(|&agent| agent_name(city, agent));
            let rest = (shown < team.len()).then(|| format!("+{}", team.len() - shown));
            names.chain(rest).collect::<Vec<_>>().join(" ")
        };
        let fitting = (0..=team.len()).rev().map(list).find(|list| list.len() <= width);
        style(fitting.unwrap_or_default()).cyan().bold().to_string()
    }

    fn agents(&self) -> Vec<String> {
        let header = "agent            assigned to  action".to_owned();
        let agents = self.scene.city.agents;
        let line = |(index, agent): (usize, &sortie_envs::save_the_city::AgentState)| {
            let kind = match agent.kind {
                AgentKind::Firefighter => "firefighter",
                AgentKind::Builder => "builder",
                AgentKind::Generalist => "generalist",
            };
            let name = format!("{:3}", agent_name(&self.scene.city, index));
            let (task, action) = self.work(index);
            format!("{} {kind:11}  {task:11}  {action}", style(name).cyan().bold())
        };
        [header].into_iter().chain(agents.iter().enumerate().map(line)).collect()
    }

    /// Several agents a line.
    fn many_agents(&self) -> Vec<String> {
        let across = (self.width / NARROW_AGENT).max(1);
        let count = self.scene.city.agents.len();
        let agent = |index: usize| {
            let (task, action) = self.work(index);
            let name = format!("{:3}", agent_name(&self.scene.city, index));
            let rest = format!("{task} {action:8}");
            format!("{} {rest:.9}", style(name).cyan().bold())
        };
        let line = |first: usize| {
            let line = (first..(first + across).min(count)).map(agent);
            line.collect::<Vec<_>>().join(" ").trim_end().to_owned()
        };
        let header = "agents: assigned to, action".to_owned();
        [header].into_iter().chain((0..count).step_by(across).map(line)).collect()
    }

    /// What an agent is assigned to, and what it does.
    fn work(&self, index: usize) -> (char, &'static str) {
        let Scene { allocation, actions, .. } = self.scene;
        let task = match allocation.get(index) {
            None | Some(&UNASSIGNED) => '-',
            Some(&task) => building_letter(usize::from(task)),
        };
        let action = actions.get(index).and_then(|&action| ACTION_NAMES.get(action as usize));
        (task, action.copied().unwrap_or("-"))
    }
}

/// As pages of `sortie view` call it.
fn agent_name(city: &City<'_>, index: usize) -> String {
    format!("{}{index}", city.agents[index].kind.letter())
}

/// `a` for building 0; a city has at most 25.
fn building_letter(index: usize) -> char {
    char::from(b'a'.saturating_add(index as u8))
}

/// The characters of a picture.
struct Glyphs {
    corners: [&'static str; 4],
    edge: &'static str,
    side: &'static str,
    nothing: &'static str,
    full: &'static str,
    empty: &'static str,
    burning: &'static str,
    open: &'static str,
    complete: &'static str,
    burned_down: &'static str,
}

/// For terminals that show Unicode.
static UNICODE: Glyphs = Glyphs {
    corners: ["┌", "┐", "└", "┘"],
    edge: "─",
    side: "│",
    nothing: "·",
    full: "█",
    empty: "░",
    burning: "▲",
    open: "□",
    complete: "■",
    burned_down: "×",
};

/// For all others.
static ASCII: Glyphs = Glyphs {
    corners: ["+", "+", "+", "+"],
    edge: "-",
    side: "|",
    nothing: ".",
    full: "#",
    empty: ".",
    burning: "^",
    open: "o",
    complete: "=",
    burned_down: "x",
};

impl Glyphs {
    fn of(canvas: Canvas) -> &'static Self {
        if canvas.is_unicode { &UNICODE } else { &ASCII }
    }
}

/// How a building looks on the map, the most urgent first.
#[derive(Clone, Copy)]
enum Look {
    Burning,
    Open,
    Complete,
    BurnedDown,
}

impl Look {
    fn of(building: &BuildingState) -> Self {
        match building.status {
            Status::Complete => Self::Complete,
            Status::BurnedDown => Self::BurnedDown,
            Status::Open if building.is_burning() => Self::Burning,
            Status::Open => Self::Open,
        }
    }

    fn style(self) -> Style {
        match self {
            Self::Burning => Style::new().red().bold(),
            Self::Open => Style::new().yellow(),
            Self::Complete => Style::new().green(),
            Self::BurnedDown => Style::new().dim(),
        }
    }

    fn word(self) -> &'static str {
        match self {
            Self::BurnedDown => "burned down",
            other => other.short_word(),
        }
    }

    /// At most eight characters.
    fn short_word(self) -> &'static str {
        match self {
            Self::Burning => "burning",
            Self::Open => "open",
            Self::Complete => "complete",
            Self::BurnedDown => "burned",
        }
    }

    fn symbol(self, glyphs: &Glyphs) -> String {
        let symbol = match self {
            Self::Burning => glyphs.burning,
            Self::Open => glyphs.open,
            Self::Complete => glyphs.complete,
            Self::BurnedDown => glyphs.burned_down,
        };
        self.style().apply_to(symbol).to_string()
    }
}

#[cfg(test)]
mod tests {
    use sortie_envs::save_the_city::{AgentState, BuildingKind, BuildingState, Status};

    use super::*;

    fn building(health: f64, fire: f64, x: u8) -> BuildingState {
        BuildingState {
            health,
            fire,
            period: 70,
            to_next_fire: 60,
            since_last_fire: 10,
            kind: BuildingKind::Fast,
            status: Status::of_health(health),
            x,
            y: 4,
        }
    }

    fn lines(scene: &Scene<'_>, width: usize, lines: usize, is_unicode: bool) -> Vec<String> {
        console::set_colors_enabled(false);
        draw(scene, Canvas { width, lines, is_unicode }).lines
    }

    #[test]
    fn a_picture_shows_where_everything_is_and_who_works_where() {
        let agents = [AgentState::at(AgentKind::Firefighter, 2, 4)];
        let buildings = [building(0.5, 0.25, 1), building(1.0, 0.0, 4), building(0.0, 0.0, 7)];
        let city = City { agents: &agents, buildings: &buildings };
        let shown = lines(&Scene { city, allocation: &[0], actions: &[9] }, 79, 21, true);
        // The map's first line is its edge, the second y = 15: y = 4 is the thirteenth.
        assert_eq!(shown[12], "│ ·▲aF0 ·■b · ·×c · · · · · · · ·│");
        assert!(shown[1].ends_with("▲a burning   ███░░░  0.25  F0"), "{}", shown[1]);
        assert!(shown[2].ends_with("■b complete  ██████  0.00"), "{}", shown[2]);
        assert!(shown[6].ends_with("F0  firefighter  a            fight"), "{}", shown[6]);
    }

    /// Twenty-four agents, six of them at each of the first four of twenty-five buildings.
    fn crowd() -> (Vec<AgentState>, Vec<BuildingState>, Vec<u8>, Vec<u16>) {
        let agents =
            (0..24).map(|index| AgentState::at(AgentKind::Generalist, index % 16, index / 16));
        let mut buildings: Vec<BuildingState> =
            (0..25).map(|index| building(1.0, 0.0, index % 16)).collect();
        for (index, building) in buildings.iter_mut().enumerate() {
            building.y = 5 + index as u8 / 16;
        }
        buildings[24] = BuildingState { x: 8, y: 6, ..building(0.4, 0.3, 8) };
        (agents.collect(), buildings, (0..24).map(|agent| agent / 6).collect(), vec![9; 24])
    }

    #[test]
    fn in_80_columns_nothing_is_cut_off_and_what_is_left_out_is_counted() {
        let (agents, buildings, allocation, actions) = crowd();
        let city = City { agents: &agents, buildings: &buildings };
        let scene = Scene { city, allocation: &allocation, actions: &actions };
        let shown = lines(&scene, 79, 21, false);
        let text = shown.join("\n");
        assert!(shown.len() <= 21, "{text}");
        assert!(shown.iter().all(|line| line.is_ascii() && line.len() <= 79), "{text}");
        // Every agent by a name of its own, and the burning building although it is the last one.
        for agent in 0..24 {
            assert!(text.contains(&format!("G{agent} ")), "G{agent}: {text}");
        }
        assert!(text.contains("^y burning"), "{text}");
        assert!(text.contains("G0 G1 G2 G3 +2"), "{text}");
        assert!(text.contains("and 17 complete"), "{text}");
    }

    #[test]
    fn a_team_without_room_is_counted() {
        let (agents, buildings, allocation, actions) = crowd();
        let city = City { agents: &agents, buildings: &buildings };
        let scene = Scene { city, allocation: &allocation, actions: &actions };
        let shown = lines(&scene, 79, 58, false);
        let line = shown.iter().find(|line| line.contains("=d complete")).expect("building d");
        assert!(line.ends_with("G18 G19 G20 +3"), "{line}");
        let wide = lines(&scene, 120, 58, false);
        let line = wide.iter().find(|line| line.contains("=d complete")).expect("building d");
        assert!(line.ends_with("G18 G19 G20 G21 G22 G23"), "{line}");
    }
}
