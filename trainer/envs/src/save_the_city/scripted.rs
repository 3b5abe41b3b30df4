//! Scripted teams: rules that assign agents to buildings, and the low level that walks there and does what fits.

use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};

use super::grid::{FreeCells, cell, neighbours};
use super::rules::{BUILD, Constants, FIGHT, FREEZE, STAY, displacement};
use super::state::{AgentKind, AgentState, BuildingState, City, MAX_AGENTS, MAX_BUILDINGS, SIDE};
use crate::decisions::{DecisionPoints, UNASSIGNED};
use crate::random::{below, member};
use crate::spec::Rule;

/// A rule that assigns agents to buildings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AllocationRule {
    /// Every agent an open building, uniformly and independently.
    Random,
    /// Every agent for itself: the nearest building of the sort it prefers.
    Heuristic,
    /// One agent after the other, by travel time, urgency and who is there already.
    Coordinated,
}

/// The rules as command lines name them, the usual one first.
pub(super) const RULES: &[Rule] = &[
    Rule::new(
        "coordinated",
        "One agent after the other, by travel time, urgency and who is there already",
    ),
    Rule::new("heuristic", "Every agent for itself, the nearest subtask of the kind it prefers"),
    Rule::new("random", "Every agent an open subtask at random"),
];

impl AllocationRule {
    /// In the order of [`RULES`].
    pub(super) const ALL: [Self; 3] = [Self::Coordinated, Self::Heuristic, Self::Random];

    /// The rule of this name.
    pub fn named(name: &str) -> Option<Self> {
        let place = RULES.iter().position(|rule| rule.name == name)?;
        Self::ALL.get(place).copied()
    }

    /// Writes for every agent its building, or [`UNASSIGNED`]; further entries are [`UNASSIGNED`].
    ///
    /// Only [`AllocationRule::Random`] draws from the generator.
    pub fn allocate(self, city: City<'_>, rng: &mut Xoshiro256PlusPlus, allocation: &mut [u8]) {
        match self {
            Self::Random => random_allocation(city, rng, allocation),
            Self::Heuristic => heuristic_allocation(city, allocation),
            Self::Coordinated => coordinated_allocation(city, allocation),
        }
    }
}

/// Gives every agent an open building, uniformly and independently.
pub fn random_allocation(city: City<'_>, rng: &mut Xoshiro256PlusPlus, allocation: &mut [u8]) {
    let open = city.open_tasks();
    allocation.fill(UNASSIGNED);
    for (task, _) in allocation.iter_mut().zip(city.agents) {
        *task = member(rng, open.into()).map_or(UNASSIGNED, |task| task as u8);
    }
}

/// Agents already given to one building, by kind.
#[derive(Clone, Copy, Default)]
struct Given([u8; 3]);

/// Gives agents, all firefighters first, then generalists, then builders, the building of lowest cost.
///
/// Ties go to the lower building index. Without an open building agents stay [`UNASSIGNED`], as do
/// entries beyond the team. The cost sees health as feature rows show it, rounded to f32, so that the
/// answer is the same from a state and from its rows.
pub fn coordinated_allocation(city: City<'_>, allocation: &mut [u8]) {
    const ORDER: [AgentKind; 3] =
        [AgentKind::Firefighter, AgentKind::Generalist, AgentKind::Builder];
    allocation.fill(UNASSIGNED);
    let mut given = [Given::default(); MAX_BUILDINGS];
    for kind in ORDER {
        for (agent, task) in city.agents.iter().zip(allocation.iter_mut()) {
            if agent.kind != kind {
                continue;
            }
            *task = cheapest_building(agent, city.buildings, &given);
            if let Some(given) = given.get_mut(usize::from(*task)) {
                given.0[kind as usize] += 1;
            }
        }
    }
}

fn cheapest_building(agent: &AgentState, buildings: &[BuildingState], given: &[Given]) -> u8 {
    let mut best = (f64::INFINITY, UNASSIGNED);
    for ((building, given), index) in buildings.iter().zip(given).zip(0..) {
        if building.is_open() {
            let cost = cost(agent, building) + crowding(agent.kind, given);
            if cost < best.0 {
                best = (cost, index);
            }
        }
    }
    best.1
}

