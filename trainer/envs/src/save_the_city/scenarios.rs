//! Which teams meet how many buildings.

use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;

use super::error::CityError;
use super::grid::{agent_candidates, sites};
use super::state::{AgentKind, BuildingKind, MAX_AGENTS, MAX_BUILDINGS};
use crate::environment::Split;

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
