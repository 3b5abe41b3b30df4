//! Random networks, and what they compute by the book: plain loops in f64.

use rand_core::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sortie_bundle::{OwnedObservation, Recording};
use sortie_core::NO_ACTION;
use sortie_core::internal::ops::Targets;
use sortie_core::plan::{
    AlignedBytes, Checksums, HEADER_BYTES, Header, Network, Plan, Profile, Program, ProgramDraft,
    Proof, checksums,
};

use crate::lower::{AgentSizes, Choice, Origin, assemble, lower_agent, lower_agent_int8};
use crate::matching::{AgentLayers, GruLayers, Layer, Matrix, Step};

/// The shape of a random network.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shape {
    pub(crate) n_max: usize,
    pub(crate) features: usize,
    pub(crate) actions: usize,
    pub(crate) last_action: bool,
    pub(crate) width: usize,
    pub(crate) heads: usize,
    pub(crate) base: usize,
}

pub(crate) struct Random(Xoshiro256PlusPlus);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(Xoshiro256PlusPlus::seed_from_u64(seed))
    }

    pub(crate) fn below(&mut self, bound: usize) -> usize {
        self.0.next_u32() as usize % bound
    }

    /// A number in [-bound, bound].
    pub(crate) fn uniform(&mut self, bound: f32) -> f32 {
        ((self.0.next_u32() >> 8) as f32 / (1 << 23) as f32 - 1.0) * bound
    }

    pub(crate) fn shape(&mut self) -> Shape {
        let heads = 1 + self.below(8);
        let steps = if heads.is_power_of_two() { 8 } else { 8 * heads };
        Shape {
            n_max: 1 + self.below(32),
            features: 1 + self.below(80),
            actions: 1 + self.below(20),
            last_action: self.below(2) == 0,
            width: steps * (1 + self.below(256 / steps)),
            heads,
            base: 8 * (1 + self.below(16)),
        }
    }

    fn matrix(&mut self, inputs: usize, outputs: usize) -> Matrix {
        let bound = 1.5 / (inputs as f32).sqrt();
        let values = (0..inputs * outputs).map(|_| self.uniform(bound)).collect();
        Matrix { inputs, outputs, values }
    }

    pub(crate) fn layer(&mut self, inputs: usize, outputs: usize, relu: bool) -> Layer {
        let matrix = self.matrix(inputs, outputs);
        let bias = (0..outputs).map(|_| self.uniform(0.5)).collect();
        Layer { matrix, bias, relu }
    }

    pub(crate) fn layers(&mut self, shape: Shape) -> AgentLayers {
        let last_action = if shape.last_action { shape.actions } else { 0 };
        let (width, base) = (shape.width, shape.base);
        let relu = self.below(2) == 0;
        AgentLayers {
            embed: self.layer(shape.features + last_action, width, true),
            heads: shape.heads,
            query: self.layer(width, width, false),
            key: self.matrix(width, width),
            value: self.matrix(width, width),
            output: self.layer(width, width, relu),
            skip: None,
            targets: None,
            steps: vec![
                Step::Dense(self.layer(width, base, true)),
                Step::Dense(self.layer(base, shape.actions, false)),
            ],
        }
    }

    /// The same with a skip past the attention.
    pub(crate) fn with_skip(&mut self, layers: AgentLayers) -> AgentLayers {
        let width = layers.embed.matrix.outputs;
        AgentLayers { skip: Some(self.matrix(width, width)), ..layers }
    }

    /// The same with a head that points: of several actions some, the last ones, aim at entities. Most are told of pairs.
    pub(crate) fn pointing(&mut self, mut layers: AgentLayers, shape: Shape) -> AgentLayers {
        let count = 1 + self.below(shape.actions - 1);
        let pair_features = self.below(4).min(shape.features / count);
        let untargeted = shape.actions - count;
        let head = layers.steps.pop();
        let Some(Step::Dense(Layer { matrix: Matrix { inputs, .. }, .. })) = head else {
            panic!("a network ends in a layer");
        };
        let outputs = untargeted + shape.width + pair_features;
        layers.steps.push(Step::Dense(self.layer(inputs, outputs, false)));
        layers.targets = Some(Targets {
            untargeted: untargeted as u16,
            first_entity: self.below(shape.n_max + 2) as u16,
            count: count as u16,
            width: shape.width as u16,
            first_pair: self.below(shape.features - count * pair_features + 1) as u16,
            pair_features: pair_features as u16,
        });
        layers
    }

    /// As [`Self::layers`], with a recurrent unit of `size` floats in front of the head.
    pub(crate) fn recurrent_layers(&mut self, shape: Shape, size: usize) -> AgentLayers {
        let mut layers = self.layers(shape);
        let mut gates = |inputs| std::array::from_fn(|_| self.layer(inputs, size, false));
        let unit = GruLayers { input: gates(shape.base), recurrent: gates(size) };
        layers.steps.truncate(1);
        layers.steps.push(Step::Gru(Box::new(unit)));
        layers.steps.push(Step::Dense(self.layer(size, shape.actions, false)));
        layers
    }
}

