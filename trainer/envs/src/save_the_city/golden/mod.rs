//! Recorded episodes, schema `sortie-golden/save-the-city/1`: written, read, and replayed exactly.
//!
//! A file holds the constants, the first state, the actions and the collision losers, which
//! determine an episode, and beside them everything that follows, which a replay compares bit for
//! bit. Masks in the files are inverted: 1 means masked, absent or closed.

mod frames;

use std::any::Any;
use std::fmt::Write;

use serde_json::{Value, json};

use super::rules::{ACTIONS, Bounce, Constants};
use super::scenarios::{BuildingPlan, CityError, Scenario, ScenarioSet};
use super::simulator::SaveTheCity;
use super::state::{
    AgentKind, AgentState, BuildingKind, BuildingState, MAX_AGENTS, MAX_BUILDINGS, Status,
};
use crate::environment::{Environment, Step, StepError};
use crate::recorded::{Comparison, Field, GoldenError, Record, Recordings, Replay};
use frames::Events;

pub use crate::recorded::Labels;

/// The schema that files must name.
pub const SCHEMA: &str = "sortie-golden/save-the-city/1";

/// How they are found.
pub(super) const RECORDINGS: Recordings =
    Recordings { schema: SCHEMA, replay, record: Some(start) };

/// Records one episode of one instance.
///
/// Start it right after a reset, tell it every step, and take the text when the episode is done and
/// the instance not yet reset.
pub struct Recorder {
    labels: Labels,
    instance: usize,
    config: Value,
    initial: Value,
    static_masks: Value,
    scenario_set: String,
    frames: Vec<Value>,
    steps: Vec<Value>,
    events: Events,
}

impl Recorder {
    /// Starts with the first state of an episode.
    pub fn new(environment: &SaveTheCity, instance: usize, labels: Labels) -> Self {
        let city = environment.city(instance);
        let mut events = Events::default();
        events.before_step(city);
        Self {
            labels,
            instance,
            config: frames::config(environment),
            initial: frames::initial(city),
            static_masks: frames::static_masks(environment, instance),
            scenario_set: environment.scenario_set().name.clone(),
            frames: vec![frames::frame(environment, instance, true)],
            steps: Vec::new(),
            events,
        }
    }

    /// Adds the step that was just taken.
    pub fn record(&mut self, environment: &SaveTheCity, actions: &[u16], outcome: &Step) {
        let instance = self.instance;
        self.steps.push(frames::step(environment, instance, actions, outcome));
        let features = has_features(self.steps.len(), outcome.done());
        self.frames.push(frames::frame(environment, instance, features));
        self.events.after_step(environment, instance, actions);
        self.events.before_step(environment.city(instance));
    }

    /// The episode as text, a line per state and step.
    pub fn finish(mut self, environment: &SaveTheCity) -> String {
        let mut text = String::from("{\n");
        for (name, value) in [
            ("schema", json!(SCHEMA)),
            ("name", json!(self.labels.name)),
            ("seed", json!(self.labels.seed)),
            ("scenario_set", json!(self.scenario_set)),
            ("policy", json!(self.labels.policy)),
            ("config", self.config),
            ("initial", self.initial),
            ("static_masks", self.static_masks),
            ("length", json!(self.steps.len())),
            ("events", self.events.finish(environment, self.instance)),
        ] {
            line(&mut text, format_args!("\"{name}\":{value},"));
        }
        list(&mut text, "frames", &self.frames, ",");
        list(&mut text, "steps", &self.steps, "");
        text.push_str("}\n");
        text
    }
}

/// Starts to record the episode of an instance.
fn start(
    environment: &dyn Environment,
    instance: usize,
    labels: Labels,
) -> Option<Box<dyn Record>> {
    let recorder = Recorder::new(city(environment)?, instance, labels);
    Some(Box::new(recorder))
}

fn city(environment: &dyn Environment) -> Option<&SaveTheCity> {
    let environment: &dyn Any = environment;
    environment.downcast_ref()
}

impl Record for Recorder {
    fn step(&mut self, environment: &dyn Environment, actions: &[u16], step: &Step) {
        if let Some(city) = city(environment) {
            self.record(city, &actions[..city.agent_count(self.instance)], step);
        }
    }

