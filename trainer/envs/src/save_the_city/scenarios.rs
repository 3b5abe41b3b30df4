//! Which teams meet how many buildings, how such an episode starts, and which states the rules allow.

use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;
use core::fmt;

use rand_xoshiro::Xoshiro256PlusPlus;

use super::grid::{agent_candidates, sites};
use super::rules::{self, Constants};
use super::state::{
    AgentKind, AgentState, BuildingKind, BuildingState, MAX_AGENTS, MAX_BUILDINGS, SIDE, Status,
};
use crate::environment::Split;
use crate::random::{below, chance, unit};

const SETS: &str = include_str!("scenarios.txt");

/// Names of the scenario sets.
pub const SET_NAMES: [&str; 12] = [
    "2-5a_2-5b",
    "2-8a_2-8b",
    "2-10a_2-10b",
    "12a_12b",
    "16a_16b",
    "20a_20b",
    "24a_24b",
    "2-8a_2-8b_sim_Q1",
    "2-8a_2-8b_sim_Q2",
    "2-8a_2-8b_sim_Q3",
    "2-8a_2-8b_sim_Q4",
    "single_scen",
];

/// The buildings of a scenario.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BuildingPlan {
    /// So many, each fast or slow with equal chance.
    Count(usize),
    /// Exactly these.
    Kinds(Vec<BuildingKind>),
}

impl BuildingPlan {
    /// How many buildings there are.
    pub fn count(&self) -> usize {
        match self {
            Self::Count(count) => *count,
            Self::Kinds(kinds) => kinds.len(),
        }
    }
}

/// One team and what it has to save.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Scenario {
    /// The agents in index order.
    pub team: Vec<AgentKind>,
    /// The buildings.
    pub buildings: BuildingPlan,
}

/// A named collection of scenarios and the sizes that cover them all.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScenarioSet {
    /// Name of the set.
    pub name: String,
    /// Most agents of a scenario: the A of the shape.
    pub max_agents: usize,
    /// Most buildings of a scenario: the T of the shape, and the measure of rewards.
    pub max_buildings: usize,
    /// Cells from one site to the next, at least 3.
    pub spacing: u8,
    /// Scenarios to learn on.
    pub train: Vec<Scenario>,
    /// Scenarios to measure on.
    pub test: Vec<Scenario>,
}

impl ScenarioSet {
    /// Sets of the dissertation's code by their names there, several of them joined by `+`.
    pub fn named(name: &str) -> Result<Self, CityError> {
        let mut sets = name.split('+').map(Self::single);
        let first = sets.next().unwrap_or_else(|| Err(unknown_set(name)))?;
        sets.try_fold(first, |union, set| union.joined(set?))
    }

    /// The scenarios of both sets.
    fn joined(mut self, other: Self) -> Result<Self, CityError> {
        if self.spacing != other.spacing {
            let reason = format!("`{}` and `{}` have other sites", self.name, other.name);
            return Err(CityError::Set(reason));
        }
        self.name = format!("{}+{}", self.name, other.name);
        self.max_agents = self.max_agents.max(other.max_agents);
        self.max_buildings = self.max_buildings.max(other.max_buildings);
        self.train.extend(other.train);
        self.test.extend(other.test);
        Ok(self)
    }

    fn single(name: &str) -> Result<Self, CityError> {
        let unknown = || unknown_set(name);
        let mut lines = SETS.lines().skip_while(|line| !is_header_of(line, name));
        let header = lines.next().ok_or_else(unknown)?;
        let mut sizes = header.split(' ').skip(2).filter_map(|word| word.parse::<u8>().ok());
        let mut size = || sizes.next().ok_or_else(unknown);
        let mut set = Self {
            name: name.to_string(),
            max_agents: size()?.into(),
            max_buildings: size()?.into(),
            spacing: size()?,
            train: Vec::new(),
            test: Vec::new(),
        };
        for line in lines.take_while(|line| !line.starts_with("set ")) {
            let (list, teams) = line.split_once(' ').ok_or_else(unknown)?;
            let scenarios = if list == "train" { &mut set.train } else { &mut set.test };
            scenarios.extend(teams.split(' ').map(scenario));
        }
        if set.test.is_empty() {
            set.test = set.train.clone();
        }
        Ok(set)
    }

    /// The scenarios of one list.
    pub fn scenarios(&self, split: Split) -> &[Scenario] {
        match split {
            Split::Train => &self.train,
            Split::Test => &self.test,
        }
    }

