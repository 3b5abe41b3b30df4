//! The agents' network, shared by all of them: entities are embedded and attended to, a head says what each action is worth
//! (dissertation section 5.4).
//!
//! Without memory `q = head relu(a)`, `a = W_o o + b_o + W_s x`, with `o` what the agent attends to and `x` its
//! own embedding; with memory `q = head h`, `h = GRU(relu(fc2 a), h before)`. The published networks have no
//! `W_s`: they see their own row through attention only.
//!
//! Where actions aim at entities the head may *point*: the utility of such an action is `(W_p h + b_p) · x_e`, the product of
//! the agent's vector with the embedding of the entity that it aims at, so that it stays meaningful whatever the target's
//! number; 0 where the agent does not see it. Where an environment says how an agent stands to each of its targets, these
//! features stand behind the embedding in that product, and the agent's vector is as much longer.

use sortie_nn::layers::gru::lengths;
use sortie_nn::random::Generator;
use sortie_nn::tape::{Gru, Linear, Parameters, Pass, Var};

use super::aims::Targets;
use super::attention::{Attended, EntityAttention, LookShape};
use super::batch::{EntityBatch, View};
use crate::export::{AttentionNetwork, GruCell, Layer, Layout, Matrix};

/// Sizes of the agents' network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AgentShape {
    /// Of embedding and attention.
    pub looking: LookShape,
    /// Actions.
    pub actions: usize,
    /// Whether the agent's own embedding reaches the layer before the head.
    pub skip: bool,
    /// Width of what agents remember; 0: they remember nothing.
    pub memory: usize,
    /// What the last actions aim at, where the head points at it.
    pub targets: Targets,
}

/// The layers.
#[derive(Clone, Copy, Debug)]
pub struct EntityAgent {
    /// The sizes.
    pub shape: AgentShape,
    looking: EntityAttention,
    out: Linear,
    skip: Option<Linear>,
    /// Before what is remembered, and the unit that does.
    memory: Option<(Linear, Gru)>,
    head: Linear,
    /// Makes the vector that points.
    pointing: Option<Linear>,
}

/// Names of the tensors of a recurrent unit.
const UNIT: [&str; 4] = ["input.weight", "recurrent.weight", "input.bias", "recurrent.bias"];

impl EntityAgent {
    /// Adds tensors under `agent`, drawn as PyTorch does.
    pub fn new(parameters: &mut Parameters, shape: AgentShape, random: &mut Generator) -> Self {
        let AgentShape { looking: look, actions, skip, memory, targets } = shape;
        let width = look.width;
        let looking = EntityAttention::new(parameters, "agent", look, random);
        let out = parameters.linear("agent.attention.out", width, width, random);
        let skip = skip.then(|| parameters.projection("agent.skip", width, width, random));
        let unit = (memory > 0).then(|| {
            let before = parameters.linear("agent.fc2", width, memory, random);
            (before, parameters.gru_of("agent.memory", UNIT, memory, random))
        });
        let last = if memory > 0 { memory } else { width };
        let head = parameters.linear("agent.head", last, actions - targets.count, random);
        let points = targets.count > 0;
        let reach = targets.reach(width);
        let pointing = points.then(|| parameters.linear("agent.pointing", last, reach, random));
        Self { shape, looking, out, skip, memory: unit, head, pointing }
    }

    /// The utilities `[blocks * agents, U]` of a batch, as a view shows it. `memory [slots, R]` is what agents remember
    /// before the first step, see [`EntityBatch::slots`], and becomes what they remember behind the last.
    pub fn utilities(
        &self,
        pass: &mut Pass<'_>,
        batch: &EntityBatch,
        view: View<'_>,
        memory: &mut [f32],
    ) -> Var {
        let attended = self.looking.attend(pass, view);
        let last = match self.memory {
            None => match self.skip {
                // In one step, where the own embedding is there once.
                Some(skip) if !view.imagines => {
                    let own = attended.own(pass, view);
                    pass.linear_sum_rectified([attended.output, own], [self.out, skip])
                }
                _ => {
                    let hidden = self.hidden(pass, attended, view);
                    pass.relu(hidden)
                }
            },
            Some((before, unit)) => {
                let hidden = self.hidden(pass, attended, view);
                let x = pass.linear_rectified(hidden, before);
                let (places, carry) = batch.in_time(view);
                let x = pass.scatter(x, places, carry.len());
                let remembered = pass.gru(x, unit, carry, memory);
                pass.gather(remembered, places)
            }
        };
        let untargeted = pass.linear(last, self.head);
        match self.pointing {
            Some(pointing) => {
                let vectors = pass.linear(last, pointing);
                let aimed = batch.aims(view).point(pass, [vectors, attended.embeddings]);
                pass.concat(&[untargeted, aimed])
            }
            None => untargeted,
        }
    }

    /// `a`, see the module.
    fn hidden(&self, pass: &mut Pass<'_>, attended: Attended, view: View<'_>) -> Var {
        let hidden = pass.linear(attended.output, self.out);
        let Some(skip) = self.skip else { return hidden };
        let own = attended.own(pass, view);
        let own = pass.linear(own, skip);
        // Where there are three blocks, to each of them.
        pass.add(hidden, own)
    }

    /// The network by these weights as it is deployed, and its memory.
    pub fn deployed<'a>(&self, values: &'a [f32]) -> (AttentionNetwork<'a>, Option<GruCell<'a>>) {
        let whole = |layer: Linear| Layer::of(layer, values, Layout::OutputsFirst);
        let EntityAttention { embed, queries, keys_values, heads, .. } = self.looking;
        let attention_in = queries.weight..keys_values.weight_range().end;
        let network = AttentionNetwork {
            inputs: embed.shape.input,
            width: embed.shape.output,
            heads,
            base: self.head.shape.input,
            outputs: self.shape.actions,
            fc1: Layer::of(embed, values, Layout::InputsFirst),
            attention_in: Matrix { values: &values[attention_in], layout: Layout::OutputsFirst },
            attention_out: whole(self.out),
            skip: self.skip.map(|skip| whole(skip).weight),
            fc2: self.memory.map(|(before, _)| whole(before)),
            head: whole(self.head),
            pointing: self.pointing.map(|pointing| self.shape.targets.deployed(pointing, values)),
        };
        let memory = self.memory.map(|(_, Gru { width, start })| {
            let mut rest = &values[start..];
            let [input, recurrent, input_bias, recurrent_bias] =
                lengths(width).map(|length| rest.split_off(..length).expect("all tensors"));
            let recurrent = Layer::outputs_first(recurrent, recurrent_bias);
            GruCell { input: Layer::outputs_first(input, input_bias), recurrent }
        });
        (network, memory)
    }
}
