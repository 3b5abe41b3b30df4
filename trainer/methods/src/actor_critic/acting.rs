//! Agents that look at scenes and choose by their policies; and policies as they are deployed: graphs over an agent's own row,
//! one for each group, with what is done to inputs taken into the first layer, and the trainer's own forward pass beside them.

use sortie_core::DecideError;
use sortie_envs::random::unit;
use sortie_envs::{EntitySet, Observation, Random};
use sortie_learn::Scenes;
use sortie_learn::export::{
    DenseLayer, DeployedAgents, DeployedNetworks, OwnRowNetwork, OwnRowNetworks,
};
use sortie_learn::networks::{OwnPass, drawn};
use sortie_nn::layers::normalise::EPSILON;
use sortie_nn::layers::softmax;
use sortie_nn::tape::Tape;

use super::groups::{Group, Groups, Rows, Running, best, emptied};
use super::policies::Policies;

/// What becomes of observations before networks are shown them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Inputs<'a> {
    /// What they are multiplied with.
    pub(crate) scale: f32,
    /// By what they are normalised then, if they are.
    pub(crate) running: Option<&'a Running>,
}

/// The policies that act.
#[derive(Clone, Copy)]
pub(crate) struct Actors<'a> {
    pub(crate) groups: &'a Groups,
    pub(crate) inputs: Inputs<'a>,
    pub(crate) policies: &'a Policies,
    pub(crate) head: usize,
    pub(crate) weights: &'a [f32],
}

/// Adds, by groups, the rows that networks are shown of what is seen in a state, each as far as its role sees.
pub(crate) fn show(groups: &Groups, scale: f32, seen: &Observation, shown: &mut Rows) {
    for (group, shown) in groups.0.iter().zip(shown) {
        for agent in group.agents.clone() {
            show_row(group, agent, scale, seen.rows.row(agent), shown);
        }
    }
}

/// Adds the row of one agent, that sees these columns and numbers.
fn show_row(
    group: &Group,
    agent: usize,
    scale: f32,
    seen: impl Iterator<Item = (usize, f32)>,
    shown: &mut Vec<f32>,
) {
    let start = shown.len();
    shown.resize(start + group.inputs(), 0.0);
    let (own, identity) = shown[start..].split_at_mut(group.observed);
    seen.for_each(|(column, number)| own[column] = scale * number);
    if group.identity {
        identity[agent - group.agents.start] = 1.0;
    }
}

/// Agents at work in several scenes.
#[derive(Debug, Default)]
pub(crate) struct Acting {
    seen: Observation,
    /// By groups, `[scenes, agents, inputs]`.
    pub(crate) shown: Rows,
    tape: Tape,
    /// By groups, `[scenes, agents, actions]`.
    pub(crate) scores: Rows,
}

impl Acting {
    /// Writes `[scenes, A]` what agents choose: drawn by their scores and the generators of instances, or without these the
    /// best.
    pub(crate) fn act(
        &mut self,
        actors: Actors<'_>,
        scenes: &Scenes<'_>,
        mut random: Option<&mut [Random]>,
        actions: &mut [u16],
    ) {
        self.look(actors, scenes);
        let groups = actors.groups;
        let teams = actions.chunks_exact_mut(groups.agents());
        for (place, (scene, actions)) in scenes.scenes.iter().zip(teams).enumerate() {
            for (group, scores) in groups.0.iter().zip(&mut self.scores) {
                let row = group.agents.len() * group.actions;
                let rows = scores[place * row..][..row].chunks_exact_mut(group.actions);
                for (scores, agent) in rows.zip(group.agents.clone()) {
                    actions[agent] = match &mut random {
                        Some(random) => {
                            softmax::forward(scores);
                            drawn(scores, unit(&mut random[scene.instance]) as f32) as u16
                        }
                        None => best(scores) as u16,
                    };
                }
            }
        }
    }

    /// Finds the scores of all actions in scenes.
    pub(crate) fn look(&mut self, actors: Actors<'_>, scenes: &Scenes<'_>) {
        let Actors { groups, inputs, policies, head, weights } = actors;
        emptied(&mut self.shown, groups.0.len());
        for scene in scenes.scenes {
            scenes.environment.observe(scene.state, 0, EntitySet::MAX, &mut self.seen);
            show(groups, inputs.scale, &self.seen, &mut self.shown);
        }
        if let Some(running) = inputs.running {
            let rows = self.shown.iter_mut().enumerate();
            rows.for_each(|(group, rows)| running.normalise(group, rows));
        }
        let mut pass = self.tape.begin(weights);
        let (heads, records) = (head..head + 1, 0..scenes.scenes.len());
        let scores = policies.scores(&mut pass, groups, &self.shown, heads, records);
        emptied(&mut self.scores, groups.0.len());
        for (scores, kept) in scores.into_iter().zip(&mut self.scores) {
            kept.extend_from_slice(pass.values(scores));
        }
    }
}