    /// Checks that every scenario fits the sizes, and that agents and buildings find cells.
    pub fn check(&self) -> Result<(), CityError> {
        let require = |holds: bool, reason: &str| {
            if holds { Ok(()) } else { Err(CityError::Set(format!("`{}`: {reason}", self.name))) }
        };
        require(self.spacing >= 3, "sites must be at least 3 cells apart")?;
        require((1..=MAX_AGENTS).contains(&self.max_agents), "1 to 64 agents are possible")?;
        require(
            (1..=MAX_BUILDINGS).contains(&self.max_buildings),
            "1 to 25 buildings are possible",
        )?;
        require(!self.train.is_empty() && !self.test.is_empty(), "a list has no scenario")?;
        for scenario in self.train.iter().chain(&self.test) {
            let (agents, buildings) = (scenario.team.len(), scenario.buildings.count());
            require(
                (1..=self.max_agents).contains(&agents),
                "a team is empty or larger than the set's",
            )?;
            require(
                (1..=self.max_buildings).contains(&buildings),
                "a scenario has no building or more than the set",
            )?;
            require(buildings <= sites(self.spacing).count(), "more buildings than sites")?;
            require(
                agent_candidates(self.spacing, agents).count() >= agents,
                "more agents than cells to start on",
            )?;
        }
        Ok(())
    }
}

fn unknown_set(name: &str) -> CityError {
    CityError::UnknownSet { name: name.to_string(), known: &SET_NAMES }
}

fn is_header_of(line: &str, name: &str) -> bool {
    let mut words = line.split(' ');
    words.next() == Some("set") && words.next() == Some(name)
}

/// Reads `B2FG3`, or `F3B3G2:F4S4` where the buildings' kinds are given.
fn scenario(word: &str) -> Scenario {
    let (team, kinds) = word.split_once(':').unwrap_or((word, ""));
    let team = expand(team).filter_map(AgentKind::from_letter).collect::<Vec<_>>();
    let buildings = if kinds.is_empty() {
        BuildingPlan::Count(team.len() + 1)
    } else {
        BuildingPlan::Kinds(expand(kinds).filter_map(BuildingKind::from_letter).collect())
    };
    Scenario { team, buildings }
}

/// The letters of a run-length list: `B2G` is B, B, G.
fn expand(list: &str) -> impl Iterator<Item = char> + '_ {
    let starts = list.char_indices().filter(|(_, letter)| letter.is_alphabetic());
    starts.flat_map(|(at, letter)| {
        let rest = &list[at + letter.len_utf8()..];
        let digits = rest.len() - rest.trim_start_matches(|c: char| c.is_ascii_digit()).len();
        core::iter::repeat_n(letter, rest[..digits].parse().unwrap_or(1))
    })
}

/// A scenario set or a state that the rules do not allow.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum CityError {
    /// There is no scenario set of that name.
    UnknownSet {
        /// The name.
        name: String,
        /// Those that there are.
        known: &'static [&'static str],
    },
    /// A scenario set breaks a limit; the text says which.
    Set(String),
    /// A state breaks a rule; the text says which.
    State(String),
}

impl fmt::Display for CityError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UnknownSet { name, known } => {
                write!(f, "no scenario set `{name}`; there are `{}`", known.join("`, `"))
            }
            Self::Set(reason) => write!(f, "impossible scenario set: {reason}"),
            Self::State(reason) => write!(f, "impossible state: {reason}"),
        }
    }
}

impl core::error::Error for CityError {}

/// Cells to draw from without replacement, kept so that a reset allocates nothing.
#[derive(Clone, Debug)]
pub(super) struct Lots {
    cells: Vec<(u8, u8)>,
}

impl Lots {
    pub(super) fn new() -> Self {
        Self { cells: Vec::with_capacity(usize::from(SIDE) * usize::from(SIDE)) }
    }

    fn refill(&mut self, cells: impl Iterator<Item = (u8, u8)>) {
        self.cells.clear();
        self.cells.extend(cells);
    }

    fn draw(&mut self, rng: &mut Xoshiro256PlusPlus) -> (u8, u8) {
        let index = below(rng, self.cells.len());
        self.cells.remove(index)
    }
}

/// Draws the kinds of a scenario's buildings.
fn building_kinds(
    plan: &BuildingPlan,
    rng: &mut Xoshiro256PlusPlus,
) -> [BuildingKind; MAX_BUILDINGS] {
    let mut kinds = [BuildingKind::Fast; MAX_BUILDINGS];
    match plan {
        BuildingPlan::Kinds(given) => kinds[..given.len()].copy_from_slice(given),
        BuildingPlan::Count(count) => {
            for kind in &mut kinds[..*count] {
                *kind = BuildingKind::ALL[below(rng, 2)];
            }
        }
    }
    kinds
}

