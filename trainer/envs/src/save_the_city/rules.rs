//! What one step does: who may do what, what buildings suffer, who yields a cell.
//!
//! Numbers are f64, one operation at a time in the written order: the order is part of the rules.

use alloc::format;
use alloc::string::String;

use serde::{Deserialize, Serialize};

use super::grid::{DIRECTIONS, FreeCells, Ground};
use super::state::{
    AgentKind, AgentState, BuildingState, MAX_AGENTS, MAX_BUILDINGS, NO_BUILDING, Status, manhattan,
};

/// Actions of every agent, whatever its kind.
pub const ACTIONS: usize = 12;

/// Names of the actions, by number.
pub const ACTION_NAMES: [&str; ACTIONS] = [
    "stay", "north", "east", "south", "west", "north-2", "east-2", "south-2", "west-2", "fight",
    "build", "freeze",
];

pub(super) const STAY: u16 = 0;
pub(super) const FIGHT: u16 = 9;
pub(super) const BUILD: u16 = 10;
/// The action that keeps a fire from doing damage.
pub const FREEZE: u16 = 11;

/// Every number of the rules that may be configured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Constants {
    /// Chance of each building to burn at the start of an episode.
    pub init_fire_chance: f64,
    /// Health lost per step at full fire and burn rate 1.
    pub fire_burn_rate: f64,
    /// Fire removed per step and unit of fire speed.
    pub fire_reduce_rate: f64,
    /// Factor on an unattended fire per step.
    pub fire_growth_rate: f64,
    /// Health gained per step and unit of build speed.
    pub base_build_rate: f64,
    /// A generalist's help, in units of the two rates above.
    pub generalist_help_factor: f64,
    /// Steps after which an episode times out.
    pub episode_limit: u32,
    /// Whether the first burned building ends the episode.
    pub end_on_any_burn: bool,
    /// Rewards are scaled so that about this much can be earned in an episode.
    pub reward_scale: f64,
    /// Reward per unit of health gained.
    pub health_delta_mult: f64,
    /// Reward of completing a building, to the team only.
    pub complete: f64,
    /// Reward of losing a building.
    pub burned_down: f64,
    /// Reward of extinguishing a fire.
    pub extinguish: f64,
    /// Reward of completing all buildings to the team, of completing one to its task.
    pub solved: f64,
    /// Reward of every step.
    pub ts_pen: f64,
}

impl Default for Constants {
    fn default() -> Self {
        Self {
            init_fire_chance: 0.4,
            fire_burn_rate: 0.035,
            fire_reduce_rate: 0.25,
            fire_growth_rate: 1.1,
            base_build_rate: 0.125,
            generalist_help_factor: 0.45,
            episode_limit: 150,
            end_on_any_burn: false,
            reward_scale: 20.0,
            health_delta_mult: 10.0,
            complete: 1.0,
            burned_down: -20.0,
            extinguish: 0.5,
            solved: 20.0,
            ts_pen: 0.0,
        }
    }
}

impl Constants {
    /// Refuses numbers by which no episode can be played.
    ///
    /// # Errors
    /// The first that is outside its limits.
    pub(super) fn check(&self) -> Result<(), String> {
        const TINY: f64 = f64::MIN_POSITIVE;
        const MOST: f64 = 1e6;
        for (name, value, least, most) in [
            ("init_fire_chance", self.init_fire_chance, 0.0, 1.0),
            ("fire_burn_rate", self.fire_burn_rate, 0.0, 100.0),
            ("fire_reduce_rate", self.fire_reduce_rate, 0.0, 100.0),
            ("fire_growth_rate", self.fire_growth_rate, 0.0, 100.0),
            ("base_build_rate", self.base_build_rate, 0.0, 100.0),
            ("generalist_help_factor", self.generalist_help_factor, 0.0, 100.0),
            ("episode_limit", self.episode_limit.into(), 1.0, 100_000.0),
            ("reward_scale", self.reward_scale, TINY, MOST),
            ("health_delta_mult", self.health_delta_mult, -MOST, MOST),
            ("complete", self.complete, -MOST, MOST),
            ("burned_down", self.burned_down, -MOST, MOST),
            ("extinguish", self.extinguish, -MOST, MOST),
            ("solved", self.solved, -MOST, MOST),
            ("ts_pen", self.ts_pen, -MOST, MOST),
        ] {
            if !(least..=most).contains(&value) {
                let least = if least == TINY { "above 0".into() } else { format!("from {least}") };
                return Err(format!("`{name}` is {value}, must be a number {least} to {most}"));
            }
        }
        Ok(())
    }

