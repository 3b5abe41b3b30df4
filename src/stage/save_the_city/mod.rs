//! What pages show of a city in which a team plays.

mod data;

use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;
use core::any::Any;

use serde::Serialize;
use sortie_core::World;
use sortie_envs::save_the_city::{
    ACTION_NAMES, AgentKind, BuildingKind, CityError, ENTRY, EpisodeMetrics, MAX_AGENTS, SIDE,
    SaveTheCity, with_city,
};
use sortie_envs::{Entry, Environment, Episode, UNASSIGNED, members, save_the_city as game};

use crate::error::StageError;
use crate::show::{Glance, Show, Shown};
use crate::stage::Stage;
use crate::thoughts::rounded;

pub use data::{
    AgentFacts, BuildingFacts, EpisodeResult, Event, EventKind, Names, State, Step, TeamValues,
};

/// SaveTheCity.
#[derive(Debug)]
pub struct City;

/// What does not change about a city.
#[derive(Debug, Serialize)]
pub struct Facts {
    side: u8,
    actions: &'static [&'static str],
    agents: Vec<AgentFacts>,
    buildings: Vec<BuildingFacts>,
}

const OWN: &str = "made by this environment's entry";

impl Show for City {
    type Facts = Facts;
    type State = State;
    type Step = Step;
    type Event = Event;

    fn entry() -> &'static Entry {
        &ENTRY
    }

    fn facts(first: Glance<'_>) -> Facts {
        let (agents, buildings) =
            with_city(first.state, |city| (agent_facts(city), building_facts(city)));
        Facts { side: SIDE, actions: &ACTION_NAMES, agents, buildings }
    }

    fn agents(facts: &Facts) -> usize {
        facts.agents.len()
    }

    fn state(seen: Glance<'_>) -> State {
        with_city(seen.state, |city| state(city, &[UNASSIGNED; MAX_AGENTS]))
    }

    fn step(seen: Glance<'_>, actions: &[u16], reward: f64, _: [&State; 2]) -> Step {
        let worlds: &dyn Any = seen.worlds;
        step(worlds.downcast_ref().expect(OWN), seen.instance, actions, reward)
    }

    fn events(
        facts: &Facts,
        at: usize,
        before: Option<&Shown<Self>>,
        now: &Shown<Self>,
    ) -> Vec<Event> {
        let names = Names { agents: &facts.agents, buildings: &facts.buildings };
        names.events_at(at, before.map(|before| &before.state), &now.state)
    }

    fn result(episode: &Episode) -> &'static str {
        match (episode.solved, episode.timed_out) {
            (true, _) => "solved",
            (false, true) => "timed-out",
            (false, false) => "lost",
        }
    }

    fn assign<W: World>(state: &mut State, stage: &mut Stage<'_, W>) -> Result<(), StageError> {
        let agents = state.places.len();
        let allocation = &stage.allocation()[..agents];
        state.allocation =
            allocation.iter().map(|task| (*task != UNASSIGNED).then_some(*task)).collect();
        state.decided = stage.is_allocated_anew();
        let values = state.status.iter().enumerate();
        let values = values.map(|(building, status)| match status {
            0 => values_at(building, &state.allocation, stage),
            _ => Ok(None),
        });
        state.values = Some(values.collect::<Result<_, StageError>>()?);
        Ok(())
    }

    /// Sets a building on fire.
    fn disturb(
        worlds: &mut dyn Environment,
        instance: usize,
        building: usize,
    ) -> Result<(), String> {
        let worlds: &mut dyn Any = worlds;
        let worlds: &mut SaveTheCity = worlds.downcast_mut().expect(OWN);
        worlds.set_fire(instance, building).map_err(|error| match error {
            CityError::State(reason) => reason,
            error => error.to_string(),
        })
    }
}

/// What teams at a building are worth.
fn values_at<W: World>(
    building: usize,
    allocation: &[Option<u8>],
    stage: &mut Stage<'_, W>,
) -> Result<Option<TeamValues>, StageError> {
    let here = allocation.iter().enumerate();
    let here = here.filter(|(_, own)| own.is_some_and(|own| usize::from(own) == building));
    let chosen = here.fold(0, |team, (agent, _)| team | 1_u64 << agent);
    let absent = (0..allocation.len()).filter(|agent| stage.is_absent(*agent));
    let absent = absent.fold(0, |set, agent| set | 1_u64 << agent);
    let mut teams = candidates(allocation.len(), stage.team_max(), chosen);
    teams.retain(|team| team & absent == 0);
    let known = stage.team_values(building, &teams)?;
    Ok(known.map(|known| TeamValues::of(&teams, &known, chosen)))
}

