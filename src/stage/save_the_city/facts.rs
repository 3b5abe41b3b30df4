//! What there is to see of a city: what stays, and what changes from state to state.

use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;

use sortie_envs::UNASSIGNED;
use sortie_envs::save_the_city::{AgentKind, BuildingKind, City, EpisodeMetrics, SaveTheCity};

use super::data::{AgentFacts, BuildingFacts, EpisodeResult, State, Step};
use crate::thoughts::rounded;

/// What does not change about the agents.
pub fn agent_facts(city: City<'_>) -> Vec<AgentFacts> {
    let agent = |(number, kind): (usize, AgentKind)| AgentFacts {
        name: format!("{}{number}", kind.letter()),
        kind: kind_name(kind),
    };
    city.agents.iter().map(|agent| agent.kind).enumerate().map(agent).collect()
}

/// What does not change about the buildings.
pub fn building_facts(city: City<'_>) -> Vec<BuildingFacts> {
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
pub fn state(city: City<'_>, allocation: &[u8]) -> State {
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