/// The plan of a random network.
pub(crate) fn plan(layers: &AgentLayers, shape: Shape) -> Vec<u8> {
    plan_that(Choice::Greedy, layers, shape)
}

/// The plan of a random network that chooses in the given way.
pub(crate) fn plan_that(choice: Choice, layers: &AgentLayers, shape: Shape) -> Vec<u8> {
    let Shape { n_max, features, actions, .. } = shape;
    let sizes = AgentSizes { n_max, features, actions, choice };
    let (program, weights) = lower_agent(layers, sizes).unwrap();
    let origin = Origin {
        source: [0; 32],
        profile: Profile::Exact,
        network: Network::Agent,
        contract: 0,
        t_max: 0,
        proof: Proof::NONE,
        action_mismatch: 0.0,
    };
    assemble(&program, &weights.to_bytes(), sizes, &origin).unwrap()
}

/// The int8 plan of a random network.
pub(crate) fn int8_plan(layers: &AgentLayers, shape: Shape) -> Vec<u8> {
    int8_plan_for(layers, shape, None)
}

/// The same, rounded for observations.
pub(crate) fn int8_plan_for(
    layers: &AgentLayers,
    shape: Shape,
    examples: Option<&Recording>,
) -> Vec<u8> {
    let Shape { n_max, features, actions, .. } = shape;
    let sizes = AgentSizes { n_max, features, actions, choice: Choice::Greedy };
    let (program, weights) = lower_agent_int8(layers, sizes, examples).unwrap();
    let origin = Origin {
        source: [0; 32],
        profile: Profile::Int8,
        network: Network::Agent,
        contract: 0,
        t_max: 0,
        proof: Proof::NONE,
        action_mismatch: 0.0,
    };
    assemble(&program, &weights.bytes, sizes, &origin).unwrap()
}

/// The utilities of the plain form of the network, in f64. `state` is replaced by the new one.
pub(crate) fn reference(
    layers: &AgentLayers,
    observation: &OwnedObservation,
    state: &mut Vec<f64>,
) -> Vec<f64> {
    let columns = layers.embed.matrix.inputs;
    let embedding = |entity: usize| {
        let row = &observation.rows[entity * observation.features..][..observation.features];
        let mut input: Vec<f64> = row.iter().map(|&value| f64::from(value)).collect();
        input.resize(columns, 0.0);
        match observation.last_actions.get(entity) {
            Some(&action) if columns > observation.features && action != NO_ACTION => {
                input[observation.features + usize::from(action)] = 1.0;
            }
            _ => {}
        }
        apply(&layers.embed, &input)
    };
    let own_row = embedding(observation.self_index);
    let own = apply(&layers.query, &own_row);
    let visible: Vec<Vec<f64>> = observation.visible.iter().map(embedding).collect();
    let keys: Vec<Vec<f64>> = visible.iter().map(|x| product(&layers.key, x)).collect();
    let values: Vec<Vec<f64>> = visible.iter().map(|x| product(&layers.value, x)).collect();
    let attended = attend(&own, &keys, &values, layers.heads);
    let output = match &layers.skip {
        None => apply(&layers.output, &attended),
        Some(skip) => {
            let bias = layers.output.bias.iter().zip(product(skip, &own_row));
            let bias = bias.map(|(bias, skip)| f64::from(*bias) + skip);
            let sums = product(&layers.output.matrix, &attended).into_iter().zip(bias);
            let sums = sums.map(|(sum, bias)| sum + bias);
            sums.map(|sum| if layers.output.relu { sum.max(0.0) } else { sum }).collect()
        }
    };
    let answer = layers.steps.iter().fold(output, |input, step| match step {
        Step::Dense(layer) => apply(layer, &input),
        Step::Gru(unit) => {
            *state = next_state(unit, &input, state);
            state.clone()
        }
    });
    let Some(targets) = layers.targets else { return answer };
    let (untargeted, query) = answer.split_at(targets.untargeted.into());
    let own = &observation.rows[observation.self_index * observation.features..];
    let pairs = &own[targets.first_pair.into()..];
    let aimed = (0..usize::from(targets.count)).map(|target| {
        let entity = usize::from(targets.first_entity) + target;
        let place = observation.visible.iter().position(|visible| visible == entity);
        let features = usize::from(targets.pair_features);
        let pair = &pairs[target * features..][..features];
        place.map_or(0.0, |place| {
            let aim = visible[place].iter().copied().chain(pair.iter().map(|it| f64::from(*it)));
            query.iter().zip(aim).map(|(q, x)| q * x).sum()
        })
    });
    untargeted.iter().copied().chain(aimed).collect()
}

