//! Teams that can be measured.

use sortie_core::entity_mask::EntityMask;
use sortie_core::policy::{DecideError, NO_ACTION as NO_ACTION_YET, Observation, Policy, visible};
use sortie_envs::save_the_city::{
    ACTIONS, City, FEATURES, UNASSIGNED, scripted_actions, write_agent_row, write_building_row,
};
use sortie_nn::random::Generator;

use super::players::{Agents, Players};
use super::{Scene, Team};
use crate::alma::records::{Conditioning, NO_ACTION, UtilityNetwork, best_action};
use crate::alma::windows::low_level::coach::Advice;
use sortie_learn::LearnError;
use sortie_learn::random::{Purpose, generator};

/// Agents that learn or have learned, greedy, on all scenes at once.
#[derive(Debug)]
pub struct NetworkTeam<'a> {
    agents: Agents<'a>,
    players: Players,
    advice: Option<Advice<'a>>,
}

impl<'a> NetworkTeam<'a> {
    /// Acts by a network that sees its subtask only.
    pub fn new(network: &'a UtilityNetwork) -> Self {
        Self::conditioned(Agents::new(network), Conditioning::Mask)
    }

    /// Acts by agents that see subtasks as they were trained to, and are told their strategies if they have a coach.
    pub fn conditioned(agents: Agents<'a>, conditioning: Conditioning) -> Self {
        let players = Players::new(conditioning, agents.network.shape());
        Self { agents, players, advice: agents.coach.map(Advice::new) }
    }
}

impl Team for NetworkTeam<'_> {
    fn act(
        &mut self,
        scenes: &[Scene<'_>],
        actions: &mut [u16],
        agents: usize,
    ) -> Result<(), LearnError> {
        self.players.act(self.agents, scenes, agents, |scene, agent, utilities| {
            let available = scenes[scene].city.agents[agent].available;
            actions[scene * agents + agent] = best_action(utilities, available).into();
        })
    }

    fn advise(&mut self, city: City<'_>, strategies: &mut Vec<f32>) -> Result<(), LearnError> {
        self.advice.as_mut().map_or(Ok(()), |advice| advice.mean(city, strategies))
    }
}

/// The scripted low level.
#[derive(Debug)]
pub struct ScriptedActors {
    generator: Generator,
}

impl ScriptedActors {
    /// A script that breaks ties by a seed.
    pub fn new(seed: u64) -> Self {
        Self { generator: generator(seed, Purpose::Evaluation, u64::MAX) }
    }
}

impl Team for ScriptedActors {
    fn act(
        &mut self,
        scenes: &[Scene<'_>],
        actions: &mut [u16],
        agents: usize,
    ) -> Result<(), LearnError> {
        for (scene, actions) in scenes.iter().zip(actions.chunks_exact_mut(agents)) {
            scripted_actions(scene.city, scene.allocation, &mut self.generator, actions);
        }
        Ok(())
    }
}

/// A deployed policy, agent by agent, on what each of them would see.
#[derive(Debug)]
pub struct PolicyTeam<P> {
    policy: P,
    rows: Vec<f32>,
    last_actions: Vec<u16>,
    entity_task: Vec<u32>,
}

impl<P: Policy> PolicyTeam<P> {
    /// Acts by a policy that was trained on SaveTheCity.
    pub fn new(policy: P) -> Self {
        Self { policy, rows: Vec::new(), last_actions: Vec::new(), entity_task: Vec::new() }
    }

    fn observe(&mut self, scene: &Scene<'_>) {
        let (agents, buildings) = (scene.city.agents, scene.city.buildings);
        self.rows.resize((agents.len() + buildings.len()) * FEATURES, 0.0);
        let mut rows = self.rows.chunks_exact_mut(FEATURES);
        for (agent, row) in agents.iter().zip(&mut rows) {
            write_agent_row(agent, row);
        }
        for (building, row) in buildings.iter().zip(&mut rows) {
            write_building_row(building, row);
        }
        let widen =
            |action: &u8| if *action == NO_ACTION { NO_ACTION_YET } else { (*action).into() };
        self.last_actions.clear();
        self.last_actions.extend(scene.last_actions[..agents.len()].iter().map(widen));
        let task_bit = |task: &u8| 1u32.checked_shl((*task).into()).unwrap_or(0);
        self.entity_task.clear();
        self.entity_task.extend(scene.allocation[..agents.len()].iter().map(task_bit));
        self.entity_task.extend((0..buildings.len()).map(|task| 1 << task));
    }
}

impl<P: Policy> Team for PolicyTeam<P> {
    fn act(
        &mut self,
        scenes: &[Scene<'_>],
        actions: &mut [u16],
        agents: usize,
    ) -> Result<(), LearnError> {
        for (scene, actions) in scenes.iter().zip(actions.chunks_exact_mut(agents)) {
            self.observe(scene);
            let everything = EntityMask::first(self.entity_task.len());
            let available: Vec<[u16; ACTIONS]> = scene
                .city
                .agents
                .iter()
                .map(|agent| std::array::from_fn(|action| agent.available >> action & 1))
                .collect();
            let see = |(index, available)| {
                let task = scene.allocation[index];
                let subtask = (task != UNASSIGNED).then_some(task);
                Observation {
                    rows: &self.rows,
                    stride: FEATURES,
                    last_actions: &self.last_actions,
                    visible: visible(everything, everything, &self.entity_task, subtask),
                    self_index: index,
                    available,
                }
            };
            let observations: Vec<Observation<'_>> =
                available.iter().map(<[u16; ACTIONS]>::as_slice).enumerate().map(see).collect();
            let mut decisions = vec![Err(DecideError::BadLength); observations.len()];
            self.policy.decide_batch(&observations, &mut decisions);
            for (action, decision) in actions.iter_mut().zip(decisions) {
                *action = decision.map_err(|e| LearnError::Team(e.to_string()))?.action;
            }
        }
        Ok(())
    }
}
