//! MA-Exp's preset `paper`: a round of updates.

use std::collections::HashMap;
use std::path::Path;

use sortie_cli::failure::{Exit, Failure};
use sortie_cli::methods;
use sortie_envs::random::{below, unit};
use sortie_learn::random::{Purpose, generator};
use sortie_methods::ma_exp::MA_EXP;
use sortie_methods::ma_exp::networks::{ActorCritic, Batch, Config};
use sortie_nn::layers::products::Products;
use sortie_nn::random::Generator;

use super::super::Figures;
use super::TrainArguments;
use super::program::{Expected, Tensors};
use super::round::{self, Kept, Round};

/// The world whose sizes the networks have.
const SET: &str = "task1-2";

/// Networks, and what they learn from.
struct MaExpRound {
    config: Config,
    learner: ActorCritic,
    batch: Batch,
    random: Generator,
    /// With which instructions products are computed.
    products: Products,
}

pub(super) fn measure(arguments: &TrainArguments) -> Result<Figures, Failure> {
    round::measure(arguments, MaExpRound::new)
}

impl MaExpRound {
    fn new(assignments: &[String], seed: u64) -> Result<Self, Failure> {
        let set = |setup, assignment: &String| MA_EXP.set(&setup, assignment);
        let mut setup = assignments.iter().try_fold(MA_EXP.preset("paper")?, set)?;
        setup.environment.set = SET.to_string();
        methods::settle(&MA_EXP, &mut setup.environment)?;
        let environment = methods::open_environment(&setup.environment)?;
        let products = setup.run.settled_products()?;
        products.use_here();
        let mut config: Config = setup.own()?;
        // As the PyTorch of today has it; the work is the same.
        config.optimiser.early_epsilon = false;
        let mut weights = generator(seed, Purpose::Weights, 0);
        let learner = config
            .learner(environment.spec(), 1, &mut weights)
            .ok_or_else(|| Failure::new(Exit::Bug, "the gridworld shows no places"))?;
        let mut random = generator(seed, Purpose::Replay, 0);
        let batch = batch(&learner, &config, &mut random);
        Ok(Self { config, learner, batch, random, products })
    }
}

impl Round for MaExpRound {
    const PROGRAM: &'static str = include_str!("../../../../benches/ma_exp_round.py");

    fn name(&self) -> String {
        let (records, products) = (self.config.replay.batch, self.products);
        format!("round of MA-Exp, {records} records of {SET}, {products}")
    }

    fn update(&mut self) {
        self.learner.update(&mut self.batch, self.config.returns.entropy, &mut self.random);
    }

    fn write(&mut self, path: &Path) -> Result<Expected, Failure> {
        let mut tensors = Tensors::default();
        let Self { config, learner, batch, random, .. } = self;
        tensors.weights(learner);
        let mut floats = |name: String, values: &[f32]| {
            let columns = values.len() / batch.records;
            let shape = [batch.records, columns];
            tensors.floats(name, if columns == 1 { &shape[..1] } else { &shape }, values);
        };
        for (kind, all) in
            [("observations", &batch.observations), ("next", &batch.next), ("own", &batch.paid)]
        {
            for (index, values) in all.iter().enumerate() {
                floats(format!("{kind}.{index}"), values);
            }
        }
        let goes_on: Vec<f32> = batch.discounts[0]
            .iter()
            .map(|discount| f32::from(u8::from(*discount > 0.0)))
            .collect();
        for (kind, values) in [
            ("states", &batch.states[0]),
            ("next_states", &batch.states[1]),
            ("rewards", &batch.rewards[0]),
            ("goes_on", &goes_on),
        ] {
            floats(kind.to_string(), values);
        }
        tensors.actions("actions", &batch.actions);
        let mut kept = Kept { random, drawn: Vec::new() };
        let report = learner.update(batch, config.returns.entropy, &mut kept);
        for (kind, drawn) in ["drawn_next", "drawn"].iter().zip(&kept.drawn) {
            tensors.actions(kind, drawn);
        }
        tensors.gradients(learner);
        tensors
            .write(settings(config, learner), path)
            .map_err(|error| Failure::new(Exit::Bug, format!("{}: {error}", path.display())))?;
        Ok(Expected { loss: report.loss, gradient_norm: f64::from(report.gradient_norm) })
    }

