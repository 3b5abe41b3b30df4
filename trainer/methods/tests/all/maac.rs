//! MAAC's update against recorded rounds of the public code (`tests/golden/networks-maac`).

use sortie_envs::random::generator;
use sortie_methods::maac::{ActorCritic, Batch, Config, Draw, Group, Groups, Rows};
use sortie_nn::tape::Parameters;

use crate::files::{Case, safetensors_case};

/// Three agents that share nothing.
const AGENTS: usize = 3;

struct Recorded {
    case: Case,
    heads: usize,
    target_rate: f32,
    entropy: f32,
    rounds: usize,
    groups: Groups,
}

impl Recorded {
    fn new(name: &str, heads: usize, target_rate: f32, entropy: f32, rounds: usize) -> Self {
        let case = safetensors_case("networks-maac", name);
        let columns = |name: String| case.get(&name).shape.clone();
        let group = |agent: usize| Group {
            agents: agent..agent + 1,
            observed: columns(format!("init/policy{agent}/fc1.weight"))[1],
            identity: false,
            actions: columns(format!("init/policy{agent}/fc3.weight"))[0],
        };
        let groups = Groups((0..AGENTS).map(group).collect());
        Self { case, heads, target_rate, entropy, rounds, groups }
    }

    /// A tensor by our name for it.
    fn tensor(&self, of: &str, name: &str) -> Vec<f32> {
        let parts: Vec<&str> = name.split('.').collect();
        let get = |name: String| self.case.get(&format!("{of}{name}")).f32s();
        let of_heads = |name: &str| -> Vec<f32> {
            let (kind, end) = name.split_once("HEAD").expect("a head");
            (0..self.heads).flat_map(|head| get(format!("critic/{kind}{head}{end}"))).collect()
        };
        match parts[..] {
            ["action_encoder", agent, end] => {
                get(format!("critic/critic_encoders.{agent}.enc_fc1.{end}"))
            }
            ["state_encoder", agent, end] => {
                get(format!("critic/state_encoders.{agent}.s_enc_fc1.{end}"))
            }
            ["hidden", agent, end] => get(format!("critic/critics.{agent}.critic_fc1.{end}")),
            ["head", agent, end] => get(format!("critic/critics.{agent}.critic_fc2.{end}")),
            ["query", end] => of_heads(&format!("selector_extractors.HEAD.{end}")),
            ["key", end] => of_heads(&format!("key_extractors.HEAD.{end}")),
            ["value", end] => of_heads(&format!("value_extractors.HEAD.0.{end}")),
            ["policy", agent, layer, end] => {
                let layer: usize = layer.parse().expect("a layer");
                get(format!("policy{agent}/fc{}.{end}", layer + 1))
            }
            _ => panic!("no tensor {name}"),
        }
    }

    fn weights(&self, of: &str, parameters: &Parameters) -> Vec<f32> {
        parameters.tensors().iter().flat_map(|tensor| self.tensor(of, &tensor.name)).collect()
    }

    fn column(&self, round: usize, name: &str, agent: usize) -> Vec<f32> {
        self.case.get(&format!("update{round}/{name}{agent}")).f32s()
    }

    fn batch(&self, round: usize) -> Batch {
        let all = |name: &str| (0..AGENTS).map(|agent| self.column(round, name, agent)).collect();
        let done: Vec<Vec<f32>> = all("in/done");
        let discounts =
            done.iter().map(|done| done.iter().map(|done| 0.99 * (1.0 - done)).collect());
        Batch {
            records: done[0].len(),
            observations: all("in/obs"),
            actions: self.actions(round, "in/act"),
            rewards: all("in/rew"),
            discounts: discounts.collect(),
            next: all("in/next_obs"),
            ..Batch::default()
        }
    }

    fn actions(&self, round: usize, name: &str) -> Vec<Vec<u32>> {
        let of_agent = |agent| self.column(round, name, agent).iter().map(|a| *a as u32).collect();
        (0..AGENTS).map(of_agent).collect()
    }

    fn learner(&self) -> ActorCritic {
        let mut config = Config::paper();
        config.network.critic_width = 16;
        config.network.policy_width = 16;
        config.network.heads = self.heads;
        config.optimiser.target_rate = self.target_rate;
        let mut learner = config.learner(self.groups.clone(), 1, &mut generator(1));
        for learner in [&mut learner.critic_learner, &mut learner.policy_learner] {
            let weights = self.weights("init/", &learner.online);
            learner.target.copy_from_slice(&weights);
            learner.online.values = weights;
        }
        learner
    }
}

/// The drawn actions as they were recorded: of the target policies, then of the policies.
struct Given(Vec<Vec<Vec<u32>>>);

impl Draw for Given {
    fn draw(&mut self, _: &Groups, _: &Rows) -> Vec<Vec<u32>> {
        self.0.remove(0)
    }
}

#[track_caller]
fn assert_close(what: &str, got: &[f32], want: &[f32], tolerance: f32) {
    assert_eq!(got.len(), want.len(), "{what}");
    let errors = got.iter().zip(want).map(|(got, want)| (got - want).abs());
    let worst = errors.fold(0.0, f32::max);
    assert!(worst <= tolerance, "{what}: off by {worst}");
}

#[test]
fn rounds_give_the_recorded_gradients_and_weights() {
    for recorded in [
        Recorded::new("update_3agents", 4, 0.01, 0.01, 2),
        Recorded::new("update_3agents_b", 2, 0.001, 0.1, 3),
    ] {
        let mut learner = recorded.learner();
        for round in 0..recorded.rounds {
            let drawn =
                ["sampled/next_act", "sampled/act"].map(|name| recorded.actions(round, name));
            let mut batch = recorded.batch(round);
            learner.update(&mut batch, recorded.entropy, &mut Given(drawn.to_vec()));
            let of = format!("update{round}/grad/");
            let name = |kind: &str| format!("{}, {of}, {kind}", recorded.case.name);
            for (kind, learner) in
                [("critic", &learner.critic_learner), ("policies", &learner.policy_learner)]
            {
                let want = recorded.weights(&of, &learner.online);
                assert_close(&name(kind), learner.gradient(), &want, 1e-6);
            }
        }
        let name = |kind: &str| format!("{}, {kind}", recorded.case.name);
        for (kind, learner) in
            [("critic", &learner.critic_learner), ("policies", &learner.policy_learner)]
        {
            let want = |of: &str| recorded.weights(of, &learner.online);
            assert_close(&name(kind), &learner.online.values, &want("final/"), 1e-6);
            assert_close(&name(kind), &learner.target, &want("final/target_"), 1e-6);
            assert_eq!(learner.average, learner.online.values);
        }
        for agent in 0..AGENTS {
            let seen = |numbers: &[f64]| numbers.iter().map(|x| *x as f32).collect::<Vec<f32>>();
            let of =
                |name: &str| recorded.case.get(&format!("final/policy{agent}/in_fn.{name}")).f32s();
            let running = learner.running.as_ref().unwrap();
            assert_close(&name("means"), &seen(&running.means[agent]), &of("running_mean"), 1e-6);
            let variances = seen(&running.variances[agent]);
            assert_close(&name("variances"), &variances, &of("running_var"), 1e-6);
        }
    }
}