    /// What an episode of at most `buildings` buildings can earn, before scaling.
    pub fn max_reward(&self, buildings: usize) -> f64 {
        let buildings = buildings as f64;
        0.5 * self.health_delta_mult * buildings + self.complete * buildings + self.solved
    }
}

/// Two agents entered one cell, and one of them went back.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Bounce {
    /// The agent of lower index.
    pub first: u8,
    /// The agent of higher index.
    pub second: u8,
    /// The one that went back.
    pub loser: u8,
}

/// The displacement of a move.
pub(super) fn displacement(action: u16) -> Option<(i8, i8)> {
    let index = usize::from(action.checked_sub(1)?);
    let (dx, dy) = *DIRECTIONS.get(index % 4)?;
    let length = 1 + (index / 4) as i8;
    (length <= 2).then_some((dx * length, dy * length))
}

/// Whether some available move brings the agent nearer to a building.
pub fn can_approach(agent: &AgentState, building: &BuildingState) -> bool {
    let nearer = |(dx, dy)| {
        let cell = (agent.x.wrapping_add_signed(dx), agent.y.wrapping_add_signed(dy));
        manhattan(cell, (building.x, building.y)) < agent.distance_to(building)
    };
    let available = |action: &u16| agent.available >> action & 1 == 1;
    (1..FIGHT).filter(available).filter_map(displacement).any(nearer)
}

/// The actions that an agent on this cell may take, as bits.
fn available_actions(agent: &AgentState, free: &FreeCells, buildings: &[BuildingState]) -> u16 {
    let mut available = 1;
    for (index, (dx, dy)) in DIRECTIONS.into_iter().enumerate() {
        available |= free.free_at(agent.x, agent.y, dx, dy) << (1 + index);
    }
    if agent.kind.longest_move() == 2 {
        for (index, (dx, dy)) in DIRECTIONS.into_iter().enumerate() {
            available |= free.free_at(agent.x, agent.y, 2 * dx, 2 * dy) << (5 + index);
        }
    }
    if agent.beside != NO_BUILDING {
        let building = &buildings[usize::from(agent.beside)];
        if building.is_burning() {
            available |= 1 << FIGHT | u16::from(agent.kind.can_freeze()) << FREEZE;
        } else if building.is_open() {
            available |= 1 << BUILD;
        }
    }
    available
}

/// Writes what each agent stands beside and may do.
pub(super) fn refresh_agents(
    ground: &Ground,
    agents: &mut [AgentState],
    buildings: &[BuildingState],
) {
    let mut free = ground.free;
    for agent in agents.iter() {
        free.occupy(agent.x, agent.y);
    }
    for agent in agents {
        agent.beside = ground.building_beside(agent.x, agent.y);
        agent.available = available_actions(agent, &free, buildings);
    }
}

/// The availability code of one action: 0 = not available, 1 = available, 2 + b = applies to building b.
pub fn availability_code(agent: &AgentState, action: usize) -> u16 {
    let bit = agent.available >> action & 1;
    if action < usize::from(FIGHT) { bit } else { bit * (2 + u16::from(agent.beside)) }
}

/// All availability codes of an agent.
pub fn availability_codes(agent: &AgentState) -> [u16; ACTIONS] {
    core::array::from_fn(|action| availability_code(agent, action))
}

/// What the agents did to one building in one step.
#[derive(Clone, Copy, Default)]
pub(super) struct Effort {
    extinguish: f64,
    build: f64,
    /// Kinds that fought, one bit each.
    pub(super) fire_kinds: u8,
    /// Kinds that built, one bit each.
    pub(super) build_kinds: u8,
    frozen: bool,
}

const FIREFIGHTER: u8 = 1 << AgentKind::Firefighter as u8;
const BUILDER: u8 = 1 << AgentKind::Builder as u8;
const GENERALIST: u8 = 1 << AgentKind::Generalist as u8;

/// Moves the agents and collects what they do to each building, in agent order.
///
/// The actions have been checked. Nobody looks at where the others go: collisions come later.
pub(super) fn act(
    constants: &Constants,
    agents: &mut [AgentState],
    actions: &[u16],
    efforts: &mut [Effort; MAX_BUILDINGS],
) {
    for (agent, &action) in agents.iter_mut().zip(actions) {
        if let Some((dx, dy)) = displacement(action) {
            agent.x = agent.x.wrapping_add_signed(dx);
            agent.y = agent.y.wrapping_add_signed(dy);
        } else if action != STAY {
            let effort = &mut efforts[usize::from(agent.beside)];
            let kind = 1 << agent.kind as u8;
            match action {
                FIGHT => {
                    effort.extinguish += agent.kind.fire_speed() * constants.fire_reduce_rate;
                    effort.fire_kinds |= kind;
                }
                BUILD => {
                    effort.build += agent.kind.build_speed() * constants.base_build_rate;
                    effort.build_kinds |= kind;
                }
                _ => effort.frozen = true,
            }
        }
    }
}

