//! Replays recorded episodes and compares every field.

use serde_json::Value;

use super::super::error::CityError;
use super::super::rules::{ACTIONS, Bounce, Constants};
use super::super::scenarios::{BuildingPlan, Scenario, ScenarioSet};
use super::super::simulator::SaveTheCity;
use super::super::state::{
    AgentKind, AgentState, BuildingKind, BuildingState, MAX_AGENTS, MAX_BUILDINGS, Status,
};
use super::SCHEMA;
use super::events::Events;
use super::frames;
use crate::environment::{Step, StepError};
use crate::recorded::Field;
use crate::recorded::GoldenError;
use crate::recorded::{Comparison, Replay};

/// Replays an episode given as text; `file` names it in the mismatches.
///
/// An action that is not available ends the replay and counts as a mismatch.
pub fn replay(file: &str, text: &str) -> Result<Replay, GoldenError> {
    let value = serde_json::from_str(text).map_err(GoldenError::Json)?;
    let root = Field::root(&value);
    if root.get("schema")?.text()? != SCHEMA {
        return Err(root.get("schema")?.refuse(format!("is not `{SCHEMA}`")));
    }
    for name in ["name", "scenario_set", "policy"] {
        root.get(name)?.text()?;
    }
    root.get("seed")?.integer(0..=u64::MAX)?;
    let length = root.get("length")?.integer(0..=1_000_000)? as usize;
    let steps = root.get("steps")?.exactly(length)?;
    let states = root.get("frames")?.exactly(length + 1)?;
    let mut environment = restore(&root)?;
    let moves = steps
        .iter()
        .map(|step| read_moves(step, environment.city(0).agents.len()))
        .collect::<Result<Vec<_>, _>>()?;

    let mut comparison = Comparison::new(file);
    comparison.compare(&root.get("static_masks")?, &frames::static_masks(&environment, 0))?;
    compare_frame(&mut comparison, &states[0], &environment, length)?;
    let mut events = Events::default();
    let mut replayed = 0;
    for (step, moves) in steps.iter().zip(&moves) {
        comparison.step = replayed;
        events.before_step(environment.city(0));
        if !play(&mut comparison, step, moves, &mut environment)? {
            return Ok(comparison.finish(replayed));
        }
        events.after_step(&environment, 0, &moves.actions);
        replayed += 1;
        comparison.step = replayed;
        compare_frame(&mut comparison, &states[replayed], &environment, length)?;
    }
    comparison.compare_whole(&root.get("events")?, &events.finish(&environment, 0));
    Ok(comparison.finish(replayed))
}

/// What a step is given: actions and collision losers.
pub(super) struct Moves {
    pub(super) actions: Vec<u16>,
    bounces: Vec<Bounce>,
}

impl Moves {
    /// Takes the step that was recorded.
    pub(super) fn play(&self, environment: &mut SaveTheCity) -> Result<Step, StepError> {
        let mut losers = self.bounces.iter().peekable();
        environment.step_with_losers(0, &self.actions, |first, second| {
            let known = |bounce: &&Bounce| {
                (usize::from(bounce.first), usize::from(bounce.second)) == (first, second)
            };
            losers.next_if(known).map_or(first, |bounce| bounce.loser.into())
        })
    }
}

pub(super) fn read_moves(step: &Field<'_>, agents: usize) -> Result<Moves, GoldenError> {
    let mut actions = Vec::new();
    for action in step.get("actions")?.exactly(agents)? {
        actions.push(action.integer(0..=ACTIONS as u64 - 1)? as u16);
    }
    let mut bounces = Vec::new();
    for bounce in step.get("bounces")?.items()? {
        let mut who = [0; 3];
        for (who, field) in who.iter_mut().zip(bounce.exactly(3)?) {
            *who = field.integer(0..=agents as u64 - 1)? as u8;
        }
        let [first, second, loser] = who;
        if first >= second || (loser != first && loser != second) {
            return Err(bounce.refuse("is not a pair in rising order and one of the two"));
        }
        bounces.push(Bounce { first, second, loser });
    }
    Ok(Moves { actions, bounces })
}

