//! The policies: each agent's own observation becomes scores of its actions. Agents that look at scenes and choose by them,
//! and as they are deployed: by graphs over an agent's own row, one for each group.

use std::ops::Range;

use sortie_core::choose::masked_argmax;
use sortie_core::{DecideError, Decision, Policy};
use sortie_envs::random::unit;
use sortie_envs::{EntitySet, Environment, Observation, Random};
use sortie_learn::Scene;
use sortie_learn::export::{
    DenseLayer, DeployedAgents, DeployedNetworks, OwnRowNetwork, OwnRowNetworks,
};
use sortie_nn::layers::normalise::EPSILON;
use sortie_nn::layers::softmax;
use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Parameters, Pass, Tape, Var};

use super::groups::{Groups, Running, bent, best, drawn};

/// The policies of all groups: a first layer, and two more for each head.
#[derive(Clone, Debug)]
pub struct Policies {
    /// The weights, group behind group.
    pub parameters: Parameters,
    slope: f32,
    groups: Vec<Layers>,
}

/// What policies are made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PolicyShape {
    /// Columns behind the first layer, and behind the second.
    pub widths: [usize; 2],
    /// Ways to score actions that share the first layer.
    pub heads: usize,
    /// What is made of numbers below zero.
    pub slope: f32,
}

#[derive(Clone, Debug)]
struct Layers {
    first: Linear,
    heads: Vec<[Linear; 2]>,
    /// Where the weights stand, those of the first layer before the others.
    range: Range<usize>,
    shared: usize,
}

impl Policies {
    /// Draws the first weights.
    pub fn new(shape: PolicyShape, groups: &Groups, random: &mut Generator) -> Self {
        let mut parameters = Parameters::default();
        let [base, width] = shape.widths;
        let layers = groups.0.iter().enumerate().map(|(index, group)| {
            let start = parameters.values.len();
            let mut linear = |layer: usize, input, output| {
                let name = format!("policy.{index}.{layer}");
                parameters.linear(&name, input, output, random)
            };
            let first = linear(0, group.inputs(), base);
            let heads = (0..shape.heads).map(|head| {
                [linear(2 * head + 1, base, width), linear(2 * head + 2, width, group.actions)]
            });
            let heads = heads.collect();
            let shared = (group.inputs() + 1) * base;
            Layers { first, heads, range: start..parameters.values.len(), shared }
        });
        let groups = layers.collect();
        Self { parameters, slope: shape.slope, groups }
    }

    /// Where the weights of each group stand.
    pub fn ranges(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        self.groups.iter().map(|layers| layers.range.clone())
    }

    /// Where those of each group stand that all its heads share.
    pub fn shared(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        self.groups.iter().map(|layers| layers.range.start..layers.range.start + layers.shared)
    }

    /// How many heads each group has.
    pub fn heads(&self) -> usize {
        self.groups.first().map_or(0, |layers| layers.heads.len())
    }

    /// What is made of numbers below zero.
    pub fn slope(&self) -> f32 {
        self.slope
    }

    /// The layers of each group with one of its heads.
    pub fn layers(&self, head: usize) -> impl Iterator<Item = [Linear; 3]> {
        self.groups.iter().map(move |layers| {
            let [second, last] = layers.heads[head];
            [layers.first, second, last]
        })
    }

    /// By groups and heads, `[rows, actions]`: the scores of actions in some records, whose softmax are their chances.
    pub fn scores(
        &self,
        pass: &mut Pass<'_>,
        groups: &Groups,
        observations: &[Vec<f32>],
        records: Range<usize>,
    ) -> Vec<Var> {
        self.scores_of(0..self.heads(), pass, groups, observations, records)
    }

