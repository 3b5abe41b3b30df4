//! What pages show of a city in which a team plays.

use alloc::string::{String, ToString};
use alloc::vec::Vec;
use core::any::Any;

use serde::Serialize;
use sortie_core::World;
use sortie_envs::save_the_city::{
    ACTION_NAMES, CityError, ENTRY, MAX_AGENTS, SIDE, SaveTheCity, with_city,
};
use sortie_envs::{Entry, Environment, Episode, UNASSIGNED};

use super::data::{AgentFacts, BuildingFacts, Event, State, Step, TeamValues};
use super::events::Names;
use super::facts::{agent_facts, building_facts, state, step};
use super::values::candidates;
use crate::error::StageError;
use crate::show::{Glance, Show, Shown};
use crate::stage::Stage;

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
    let teams = candidates(allocation.len(), stage.team_max(), chosen);
    let known = stage.team_values(building, &teams)?;
    Ok(known.map(|known| TeamValues::of(&teams, &known, chosen)))
}
