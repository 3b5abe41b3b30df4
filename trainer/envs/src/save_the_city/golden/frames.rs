//! What a recorded episode says of each state and step, as JSON, and what made it interesting.

use std::collections::BTreeMap;

use crc::{CRC_32_ISO_HDLC, Crc};
use serde_json::{Map, Value, json};

use crate::decisions::UNASSIGNED;
use crate::environment::{Environment, Step};
use crate::observation::{EntitySet, Observation, members};
use crate::save_the_city::episode::EpisodeMetrics;
use crate::save_the_city::observation::FEATURES;
use crate::save_the_city::rules::{
    BUILD, Bounce, FIGHT, FREEZE, availability_code, availability_codes,
};
use crate::save_the_city::scripted::heuristic_allocation;
use crate::save_the_city::simulator::SaveTheCity;
use crate::save_the_city::state::{AgentKind, AgentState, BuildingState, City, MAX_AGENTS, Status};

const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// The three masks that stay the same for an episode.
pub(super) fn static_masks(environment: &SaveTheCity, instance: usize) -> Value {
    let shape = environment.shape();
    let seen = observed(environment, instance);
    let present = |entity: usize| seen.present >> entity & 1 == 1;
    let is_agent = |entity: usize| entity < shape.agents;
    // Buildings look at buildings; agents look where they can.
    let sees = |from: usize, to: usize| {
        if is_agent(from) {
            seen.observable[from] >> to & 1 == 1
        } else {
            present(from) && present(to) && !is_agent(to)
        }
    };
    let masked = |holds: bool| u8::from(!holds);
    let entities = || 0..shape.entities;
    let tasks_of = |entity: usize| seen.entity_task[entity];
    json!({
        "obs_mask": entities()
            .map(|from| entities().map(|to| masked(sees(from, to))).collect())
            .collect::<Vec<Vec<u8>>>(),
        "entity_mask": entities().map(|entity| masked(present(entity))).collect::<Vec<_>>(),
        "entity2task_mask": entities()
            .map(|entity| {
                (0..shape.tasks).map(|task| masked(tasks_of(entity) >> task & 1 == 1)).collect()
            })
            .collect::<Vec<Vec<u8>>>(),
    })
}

/// One state; with `features` also its rows, column by column.
pub(super) fn frame(environment: &SaveTheCity, instance: usize, features: bool) -> Value {
    let city = environment.city(instance);
    let seen = observed(environment, instance);
    let mut places = Vec::new();
    for agent in city.agents {
        places.extend([agent.x, agent.y]);
    }
    let buildings = || city.buildings.iter();
    let mut frame = json!({
        "agents": places,
        "health": buildings().map(|building| building.health).collect::<Vec<_>>(),
        "fire": buildings().map(|building| building.fire).collect::<Vec<_>>(),
        "ttnf": buildings().map(|building| building.to_next_fire).collect::<Vec<_>>(),
        "tslf": buildings().map(|building| building.since_last_fire).collect::<Vec<_>>(),
        "status": buildings().map(|building| building.status as u8).collect::<Vec<_>>(),
        "avail": city.agents.iter().map(availability_codes).collect::<Vec<_>>(),
        "task_mask": task_mask(environment, instance),
        "heur": heuristic(city),
        "feat_crc": feature_checksum(&seen),
    });
    if features {
        frame["feat"] = sparse_features(&seen);
    }
    frame
}

/// One step that was just taken.
pub(super) fn step(
    environment: &SaveTheCity,
    instance: usize,
    actions: &[u16],
    outcome: &Step,
) -> Value {
    let bounces = environment.bounces(instance);
    let mut step = json!({
        "actions": &actions[..environment.agent_count(instance)],
        "bounces": bounces.iter().map(|&Bounce { first, second, loser }| [first, second, loser])
            .collect::<Vec<_>>(),
        "reward": outcome.reward,
        "task_rewards": environment.task_rewards(instance),
        "tasks_terminated": task_mask(environment, instance),
        "tasks_changed": outcome.tasks_changed,
        "done": outcome.done(),
    });
    if outcome.done() {
        step["info"] = info(environment.metrics(instance));
    }
    step
}