    /// The same of some heads.
    pub fn scores_of(
        &self,
        heads: Range<usize>,
        pass: &mut Pass<'_>,
        groups: &Groups,
        observations: &[Vec<f32>],
        records: Range<usize>,
    ) -> Vec<Var> {
        let mut scores = Vec::new();
        for ((layers, group), observations) in self.groups.iter().zip(&groups.0).zip(observations) {
            let x = pass.input(group.inputs(), group.rows(observations, group.inputs(), &records));
            let x = bent(pass, x, layers.first, self.slope);
            for [second, last] in &layers.heads[heads.clone()] {
                let x = bent(pass, x, *second, self.slope);
                scores.push(pass.linear(x, *last));
            }
        }
        scores
    }
}

/// What becomes of observations before networks are shown them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Inputs {
    pub(crate) normalised: bool,
    /// What they are multiplied with if they are not.
    pub(crate) scale: f32,
}

/// What is seen in one state, all agents one behind the other, each as far as its role sees.
pub(crate) fn observe(
    environment: &dyn Environment,
    groups: &Groups,
    state: &[u8],
    seen: &mut Observation,
    numbers: &mut Vec<f32>,
) {
    environment.observe(state, 0, EntitySet::MAX, seen);
    for group in &groups.0 {
        for agent in group.agents.clone() {
            let start = numbers.len();
            numbers.resize(start + group.observed, 0.0);
            seen.rows.write_dense(agent, &mut numbers[start..]);
        }
    }
}

/// Numbers that all agents see together.
pub(crate) fn observed(groups: &Groups) -> usize {
    groups.0.iter().map(|group| group.observed * group.agents.len()).sum()
}

/// Adds, by groups, the rows that the networks are shown of what is seen in one state.
pub(crate) fn show(
    groups: &Groups,
    inputs: Inputs,
    mut observation: &[f32],
    shown: &mut [Vec<f32>],
) {
    let scale = if inputs.normalised { 1.0 } else { inputs.scale };
    for (group, shown) in groups.0.iter().zip(shown) {
        for index in 0..group.agents.len() {
            let (own, rest) = observation.split_at(group.observed);
            observation = rest;
            shown.extend(own.iter().map(|number| scale * number));
            if group.identity {
                let start = shown.len();
                shown.resize(start + group.agents.len(), 0.0);
                shown[start + index] = 1.0;
            }
        }
    }
}

/// Agents at work in several scenes.
#[derive(Debug, Default)]
pub(crate) struct Acting {
    seen: Observation,
    /// `[scenes, observed]`
    pub(crate) observations: Vec<f32>,
    /// By groups, `[scenes, agents, inputs]`.
    pub(crate) shown: Vec<Vec<f32>>,
    tape: Tape,
    /// By groups, `[scenes, agents, actions]`.
    pub(crate) scores: Vec<Vec<f32>>,
}

/// The policies that act.
#[derive(Clone, Copy)]
pub(crate) struct Actors<'a> {
    pub(crate) groups: &'a Groups,
    pub(crate) inputs: Inputs,
    pub(crate) policies: &'a Policies,
    pub(crate) head: usize,
    pub(crate) weights: &'a [f32],
    pub(crate) running: &'a Running,
}