/// What an agent thinks of its actions by its own row alone, `[actions]`; none of an agent that there is not, or of a row
/// that is too short.
pub(crate) fn scores_of(
    actors: Actors<'_>,
    tape: &mut Tape,
    agent: usize,
    row: &[f32],
) -> Option<Vec<f32>> {
    let Actors { groups, inputs, policies, head, weights } = actors;
    let mut all = groups.0.iter().enumerate();
    let (index, group) = all.find(|(_, group)| group.agents.contains(&agent))?;
    let own = row.get(..group.observed)?;
    let mut shown = Vec::new();
    let own = own.iter().copied().enumerate();
    show_row(group, agent, inputs.scale, own, &mut shown);
    inputs.running.inspect(|running| running.normalise(index, &mut shown));
    let (mut pass, mut scores) = (tape.begin(weights), Vec::new());
    policies.score(&mut pass, index, &shown, head..head + 1, &mut scores);
    Some(pass.values(scores[0]).to_vec())
}

/// The agents that these policies are, in teams with so many actions.
pub(crate) fn deployed(actors: Actors<'_>, actions: usize) -> DeployedAgents<'_> {
    let mut tape = Tape::default();
    let utilities = move |seen: &sortie_core::Observation<'_>, _: &mut [f32]| {
        let agent = seen.self_index;
        let row = seen.rows.get(agent * seen.stride..).unwrap_or_default();
        let scores = scores_of(actors, &mut tape, agent, row);
        let mut scores = scores.ok_or(DecideError::BadLength)?;
        scores.resize(actions, 0.0);
        Ok(scores)
    };
    let networks = DeployedNetworks::OwnRow(networks(actors));
    DeployedAgents { networks, policy: Box::new(OwnPass { actions, memory: 0, utilities }) }
}

/// The layers of policies that act. What is done to their inputs is folded into the first.
fn networks(actors: Actors<'_>) -> OwnRowNetworks {
    let (mut network_of, mut networks) = (Vec::new(), Vec::new());
    let Actors { groups, policies, head, weights, .. } = actors;
    for (index, group) in groups.0.iter().enumerate() {
        let mut layers = policies.layers(index, head).map(|layer| DenseLayer::of(layer, weights));
        fold(actors, index, &mut layers[0]);
        network_of.resize(group.agents.end, index);
        networks.push(OwnRowNetwork { features: group.observed, layers: layers.into() });
    }
    OwnRowNetworks { slope: policies.slope, network_of, networks }
}

/// Takes into a group's first layer what becomes of each of its inputs: a factor times it, and an offset.
fn fold(actors: Actors<'_>, index: usize, layer: &mut DenseLayer) {
    let group = &actors.groups.0[index];
    let column = |column: usize| match actors.inputs.running {
        Some(running) => {
            let factor = 1.0 / (running.variances[index][column] + f64::from(EPSILON)).sqrt();
            [factor, -factor * running.means[index][column]]
        }
        None if column < group.observed => [f64::from(actors.inputs.scale), 0.0],
        None => [1.0, 0.0],
    };
    let columns: Vec<[f64; 2]> = (0..group.inputs()).map(column).collect();
    for (row, bias) in layer.weight.chunks_exact_mut(layer.inputs).zip(&mut layer.bias) {
        let mut sum = f64::from(*bias);
        for (weight, [factor, offset]) in row.iter_mut().zip(&columns) {
            sum += f64::from(*weight) * offset;
            *weight = (f64::from(*weight) * factor) as f32;
        }
        *bias = sum as f32;
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
        let mut seen = Observation::default();
        for (first, observed) in [(1, 11), (12, 11), (23, 6), (29, 6)] {
            let row: Vec<f32> = (first..first + observed).map(|number| number as f32).collect();
            seen.rows.push_dense(&row);
        }
        let mut shown = vec![Vec::new(); 2];
        show(&groups, 2.0, &seen, &mut shown);
        let second: Vec<f32> = (12..=22).map(|number| 2.0 * number as f32).collect();
        assert_eq!((shown[0].len(), &shown[0][13..24]), (26, &second[..]));
        assert_eq!((&shown[0][11..13], &shown[0][24..]), (&[1.0, 0.0][..], &[0.0, 1.0][..]));
        assert_eq!((shown[1].len(), &shown[1][14..]), (16, &[0.0, 1.0][..]));
        // Who is alone needs not be told.
        let alone = Groups::new(world.spec(), false, true);
        assert_eq!(alone.0.iter().map(|group| group.inputs()).collect::<Vec<_>>(), [11, 11, 6, 6]);
    }
}