/// What the heads of one query, already scaled, bring together.
pub(crate) fn attend(
    query: &[f64],
    keys: &[Vec<f64>],
    values: &[Vec<f64>],
    heads: usize,
) -> Vec<f64> {
    let mut attended = vec![0.0; query.len()];
    let head = query.len() / heads;
    for start in (0..query.len()).step_by(head) {
        let range = start..start + head;
        let dot = |key: &Vec<f64>| {
            query[range.clone()].iter().zip(&key[range.clone()]).map(|(a, b)| a * b).sum::<f64>()
        };
        let scores: Vec<f64> = keys.iter().map(dot).collect();
        let largest = scores.iter().copied().fold(f64::MIN, f64::max);
        let total: f64 = scores.iter().map(|score| (score - largest).exp()).sum();
        for (score, value) in scores.iter().zip(values) {
            let weight = (score - largest).exp() / total;
            let parts = attended[range.clone()].iter_mut().zip(&value[range.clone()]);
            parts.for_each(|(sum, value)| *sum += weight * value);
        }
    }
    attended
}

/// One step of a recurrent unit.
fn next_state(unit: &GruLayers, input: &[f64], state: &[f64]) -> Vec<f64> {
    let [input_r, input_z, input_n] = unit.input.each_ref().map(|layer| apply(layer, input));
    let [state_r, state_z, state_n] = unit.recurrent.each_ref().map(|layer| apply(layer, state));
    let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
    let next = |index: usize| {
        let reset = sigmoid(input_r[index] + state_r[index]);
        let update = sigmoid(input_z[index] + state_z[index]);
        let new = (input_n[index] + reset * state_n[index]).tanh();
        (1.0 - update) * new + update * state[index]
    };
    (0..state.len()).map(next).collect()
}

pub(crate) fn apply(layer: &Layer, input: &[f64]) -> Vec<f64> {
    let sums = product(&layer.matrix, input);
    let sums = sums.iter().zip(&layer.bias).map(|(sum, &bias)| sum + f64::from(bias));
    sums.map(|sum| if layer.relu { sum.max(0.0) } else { sum }).collect()
}

fn product(matrix: &Matrix, input: &[f64]) -> Vec<f64> {
    let mut sums = vec![0.0; matrix.outputs];
    for (value, row) in input.iter().zip(matrix.values.chunks(matrix.outputs)) {
        sums.iter_mut().zip(row).for_each(|(sum, &weight)| *sum += value * f64::from(weight));
    }
    sums
}

/// The same plan with some bytes changed and its checksums made right again, as a forger would do.
pub(crate) fn forge(good: &[u8], change: impl FnOnce(&mut Vec<u8>)) -> Option<AlignedBytes> {
    let mut plan = good.to_vec();
    change(&mut plan);
    let (header, _) = Header::read(&plan).ok()?;
    let part = |offset: u32, len: u32| plan.get(offset as usize..)?.get(..len as usize);
    let program = part(header.program_offset, header.program_len)?;
    let weights = part(header.weights_offset, header.weights_len)?;
    let Checksums { program, weights } = checksums(&header, program, weights);
    plan.splice(60..64, program.to_le_bytes());
    plan.splice(64..68, weights.to_le_bytes());
    Some(AlignedBytes::copy_of(&plan))
}

/// The same plan with another program.
pub(crate) fn with_program(good: &[u8], program: &ProgramDraft) -> AlignedBytes {
    let bytes = program.to_bytes();
    let bytes = bytes.as_slice();
    let program: Program<'_> = Program::read(bytes).unwrap();
    let forged = forge(good, |plan| {
        plan[HEADER_BYTES..HEADER_BYTES + bytes.len()].copy_from_slice(bytes);
        plan[48..52].copy_from_slice(&(bytes.len() as u32).to_le_bytes());
        let per_agent = 4 * program.own_floats().unwrap_or(0);
        plan[120..124].copy_from_slice(&per_agent.to_le_bytes());
    });
    forged.unwrap()
}

/// Changes every byte of header and program to several values, and runs what still loads: the checks must
/// keep every access inside. Returns how many were refused and how many ran.
pub(crate) fn run_forged(good: &[u8], mut run: impl FnMut(&Plan<'_>)) -> (usize, usize) {
    let (header, _) = Header::read(good).unwrap();
    let end = HEADER_BYTES + header.program_len as usize;
    let (mut refused, mut ran) = (0, 0);
    for at in 12..end {
        for value in [0, 1, 2, 0x40, 0x7f, 0x80, 0xff, good[at].wrapping_add(1), good[at] ^ 0x10] {
            let Some(bytes) = forge(good, |plan| plan[at] = value) else { continue };
            match Plan::load(bytes.as_slice()) {
                Ok(plan) => {
                    ran += 1;
                    run(&plan);
                }
                Err(_) => refused += 1,
            }
        }
    }
    (refused, ran)
}

/// Asks an agent's plan for utilities; any answer will do.
pub(crate) fn ask_anything(plan: &Plan<'_>, observation: &OwnedObservation) {
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes().min(1 << 20));
    let mut utilities = vec![0.0; plan.actions()];
    let mut hidden = vec![0.5; plan.hidden()];
    let (view, hidden) = (observation.view(), Some(hidden.as_mut_slice()));
    let _ = plan.utilities(arena.as_mut_slice(), &view, hidden, &mut utilities);
}
