//! What agents think: utilities and attention of a run's network or of a bundle's.

use sortie_bundle::Bundle;
use sortie_core::choose::masked_argmax;
use sortie_core::{DecideError, Decision, Observation, Policy};
use sortie_methods::alma::agents::NetworkPolicy;
use sortie_plans::{AttentionLayers, AttentionProbe, roles_of};
pub(super) use sortie_stage::Thought;

use crate::compiler::compiler;
use crate::failure::Failure;

/// A policy that also tells what it attends to.
pub(super) trait Mind: Policy {
    /// Every visible entity with its weights `[heads]`, once the utilities of the same observation
    /// have been asked for.
    fn attention(
        &mut self,
        observation: &Observation<'_>,
    ) -> Result<Vec<(usize, Vec<f32>)>, DecideError>;
}

impl Mind for NetworkPolicy<'_> {
    fn attention(
        &mut self,
        observation: &Observation<'_>,
    ) -> Result<Vec<(usize, Vec<f32>)>, DecideError> {
        let attention = NetworkPolicy::attention(self, observation);
        Ok(attention.map(|(entity, weights)| (entity, weights.to_vec())).collect())
    }
}

/// What tells whom a bundle's agents attend to; none where they attend to nobody that is known.
pub(super) fn attention_of(bundle: &Bundle) -> Result<Option<AttentionLayers>, Failure> {
    let attends = bundle.options().is_none() && roles_of(bundle)?.is_none();
    Ok(attends.then(|| compiler().attention(bundle.agent_onnx())).transpose()?)
}

/// A bundle as deployed, with the attention read from its graph.
pub(super) struct DeployedMind<'a> {
    policy: Box<dyn Policy + 'a>,
    /// None where the network attends to nothing that is known.
    probe: Option<AttentionProbe>,
}

impl<'a> DeployedMind<'a> {
    pub(super) fn new(bundle: &Bundle, policy: Box<dyn Policy + 'a>) -> Result<Self, Failure> {
        let features = usize::from(bundle.contract().features);
        let probe = attention_of(bundle)?.map(|layers| AttentionProbe::new(layers, features));
        Ok(Self { policy, probe })
    }
}

impl Policy for DeployedMind<'_> {
    fn actions(&self) -> usize {
        self.policy.actions()
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        self.policy.utilities(observation, utilities)
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        self.policy.decide(observation)
    }

    fn begin_episode(&mut self) -> bool {
        self.policy.begin_episode()
    }
}

impl Mind for DeployedMind<'_> {
    fn attention(
        &mut self,
        observation: &Observation<'_>,
    ) -> Result<Vec<(usize, Vec<f32>)>, DecideError> {
        let attention = self.probe.as_ref().map(|probe| probe.by_entity(observation));
        attention.unwrap_or_else(|| Ok(Vec::new()))
    }
}

/// Decides by a mind and notes every thought, in the order of the decisions.
pub(super) struct Diary<'a> {
    mind: &'a mut dyn Mind,
    pub(super) thoughts: Vec<Thought>,
}

impl<'a> Diary<'a> {
    pub(super) fn new(mind: &'a mut dyn Mind) -> Self {
        Self { mind, thoughts: Vec::new() }
    }
}

impl Policy for Diary<'_> {
    fn actions(&self) -> usize {
        self.mind.actions()
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        self.mind.utilities(observation, utilities)
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        let mut utilities = vec![0.0; self.mind.actions()];
        self.mind.utilities(observation, &mut utilities)?;
        let attention = self.mind.attention(observation)?;
        self.thoughts.push(Thought::new(&utilities, attention));
        masked_argmax(&utilities, observation.available)
    }
}