/// What it takes this agent, and what waits for it, at a building that nobody else goes to.
fn cost(agent: &AgentState, building: &BuildingState) -> f64 {
    let travel = agent.travel_time_to(building);
    let health = f64::from(building.health as f32);
    let to_next_fire = f64::from(building.to_next_fire);
    if building.is_burning() {
        let burn_rate = Constants::default().fire_burn_rate * building.kind.burn_rate();
        let lifetime = health / burn_rate;
        match agent.kind {
            AgentKind::Firefighter => travel + 0.15 * (lifetime - travel).max(0.0),
            AgentKind::Generalist => {
                travel + 0.2 * lifetime + if travel > lifetime { 8.0 } else { 0.0 }
            }
            AgentKind::Builder => travel + 12.0,
        }
    } else {
        match agent.kind {
            AgentKind::Builder => {
                let too_late = if to_next_fire < travel { 20.0 } else { 0.0 };
                travel + 4.0 * (1.0 - health) + too_late
            }
            AgentKind::Firefighter => travel + 15.0 + 0.5 * to_next_fire,
            AgentKind::Generalist => travel + 10.0 + 0.5 * to_next_fire,
        }
    }
}

/// Agents of one kind are better spread; a generalist does less where a firefighter goes.
fn crowding(kind: AgentKind, given: &Given) -> f64 {
    let same = 8.0 * f64::from(given.0[kind as usize]);
    let firefighters = given.0[AgentKind::Firefighter as usize];
    let redundant = kind == AgentKind::Generalist && firefighters > 0;
    same + if redundant { 1.5 } else { 0.0 }
}

/// Gives every agent the nearest open building of the sort that it prefers.
///
/// Builders prefer buildings that do not burn, the others those that do; ties go to the lower index.
/// Without an open building agents stay [`UNASSIGNED`], as do entries beyond the team.
pub fn heuristic_allocation(city: City<'_>, allocation: &mut [u8]) {
    allocation.fill(UNASSIGNED);
    for (task, agent) in allocation.iter_mut().zip(city.agents) {
        *task = preferred_building(agent, city.buildings);
    }
}

fn preferred_building(agent: &AgentState, buildings: &[BuildingState]) -> u8 {
    let wants_fire = agent.kind != AgentKind::Builder;
    let open = buildings.iter().zip(0..).filter(|(building, _)| building.is_open());
    open.min_by_key(|(building, index)| {
        (building.is_burning() != wants_fire, agent.distance_to(building), *index)
    })
    .map_or(UNASSIGNED, |(_, index)| index)
}

/// Steps from a cell to the goal; [`FAR`] where there is no way.
type Distances = [u8; CELLS];
const CELLS: usize = SIDE as usize * SIDE as usize;
const FAR: u8 = u8::MAX;

/// Writes the scripted action of every agent, given its building or [`UNASSIGNED`].
///
/// Beside its open building an agent fights, builds or freezes as its kind does best; elsewhere it
/// takes the available move that brings it closest, ties at random, avoiding cells that earlier
/// agents chose in this step. Every action written is available.
pub fn scripted_actions(
    city: City<'_>,
    allocation: &[u8],
    rng: &mut Xoshiro256PlusPlus,
    actions: &mut [u16],
) {
    let mut unclaimed = FreeCells::all();
    for (index, (agent, action)) in city.agents.iter().zip(actions.iter_mut()).enumerate() {
        let task = allocation.get(index).copied().unwrap_or(UNASSIGNED);
        *action = match city.buildings.get(usize::from(task)) {
            Some(building) if agent.distance_to(building) == 1 => {
                work(city, allocation, index, building)
            }
            Some(building) => walk(city, index, building, &unclaimed, rng),
            None => STAY,
        };
        if agent.available >> *action & 1 == 0 {
            *action = STAY;
        }
        if let Some((x, y)) = destination(agent, *action) {
            unclaimed.occupy(x, y);
        }
    }
}

/// What an agent does beside its building.
fn work(city: City<'_>, allocation: &[u8], index: usize, building: &BuildingState) -> u16 {
    let agent = &city.agents[index];
    if !building.is_burning() {
        return BUILD;
    }
    if agent.kind != AgentKind::Generalist {
        return FIGHT;
    }
    let there = |kind: AgentKind| {
        city.agents.iter().zip(allocation).any(|(other, &task)| {
            other.kind == kind && task == allocation[index] && other.distance_to(building) == 1
        })
    };
    let helps = there(AgentKind::Builder) && !there(AgentKind::Firefighter);
    if helps { FIGHT } else { FREEZE }
}

/// The move that brings an agent closest to a free cell beside its building.
///
/// A way around the other agents is tried first, then one that ignores them.
fn walk(
    city: City<'_>,
    index: usize,
    building: &BuildingState,
    unclaimed: &FreeCells,
    rng: &mut Xoshiro256PlusPlus,
) -> u16 {
    let agent = &city.agents[index];
    let mut free = FreeCells::all();
    for building in city.buildings {
        free.occupy(building.x, building.y);
    }
    let around_buildings = free;
    for (other, agent) in city.agents.iter().enumerate() {
        if other != index {
            free.occupy(agent.x, agent.y);
        }
    }
    let mut closest = |free| closest_move(agent, &distances(building, agent, free), unclaimed, rng);
    closest(&free).or_else(|| closest(&around_buildings)).unwrap_or(STAY)
}

