//! MAAC's preset `paper`: a round of updates.

use std::collections::HashMap;
use std::path::Path;

use sortie_cli::failure::{Exit, Failure};
use sortie_cli::methods;
use sortie_envs::random::{below, unit};
use sortie_learn::random::{Purpose, generator};
use sortie_methods::maac::{ActorCritic, Batch, Config, Group, Groups, MAAC};
use sortie_nn::layers::products::Products;
use sortie_nn::random::Generator;

use super::super::Figures;
use super::TrainArguments;
use super::program::{Expected, Tensors};
use super::round::{self, Kept, Round};

/// The world whose sizes the networks have.
const SET: &str = "treasure-8";

/// Networks, and what they learn from.
struct MaacRound {
    config: Config,
    groups: Groups,
    learner: ActorCritic,
    batch: Batch,
    random: Generator,
    /// With which instructions products are computed.
    products: Products,
}

pub(super) fn measure(arguments: &TrainArguments) -> Result<Figures, Failure> {
    round::measure(arguments, MaacRound::new)
}

impl MaacRound {
    fn new(assignments: &[String], seed: u64) -> Result<Self, Failure> {
        let set = |setup, assignment: &String| MAAC.set(&setup, assignment);
        let mut setup = assignments.iter().try_fold(MAAC.preset("paper")?, set)?;
        setup.environment.set = SET.to_string();
        methods::settle(&MAAC, &mut setup.environment)?;
        let environment = methods::open_environment(&setup.environment)?;
        let products = setup.run.settled_products()?;
        products.use_here();
        let mut config: Config = setup.own()?;
        // As the PyTorch of today has it; the work is the same.
        config.optimiser.early_epsilon = false;
        let groups = Groups::new(environment.spec(), false, false);
        let mut random = generator(seed, Purpose::Replay, 0);
        let batch = batch(&groups, &config, &mut random);
        let mut weights = generator(seed, Purpose::Weights, 0);
        let learner = config.learner(groups.clone(), 1, &mut weights);
        Ok(Self { config, groups, learner, batch, random, products })
    }
}

impl Round for MaacRound {
    const PROGRAM: &'static str = include_str!("../../../../benches/maac_round.py");

    fn name(&self) -> String {
        let (records, products) = (self.config.replay.batch, self.products);
        format!("round of MAAC, {records} records of {SET}, {products}")
    }

    fn update(&mut self) {
        self.learner.update(&mut self.batch, self.config.entropy.end, &mut self.random);
    }

    fn write(&mut self, path: &Path) -> Result<Expected, Failure> {
        let mut tensors = Tensors::default();
        let Self { config, groups, learner, batch, random, .. } = self;
        tensors.weights(learner);
        for (index, group) in groups.0.iter().enumerate() {
            let rows = batch.records;
            let mut floats = |kind: &str, columns: &[usize], values: &[f32]| {
                let shape = [&[rows], columns].concat();
                tensors.floats(format!("{kind}.{index}"), &shape, values);
            };
            floats("observations", &[group.inputs()], &batch.observations[index]);
            floats("next", &[group.inputs()], &batch.next[index]);
            floats("rewards", &[], &batch.rewards[index]);
            floats("discounts", &[], &batch.discounts[index]);
        }
        tensors.actions("actions", &batch.actions);
        let mut kept = Kept { random, drawn: Vec::new() };
        let report = learner.update(batch, config.entropy.end, &mut kept);
        for (kind, drawn) in ["drawn_next", "drawn"].iter().zip(&kept.drawn) {
            tensors.actions(kind, drawn);
        }
        tensors.gradients(learner);
        tensors
            .write(settings(config, groups), path)
            .map_err(|error| Failure::new(Exit::Bug, format!("{}: {error}", path.display())))?;
        Ok(Expected { loss: report.loss, gradient_norm: f64::from(report.gradient_norm) })
    }

    fn operations(&self) -> f64 {
        self.groups.0.iter().map(|group| operations(group, &self.groups, &self.config)).sum()
    }
}

/// Records of agents that saw noise, did anything and earned noise; one in fifty ended an episode.
fn batch(groups: &Groups, config: &Config, random: &mut Generator) -> Batch {
    let records = config.replay.batch;
    let mut batch = Batch { records, ..Batch::default() };
    for group in &groups.0 {
        let mut noise = |count: usize| -> Vec<f32> {
            (0..count).map(|_| 2.0 * unit(random) as f32 - 1.0).collect()
        };
        batch.observations.push(noise(records * group.inputs()));
        batch.next.push(noise(records * group.inputs()));
        batch.rewards.push(noise(records));
        let actions = (0..records).map(|_| below(random, group.actions) as u32);
        batch.actions.push(actions.collect());
        let goes_on = (0..records).map(|_| if below(random, 50) == 0 { 0.0 } else { 1.0 });
        let discounts = goes_on.map(|goes_on| config.returns.discount * goes_on);
        batch.discounts.push(discounts.collect());
    }
    batch
}

fn settings(config: &Config, groups: &Groups) -> HashMap<String, String> {
    let (optimiser, update) = (&config.optimiser, &config.update);
    let of = |(name, number): (&str, f64)| (name.to_string(), number.to_string());
    let settings = [
        ("agents", groups.agents() as f64),
        ("heads", config.network.heads as f64),
        ("rate", f64::from(optimiser.critic_rate)),
        ("weight_decay", f64::from(optimiser.weight_decay)),
        ("critic_clip", f64::from(optimiser.critic_clip)),
        ("policy_clip", f64::from(optimiser.policy_clip)),
        ("target_rate", f64::from(optimiser.target_rate)),
        ("entropy", f64::from(config.entropy.end)),
        ("attention_penalty", f64::from(update.attention_penalty)),
        ("score_penalty", f64::from(update.score_penalty)),
    ];
    settings.into_iter().map(of).collect()
}

/// Operations of the products of a round for the agents of a group: of three passes through the critic one goes back, of
/// three through the policy too. A layer that goes back costs as much again for its weights, and as much for its input.
fn operations(group: &Group, groups: &Groups, config: &Config) -> f64 {
    let (inputs, actions) = (group.inputs(), group.actions);
    let (critic, policy) = (config.network.critic_width, config.network.policy_width);
    let others = groups.agents() - 1;
    // Layers that are shown the batch, whose slopes nobody asks for.
    let first = [(inputs + actions) * critic + inputs * critic, inputs * policy];
    let inner = [
        3 * critic * critic + 2 * others * critic + 2 * critic * critic + critic * actions,
        policy * policy + policy * actions,
    ];
    let passes: usize = first.iter().zip(inner).map(|(first, inner)| 4 * first + 5 * inner).sum();
    let rows = config.replay.batch * group.agents.len();
    2.0 * (rows * passes) as f64
}