/// Sets up the city that the file describes, in its first state.
pub(super) fn restore(root: &Field<'_>) -> Result<SaveTheCity, GoldenError> {
    let config = root.get("config")?;
    let size = |name: &str, most: usize| -> Result<usize, GoldenError> {
        Ok(config.get(name)?.integer(1..=most as u64)? as usize)
    };
    let (max_agents, max_buildings) =
        (size("max_n_agents", MAX_AGENTS)?, size("max_n_buildings", MAX_BUILDINGS)?);
    let spacing = config.get("bld_spacing")?.integer(3..=u8::MAX.into())? as u8;
    let initial = root.get("initial")?;
    let agents =
        initial.get("agents")?.items()?.iter().map(read_agent).collect::<Result<Vec<_>, _>>()?;
    let buildings = initial.get("buildings")?;
    let buildings = buildings.items()?.iter().map(read_building).collect::<Result<Vec<_>, _>>()?;

    let scenario = Scenario {
        team: agents.iter().map(|agent| agent.kind).collect(),
        buildings: BuildingPlan::Kinds(buildings.iter().map(|building| building.kind).collect()),
    };
    let set = ScenarioSet {
        name: root.get("scenario_set")?.text()?.into(),
        max_agents,
        max_buildings,
        spacing,
        train: vec![scenario.clone()],
        test: vec![scenario],
    };
    let refuse = |error: CityError| initial.refuse(format!("cannot be used: {error}"));
    let mut environment = SaveTheCity::new(set, read_constants(&config)?, 1, 0).map_err(refuse)?;
    environment.restore(0, &agents, &buildings, 0).map_err(refuse)?;
    Ok(environment)
}

fn read_constants(config: &Field<'_>) -> Result<Constants, GoldenError> {
    let game = |name: &str| config.get("game_config")?.get(name)?.number();
    let reward = |name: &str| config.get("reward_config")?.get(name)?.number();
    Ok(Constants {
        init_fire_chance: game("init_fire_chance")?,
        fire_burn_rate: game("fire_burn_rate")?,
        fire_reduce_rate: game("fire_reduce_rate")?,
        fire_growth_rate: game("fire_growth_rate")?,
        base_build_rate: game("base_build_rate")?,
        generalist_help_factor: game("generalist_help_factor")?,
        episode_limit: config.get("episode_limit")?.integer(1..=u32::MAX.into())? as u32,
        end_on_any_burn: config.get("end_on_any_burn")?.flag()?,
        reward_scale: config.get("reward_scale")?.number()?,
        health_delta_mult: reward("health_delta_mult")?,
        complete: reward("complete")?,
        burned_down: reward("burned_down")?,
        extinguish: reward("extinguish")?,
        solved: reward("solved")?,
        ts_pen: reward("ts_pen")?,
    })
}

fn read_place(object: &Field<'_>) -> Result<(u8, u8), GoldenError> {
    let coordinate = |name: &str| Ok(object.get(name)?.integer(0..=15)? as u8);
    Ok((coordinate("x")?, coordinate("y")?))
}

fn read_agent(agent: &Field<'_>) -> Result<AgentState, GoldenError> {
    let (x, y) = read_place(agent)?;
    Ok(AgentState::at(agent.get("type")?.letter(AgentKind::from_letter)?, x, y))
}

fn read_building(building: &Field<'_>) -> Result<BuildingState, GoldenError> {
    let (x, y) = read_place(building)?;
    let steps = |name: &str| Ok(building.get(name)?.integer(0..=u16::MAX.into())? as u16);
    let health = building.get("health")?.number()?;
    Ok(BuildingState {
        health,
        fire: building.get("fire")?.number()?,
        period: steps("rate")?,
        to_next_fire: steps("ttnf")?,
        since_last_fire: steps("tslf")?,
        kind: building.get("type")?.letter(BuildingKind::from_letter)?,
        status: Status::of_health(health),
        x,
        y,
    })
}

/// Plays one step and compares what it says; false where it cannot be played.
fn play(
    comparison: &mut Comparison<'_>,
    step: &Field<'_>,
    moves: &Moves,
    environment: &mut SaveTheCity,
) -> Result<bool, GoldenError> {
    let outcome = match moves.play(environment) {
        Ok(outcome) => outcome,
        Err(error) => {
            let actions = step.get("actions")?;
            match error {
                StepError::Unavailable { agent, .. } => {
                    let action = &actions.items()?[agent];
                    comparison.note(action.path(), action.value(), &error.to_string().into());
                }
                _ => comparison.note(actions.path(), actions.value(), &error.to_string().into()),
            }
            return Ok(false);
        }
    };
    comparison.compare(step, &frames::step(environment, 0, &moves.actions, &outcome))?;
    if let (Some(info), false) = (step.find("info")?, outcome.done()) {
        comparison.note(info.path(), info.value(), &Value::Null);
    }
    Ok(true)
}

/// Compares the state before the current step.
fn compare_frame(
    comparison: &mut Comparison<'_>,
    state: &Field<'_>,
    environment: &SaveTheCity,
    length: usize,
) -> Result<(), GoldenError> {
    let due = super::record::has_features(comparison.step, comparison.step == length);
    let features = due || state.find("feat")?.is_some();
    comparison.compare(state, &frames::frame(environment, 0, features))
}