/// What does not change about the agents.
pub fn agent_facts(city: game::City<'_>) -> Vec<AgentFacts> {
    let agent = |(number, kind): (usize, AgentKind)| AgentFacts {
        name: format!("{}{number}", kind.letter()),
        kind: kind_name(kind),
    };
    city.agents.iter().map(|agent| agent.kind).enumerate().map(agent).collect()
}

/// What does not change about the buildings.
pub fn building_facts(city: game::City<'_>) -> Vec<BuildingFacts> {
    let buildings = city.buildings.iter().enumerate().map(|(number, building)| BuildingFacts {
        name: building_name(number),
        kind: match building.kind {
            BuildingKind::Fast => "fast",
            BuildingKind::Slow => "slow",
        },
        x: building.x,
        y: building.y,
        period: building.period,
    });
    buildings.collect()
}

/// A state under an allocation, without what anybody thinks in it.
pub fn state(city: game::City<'_>, allocation: &[u8]) -> State {
    let (agents, buildings) = (city.agents, city.buildings);
    let assigned = allocation.iter().map(|&task| (task != UNASSIGNED).then_some(task));
    State {
        places: agents.iter().map(|agent| (agent.x, agent.y)).collect(),
        health: buildings.iter().map(|building| rounded(building.health)).collect(),
        fire: buildings.iter().map(|building| rounded(building.fire)).collect(),
        status: buildings.iter().map(|building| building.status as u8).collect(),
        next_fire: buildings.iter().map(|building| building.to_next_fire).collect(),
        available: agents.iter().map(|agent| agent.available).collect(),
        allocation: assigned.take(agents.len()).collect(),
        decided: false,
        thoughts: None,
        values: None,
    }
}

/// What the last step of an instance came to for these actions.
pub fn step(worlds: &SaveTheCity, instance: usize, actions: &[u16], reward: f64) -> Step {
    let city = worlds.city(instance);
    let rewards = sortie_envs::Environment::task_rewards(worlds, instance).iter();
    Step {
        actions: actions[..city.agents.len()].to_vec(),
        reward: rounded(reward),
        task_rewards: rewards.take(city.buildings.len()).copied().map(rounded).collect(),
        bounced: worlds.bounces(instance).iter().map(|bounce| bounce.loser).collect(),
    }
}

/// How an episode that is over has ended.
pub fn result(metrics: &EpisodeMetrics) -> EpisodeResult {
    match (metrics.solved, metrics.timed_out) {
        (true, _) => EpisodeResult::Solved,
        (false, true) => EpisodeResult::TimedOut,
        (false, false) => EpisodeResult::Lost,
    }
}

fn kind_name(kind: AgentKind) -> &'static str {
    match kind {
        AgentKind::Firefighter => "firefighter",
        AgentKind::Builder => "builder",
        AgentKind::Generalist => "generalist",
    }
}

/// `a` for building 0; a city has at most 25.
fn building_name(number: usize) -> String {
    char::from(b'a'.saturating_add(number as u8)).to_string()
}

/// Other teams that are shown.
const OTHERS: usize = 3;
/// Most agents for which all teams are compared; beyond, those that differ in one agent.
const ALL_TEAMS: usize = 8;

/// Nobody, the chosen team, and others of the first so many agents that the allocator may give; bit a stands for agent a.
pub fn candidates(agents: usize, team_max: usize, chosen: u64) -> Vec<u64> {
    let fits = |team: &u64| team.count_ones() as usize <= team_max;
    let mut teams: Vec<u64> = if agents <= ALL_TEAMS {
        (0..1 << agents).filter(fits).collect()
    } else {
        (0..agents).map(|agent| chosen ^ 1 << agent).filter(fits).collect()
    };
    teams.extend([0, chosen]);
    teams.sort_unstable();
    teams.dedup();
    teams
}

impl TeamValues {
    /// What is shown of teams and their values: the chosen one, nobody, and the best others.
    pub fn of(teams: &[u64], values: &[f32], chosen: u64) -> Self {
        let mut others = Vec::new();
        let (mut own, mut nobody) = (0.0, 0.0);
        for (&team, &value) in teams.iter().zip(values) {
            if team == 0 {
                nobody = rounded(value);
            }
            if team == chosen {
                own = rounded(value);
            } else if team != 0 {
                others.push((members(team.into()).collect(), rounded(value)));
            }
        }
        others.sort_by(|(_, one): &(Vec<usize>, f64), (_, other)| other.total_cmp(one));
        others.truncate(OTHERS);
        Self { chosen: own, nobody, others }
    }
}
