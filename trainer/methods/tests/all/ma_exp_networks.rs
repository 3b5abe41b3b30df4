//! The published learner of MA-Exp against recorded rounds of the public code (`tests/golden/networks-maac`).

use safetensors::SafeTensors;
use serde_json::Value;
use sortie_envs::random::generator;
use sortie_methods::ma_exp::Types;
use sortie_methods::ma_exp::networks::{
    ActorCritic, Batch, Config, Draw, Group, Groups, MetaPolicy, Moments, Rows,
};
use sortie_nn::tape::Parameters;

use crate::files::{Case, safetensors_case};

/// Two agents that see seven numbers and have five actions.
const AGENTS: usize = 2;
const ACTIONS: usize = 5;

struct Recorded {
    case: Case,
    heads: usize,
    paid: bool,
    config: Config,
    /// Losses and norms of its rounds, and turns of its meta-policy.
    logs: Value,
    turns: Value,
}

impl Recorded {
    fn new(name: &str, types: Types) -> Self {
        let case = safetensors_case("networks-maac", name);
        let mut config = Config::default();
        config.heads.intrinsic = types;
        (config.network.critic_width, config.network.base_width) = (16, 16);
        config.network.head_width = 4;
        config.returns.intrinsic_discount = 0.95;
        config.optimiser.target_rate = 0.05;
        let heads = config.heads();
        let path = format!(
            "{}/../../tests/golden/networks-maac/{name}.safetensors",
            env!("CARGO_MANIFEST_DIR")
        );
        let bytes = std::fs::read(path).unwrap();
        let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
        let said = header.metadata().clone().unwrap();
        let [logs, turns] =
            ["logs", "selector_turns"].map(|key| serde_json::from_str(&said[key]).unwrap());
        Self { case, heads: heads.len(), paid: heads[0].is_some(), config, logs, turns }
    }

    /// A tensor by our name for it.
    fn tensor(&self, of: &str, name: &str) -> Vec<f32> {
        let parts: Vec<&str> = name.split('.').collect();
        let get = |name: String| self.case.get(&format!("{of}{name}")).f32s();
        match parts[..] {
            ["encoder", end] => get(format!("critic/state_vect_encoder.vect_enc_fc.{end}")),
            [kind @ ("team" | "own"), head, agent, part, end] => {
                let kind = if kind == "team" { "extr" } else { "intr" };
                let layer = if part == "last" { 2 } else { 0 };
                let whole = get(format!("critic/{kind}_critics.{head}.{agent}.{layer}.{end}"));
                let rows = || whole.chunks_exact(ACTIONS + 16);
                match (part, end) {
                    ("others", _) => rows().flat_map(|row| &row[..ACTIONS]).copied().collect(),
                    ("state", "weight") => {
                        rows().flat_map(|row| &row[ACTIONS..]).copied().collect()
                    }
                    _ => whole,
                }
            }
            ["policy", agent, "0", end] => get(format!("policy{agent}/network.vect_fc.0.{end}")),
            ["policy", agent, layer, end] => {
                let layer = layer.parse::<usize>().unwrap() - 1;
                let (head, layer) = (layer / 2, 2 * (layer % 2));
                get(format!("policy{agent}/network.fc_out.{head}.{layer}.{end}"))
            }
            _ => panic!("no tensor {name}"),
        }
    }

    fn weights(&self, of: &str, parameters: &Parameters) -> Vec<f32> {
        parameters.tensors().iter().flat_map(|tensor| self.tensor(of, &tensor.name)).collect()
    }

    fn input(&self, round: usize, name: &str) -> Vec<f32> {
        self.case.get(&format!("update{round}/in/{name}")).f32s()
    }

    fn of_agents<T>(&self, of_agent: impl Fn(usize) -> T) -> Vec<T> {
        (0..AGENTS).map(of_agent).collect()
    }

