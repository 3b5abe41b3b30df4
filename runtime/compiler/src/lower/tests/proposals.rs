//! The allocator that proposes, against the recorded decisions of the public code and against plain loops.

use safetensors::SafeTensors;
use sortie_bundle::OwnedAllocationState;
use sortie_core::allocate::ProposalAllocator;
use sortie_core::allocate::proposals::{Draw, largest_open};
use sortie_core::plan::{AlignedBytes, Network, Plan, Profile, Proof};
use sortie_core::{EntityMask, UNASSIGNED};

use crate::lower::{AgentSizes, Choice, Origin, assemble, lower_proposals};
use crate::matching::{
    AllAttention, CriticLayers, Layer, Matrix, ProposalLayers, StepLayers, TrunkLayers,
};

const GOLDEN: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../../tests/golden/networks/allocation_decision_default.safetensors"
);

/// A plan of the layers for at most `n_max` entities.
pub(crate) fn plan(layers: &ProposalLayers, n_max: usize, profile: Profile) -> AlignedBytes {
    let (program, weights) = lower_proposals(layers, n_max).unwrap();
    let features = layers.trunk.embed.matrix.inputs;
    let sizes = AgentSizes { n_max, features, actions: 1, choice: Choice::Greedy };
    let origin = Origin {
        source: [0; 32],
        profile,
        network: Network::Proposals,
        contract: 0,
        t_max: layers.trunk.tasks.inputs as u16,
        proof: Proof::NONE,
        action_mismatch: 0.0,
    };
    AlignedBytes::copy_of(&assemble(&program, &weights.to_bytes(), sizes, &origin).unwrap())
}

/// The columns `start..` of a matrix `[out, in]`, as many as `inputs`.
fn matrix(values: &[f32], columns: usize, start: usize, inputs: usize) -> Matrix {
    let outputs = values.len() / columns;
    let row =
        |input: usize| (0..outputs).map(move |output| values[output * columns + start + input]);
    Matrix { inputs, outputs, values: (0..inputs).flat_map(row).collect() }
}

fn scaled(mut matrix: Matrix, factor: f32) -> Matrix {
    matrix.values.iter_mut().for_each(|value| *value *= factor);
    matrix
}

/// Attention from the packed `[3 E, E]` and the output layer.
fn attention(packed: &[f32], output: &[f32], bias: Vec<f32>, heads: usize) -> AllAttention {
    let width = bias.len();
    let part = |index: usize| Layer {
        matrix: matrix(&packed[index * width * width..][..width * width], width, 0, width),
        bias: vec![0.0; width],
        relu: false,
    };
    let mut query = part(0);
    query.matrix = scaled(query.matrix, 1.0 / ((width / heads) as f32).sqrt());
    let output = Layer { matrix: matrix(output, width, 0, width), bias, relu: false };
    AllAttention { heads, query, key: part(1), value: part(2), output }
}

/// The public code's tensors as layers.
fn golden_layers(file: &SafeTensors<'_>, heads: usize) -> ProposalLayers {
    let floats = |name: &str| floats(file, &format!("w/{name}"));
    let policy = |name: &str| floats(&format!("policy.{name}"));
    let critic = |name: &str| floats(&format!("critic.{name}"));
    let first = |weight: Vec<f32>, bias: Vec<f32>| {
        let inputs = weight.len() / bias.len();
        Layer { matrix: matrix(&weight, inputs, 0, inputs), bias, relu: false }
    };
    let tasks = |weight: Vec<f32>, width: usize| {
        let tasks = weight.len() / width;
        matrix(&weight, tasks, 0, tasks)
    };
    let width = policy("fc1.bias").len();
    let counts = |weight: Vec<f32>, bias: Vec<f32>, of_bias: f32| {
        let mut counts = scaled(matrix(&weight, 2, 0, 2), 0.2);
        counts.values.extend(bias.iter().map(|bias| bias * of_bias));
        Matrix { inputs: 3, ..counts }
    };
    let update = policy("embed_update.weight");
    let half = |start: usize| matrix(&update, 2 * width, start, width);
    let update_bias = policy("embed_update.bias");
    ProposalLayers {
        trunk: TrunkLayers {
            embed: first(policy("fc1.weight"), policy("fc1.bias")),
            tasks: tasks(policy("task_embed.fc.weight"), width),
            attention: attention(
                &policy("attn.in_trans.weight"),
                &policy("attn.out_trans.weight"),
                policy("attn.out_trans.bias"),
                heads,
            ),
        },
        step: StepLayers {
            counts: counts(policy("count_embed.weight"), policy("count_embed.bias"), 1.0),
            scale: 1.0 / (width as f32).sqrt(),
            from_task: Layer { matrix: half(0), bias: vec![0.0; width], relu: false },
            from_agent: Layer { matrix: half(width), bias: update_bias, relu: false },
        },
        critic: CriticLayers {
            embed: first(critic("in_fc_ent.weight"), critic("in_fc_ent.bias")),
            tasks: tasks(critic("in_fc_alloc.fc.weight"), width),
            counts: counts(
                critic("count_embed.count_embed.weight"),
                critic("count_embed.count_embed.bias"),
                0.2,
            ),
            attention: attention(
                &critic("attn.in_trans.weight"),
                &critic("attn.out_trans.weight"),
                critic("attn.out_trans.bias"),
                heads,
            ),
            head: first(critic("out_fc.weight"), critic("out_fc.bias")),
        },
    }
}

