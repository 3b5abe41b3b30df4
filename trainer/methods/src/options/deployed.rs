//! The agent as it is deployed: three networks, what it is shown, and the rules of its options.

use sortie_bundle::{Affords, MilestoneSign, OptionsContract, PictureContract};
use sortie_core::DecideError;
use sortie_core::options::{OptionNetworks, OptionPolicy};
use sortie_envs::Sign;
use sortie_learn::export::{DenseLayer, DeployedAgents, DeployedNetworks, OptionGraphs};
use sortie_nn::layers::SparseRows;
use sortie_nn::layers::elementwise::{Activation, activate};
use sortie_nn::tape::Tape;

use super::play::{Actors, Chances, Chooser};
use crate::pictures::{Heads, Network};

/// The agent that these networks are, by a seed for what it draws.
pub(crate) fn deployed<'a>(
    actors: Actors<'a>,
    signs: &[(String, Sign)],
    chances: Chances<'_>,
    seed: u64,
) -> Option<DeployedAgents<'a>> {
    let chooser = actors.chooser?;
    let options = contract(actors, chooser, signs, chances, seed)?;
    let rules = options.rules(actors.controller.0.heads.actions).ok()?;
    let row = vec![0.0; actors.shown.columns()];
    let own = OwnNetworks { actors, chooser, tape: Tape::default(), row: SparseRows::default() };
    let policy = OptionPolicy::new(rules, own, row)?;
    let networks = graphs(actors, chooser)?;
    Some(DeployedAgents {
        networks: DeployedNetworks::Options { options, graphs: networks },
        policy: Box::new(policy),
    })
}

fn contract(
    actors: Actors<'_>,
    chooser: Chooser<'_>,
    signs: &[(String, Sign)],
    chances: Chances<'_>,
    seed: u64,
) -> Option<OptionsContract> {
    let shape = actors.shown.shape();
    let first = shape.features() - shape.counts;
    let [reached, known] = chooser.known;
    let milestone = |(place, (name, sign)): (usize, &(String, Sign))| {
        let affordance = match (reached >> place & 1, known >> place & 1) {
            (0, _) if !chooser.unreached => Affords::Never,
            (_, 0) => Affords::Always,
            _ => Affords::Learned,
        };
        let carried = (sign.feature.checked_sub(first)?) as u16;
        Some(MilestoneSign { name: name.clone(), carried, change: sign.change, affordance })
    };
    let milestones = signs.iter().enumerate().map(milestone);
    let milestones: Vec<_> = milestones.collect::<Option<_>>()?;
    (milestones.len() == actors.controller.0.heads.goals).then_some(OptionsContract {
        steps: actors.option_steps,
        threshold: chooser.threshold,
        action_chance: chances.actions,
        goal_chance: chances.afforded,
        varied: chances.varied,
        // What TOML holds.
        seed: seed >> 1,
        picture: PictureContract {
            channels: shape.channels as u16,
            size: shape.size as u16,
            counts: shape.counts as u16,
            crop: shape.crop as u16,
            nearest: shape.nearest,
        },
        milestones,
    })
}

fn graphs(actors: Actors<'_>, chooser: Chooser<'_>) -> Option<OptionGraphs> {
    let layers = |(network, weights): (&Network, &[f32])| network.dense(weights);
    let mut controller = layers(actors.controller)?;
    let [.., head] = &mut controller;
    let Heads { goals, actions, .. } = actors.controller.0.heads;
    let heads = (0..goals).map(|goal| head_of(head, goals, actions, goal)).collect();
    let [first, second, _] = controller;
    let mut meta = layers(chooser.meta)?;
    if chooser.meta.0.heads.dueling {
        meta[2] = head_of(&meta[2], 1, goals, 0);
    }
    Some(OptionGraphs {
        controller: [first, second],
        heads,
        meta,
        affordance: layers(chooser.classifier)?,
    })
}

/// The values of all actions for a goal as one layer: value and advantages, less their mean.
fn head_of(head: &DenseLayer, goals: usize, actions: usize, goal: usize) -> DenseLayer {
    let row = |output: usize| {
        let weights = &head.weight[output * head.inputs..][..head.inputs];
        weights.iter().chain(&head.bias[output..=output]).map(|number| f64::from(*number))
    };
    let advantages = (0..actions).map(|action| row(goals + goal * actions + action));
    let mut mean = vec![0.0; head.inputs + 1];
    for advantage in advantages.clone() {
        mean.iter_mut().zip(advantage).for_each(|(sum, number)| *sum += number / actions as f64);
    }
    let mut layer = DenseLayer { inputs: head.inputs, weight: Vec::new(), bias: Vec::new() };
    for advantage in advantages {
        let numbers = advantage.zip(row(goal)).zip(&mean);
        let mut numbers: Vec<f32> =
            numbers.map(|((advantage, value), mean)| (value + advantage - mean) as f32).collect();
        layer.bias.extend(numbers.pop());
        layer.weight.extend(numbers);
    }
    layer
}

/// The trainer's own passes: what golden answers expect of every engine.
struct OwnNetworks<'a> {
    actors: Actors<'a>,
    chooser: Chooser<'a>,
    tape: Tape,
    row: SparseRows,
}

impl OwnNetworks<'_> {
    /// The values of all actions for a goal, by what is shown.
    fn values(
        &mut self,
        (network, weights): (&Network, &[f32]),
        shown: &[f32],
        goal: usize,
    ) -> Vec<f32> {
        self.row.clear();
        self.row.push_dense(shown);
        let mut pass = self.tape.begin_forward(weights);
        let hidden = network.hidden(&mut pass, &self.row);
        let values = network.values(&mut pass, hidden, &[network.place(0, goal)]);
        pass.values(values).to_vec()
    }
}

impl OptionNetworks for OwnNetworks<'_> {
    fn actions(
        &mut self,
        shown: &[f32],
        goal: usize,
        values: &mut [f32],
    ) -> Result<(), DecideError> {
        values.copy_from_slice(&self.values(self.actors.controller, shown, goal));
        Ok(())
    }

    fn goals(&mut self, shown: &[f32], values: &mut [f32]) -> Result<(), DecideError> {
        values.copy_from_slice(&self.values(self.chooser.meta, shown, 0));
        Ok(())
    }

    fn affordances(&mut self, shown: &[f32], likelihoods: &mut [f32]) -> Result<(), DecideError> {
        let logits = self.values(self.chooser.classifier, shown, 0);
        activate(Activation::Sigmoid, &logits, likelihoods);
        Ok(())
    }
}