    fn finish(self: Box<Self>, environment: &dyn Environment) -> String {
        city(environment).map_or_else(String::new, |city| Recorder::finish(*self, city))
    }
}

/// Features are written for the first state, every tenth and the last.
fn has_features(state: usize, last: bool) -> bool {
    state.is_multiple_of(10) || last
}

fn list(text: &mut String, name: &str, values: &[Value], end: &str) {
    line(text, format_args!("\"{name}\":["));
    for (index, value) in values.iter().enumerate() {
        let comma = if index + 1 < values.len() { "," } else { "" };
        line(text, format_args!("{value}{comma}"));
    }
    line(text, format_args!("]{end}"));
}

fn line(text: &mut String, content: std::fmt::Arguments<'_>) {
    writeln!(text, "{content}").expect("writing to a text in memory cannot fail");
}

/// Replays an episode given as text; `file` names it in the mismatches.
///
/// An action that is not available ends the replay and counts as a mismatch.
pub fn replay(file: &str, text: &str) -> Result<Replay, GoldenError> {
    let value = serde_json::from_str(text).map_err(GoldenError::Json)?;
    let root = Field::root(&value);
    let length = root.episode_length(SCHEMA, &["name", "scenario_set", "policy"])?;
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
struct Moves {
    actions: Vec<u16>,
    bounces: Vec<Bounce>,
}

impl Moves {
    /// Takes the step that was recorded.
    fn play(&self, environment: &mut SaveTheCity) -> Result<Step, StepError> {
        let mut losers = self.bounces.iter().peekable();
        environment.step_with_losers(0, &self.actions, |first, second| {
            let known = |bounce: &&Bounce| {
                (usize::from(bounce.first), usize::from(bounce.second)) == (first, second)
            };
            losers.next_if(known).map_or(first, |bounce| bounce.loser.into())
        })
    }
}

fn read_moves(step: &Field<'_>, agents: usize) -> Result<Moves, GoldenError> {
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
fn restore(root: &Field<'_>) -> Result<SaveTheCity, GoldenError> {
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
    let due = has_features(comparison.step, comparison.step == length);
    let features = due || state.find("feat")?.is_some();
    comparison.compare(state, &frames::frame(environment, 0, features))
}

/// A recorded episode in a world of its own.
///
/// Nothing but the actions and the collision losers is taken from the file; [`replay`] says
/// whether the rest agrees.
pub struct Playback {
    labels: Labels,
    world: SaveTheCity,
    moves: Vec<Moves>,
    played: usize,
}

impl Playback {
    /// Reads an episode given as text and sets up its first state.
    pub fn new(text: &str) -> Result<Self, GoldenError> {
        let value = serde_json::from_str(text).map_err(GoldenError::Json)?;
        let root = Field::root(&value);
        let labels = Labels {
            name: root.get("name")?.text()?.into(),
            policy: root.get("policy")?.text()?.into(),
            seed: root.get("seed")?.integer(0..=u64::MAX)?,
        };
        let world = restore(&root)?;
        let agents = world.city(0).agents.len();
        let steps = root.get("steps")?.items()?;
        let moves = steps.iter().map(|step| read_moves(step, agents)).collect::<Result<_, _>>()?;
        Ok(Self { labels, world, moves, played: 0 })
    }

    /// What the episode is called.
    pub fn labels(&self) -> &Labels {
        &self.labels
    }

    /// The world in its current state, as instance 0.
    pub fn world(&self) -> &SaveTheCity {
        &self.world
    }

    /// The actions that the next step takes; `None` at the end.
    pub fn next_actions(&self) -> Option<&[u16]> {
        self.moves.get(self.played).map(|moves| moves.actions.as_slice())
    }

    /// Takes the next step; `None` at the end.
    pub fn step(&mut self) -> Result<Option<Step>, StepError> {
        let Some(moves) = self.moves.get(self.played) else { return Ok(None) };
        let outcome = moves.play(&mut self.world)?;
        self.played += 1;
        Ok(Some(outcome))
    }
}
