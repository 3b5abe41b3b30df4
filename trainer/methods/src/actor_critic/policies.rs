//! The policies: each agent's own observation becomes scores of its actions.

use std::ops::Range;

use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Parameters, Pass, Var};

use super::groups::Groups;
use super::values::leaky;

/// The policies of all groups: three layers each.
#[derive(Clone, Debug)]
pub struct Policies {
    /// The weights, group behind group.
    pub parameters: Parameters,
    groups: Vec<([Linear; 3], Range<usize>)>,
}

impl Policies {
    /// Draws the first weights.
    pub fn new(width: usize, groups: &Groups, random: &mut Generator) -> Self {
        let mut parameters = Parameters::default();
        let layers = groups.0.iter().enumerate().map(|(index, group)| {
            let first = parameters.values.len();
            let sizes = [group.inputs(), width, width, group.actions];
            let layers = std::array::from_fn(|layer| {
                let name = format!("policy.{index}.{layer}");
                parameters.linear(&name, sizes[layer], sizes[layer + 1], random)
            });
            (layers, first..parameters.values.len())
        });
        let groups = layers.collect();
        Self { parameters, groups }
    }

    /// Where the weights of each group stand.
    pub fn ranges(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        self.groups.iter().map(|(_, range)| range.clone())
    }

    /// The layers of each group.
    pub fn layers(&self) -> impl Iterator<Item = &[Linear; 3]> {
        self.groups.iter().map(|(layers, _)| layers)
    }

    /// By groups, `[rows, actions]`: the scores of actions in some records, whose softmax are their chances.
    pub fn scores(
        &self,
        pass: &mut Pass<'_>,
        groups: &Groups,
        observations: &[Vec<f32>],
        records: Range<usize>,
    ) -> Vec<Var> {
        let scores = self.groups.iter().zip(&groups.0).zip(observations);
        let scores = scores.map(|((([first, second, last], _), group), observations)| {
            let x = pass.input(group.inputs(), group.rows(observations, group.inputs(), &records));
            let x = leaky(pass, x, *first);
            let x = leaky(pass, x, *second);
            pass.linear(x, *last)
        });
        scores.collect()
    }
}