fn info(metrics: &EpisodeMetrics) -> Value {
    let mut info = json!({
        "solved": u8::from(metrics.solved),
        "prop_buildings_completed": metrics.proportion_completed(),
        "fires_extinguished": metrics.fires_extinguished,
        "buildings_completed": metrics.buildings_completed,
        "buildings_burned": metrics.buildings_burned,
        "buildings_health_delta": metrics.health_delta,
    });
    if metrics.timed_out {
        info["episode_limit"] = true.into();
    }
    if let Some(mean) = metrics.types_per_firefight() {
        info["types_per_firefight"] = mean.into();
    }
    if let Some(mean) = metrics.types_per_build() {
        info["types_per_build"] = mean.into();
    }
    info
}

fn task_mask(environment: &SaveTheCity, instance: usize) -> Vec<u8> {
    let open = environment.open_tasks(instance);
    (0..environment.shape().tasks).map(|task| u8::from(open >> task & 1 == 0)).collect()
}

fn heuristic(city: City<'_>) -> Vec<i32> {
    let mut allocation = [UNASSIGNED; MAX_AGENTS];
    heuristic_allocation(city, &mut allocation);
    let task = |&task: &u8| if task == UNASSIGNED { -1 } else { i32::from(task) };
    allocation[..city.agents.len()].iter().map(task).collect()
}

/// All that there is to see.
fn observed(environment: &SaveTheCity, instance: usize) -> Observation {
    let (mut state, mut seen) = (Vec::new(), Observation::default());
    environment.save(instance, &mut state);
    environment.observe(&state, 0, EntitySet::MAX, &mut seen);
    seen
}

/// Of all rows, those of absent entities as zeros.
fn feature_checksum(seen: &Observation) -> u32 {
    let mut digest = CRC.digest();
    let mut row = [0.0_f32; FEATURES];
    for entity in 0..seen.entity_task.len() {
        row.fill(0.0);
        if seen.entities >> entity & 1 == 1 {
            seen.rows.write_dense(seen.row_of(entity), &mut row);
        }
        row.iter().for_each(|value| digest.update(&value.to_le_bytes()));
    }
    digest.finalize()
}

fn sparse_features(seen: &Observation) -> Value {
    let row = |(row, entity)| {
        let entries = seen.rows.row(row).filter(|(_, value)| *value != 0.0);
        let (columns, values): (Vec<_>, Vec<_>) = entries.unzip();
        json!([entity, columns, values.iter().map(decimal).collect::<Vec<_>>()])
    };
    members(seen.entities).enumerate().map(row).collect()
}

/// The f64 with the shortest decimals of an f32, which is how the files give features.
fn decimal(value: &f32) -> f64 {
    value.to_string().parse().unwrap_or(f64::from(*value))
}

/// The constants and sizes of the environment.
pub(super) fn config(environment: &SaveTheCity) -> Value {
    let (set, constants) = (environment.scenario_set(), environment.constants());
    json!({
        "max_n_agents": set.max_agents,
        "max_n_buildings": set.max_buildings,
        "bld_spacing": set.spacing,
        "episode_limit": constants.episode_limit,
        "end_on_any_burn": constants.end_on_any_burn,
        "reward_scale": constants.reward_scale,
        "game_config": {
            "init_fire_chance": constants.init_fire_chance,
            "fire_burn_rate": constants.fire_burn_rate,
            "fire_reduce_rate": constants.fire_reduce_rate,
            "fire_growth_rate": constants.fire_growth_rate,
            "base_build_rate": constants.base_build_rate,
            "generalist_help_factor": constants.generalist_help_factor,
        },
        "reward_config": {
            "health_delta_mult": constants.health_delta_mult,
            "complete": constants.complete,
            "burned_down": constants.burned_down,
            "extinguish": constants.extinguish,
            "solved": constants.solved,
            "ts_pen": constants.ts_pen,
        },
    })
}

/// The first state.
pub(super) fn initial(city: City<'_>) -> Value {
    let agents = city.agents.iter().map(
        |agent| json!({ "type": agent.kind.letter().to_string(), "x": agent.x, "y": agent.y }),
    );
    let buildings = city.buildings.iter().map(|building| {
        json!({
            "type": building.kind.letter().to_string(),
            "x": building.x,
            "y": building.y,
            "health": building.health,
            "fire": building.fire,
            "rate": building.period,
            "ttnf": building.to_next_fire,
            "tslf": building.since_last_fire,
        })
    });
    let mut initial = Map::new();
    initial.insert("agents".into(), agents.collect());
    initial.insert("buildings".into(), buildings.collect());
    initial.into()
}

/// The counts of one episode; what never happened is left out.
#[derive(Default)]
pub(super) struct Events {
    counts: BTreeMap<&'static str, u32>,
    agents: Vec<AgentState>,
    buildings: Vec<BuildingState>,
}

