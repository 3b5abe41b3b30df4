//! Agents that act: greedy, or with chance, and as they are deployed.

use std::collections::BTreeMap;

use sortie_core::choose::masked_argmax;
use sortie_core::{DecideError, Decision, Policy};
use sortie_envs::random::{chance, member};
use sortie_envs::{ActionSet, EntitySet, Observation, Random};
use sortie_learn::export::{
    AttentionNetwork, DeployedAgents, DeployedNetworks, GruCell, Layer, Layout, Matrix,
};
use sortie_nn::layers::gru::lengths;

use super::agent::AgentPass;
use super::looking::views;
use super::scenes::Scenes;
use super::split_attention::HEADS;
use super::temporal_difference::{Network, best};

/// Buffers for the decisions of any number of teams at once, and what their agents remember.
#[derive(Clone, Debug, Default)]
pub struct Acting {
    scenes: Scenes,
    slots: usize,
    pass: AgentPass,
    /// Who acts, and whether its episode begins.
    instances: Vec<(usize, bool)>,
    /// `[teams, A, memory]`
    memory: Vec<f32>,
    /// Of every instance `[A, memory]`; empty where agents remember nothing.
    pub(super) memories: BTreeMap<usize, Vec<f32>>,
}

impl Acting {
    /// Forgets all teams, but not what they remember.
    pub fn clear(&mut self) {
        self.scenes.clear();
        self.instances.clear();
    }

    /// Adds the team of an instance.
    pub fn push(&mut self, instance: usize, begins: bool, seen: &Observation) {
        self.slots = seen.observable.len();
        self.instances.push((instance, begins));
        self.scenes.push(seen, |_| EntitySet::MAX);
    }

    /// Writes for every team the best actions of its agents.
    pub fn choose(&mut self, network: &Network, actions: &mut [u16]) {
        self.decide(network, actions, |_, best, _| best);
    }

    /// The same, each replaced by a random one with the chance and by the generator of its team.
    pub fn act<'a>(
        &mut self,
        network: &Network,
        teams: impl Iterator<Item = (f32, &'a mut Random)>,
        actions: &mut [u16],
    ) {
        let mut teams: Vec<_> = teams.collect();
        self.decide(network, actions, |team, best, available| {
            let (epsilon, random) = &mut teams[team];
            if chance(random, (*epsilon).into()) {
                member(random, available.into()).unwrap_or(best)
            } else {
                best
            }
        });
    }

    fn decide(
        &mut self,
        network: &Network,
        actions: &mut [u16],
        mut choose: impl FnMut(usize, usize, ActionSet) -> usize,
    ) {
        self.scenes.finish();
        let shape = network.shape.agent;
        self.recall(shape.memory);
        let memory = (shape.memory > 0).then_some(&mut *self.memory);
        let scenes = (&self.scenes, 1);
        let utilities = self.pass.forward_from(shape, network.agent(), scenes, memory);
        let mut agents = utilities.chunks_exact(shape.actions).zip(self.scenes.available());
        let teams = self.scenes.sizes().iter().zip(actions.chunks_exact_mut(self.slots.max(1)));
        for (team, (size, actions)) in teams.enumerate() {
            for (action, (utilities, available)) in
                actions.iter_mut().zip(agents.by_ref().take(*size))
            {
                *action = choose(team, best(utilities, *available), *available) as u16;
            }
        }
        self.keep(shape.memory);
    }

    /// What every team remembers: nothing where its episode begins.
    fn recall(&mut self, width: usize) {
        let team = self.slots * width;
        self.memory.clear();
        self.memory.resize(self.instances.len() * team, 0.0);
        for (place, (instance, begins)) in self.instances.iter().enumerate() {
            if let Some(memory) = self.memories.get(instance).filter(|_| !begins) {
                self.memory[place * team..][..team].copy_from_slice(memory);
            }
        }
    }

    /// Keeps what every team remembers now.
    fn keep(&mut self, width: usize) {
        let memories = self.memory.chunks_exact((self.slots * width).max(1));
        for ((instance, _), memory) in self.instances.iter().zip(memories) {
            self.memories.insert(*instance, memory.to_vec());
        }
    }
}