/// What happened to one building in one step.
#[derive(Clone, Copy, Default)]
pub(super) struct Change {
    pub(super) health_delta: f64,
    pub(super) extinguished: bool,
    pub(super) completed: bool,
    pub(super) burned: bool,
}

/// Fire, health and ignition clock of one open building.
pub(super) fn update_building(
    constants: &Constants,
    building: &mut BuildingState,
    effort: &Effort,
) -> Change {
    let (previous_fire, previous_health) = (building.fire, building.health);
    building.fire = fire_after(constants, previous_fire, effort);
    building.health = health_after(constants, building, effort);
    building.status = Status::of_health(building.health);
    let change = Change {
        health_delta: building.health - previous_health,
        extinguished: previous_fire > 0.0 && building.fire == 0.0,
        completed: building.status == Status::Complete,
        burned: building.status == Status::BurnedDown,
    };
    if change.burned {
        building.fire = 0.0;
    }
    tick_ignition(building);
    change
}

fn fire_after(constants: &Constants, fire: f64, effort: &Effort) -> f64 {
    let fire = if effort.extinguish == 0.0 {
        constants.fire_growth_rate * fire
    } else {
        let mut extinguish = effort.extinguish;
        if effort.fire_kinds & (BUILDER | GENERALIST) == BUILDER | GENERALIST {
            extinguish += constants.generalist_help_factor * constants.fire_reduce_rate;
        }
        fire - extinguish
    };
    fire.clamp(0.0, 1.0)
}

fn health_after(constants: &Constants, building: &BuildingState, effort: &Effort) -> f64 {
    let mut build = effort.build;
    if effort.build_kinds & (FIREFIGHTER | GENERALIST) == FIREFIGHTER | GENERALIST {
        build += constants.generalist_help_factor * constants.base_build_rate;
    }
    if !effort.frozen {
        build -= (building.fire * building.kind.burn_rate()) * constants.fire_burn_rate;
    }
    (building.health + build).clamp(0.0, 1.0)
}

/// The clock runs whether or not the building burns: a weak fire is set to full as well.
fn tick_ignition(building: &mut BuildingState) {
    if building.is_open() {
        building.to_next_fire = building.to_next_fire.saturating_sub(1);
        building.since_last_fire = building.since_last_fire.saturating_add(1);
        if building.to_next_fire == 0 {
            ignite(building);
        }
    } else {
        close(building);
    }
}

/// Sets a building on full fire and restarts its clock.
pub(super) fn ignite(building: &mut BuildingState) {
    building.fire = 1.0;
    building.to_next_fire = building.period;
    building.since_last_fire = 0;
}

/// Stops the clock of a closed building.
pub(super) fn close(building: &mut BuildingState) {
    building.to_next_fire = 1000;
    building.since_last_fire = 0;
}

/// The cells of all agents before they move.
pub(super) fn cells(agents: &[AgentState]) -> [(u8, u8); MAX_AGENTS] {
    let mut cells = [(0, 0); MAX_AGENTS];
    for (cell, agent) in cells.iter_mut().zip(agents) {
        *cell = (agent.x, agent.y);
    }
    cells
}

/// Sends the loser of every pair in one cell back to where it was; returns how many were sent.
///
/// One pass in index order is enough: nobody can have entered a cell that was occupied before.
/// Every loser leaves the race, so there are fewer bounces than agents.
pub(super) fn resolve_collisions(
    agents: &mut [AgentState],
    previous: &[(u8, u8); MAX_AGENTS],
    bounces: &mut [Bounce],
    mut draw_loser: impl FnMut(usize, usize) -> usize,
) -> usize {
    let mut count = 0;
    for first in 0..agents.len() {
        for second in first + 1..agents.len() {
            let (one, other) = (&agents[first], &agents[second]);
            if (one.x, one.y) != (other.x, other.y) {
                continue;
            }
            let loser = draw_loser(first, second);
            (agents[loser].x, agents[loser].y) = previous[loser];
            bounces[count] =
                Bounce { first: first as u8, second: second as u8, loser: loser as u8 };
            count += 1;
        }
    }
    count
}