    fn batch(&self, round: usize) -> Batch {
        let input = |name: &str| self.input(round, name);
        let observed = |name: &str| self.of_agents(|agent| input(&format!("{name}{agent}")));
        let (rewards, done) = (input("rew"), input("done"));
        let discounts: Vec<f32> = done.iter().map(|done| 0.99 * (1.0 - done)).collect();
        let records = rewards.len();
        let whole = |numbers: Vec<f32>| numbers.into_iter().map(|number| number as u32).collect();
        // By types and agents there, by agents and heads here.
        let paid = if self.paid { input("intr_rew") } else { Vec::new() };
        let own = (0..AGENTS * self.heads).map(|index| {
            let (agent, head) = (index / self.heads, index % self.heads);
            let start = (head * AGENTS + agent) * records;
            paid.get(start..start + records).unwrap_or_default().to_vec()
        });
        Batch {
            paid: own.collect(),
            states: ["state", "next_state"].map(input),
            records,
            observations: observed("obs"),
            actions: self.of_agents(|agent| whole(input(&format!("act{agent}")))),
            rewards: vec![rewards; AGENTS],
            discounts: vec![discounts; AGENTS],
            next: observed("next_obs"),
            follows: Vec::new(),
        }
    }

    /// By agents and heads: actions that were drawn in a round.
    fn drawn(&self, round: usize, name: &str) -> Vec<Vec<u32>> {
        let drawn = self.case.get(&format!("update{round}/sampled/{name}")).f32s();
        let records = drawn.len() / (AGENTS * self.heads);
        drawn.chunks_exact(records).map(|own| own.iter().map(|a| *a as u32).collect()).collect()
    }

    fn learner(&self, threads: usize) -> ActorCritic {
        let group = |agent: usize| Group {
            agents: agent..agent + 1,
            observed: 7,
            identity: false,
            actions: ACTIONS,
        };
        let groups = Groups((0..AGENTS).map(group).collect());
        let mut learner = self.config.learner_of(groups, 12, threads, &mut generator(1));
        for learner in [&mut learner.critic_learner, &mut learner.policy_learner] {
            learner.target = self.weights("init/target_", &learner.online);
            learner.online.values = self.weights("init/", &learner.online);
        }
        learner
    }
}

/// The drawn actions as they were recorded: of the target policies, then of the policies. Keeps the scores.
struct Given {
    actions: Vec<Vec<Vec<u32>>>,
    scores: Vec<Rows>,
}

impl Draw for Given {
    fn draw(&mut self, _: &Groups, scores: &Rows) -> Vec<Vec<u32>> {
        self.scores.push(scores.clone());
        self.actions.remove(0)
    }
}

#[track_caller]
fn assert_close(what: &str, got: &[f32], want: &[f32], tolerance: f32) {
    assert_eq!(got.len(), want.len(), "{what}");
    let errors = got.iter().zip(want).map(|(got, want)| (got - want).abs());
    let worst = errors.fold(0.0, f32::max);
    assert!(worst <= tolerance, "{what}: off by {worst}");
}

fn recordings() -> [(Recorded, usize); 2] {
    [
        (Recorded::new("maexp_update_n2", Types::Multi), 2),
        (Recorded::new("maexp_update_sac_noexp", Types::None), 1),
    ]
}

#[test]
fn rounds_give_the_recorded_losses_gradients_and_weights() {
    for (recorded, rounds) in recordings() {
        let mut learner = recorded.learner(1);
        for round in 0..rounds {
            let actions = ["next_act", "act"].map(|name| recorded.drawn(round, name)).to_vec();
            let mut given = Given { actions, scores: Vec::new() };
            let entropy = recorded.config.returns.entropy;
            let report = learner.update(&mut recorded.batch(round), entropy, &mut given);
            let of = format!("update{round}/grad/");
            let name = |kind: &str| format!("{}, {of}, {kind}", recorded.case.name);
            let logs = &recorded.logs[round];
            let logged = |key: &str| logs[key].as_f64().unwrap();
            let loss = logged("losses/q_loss");
            assert!((report.loss - loss).abs() < 1e-6 * loss, "{} {loss}", report.loss);
            let norm = logged("grad_norms/critic");
            assert!((f64::from(report.gradient_norm) - norm).abs() < 1e-6 * norm, "{norm}");
            for (kind, learner) in
                [("critic", &learner.critic_learner), ("policies", &learner.policy_learner)]
            {
                let want = recorded.weights(&of, &learner.online);
                assert_close(&name(kind), learner.gradient(), &want, 1e-6);
            }
            for agent in 0..AGENTS {
                let name = format!("update{round}/fwd/logits_agent{agent}");
                let scores = &given.scores[1][agent * recorded.heads..][..recorded.heads];
                assert_close(&name, &scores.concat(), &recorded.case.get(&name).f32s(), 1e-6);
            }
        }
        let name = |kind: &str| format!("{}, {kind}", recorded.case.name);
        for learner in [&learner.critic_learner, &learner.policy_learner] {
            for (of, got) in
                [("final/", &learner.online.values), ("final/target_", &learner.target)]
            {
                assert_close(&name(of), got, &recorded.weights(of, &learner.online), 1e-6);
            }
        }
    }
}