impl Acting {
    /// Finds the scores of all actions in scenes.
    pub(crate) fn look<'s>(
        &mut self,
        actors: Actors<'_>,
        environment: &dyn Environment,
        scenes: impl Iterator<Item = &'s Scene<'s>>,
    ) {
        let Actors { groups, inputs, .. } = actors;
        self.forget(groups);
        let width = observed(groups);
        let mut count = 0;
        for scene in scenes {
            observe(environment, groups, scene.state, &mut self.seen, &mut self.observations);
            let own = &self.observations[count * width..];
            show(groups, inputs, own, &mut self.shown);
            count += 1;
        }
        self.score(actors, count);
    }

    /// What an agent thinks of its actions by its own row alone, `[actions]`; none of an agent that there is not, or of
    /// a row that is too short.
    pub(crate) fn look_from(
        &mut self,
        actors: Actors<'_>,
        agent: usize,
        row: &[f32],
    ) -> Option<&[f32]> {
        let groups = actors.groups;
        let (index, group) =
            groups.0.iter().enumerate().find(|(_, group)| group.agents.contains(&agent))?;
        let own = row.get(..group.observed)?;
        self.forget(groups);
        for of in &groups.0 {
            for other in of.agents.clone() {
                let end = self.observations.len() + of.observed;
                self.observations.extend_from_slice(if other == agent { own } else { &[] });
                self.observations.resize(end, 0.0);
            }
        }
        show(groups, actors.inputs, &self.observations, &mut self.shown);
        self.score(actors, 1);
        let place = agent - group.agents.start;
        self.scores.get(index)?.get(place * group.actions..)?.get(..group.actions)
    }

    fn forget(&mut self, groups: &Groups) {
        self.observations.clear();
        self.shown.resize_with(groups.0.len(), Vec::new);
        self.shown.iter_mut().for_each(Vec::clear);
    }

    fn score(&mut self, actors: Actors<'_>, count: usize) {
        let Actors { groups, inputs, policies, head, weights, running } = actors;
        if inputs.normalised {
            let rows = self.shown.iter_mut().enumerate();
            rows.for_each(|(group, rows)| running.normalise(group, rows));
        }
        let mut pass = self.tape.begin(weights);
        let heads = head..head + 1;
        let scores = policies.scores_of(heads, &mut pass, groups, &self.shown, 0..count);
        self.scores.resize_with(scores.len(), Vec::new);
        for (scores, kept) in scores.into_iter().zip(&mut self.scores) {
            kept.clear();
            kept.extend_from_slice(pass.values(scores));
        }
    }

    /// Writes `[agents]` what agents choose in one of the scenes: drawn by their scores, or without a generator the best.
    pub(crate) fn choose(
        &mut self,
        groups: &Groups,
        scene: usize,
        mut random: Option<&mut Random>,
        actions: &mut [u16],
    ) {
        for (group, scores) in groups.0.iter().zip(&mut self.scores) {
            let row = group.agents.len() * group.actions;
            let rows = scores[scene * row..][..row].chunks_exact_mut(group.actions);
            for (scores, agent) in rows.zip(group.agents.clone()) {
                actions[agent] = match &mut random {
                    Some(random) => {
                        softmax::forward(scores);
                        drawn(scores, unit(random) as f32) as u16
                    }
                    None => best(scores) as u16,
                };
            }
        }
    }
}

