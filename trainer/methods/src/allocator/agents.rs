//! Agents that head for what they were given, as they are deployed: a network that is written down, not learned.

use std::ops::Range;

use sortie_core::Observation;
use sortie_envs::Spec;
use sortie_learn::export::{
    AttentionNetwork, DeployedAgents, DeployedNetworks, Layer, Layout, Matrix, PointingHead,
};
use sortie_learn::networks::OwnPass;

/// Width of its embedding: all entities are alike.
const WIDTH: usize = 4;

/// An agent that takes the action which is aimed at what it sees, and it sees its subtask alone; the first action where it sees
/// nothing that it may head for.
#[derive(Clone, Debug)]
pub(super) struct HeadingAgents {
    features: usize,
    actions: usize,
    /// The entities that the last actions are aimed at.
    targets: Range<usize>,
    zeros: Vec<f32>,
    ones: [f32; WIDTH],
}

impl HeadingAgents {
    pub(super) fn new(spec: &Spec) -> Self {
        let (features, actions) = (spec.shape.features, spec.shape.actions);
        let most = features.max(actions).max(3 * WIDTH);
        let (targets, zeros) = (spec.targets.clone(), vec![0.0; WIDTH * most]);
        Self { features, actions, targets, zeros, ones: [1.0; WIDTH] }
    }

    /// Every entity is embedded as ones, and the agent's vector is ones: what is seen is worth 1.
    pub(super) fn network(&self) -> AttentionNetwork<'_> {
        let count = self.targets.len();
        let matrix =
            |size: usize| Matrix { values: &self.zeros[..size], layout: Layout::OutputsFirst };
        let zeros = |inputs: usize, outputs: usize| Layer {
            weight: matrix(inputs * outputs),
            bias: &self.zeros[..outputs],
        };
        let ones = |inputs: usize| Layer { weight: matrix(inputs * WIDTH), bias: &self.ones };
        AttentionNetwork {
            inputs: self.features,
            width: WIDTH,
            heads: 1,
            base: WIDTH,
            outputs: self.actions,
            fc1: ones(self.features),
            attention_in: matrix(3 * WIDTH * WIDTH),
            attention_out: zeros(WIDTH, WIDTH),
            skip: None,
            fc2: None,
            head: zeros(WIDTH, self.actions - count),
            pointing: Some(PointingHead {
                first_entity: self.targets.start,
                count,
                query: ones(WIDTH),
                pairs: None,
                scale: 1.0 / WIDTH as f32,
            }),
        }
    }

    /// What each of its actions is worth to an agent.
    fn utilities(&self, seen: &Observation<'_>) -> Vec<f32> {
        let mut utilities = vec![0.0; self.actions - self.targets.len()];
        let visible = self.targets.clone().map(|target| seen.visible.contains(target));
        utilities.extend(visible.map(|visible| f32::from(u8::from(visible))));
        utilities
    }

    pub(super) fn deployed(&self) -> DeployedAgents<'_> {
        let networks = DeployedNetworks::Attention { network: self.network(), memory: None };
        let utilities = |seen: &Observation<'_>, _: &mut [f32]| Ok(self.utilities(seen));
        let policy = Box::new(OwnPass { actions: self.actions, memory: 0, utilities });
        DeployedAgents { networks, policy }
    }
}