/// The kinds that took one action at one building.
struct Kinds([bool; 3]);

impl Kinds {
    fn has(&self, kind: AgentKind) -> bool {
        self.0[kind as usize]
    }

    fn any(&self) -> bool {
        self.0.contains(&true)
    }
}

impl Events {
    /// Remembers the state that the next step starts from.
    pub(super) fn before_step(&mut self, city: City<'_>) {
        self.agents = city.agents.to_vec();
        self.buildings = city.buildings.to_vec();
    }

    /// Counts the step that was just taken.
    pub(super) fn after_step(
        &mut self,
        environment: &SaveTheCity,
        instance: usize,
        actions: &[u16],
    ) {
        let bounces = environment.bounces(instance).len();
        self.add("bounces", bounces);
        self.add("multi_bounce", usize::from(bounces >= 2));
        self.count_actions(actions);
        let after = environment.city(instance);
        for (index, building) in after.buildings.iter().enumerate() {
            self.count_team_work(index, actions);
            self.count_changes(self.buildings[index], building);
        }
    }

    /// Adds what the whole episode came to and gives all counts.
    pub(super) fn finish(&mut self, environment: &SaveTheCity, instance: usize) -> Value {
        let metrics = environment.metrics(instance);
        let limit = environment.constants().episode_limit;
        self.add("limit_reached", usize::from(metrics.steps >= limit));
        self.add("timeout", usize::from(metrics.timed_out));
        self.add("solved", usize::from(metrics.solved));
        json!(self.counts)
    }

    fn add(&mut self, name: &'static str, count: usize) {
        if count > 0 {
            *self.counts.entry(name).or_default() += count as u32;
        }
    }

    fn count_actions(&mut self, actions: &[u16]) {
        let kinds = self.agents.iter().map(|agent| agent.kind);
        for name in kinds.zip(actions).filter_map(|(kind, &action)| name_of(kind, action)) {
            *self.counts.entry(name).or_default() += 1;
        }
    }

    /// The kinds that took `action` at a building.
    fn kinds(&self, action: u16, building: usize, actions: &[u16]) -> Kinds {
        let mut kinds = [false; 3];
        for (agent, &taken) in self.agents.iter().zip(actions) {
            let code = usize::from(availability_code(agent, taken.into()));
            kinds[agent.kind as usize] |= taken == action && code == building + 2;
        }
        Kinds(kinds)
    }

    fn count_team_work(&mut self, building: usize, actions: &[u16]) {
        use AgentKind::{Builder, Firefighter, Generalist};
        let fire = self.kinds(FIGHT, building, actions);
        let build = self.kinds(BUILD, building, actions);
        let frozen = self.kinds(FREEZE, building, actions).any();
        let alone = fire.has(Generalist) && !fire.has(Builder) && !fire.has(Firefighter);
        for (name, happened) in [
            ("frozen_steps", frozen),
            ("freeze_and_fire_same_step", frozen && fire.any()),
            ("help_fire", fire.has(Builder) && fire.has(Generalist)),
            ("help_build", build.has(Firefighter) && build.has(Generalist)),
            ("fire_by_G_alone", alone),
        ] {
            self.add(name, happened.into());
        }
    }

    fn count_changes(&mut self, before: BuildingState, after: &BuildingState) {
        if !before.is_open() {
            return;
        }
        let ignited = after.is_open() && after.since_last_fire == 0;
        for (name, happened) in [
            ("ignitions", ignited && !before.is_burning()),
            ("reignite_while_burning", ignited && before.is_burning()),
            (
                "extinguished",
                before.is_burning() && !after.is_burning() && after.status != Status::BurnedDown,
            ),
            ("completed", after.status == Status::Complete),
            ("burned", after.status == Status::BurnedDown),
        ] {
            self.add(name, happened.into());
        }
    }
}

/// The count that an action of an agent belongs to.
fn name_of(kind: AgentKind, action: u16) -> Option<&'static str> {
    Some(match (action, kind) {
        (5..FIGHT, _) => "move2",
        (FIGHT, AgentKind::Firefighter) => "fire_by_F",
        (FIGHT, AgentKind::Builder) => "fire_by_B",
        (FIGHT, AgentKind::Generalist) => "fire_by_G",
        (BUILD, AgentKind::Firefighter) => "build_by_F",
        (BUILD, AgentKind::Builder) => "build_by_B",
        (BUILD, AgentKind::Generalist) => "build_by_G",
        (FREEZE, _) => "freeze",
        _ => return None,
    })
}
