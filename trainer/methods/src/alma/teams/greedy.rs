//! Teams that can be measured.

use sortie_core::entity_mask::EntityMask;
use sortie_core::policy::{DecideError, NO_ACTION as NO_ACTION_YET, Observation, Policy, visible};
use sortie_envs::{ActionSet, Observation as Seen, UNASSIGNED, members};
use sortie_nn::random::Generator;

use super::{Scene, Team};

use super::players::{Agents, Players};

use crate::alma::agents::{Conditioning, NO_ACTION, UtilityNetwork, best_action};
use crate::alma::coach::Advice;
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
            let available = scenes[scene].seen.available[agent];
            actions[scene * agents + agent] = best_action(utilities, available).into();
        })
    }

    fn advise(&mut self, seen: &Seen, strategies: &mut Vec<f32>) -> Result<(), LearnError> {
        self.advice.as_mut().map_or(Ok(()), |advice| advice.mean(seen, strategies))
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
            let Scene { environment, state, allocation, .. } = *scene;
            if !environment.scripted(state, allocation, &mut self.generator, actions) {
                let name = environment.spec().name;
                return Err(LearnError::Team(format!("`{name}` has no scripted agents")));
            }
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
    /// Acts by a policy under the subtask mask.
    pub fn new(policy: P) -> Self {
        Self { policy, rows: Vec::new(), last_actions: Vec::new(), entity_task: Vec::new() }
    }

    fn observe(&mut self, scene: &Scene<'_>, features: usize) {
        let (seen, agents) = (scene.seen, scene.seen.agents());
        seen.rows.write_all(features, &mut self.rows);
        let widen =
            |action: &u8| if *action == NO_ACTION { NO_ACTION_YET } else { (*action).into() };
        self.last_actions.clear();
        self.last_actions.extend(scene.last_actions[..agents].iter().map(widen));
        let task_bit = |task: &u8| 1u32.checked_shl((*task).into()).unwrap_or(0);
        self.entity_task.clear();
        self.entity_task.extend(scene.allocation[..agents].iter().map(task_bit));
        let things = members(seen.present).skip(agents);
        self.entity_task.extend(things.map(|entity| seen.entity_task[entity]));
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
            let shape = scene.environment.spec().shape;
            self.observe(scene, shape.features);
            let everything = EntityMask::first(self.entity_task.len());
            let codes = |set: &ActionSet| {
                (0..shape.actions).map(|action| (set >> action & 1) as u16).collect()
            };
            let present = &scene.seen.available[..scene.seen.agents()];
            let available: Vec<Vec<u16>> = present.iter().map(codes).collect();
            let see = |(index, available)| {
                let task = scene.allocation[index];
                let subtask = (task != UNASSIGNED).then_some(task);
                Observation {
                    rows: &self.rows,
                    stride: shape.features,
                    last_actions: &self.last_actions,
                    visible: visible(everything, everything, &self.entity_task, subtask),
                    self_index: index,
                    available,
                }
            };
            let observations: Vec<Observation<'_>> =
                available.iter().map(Vec::as_slice).enumerate().map(see).collect();
            let mut decisions = vec![Err(DecideError::BadLength); observations.len()];
            self.policy.decide_batch(&observations, &mut decisions);
            for (action, decision) in actions.iter_mut().zip(decisions) {
                *action = decision.map_err(|e| LearnError::Team(e.to_string()))?.action;
            }
        }
        Ok(())
    }
}
