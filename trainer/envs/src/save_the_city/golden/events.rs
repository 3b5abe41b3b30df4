//! Counts of what makes an episode interesting, for choosing among recorded files.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use super::super::rules::{BUILD, FIGHT, FREEZE, availability_code};
use super::super::simulator::SaveTheCity;
use super::super::state::{AgentKind, AgentState, BuildingState, City, Status};

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