/// The agents that these policies are, in teams with so many actions.
pub(crate) fn deployed(actors: Actors<'_>, actions: usize) -> DeployedAgents<'_> {
    let policy = OwnPass { actors, acting: Acting::default(), actions };
    DeployedAgents {
        networks: DeployedNetworks::OwnRow(networks(actors)),
        policy: Box::new(policy),
    }
}

/// The policies' layers. What is done to their inputs is folded into the first.
fn networks(actors: Actors<'_>) -> OwnRowNetworks {
    let (mut network_of, mut networks) = (Vec::new(), Vec::new());
    for (index, layers) in actors.policies.layers(actors.head).enumerate() {
        let group = &actors.groups.0[index];
        let [mut first, second, last] = layers.map(|layer| dense(actors.weights, layer));
        Columns::of(actors, index).fold(&mut first);
        network_of.resize(group.agents.end, index);
        networks
            .push(OwnRowNetwork { features: group.observed, layers: vec![first, second, last] });
    }
    OwnRowNetworks { slope: actors.policies.slope(), network_of, networks }
}

/// What becomes of each input of a group's network: a factor times it, and an offset.
struct Columns(Vec<[f64; 2]>);

impl Columns {
    fn of(actors: Actors<'_>, index: usize) -> Self {
        let Actors { groups, inputs, running, .. } = actors;
        let group = &groups.0[index];
        let column = |column: usize| {
            if inputs.normalised {
                let factor = 1.0 / (running.variances[index][column] + f64::from(EPSILON)).sqrt();
                [factor, -factor * running.means[index][column]]
            } else if column < group.observed {
                [f64::from(inputs.scale), 0.0]
            } else {
                [1.0, 0.0]
            }
        };
        Self((0..group.inputs()).map(column).collect())
    }

    /// Takes factors and offsets into a layer behind them.
    fn fold(&self, layer: &mut DenseLayer) {
        let rows = layer.weight.chunks_exact_mut(layer.inputs).zip(&mut layer.bias);
        for (row, bias) in rows {
            let mut sum = f64::from(*bias);
            for (weight, [factor, offset]) in row.iter_mut().zip(&self.0) {
                sum += f64::from(*weight) * offset;
                *weight = (f64::from(*weight) * factor) as f32;
            }
            *bias = sum as f32;
        }
    }
}

fn dense(weights: &[f32], layer: Linear) -> DenseLayer {
    let [inputs, outputs] = [layer.shape.input, layer.shape.output];
    let part = |start: usize, length: usize| weights[start..start + length].to_vec();
    DenseLayer {
        inputs,
        weight: part(layer.weight, inputs * outputs),
        bias: layer.bias.map_or_else(|| vec![0.0; outputs], |start| part(start, outputs)),
    }
}

/// Decides with the trainer's own forward pass: what golden observations expect of every engine.
struct OwnPass<'a> {
    actors: Actors<'a>,
    acting: Acting,
    actions: usize,
}

impl Policy for OwnPass<'_> {
    fn actions(&self) -> usize {
        self.actions
    }

    fn utilities(
        &mut self,
        observation: &sortie_core::Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        let agent = observation.self_index;
        let row = observation.rows.get(agent * observation.stride..).unwrap_or_default();
        let scores = self.acting.look_from(self.actors, agent, row);
        let scores = scores.ok_or(DecideError::BadLength)?;
        utilities.fill(0.0);
        let known = utilities.get_mut(..scores.len()).ok_or(DecideError::BadLength)?;
        known.copy_from_slice(scores);
        Ok(())
    }

    fn decide(
        &mut self,
        observation: &sortie_core::Observation<'_>,
    ) -> Result<Decision, DecideError> {
        let mut utilities = vec![0.0; self.actions];
        self.utilities(observation, &mut utilities)?;
        masked_argmax(&utilities, observation.available)
    }
}

#[cfg(test)]
mod tests {
    use sortie_envs::Split;

    use super::*;

    #[test]
    fn agents_that_share_are_shown_what_they_see_and_which_they_are() {
        let world =
            sortie_envs::open("particle/rover-tower-4", Split::Train, 1, &Default::default());
        let world = world.unwrap();
        let groups = Groups::new(world.spec(), true, true);
        assert_eq!(groups.0.iter().map(|group| group.inputs()).collect::<Vec<_>>(), [13, 8]);
        let inputs = Inputs { normalised: false, scale: 2.0 };
        let observation: Vec<f32> = (1..=34).map(|number| number as f32).collect();
        let mut shown = vec![Vec::new(); 2];
        show(&groups, inputs, &observation, &mut shown);
        let second: Vec<f32> = (12..=22).map(|number| 2.0 * number as f32).collect();
        assert_eq!((shown[0].len(), &shown[0][13..24]), (26, &second[..]));
        assert_eq!((&shown[0][11..13], &shown[0][24..]), (&[1.0, 0.0][..], &[0.0, 1.0][..]));
        assert_eq!((shown[1].len(), &shown[1][14..]), (16, &[0.0, 1.0][..]));
        // Who is alone needs not be told.
        let alone = Groups::new(world.spec(), false, true);
        assert_eq!(alone.0.iter().map(|group| group.inputs()).collect::<Vec<_>>(), [11, 11, 6, 6]);
    }
}
