//! An agent's network as the products that an int8 plan computes with whole numbers.

use std::ops::Range;

use sortie_core::internal::math::exp;
use sortie_core::{NO_ACTION, Observation};
use sortie_plans::CompileError;

use crate::lower::agent::{behind_heads, padded_heads, side_by_side};
use crate::matching::{AgentLayers, Layer, Matrix, Step};

/// The first product, of entities' rows.
pub(crate) const EMBED: usize = 0;

/// The queries of all heads.
pub(crate) const QUERY: usize = 1;

/// The products of a network, in the order in which a decision needs them: the embedding, the queries of all heads,
/// absorbed keys and then values head by head, the attention's output, and what follows it.
///
/// Keys and values have no bias. A head takes and gives as many numbers as the plan has for it, those of padding included.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Products {
    pub(crate) heads: usize,
    /// Features d; the last action's one-hot follows them, if the embedding has more inputs.
    features: usize,
    pub(crate) layers: Vec<Layer>,
}

impl Products {
    /// The products of a network of so many features.
    ///
    /// # Errors
    /// The network has a recurrent unit.
    pub(crate) fn of(network: &AgentLayers, features: usize) -> Result<Self, CompileError> {
        let heads = network.heads;
        let width = network.key.outputs / heads;
        let parts = |matrix: &Matrix| -> Vec<Matrix> {
            (0..heads).map(|head| matrix.columns(head * width, width)).collect()
        };
        let plain = |matrix: Matrix| Layer { bias: vec![0.0; matrix.outputs], relu: false, matrix };
        let query: Vec<Layer> = parts(&network.query.matrix)
            .into_iter()
            .zip(network.query.bias.chunks_exact(width))
            .map(|(matrix, bias)| Layer { matrix, bias: bias.to_vec(), relu: false })
            .collect();
        let keys = parts(&network.key).into_iter().map(|keys| padded_heads(&keys.transposed(), 1));
        let mut layers = vec![network.embed.clone(), side_by_side(&query)];
        layers.extend(keys.chain(parts(&network.value)).map(plain));
        layers.push(behind_heads(network));
        for step in &network.steps {
            match step {
                Step::Dense(layer) => layers.push(layer.clone()),
                Step::Gru(_) => {
                    return Err(CompileError::NoInt8 { what: "a recurrent unit (Gru)".into() });
                }
            }
        }
        Ok(Self { heads, features, layers })
    }

    /// Absorbed keys, head by head.
    pub(crate) fn keys(&self) -> Range<usize> {
        QUERY + 1..QUERY + 1 + self.heads
    }

    /// Values, head by head.
    pub(crate) fn values(&self) -> Range<usize> {
        self.keys().end..self.keys().end + self.heads
    }

    /// The attention's output, which takes the heads' values, and behind them the own row where there is a skip.
    pub(crate) fn output(&self) -> usize {
        self.values().end
    }

    /// Whether a product has a bias.
    pub(crate) fn has_bias(&self, index: usize) -> bool {
        !(self.keys().start..self.values().end).contains(&index)
    }

    /// Numbers that a head hands to the output.
    pub(crate) fn head_width(&self) -> usize {
        self.layers[QUERY].matrix.outputs / self.heads
    }

    /// Products that do not depend on each other, in order: what one of them is given depends on those before it.
    pub(crate) fn stages(&self) -> Vec<Range<usize>> {
        let mut stages = vec![EMBED..QUERY, QUERY..QUERY + 1, self.keys(), self.values()];
        stages.extend((self.output()..self.layers.len()).map(|index| index..index + 1));
        stages
    }

    /// The utilities of an observation, in f32. `note` is told what every product is given. Only products before
    /// `until` are computed: nothing is returned where that is not all.
    pub(crate) fn follow(
        &self,
        observation: &Observation<'_>,
        until: usize,
        mut note: impl FnMut(usize, &[f32]),
    ) -> Option<Vec<f32>> {
        let mut product = |index: usize, input: &[f32]| {
            let layer = self.layers.get(index).filter(|_| index < until)?;
            note(index, input);
            Some(layer.apply(input))
        };
        let own = observation.self_index;
        let mut rows = Vec::new();
        let mut own_row = None;
        for entity in observation.visible.iter() {
            let row = product(EMBED, &self.input(observation, entity)?)?;
            if entity == own {
                own_row = Some(row.clone());
            }
            rows.push(row);
        }
        let own_row = match own_row {
            Some(row) => row,
            None => product(EMBED, &self.input(observation, own)?)?,
        };
        let mixed = match rows.as_slice() {
            [] => Vec::new(),
            [only] => vec![only.clone(); self.heads],
            _ => {
                let queries = product(QUERY, &own_row)?;
                let asked = self.keys().zip(queries.chunks_exact(self.head_width()));
                let absorbed = asked.map(|(keys, query)| product(keys, query));
                let absorbed: Vec<Vec<f32>> = absorbed.collect::<Option<_>>()?;
                absorbed.iter().map(|absorbed| mix(&rows, absorbed)).collect()
            }
        };
        let mut answer = Vec::new();
        for (head, (values, mixed)) in (1..).zip(self.values().zip(&mixed)) {
            answer.extend(product(values, mixed)?);
            answer.resize(head * self.head_width(), 0.0);
        }
        answer.resize(self.heads * self.head_width(), 0.0);
        if self.layers[self.output()].matrix.inputs > answer.len() {
            answer.extend(own_row);
        }
        for index in self.output()..self.layers.len() {
            answer = product(index, &answer)?;
        }
        Some(answer)
    }

    /// An entity's features and last action, if they are numbers.
    fn input(&self, observation: &Observation<'_>, entity: usize) -> Option<Vec<f32>> {
        let start = entity * observation.stride;
        let mut input = observation.rows.get(start..start + self.features)?.to_vec();
        input.resize(self.layers[EMBED].matrix.inputs, 0.0);
        let action = observation.last_actions.get(entity).filter(|action| **action != NO_ACTION);
        if let Some(one) =
            action.and_then(|action| input.get_mut(self.features + usize::from(*action)))
        {
            *one = 1.0;
        }
        input.iter().all(|value| value.is_finite()).then_some(input)
    }
}

/// Rows, mixed by how well they answer the absorbed query.
fn mix(rows: &[Vec<f32>], absorbed: &[f32]) -> Vec<f32> {
    let scores = rows.iter().map(|row| row.iter().zip(absorbed).map(|(a, b)| a * b).sum::<f32>());
    let scores: Vec<f32> = scores.collect();
    let largest = scores.iter().copied().fold(f32::MIN, f32::max);
    let weights: Vec<f32> = scores.iter().map(|score| exp(score - largest)).collect();
    let sum: f32 = weights.iter().sum();
    let mut mixed = vec![0.0; absorbed.len()];
    for (row, weight) in rows.iter().zip(weights) {
        mixed.iter_mut().zip(row).for_each(|(mixed, value)| *mixed += weight / sum * value);
    }
    mixed
}