fn floats(file: &SafeTensors<'_>, name: &str) -> Vec<f32> {
    let bytes = file.tensor(name).unwrap().data();
    bytes.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
}

fn doubles(file: &SafeTensors<'_>, name: &str) -> Vec<f64> {
    let bytes = file.tensor(name).unwrap().data();
    bytes.as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect()
}

fn places(file: &SafeTensors<'_>, name: &str) -> Vec<u8> {
    let bytes = file.tensor(name).unwrap().data().as_chunks::<4>().0;
    let place = |bytes: &[u8; 4]| u8::try_from(i32::from_le_bytes(*bytes)).unwrap_or(UNASSIGNED);
    bytes.iter().map(place).collect()
}

const AGENTS: usize = 5;
const ENTITIES: usize = 11;
const TASKS: usize = 6;
const FEATURES: usize = 58;
const PROPOSALS: usize = 32;

/// The states of the recorded decisions, whose masks have a 1 for what is absent.
fn golden_states(file: &SafeTensors<'_>) -> Vec<OwnedAllocationState> {
    let mask = |name: &str| file.tensor(name).unwrap().data();
    let bits = |mask: &[u8]| {
        (0..).zip(mask).fold(0, |bits, (place, blocked)| bits | u32::from(*blocked == 0) << place)
    };
    let rows = floats(file, "in/entities");
    let last = floats(file, "in/last_alloc");
    let state = |index: usize| {
        let part = |name: &str, size: usize| &mask(name)[index * size..][..size];
        let last = last[index * AGENTS * TASKS..].chunks(TASKS).take(AGENTS);
        let last = last.map(|row| (0..).zip(row).map(|(task, is)| (*is as u32) << task).sum());
        let of_task = part("in/entity2task_mask", ENTITIES * TASKS).chunks(TASKS).skip(AGENTS);
        OwnedAllocationState {
            agents: AGENTS,
            tasks: TASKS,
            rows: rows[index * ENTITIES * FEATURES..][..ENTITIES * FEATURES].to_vec(),
            features: FEATURES,
            present: EntityMask::from_words(&[bits(part("in/entity_mask", ENTITIES)).into()]),
            entity_task: last.chain(of_task.map(bits)).collect(),
            open_tasks: bits(part("in/task_mask", TASKS)),
            available: Vec::new(),
        }
    };
    (0..rows.len() / ENTITIES / FEATURES).map(state).collect()
}

/// Draws by recorded noise, or as recorded, and sums up the logarithms of the choices' probabilities.
struct Recorded<'a> {
    noise: &'a [f32],
    log_pi: Vec<f64>,
    tasks: usize,
    agents: usize,
}

impl Draw for Recorded<'_> {
    fn draw(&mut self, proposal: usize, agent: usize, logits: &[f32], open_tasks: u32) -> usize {
        let noise = &self.noise[(proposal * self.agents + agent) * self.tasks..][..self.tasks];
        let sums: Vec<f32> = logits.iter().zip(noise).map(|(logit, noise)| logit + noise).collect();
        let task = largest_open(&sums, open_tasks);
        self.log_pi[proposal] += log_probability(logits, open_tasks, task);
        task
    }
}

/// The logarithm of the policy's probability of a subtask.
pub(crate) fn log_probability(logits: &[f32], open_tasks: u32, task: usize) -> f64 {
    let open = logits.iter().enumerate().filter(|(task, _)| open_tasks >> task & 1 == 1);
    let total: f64 = open.map(|(_, logit)| f64::from(*logit).exp()).sum();
    f64::from(logits[task]) - total.ln()
}

#[test]
fn recorded_decisions_are_made_again() {
    let bytes = std::fs::read(GOLDEN).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let layers = golden_layers(&file, 4);
    let (proposals, best) = (places(&file, "out/proposals"), places(&file, "out/best_alloc"));
    let (noise, log_pi) = (floats(&file, "in/gumbel"), doubles(&file, "out/log_pi"));
    let values = doubles(&file, "out/critic_values");
    for profile in [Profile::Exact, Profile::Fused] {
        let plan = plan(&layers, ENTITIES, profile);
        let plan = Plan::load(plan.as_slice()).unwrap();
        let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
        arena.as_mut_slice().fill(0xff);
        let mut allocator =
            ProposalAllocator::new(plan, arena.as_mut_slice(), PROPOSALS, 0).unwrap();
        for (index, state) in golden_states(&file).iter().enumerate() {
            let noise = &noise[index * PROPOSALS * AGENTS * TASKS..];
            let log_pi_of = vec![0.0; PROPOSALS];
            let mut draw = Recorded { noise, log_pi: log_pi_of, tasks: TASKS, agents: AGENTS };
            let got = allocator.propose(&state.view(), &mut draw).unwrap();
            for proposal in 0..PROPOSALS {
                let at = index * PROPOSALS + proposal;
                let want = &proposals[at * AGENTS..][..AGENTS];
                assert!(got.allocation(proposal).eq(want.iter().copied()), "{at}");
                assert!((draw.log_pi[proposal] - log_pi[at]).abs() <= 1e-5, "{at}");
                let error = (f64::from(got.values()[proposal]) - values[at]).abs();
                assert!(error <= 1e-5 * (1.0 + values[at].abs()), "{at}: {error}");
            }
            let chosen = got.allocation(got.best().unwrap());
            assert!(chosen.eq(best[index * AGENTS..][..AGENTS].iter().copied()), "{index}");
        }
    }
}