    /// Of three passes through the critic one goes back, of three through the policies too. A layer that goes back costs as
    /// much again for its weights, and as much for its input.
    fn operations(&self) -> f64 {
        let Self { config, learner, batch, .. } = self;
        let (network, heads) = (&config.network, config.heads().len());
        let records = batch.records;
        let agents = learner.groups.0.len();
        let mut passes = 4 * batch.states[0].len() / records * network.critic_width;
        for group in &learner.groups.0 {
            let others = (agents - 1) * group.actions;
            let value = [
                others * network.critic_width,
                (network.critic_width + group.actions) * network.critic_width,
            ];
            let head = (network.base_width + group.actions) * network.head_width;
            passes += 4 * group.inputs() * network.base_width + 5 * heads * head;
            passes += 2 * heads * (4 * value[0] + 5 * value[1]);
        }
        2.0 * (records * passes) as f64
    }
}

/// Records of agents that saw noise, did anything and earned noise; one in fifty ended an episode.
fn batch(learner: &ActorCritic, config: &Config, random: &mut Generator) -> Batch {
    let records = config.replay.batch;
    let groups = &learner.groups;
    let noise = |columns: usize, random: &mut Generator| -> Vec<f32> {
        (0..records * columns).map(|_| 2.0 * unit(random) as f32 - 1.0).collect()
    };
    let encoder = &learner.critic_learner.online.tensors()[0];
    let state = encoder.shape[1];
    let states = [state, state].map(|columns| noise(columns, random));
    let pairs = 0..groups.0.len() * learner.policies.heads;
    let paid = pairs.map(|_| noise(1, random)).collect();
    let discount = config.returns.discount;
    let discounts: Vec<f32> =
        (0..records).map(|_| if below(random, 50) == 0 { 0.0 } else { discount }).collect();
    let rewards = noise(1, random);
    let mut seen = || groups.0.iter().map(|group| noise(group.inputs(), random)).collect();
    let [observations, next] = [seen(), seen()];
    let did = groups
        .0
        .iter()
        .map(|group| (0..records).map(|_| below(random, group.actions) as u32).collect());
    Batch {
        records,
        observations,
        actions: did.collect(),
        rewards: vec![rewards; groups.0.len()],
        discounts: vec![discounts; groups.0.len()],
        next,
        follows: Vec::new(),
        states,
        paid,
    }
}

fn settings(config: &Config, learner: &ActorCritic) -> HashMap<String, String> {
    let (optimiser, returns) = (&config.optimiser, &config.returns);
    let of = |(name, number): (&str, f64)| (name.to_string(), number.to_string());
    let settings = [
        ("agents", learner.groups.0.len() as f64),
        ("heads", learner.policies.heads as f64),
        ("choices", learner.groups.0[0].actions as f64),
        ("rate", f64::from(optimiser.critic_rate)),
        ("weight_decay", f64::from(optimiser.weight_decay)),
        ("critic_clip", f64::from(optimiser.critic_clip)),
        ("policy_clip", f64::from(optimiser.policy_clip)),
        ("target_rate", f64::from(optimiser.target_rate)),
        ("score_penalty", f64::from(optimiser.score_penalty)),
        ("entropy", f64::from(returns.entropy)),
        ("discount", f64::from(returns.discount)),
        ("own_discount", f64::from(returns.intrinsic_discount)),
        ("own_weight", f64::from(returns.intrinsic_weight)),
    ];
    settings.into_iter().map(of).collect()
}