/// The agents of a network.
pub(super) fn deployed(network: &Network) -> DeployedAgents<'_> {
    let shape = network.shape.agent;
    let [fc1, fc1_bias, attention_in, out, out_bias, skip, fc2, fc2_bias, unit, head, head_bias] =
        shape.views(network.agent());
    let matrix = |values| Matrix { values, layout: Layout::OutputsFirst };
    let remembers = shape.memory > 0;
    let memory = remembers.then(|| {
        let [input, recurrent, input_bias, recurrent_bias] = views(unit, lengths(shape.memory));
        GruCell {
            input: Layer { weight: matrix(input), bias: input_bias },
            recurrent: Layer { weight: matrix(recurrent), bias: recurrent_bias },
        }
    });
    let layers = AttentionNetwork {
        inputs: shape.input,
        width: shape.width,
        heads: HEADS,
        base: shape.last(),
        outputs: shape.actions,
        fc1: Layer { weight: Matrix { values: fc1, layout: Layout::InputsFirst }, bias: fc1_bias },
        attention_in: matrix(attention_in),
        attention_out: Layer { weight: matrix(out), bias: out_bias },
        skip: shape.skip.then(|| matrix(skip)),
        fc2: remembers.then(|| Layer { weight: matrix(fc2), bias: fc2_bias }),
        head: Layer { weight: matrix(head), bias: head_bias },
        pointing: None,
    };
    DeployedAgents {
        networks: DeployedNetworks::Attention { network: layers, memory },
        policy: Box::new(NetworkPolicy::new(network)),
    }
}

/// Decides with the trainer's own forward pass: what golden observations expect of every engine.
struct NetworkPolicy<'a> {
    network: &'a Network,
    pass: AgentPass,
    scenes: Scenes,
    seen: Observation,
}

impl<'a> NetworkPolicy<'a> {
    fn new(network: &'a Network) -> Self {
        Self {
            network,
            pass: AgentPass::default(),
            scenes: Scenes::default(),
            seen: Observation { available: vec![0], ..Observation::default() },
        }
    }

    /// The agent becomes the first entity and the only agent, what it sees follows.
    fn look(&mut self, observation: &sortie_core::Observation<'_>) -> Result<(), DecideError> {
        let own = observation.self_index;
        let columns = self.network.shape.agent.input;
        let others = observation.visible.iter().filter(|entity| *entity != own);
        self.seen.rows.clear();
        let mut entities = 0;
        for entity in std::iter::once(own).chain(others) {
            let row = observation.rows.get(entity * observation.stride..);
            let row = row.and_then(|row| row.get(..columns)).ok_or(DecideError::BadLength)?;
            self.seen.rows.push_dense(row);
            entities += 1;
        }
        let all = EntitySet::MAX >> (EntitySet::BITS as usize - entities);
        (self.seen.present, self.seen.entities) = (all, all);
        self.seen.observable.clear();
        self.seen.observable.push(if observation.visible.contains(own) { all } else { all & !1 });
        self.scenes.clear();
        self.scenes.push(&self.seen, |_| EntitySet::MAX);
        self.scenes.finish();
        Ok(())
    }
}

impl Policy for NetworkPolicy<'_> {
    fn actions(&self) -> usize {
        self.network.shape.agent.actions
    }

    fn utilities(
        &mut self,
        observation: &sortie_core::Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        self.utilities_with(observation, &mut [], utilities)
    }

    fn decide(
        &mut self,
        observation: &sortie_core::Observation<'_>,
    ) -> Result<Decision, DecideError> {
        self.decide_with(observation, &mut [])
    }

    fn hidden(&self) -> usize {
        self.network.shape.agent.memory
    }

    fn utilities_with(
        &mut self,
        observation: &sortie_core::Observation<'_>,
        hidden: &mut [f32],
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        let shape = self.network.shape.agent;
        if hidden.len() != shape.memory {
            return Err(DecideError::HiddenState { want: shape.memory, got: hidden.len() });
        }
        self.look(observation)?;
        let memory = (shape.memory > 0).then_some(hidden);
        let scenes = (&self.scenes, 1);
        let computed = self.pass.forward_from(shape, self.network.agent(), scenes, memory);
        if computed.len() != utilities.len() {
            return Err(DecideError::BadLength);
        }
        utilities.copy_from_slice(computed);
        Ok(())
    }

    fn decide_with(
        &mut self,
        observation: &sortie_core::Observation<'_>,
        hidden: &mut [f32],
    ) -> Result<Decision, DecideError> {
        let mut utilities = vec![0.0; self.actions()];
        self.utilities_with(observation, hidden, &mut utilities)?;
        masked_argmax(&utilities, observation.available)
    }
}
