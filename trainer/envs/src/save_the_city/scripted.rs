//! The scripted low level: walk to the assigned building, then do there what fits.

use rand_xoshiro::Xoshiro256PlusPlus;

use super::allocation::AllocationRule;
use super::grid::{FreeCells, cell, neighbours};
use super::rules::{BUILD, FIGHT, FREEZE, STAY, displacement};
use super::state::{AgentKind, AgentState, BuildingState, City, MAX_AGENTS, SIDE};
use crate::decisions::DecisionPoints;
use crate::decisions::UNASSIGNED;
use crate::random::{below, member};

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