#[test]
fn turns_move_the_meta_policy_as_recorded() {
    for (recorded, _) in recordings() {
        let mut random = generator(1);
        let mut meta = MetaPolicy::new(recorded.heads, &mut random);
        meta.scores = recorded.case.get("init/selector/selector").data.clone();
        for turn in recorded.turns.as_array().unwrap() {
            let numbers = |key: &str| -> Vec<f64> {
                turn[key].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
            };
            meta.head = turn["head"].as_u64().unwrap() as usize;
            meta.learn(&recorded.config.meta, &numbers("returns"));
            for (moments, mean) in meta.returns.iter().zip(numbers("means")) {
                assert!((moments.mean - mean).abs() < 1e-9, "{} {mean}", moments.mean);
            }
            for (score, want) in meta.scores.iter().zip(numbers("selector_after")) {
                assert!((score - want).abs() < 1e-5, "{score} {want}");
            }
        }
        let last = meta.scores.iter().map(|score| *score as f32).collect::<Vec<_>>();
        let want = recorded.case.get("final/selector/selector").f32s();
        assert_close("the meta-policy", &last, &want, 1e-5);
    }
}

#[test]
fn intrinsic_rewards_have_the_recorded_deviations() {
    for agents in [2, 4] {
        let case = safetensors_case("networks-maac", &format!("maexp_intrinsic_n{agents}"));
        let mut moments = vec![Moments::default(); 5 * agents];
        for update in 0..4 {
            let get = |name: &str| case.get(&format!("u{update}/{name}")).data.clone();
            let [rewards, means, variances, counts] =
                ["reward", "rms_mean", "rms_var", "rms_count"].map(get);
            let batch = rewards.len() / moments.len();
            for (pair, moments) in moments.iter_mut().enumerate() {
                // Recorded are rewards that were divided by the deviation of then.
                let paid = rewards[pair * batch..][..batch].iter();
                let paid: Vec<f64> = paid.map(|reward| reward * variances[pair].sqrt()).collect();
                if update < 3 {
                    moments.add(&paid);
                }
                for (got, want) in [
                    (moments.mean, means[pair]),
                    (moments.variance, variances[pair]),
                    (moments.count, counts[pair]),
                ] {
                    assert!((got - want).abs() < 1e-6, "{agents}, {update}, {pair}: {got} {want}");
                }
            }
        }
    }
}

/// More records than a chunk has.
#[test]
fn any_number_of_threads_finds_the_same_bits() {
    let (recorded, _) = &recordings()[0];
    let small = recorded.batch(0);
    let times = |numbers: &Vec<f32>| numbers.repeat(40);
    let batch = Batch {
        records: 40 * small.records,
        observations: small.observations.iter().map(times).collect(),
        actions: small.actions.iter().map(|actions| actions.repeat(40)).collect(),
        rewards: small.rewards.iter().map(times).collect(),
        discounts: small.discounts.iter().map(times).collect(),
        next: small.next.iter().map(times).collect(),
        follows: Vec::new(),
        states: small.states.clone().map(|state| state.repeat(40)),
        paid: small.paid.iter().map(times).collect(),
    };
    let learned = |threads: usize| {
        let mut learner = recorded.learner(threads);
        learner.update(&mut batch.clone(), 0.01, &mut generator(7));
        [learner.critic_learner, learner.policy_learner].map(|learner| learner.online.values)
    };
    let alone = learned(1);
    assert!(alone == learned(2) && alone == learned(5));
}