/// Draws one building on one of the sites that are left; it does not burn yet.
fn draw_building(
    kind: BuildingKind,
    lots: &mut Lots,
    rng: &mut Xoshiro256PlusPlus,
) -> BuildingState {
    let (x, y) = lots.draw(rng);
    let (low, high) = if chance(rng, 0.5) { (0.25, 0.4) } else { (0.6, 0.75) };
    let share = unit(rng);
    let health = low * share + high * (1.0 - share);
    let (shortest, longest) = kind.periods();
    let period = shortest + below(rng, usize::from(longest - shortest) + 1) as u16;
    BuildingState {
        health,
        fire: 0.0,
        period,
        to_next_fire: period,
        since_last_fire: 0,
        kind,
        status: Status::Open,
        x,
        y,
    }
}

/// Draws agents and buildings of an episode into slices of the scenario's sizes.
///
/// The draws come in the order of the dissertation's code.
pub(super) fn draw_city(
    constants: &Constants,
    spacing: u8,
    scenario: &Scenario,
    lots: &mut Lots,
    rng: &mut Xoshiro256PlusPlus,
    agents: &mut [AgentState],
    buildings: &mut [BuildingState],
) {
    let kinds = building_kinds(&scenario.buildings, rng);
    lots.refill(agent_candidates(spacing, agents.len()));
    for (agent, &kind) in agents.iter_mut().zip(&scenario.team) {
        let (x, y) = lots.draw(rng);
        *agent = AgentState::at(kind, x, y);
    }
    lots.refill(sites(spacing));
    for (building, kind) in buildings.iter_mut().zip(kinds) {
        *building = draw_building(kind, lots, rng);
    }
    for building in buildings {
        if chance(rng, constants.init_fire_chance) {
            rules::ignite(building);
        }
    }
}

/// What fills the slots of absent agents.
pub(super) const ABSENT_AGENT: AgentState = AgentState::at(AgentKind::Firefighter, 0, 0);

/// What fills the slots of absent buildings.
pub(super) const ABSENT_BUILDING: BuildingState = BuildingState {
    health: 1.0,
    fire: 0.0,
    period: 1,
    to_next_fire: 1000,
    since_last_fire: 0,
    kind: BuildingKind::Fast,
    status: Status::Complete,
    x: 0,
    y: 0,
};

/// Refuses a state that no episode of the set can be in.
pub(super) fn check_state(
    set: &ScenarioSet,
    agents: &[AgentState],
    buildings: &[BuildingState],
) -> Result<(), CityError> {
    let require = |holds: bool, what: &str, index: usize, reason: &str| {
        if holds { Ok(()) } else { Err(CityError::State(format!("{what} {index} {reason}"))) }
    };
    let on_map = |x: u8, y: u8| x < SIDE && y < SIDE;
    let fits = (1..=set.max_agents).contains(&agents.len());
    require(fits, "a team of", agents.len(), "does not fit the set")?;
    let fits = (1..=set.max_buildings).contains(&buildings.len());
    require(fits, "a number of buildings of", buildings.len(), "does not fit the set")?;
    for (index, building) in buildings.iter().enumerate() {
        let (health, fire) = (building.health, building.fire);
        let say = |holds, reason| require(holds, "building", index, reason);
        say(on_map(building.x, building.y), "is off the map")?;
        say((0.0..=1.0).contains(&health), "has a health outside 0..=1")?;
        say((0.0..=1.0).contains(&fire), "has a fire outside 0..=1")?;
        say(building.period > 0, "has a period of 0")?;
        let closed = Status::of_health(health) != Status::Open;
        say(!(closed && building.is_burning()), "is closed and burns")?;
        say(closed || building.to_next_fire > 0, "is open and its clock has run out")?;
    }
    for (index, agent) in agents.iter().enumerate() {
        let say = |holds, reason| require(holds, "agent", index, reason);
        say(on_map(agent.x, agent.y), "is off the map")?;
        let place = (agent.x, agent.y);
        let shared = agents[..index].iter().any(|other| (other.x, other.y) == place)
            || buildings.iter().any(|building| (building.x, building.y) == place);
        say(!shared, "shares its cell")?;
    }
    Ok(())
}
