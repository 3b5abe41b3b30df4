//! The live picture of a city: its map, who is assigned where, and how fast the team ticks.

use console::{Style, style};
use sortie_core::UNASSIGNED;
use sortie_envs::save_the_city::{ACTION_NAMES, AgentKind, BuildingState, City, SIDE, Status};

use crate::latency::Percentiles;

/// Characters of one map cell.
const CELL: usize = 2;
/// Characters of a health bar.
const BAR: usize = 10;

/// All that one picture shows.
pub(super) struct Picture<'a> {
    pub(super) city: City<'a>,
    /// Building of every agent, [`UNASSIGNED`] for none.
    pub(super) allocation: &'a [u8],
    /// Last action of every agent, by index.
    pub(super) actions: &'a [u16],
    pub(super) episode: usize,
    /// `None` = without end.
    pub(super) episodes: Option<usize>,
    pub(super) finished: usize,
    pub(super) solved: usize,
    pub(super) step: u32,
    pub(super) tick: Percentiles,
}

/// The picture as lines of text, without line ends.
pub(super) fn lines(picture: &Picture<'_>) -> Vec<String> {
    let mut left = map(&picture.city);
    let right = side_panel(picture);
    let width = usize::from(SIDE) * CELL + 2;
    left.resize(left.len().max(right.len()), " ".repeat(width));
    let mut lines = vec![headline(picture)];
    for (index, map_line) in left.into_iter().enumerate() {
        let text = right.get(index).map_or("", String::as_str);
        lines.push(format!("{map_line}  {text}").trim_end().to_string());
    }
    lines.push(legend());
    lines
}

fn headline(picture: &Picture<'_>) -> String {
    let of = picture.episodes.map_or(String::new(), |episodes| format!(" of {episodes}"));
    format!(
        "episode {}{of}, step {:3}   solved {} of {}   tick p50 {:.0} us, p99 {:.0} us",
        picture.episode,
        picture.step,
        picture.solved,
        picture.finished,
        picture.tick.p50,
        picture.tick.p99,
    )
}

fn legend() -> String {
    format!(
        "{} burning  {} open  {} complete  {} burned down  {}",
        symbol(Look::Burning),
        symbol(Look::Open),
        symbol(Look::Complete),
        symbol(Look::BurnedDown),
        "F firefighter  B builder  G generalist"
    )
}

/// North is up.
fn map(city: &City<'_>) -> Vec<String> {
    let edge = "─".repeat(usize::from(SIDE) * CELL);
    let mut lines = vec![format!("┌{edge}┐")];
    for y in (0..SIDE).rev() {
        let row: String = (0..SIDE).map(|x| cell(city, x, y)).collect();
        lines.push(format!("│{row}│"));
    }
    lines.push(format!("└{edge}┘"));
    lines
}

fn cell(city: &City<'_>, x: u8, y: u8) -> String {
    if let Some(index) = city.agents.iter().position(|agent| (agent.x, agent.y) == (x, y)) {
        return agent_name(city, index);
    }
    if let Some(index) = city.buildings.iter().position(|other| (other.x, other.y) == (x, y)) {
        let look = Look::of(&city.buildings[index]);
        return format!("{}{}", symbol(look), look.style().apply_to(building_letter(index)));
    }
    style(" ·").dim().to_string()
}

fn side_panel(picture: &Picture<'_>) -> Vec<String> {
    let mut lines = vec!["building     health      fire  team".to_string()];
    for (index, building) in picture.city.buildings.iter().enumerate() {
        lines.push(building_line(picture, index, building));
    }
    lines.push(String::new());
    lines.push("agent           assigned to  action".to_string());
    for index in 0..picture.city.agents.len() {
        lines.push(agent_line(picture, index));
    }
    lines
}

fn building_line(picture: &Picture<'_>, index: usize, building: &BuildingState) -> String {
    let look = Look::of(building);
    let full = (building.health * BAR as f64).round() as usize;
    let bar = format!("{}{}", "█".repeat(full), "░".repeat(BAR - full.min(BAR)));
    let team: Vec<String> = (0..picture.city.agents.len())
        .filter(|&agent| picture.allocation.get(agent) == Some(&(index as u8)))
        .map(|agent| agent_name(&picture.city, agent))
        .collect();
    format!(
        "{}{} {:8}  {bar}  {:4.2}  {}",
        symbol(look),
        building_letter(index),
        look.word(),
        building.fire,
        team.join(" ")
    )
}

fn agent_line(picture: &Picture<'_>, index: usize) -> String {
    let task = match picture.allocation.get(index) {
        None | Some(&UNASSIGNED) => "-".to_string(),
        Some(&task) => building_letter(usize::from(task)).to_string(),
    };
    let action = picture.actions.get(index).and_then(|&action| ACTION_NAMES.get(action as usize));
    let kind = match picture.city.agents[index].kind {
        AgentKind::Firefighter => "firefighter",
        AgentKind::Builder => "builder",
        AgentKind::Generalist => "generalist",
    };
    format!("{} {kind:11}  {task:11}  {}", agent_name(&picture.city, index), action.unwrap_or(&"-"))
}

fn agent_name(city: &City<'_>, index: usize) -> String {
    let letter = city.agents[index].kind.letter();
    style(format!("{letter}{:<1}", index % 10)).cyan().bold().to_string()
}

/// `a` for building 0; a city has at most 25.
fn building_letter(index: usize) -> char {
    char::from(b'a'.saturating_add(index as u8))
}

/// How a building looks on the map.
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
            Self::Burning => "burning",
            Self::Open => "open",
            Self::Complete => "complete",
            Self::BurnedDown => "burned",
        }
    }
}

fn symbol(look: Look) -> String {
    let symbol = match look {
        Look::Burning => '▲',
        Look::Open => '□',
        Look::Complete => '■',
        Look::BurnedDown => '×',
    };
    look.style().apply_to(symbol).to_string()
}

#[cfg(test)]
mod tests {
    use sortie_envs::save_the_city::{AgentState, BuildingKind};

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

    #[test]
    fn a_picture_shows_where_everything_is_and_who_works_where() {
        console::set_colors_enabled(false);
        let agents = [AgentState::at(AgentKind::Firefighter, 2, 4)];
        let buildings = [building(0.5, 0.25, 1), building(1.0, 0.0, 4), building(0.0, 0.0, 7)];
        let shown = lines(&Picture {
            city: City { agents: &agents, buildings: &buildings },
            allocation: &[0],
            actions: &[9],
            episode: 2,
            episodes: Some(20),
            finished: 1,
            solved: 1,
            step: 7,
            tick: Percentiles { p50: 20.4, p99: 80.0, p999: None, max: 90.0 },
        });
        assert_eq!(
            shown[0],
            "episode 2 of 20, step   7   solved 1 of 1   tick p50 20 us, p99 80 us"
        );
        // The map's first line is its edge, the second y = 15: y = 4 is the thirteenth.
        assert_eq!(shown[13], "│ ·▲aF0 ·■b · ·×c · · · · · · · ·│");
        assert!(shown[2].ends_with("▲a burning   █████░░░░░  0.25  F0"), "{}", shown[2]);
        assert!(shown[3].ends_with("■b complete  ██████████  0.00"), "{}", shown[3]);
        assert!(shown[7].ends_with("F0 firefighter  a            fight"), "{}", shown[7]);
    }
}