/// Steps over free cells to the cells beside a building, for all cells nearer than the agent's.
fn distances(building: &BuildingState, agent: &AgentState, free: &FreeCells) -> Distances {
    let mut distances = [FAR; CELLS];
    let mut queue = Queue { cells: [(0, 0); CELLS], length: 0 };
    queue.visit(&mut distances, free, (building.x, building.y), 0);
    let mut next = 0;
    while next < queue.length {
        let (x, y) = queue.cells[next];
        if (x, y) == (agent.x, agent.y) {
            break;
        }
        let distance = distances[cell(x, y)] + 1;
        queue.visit(&mut distances, free, (x, y), distance);
        next += 1;
    }
    distances
}

/// The cells found so far, nearest first.
struct Queue {
    cells: [(u8, u8); CELLS],
    length: usize,
}

impl Queue {
    /// Adds the free neighbours of a cell that were not found before.
    fn visit(
        &mut self,
        distances: &mut Distances,
        free: &FreeCells,
        (x, y): (u8, u8),
        distance: u8,
    ) {
        for (x, y) in neighbours(x, y) {
            if free.is_free(x, y) && distances[cell(x, y)] == FAR {
                distances[cell(x, y)] = distance;
                self.cells[self.length] = (x, y);
                self.length += 1;
            }
        }
    }
}

/// The available move to an unclaimed cell that lowers the distance most, ties at random.
fn closest_move(
    agent: &AgentState,
    distances: &Distances,
    unclaimed: &FreeCells,
    rng: &mut Xoshiro256PlusPlus,
) -> Option<u16> {
    let mut best = distances[cell(agent.x, agent.y)];
    let mut moves = [STAY; 8];
    let mut count = 0;
    for action in (1..FIGHT).filter(|action| agent.available >> action & 1 == 1) {
        let Some((x, y)) = destination(agent, action) else { continue };
        let distance = distances[cell(x, y)];
        if !unclaimed.is_free(x, y) || distance > best || (distance == best && count == 0) {
            continue;
        }
        if distance < best {
            (best, count) = (distance, 0);
        }
        moves[count] = action;
        count += 1;
    }
    match count {
        0 => None,
        1 => Some(moves[0]),
        _ => Some(moves[below(rng, count)]),
    }
}

/// The cell that a move leads to.
fn destination(agent: &AgentState, action: u16) -> Option<(u8, u8)> {
    let (dx, dy) = displacement(action)?;
    let (x, y) = (agent.x.checked_add_signed(dx)?, agent.y.checked_add_signed(dy)?);
    (x < SIDE && y < SIDE).then_some((x, y))
}

/// Writes an available action of every agent, drawn uniformly.
pub fn random_actions(city: City<'_>, rng: &mut Xoshiro256PlusPlus, actions: &mut [u16]) {
    for (agent, action) in city.agents.iter().zip(actions) {
        *action = member(rng, agent.available.into()).map_or(STAY, |action| action as u16);
    }
}

/// A team that walks by script and is allocated by a rule: the yardstick for learned teams.
#[derive(Clone, Debug)]
pub struct ScriptedTeam {
    rule: AllocationRule,
    decisions: DecisionPoints,
    allocation: [u8; MAX_AGENTS],
    rng: Xoshiro256PlusPlus,
}

impl ScriptedTeam {
    /// A team that decides by `rule` at the given points.
    pub fn new(rule: AllocationRule, decisions: DecisionPoints, rng: Xoshiro256PlusPlus) -> Self {
        Self { rule, decisions, allocation: [UNASSIGNED; MAX_AGENTS], rng }
    }

    /// Starts a new episode.
    pub fn restart(&mut self) {
        self.decisions.restart();
    }

    /// The building of every agent, or [`UNASSIGNED`].
    pub fn allocation(&self) -> &[u8] {
        &self.allocation
    }

    /// Writes the actions of the next step; `tasks_changed` is about the step that led here.
    pub fn act(&mut self, city: City<'_>, tasks_changed: bool, actions: &mut [u16]) {
        if self.decisions.is_due(tasks_changed) {
            self.rule.allocate(city, &mut self.rng, &mut self.allocation);
        }
        scripted_actions(city, &self.allocation, &mut self.rng, actions);
    }
}
