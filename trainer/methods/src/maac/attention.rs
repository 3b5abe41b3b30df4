//! What agents think, for whoever looks on: their scores, and whom the critic looks at (dissertation figure 3.5).

use sortie_learn::Thought;
use sortie_nn::tape::Tape;

use crate::actor_critic::acting::Acting;
use crate::actor_critic::critic::Shown;
use crate::actor_critic::groups::{Group, Rows};
use crate::actor_critic::learner::ActorCritic;

/// `[scenes, A]`: what agents that have looked at scenes think, where these are their actions.
///
/// Nobody's attention is told where inputs are normalised over batches: a scene alone is none.
pub(super) fn thoughts(learner: &ActorCritic, acting: &Acting, actions: &[u16]) -> Vec<Thought> {
    let groups = &learner.groups;
    let scenes = actions.len() / groups.agents();
    let is_told = learner.running.is_none();
    let looks = if is_told { looks(learner, &acting.shown, actions) } else { Vec::new() };
    let mut thoughts = vec![Thought::default(); actions.len()];
    let mut looks = looks.into_iter();
    for (group, scores) in groups.0.iter().zip(&acting.scores) {
        let mut scores = scores.chunks_exact(group.actions);
        for scene in 0..scenes {
            for agent in group.agents.clone() {
                let thought = &mut thoughts[scene * groups.agents() + agent];
                thought.scores = scores.next().unwrap_or_default().to_vec();
                let others = (0..groups.agents()).filter(|other| *other != agent);
                thought.attention = others.zip(looks.next().unwrap_or_default()).collect();
            }
        }
    }
    thoughts
}

/// For every row of some scenes the weights of all others, by heads; none where all count the same.
fn looks(learner: &ActorCritic, observations: &Rows, actions: &[u16]) -> Vec<Vec<Vec<f32>>> {
    let ActorCritic { critic, groups, critic_learner, .. } = learner;
    let agents = groups.agents();
    let scenes = actions.len() / agents;
    let of_group = |group: &Group| {
        let rows = actions.chunks_exact(agents).flat_map(|scene| &scene[group.agents.clone()]);
        rows.map(|action| u32::from(*action)).collect()
    };
    let actions: Vec<Vec<u32>> = groups.0.iter().map(of_group).collect();
    let own = &Rows::new();
    let shown = Shown { observations, states: &[], actions: &actions, own, learns: false };
    let mut tape = Tape::default();
    let mut pass = tape.begin(&critic_learner.online.values);
    let values = critic.values(&mut pass, shown, 0..scenes);
    let weights = values.attended.and_then(|attended| pass.attention_weights(attended));
    let Some(weights) = weights.filter(|weights| !weights.is_empty()) else { return Vec::new() };
    let of_row = weights.len() / (agents * scenes);
    let heads = of_row / (agents - 1);
    let row = |weights: &[f32]| weights.chunks_exact(heads).map(<[f32]>::to_vec).collect();
    weights.chunks_exact(of_row).map(row).collect()
}

#[cfg(test)]
mod tests {
    use sortie_envs::random::generator;
    use sortie_envs::{EntitySet, Environment, Observation, Split};
    use sortie_learn::{Scene, Scenes};
    use sortie_nn::random::stream;

    use super::*;
    use crate::actor_critic::groups::{Groups, SLOPE};
    use crate::maac::{Config, CriticKind};

    /// Two rovers and two towers in two scenes.
    struct Fixture {
        world: Box<dyn Environment>,
        config: Config,
        learner: ActorCritic,
        states: [Vec<u8>; 2],
    }

    const ACTIONS: [u16; 8] = [0, 1, 2, 3, 4, 3, 2, 1];

    impl Fixture {
        fn new(config: Config) -> Self {
            let world =
                sortie_envs::open("particle/rover-tower-4", Split::Test, 1, &Default::default());
            let mut world = world.unwrap();
            let states = [1, 2].map(|seed| {
                world.reset(0, &mut generator(seed));
                let mut state = Vec::new();
                world.save(0, &mut state);
                state
            });
            let network = &config.network;
            let groups = Groups::new(world.spec(), network.shared, network.identity);
            let learner = config.learner(groups, 1, &mut stream(1, 1, 0));
            Self { world, config, learner, states }
        }

        fn thoughts(&self) -> Vec<Thought> {
            let learner = &self.learner;
            let actors = self.config.actors(learner, &learner.policy_learner.online.values);
            let scene = |state| Scene { instance: 0, state, begins: true, tasks_changed: false };
            let scenes: Vec<Scene<'_>> = self.states.iter().map(|state| scene(state)).collect();
            let mut acting = Acting::default();
            acting.look(actors, &Scenes { environment: &*self.world, scenes: &scenes });
            thoughts(learner, &acting, &ACTIONS)
        }

        /// What an agent's networks are shown, told which of the two of its role it is.
        fn shown(&self, scene: usize, agent: usize) -> Vec<f32> {
            let mut seen = Observation::default();
            self.world.observe(&self.states[scene], 0, EntitySet::MAX, &mut seen);
            let mut row = vec![0.0; self.world.spec().features_of(agent).len()];
            seen.rows.write_dense(agent, &mut row);
            row.iter_mut().for_each(|number| *number *= self.config.network.input_scale);
            row.extend((0..2).map(|place| f32::from(u8::from(place == agent % 2))));
            row
        }

        /// A layer of the critic by its name, with a leaky ReLU if it has offsets.
        fn layer(&self, name: &str, x: &[f32]) -> Vec<f32> {
            let parameters = &self.learner.critic_learner.online;
            let tensor = |part: &str| {
                let name = format!("{name}{part}");
                let tensor = parameters.tensors().iter().find(|tensor| tensor.name == name);
                tensor.map(|tensor| &parameters.values[tensor.range.clone()])
            };
            let weight = tensor(".weight").or_else(|| tensor("")).expect(name);
            let bias = tensor(".bias");
            let output = |(index, row): (usize, &[f32])| {
                let sum: f32 = row.iter().zip(x).map(|(weight, x)| weight * x).sum();
                let Some(bias) = bias else { return sum };
                let y = sum + bias[index];
                if y > 0.0 { y } else { SLOPE * y }
            };
            weight.chunks_exact(x.len()).enumerate().map(output).collect()
        }

        fn query(&self, scene: usize, agent: usize) -> Vec<f32> {
            let encoder = format!("state_encoder.{}", agent / 2);
            self.layer("query", &self.layer(&encoder, &self.shown(scene, agent)))
        }

        fn key(&self, scene: usize, agent: usize) -> Vec<f32> {
            let mut shown = self.shown(scene, agent);
            let taken = ACTIONS[4 * scene + agent];
            shown.extend((0..5).map(|action| f32::from(u8::from(action == taken))));
            let encoder = format!("action_encoder.{}", agent / 2);
            self.layer("key", &self.layer(&encoder, &shown))
        }
    }

    fn config() -> Config {
        let mut config = Config::default();
        config.network.normalised = false;
        config.network.shared = true;
        config.network.identity = true;
        config.network.input_scale = 3.0;
        config.network.heads = 4;
        config.network.critic_width = 16;
        config
    }

    #[test]
    fn weights_are_the_softmax_of_queries_and_keys_over_the_others() {
        let fixture = Fixture::new(config());
        let thoughts = fixture.thoughts();
        assert_eq!(thoughts.len(), 8);
        for (row, thought) in thoughts.iter().enumerate() {
            let (scene, agent) = (row / 4, row % 4);
            let others: Vec<usize> = (0..4).filter(|other| *other != agent).collect();
            let found: Vec<usize> = thought.attention.iter().map(|(other, _)| *other).collect();
            assert_eq!(found, others);
            let query = fixture.query(scene, agent);
            let keys: Vec<Vec<f32>> =
                others.iter().map(|other| fixture.key(scene, *other)).collect();
            for head in 0..4 {
                let score = |key: &Vec<f32>| {
                    let part = 4 * head..4 * head + 4;
                    let products = query[part.clone()].iter().zip(&key[part]).map(|(q, k)| q * k);
                    (products.sum::<f32>() / 2.0).exp()
                };
                let scores: Vec<f32> = keys.iter().map(score).collect();
                let sum: f32 = scores.iter().sum();
                for (score, (other, weights)) in scores.iter().zip(&thought.attention) {
                    let (want, got) = (score / sum, weights[head]);
                    assert!((want - got).abs() < 1e-5, "{agent} at {other}: {want} {got}");
                }
            }
        }
    }

    #[test]
    fn who_looks_at_nobody_in_particular_still_has_scores() {
        let looking = Fixture::new(config()).thoughts();
        let mut uniform = config();
        uniform.network.critic = CriticKind::Uniform;
        let mut normalised = config();
        normalised.network.normalised = true;
        for config in [uniform, normalised] {
            let thoughts = Fixture::new(config).thoughts();
            assert!(thoughts.iter().all(|thought| thought.attention.is_empty()));
            assert!(thoughts.iter().all(|thought| thought.scores.len() == 5));
        }
        // Each agent's own, scene by scene.
        let scores: Vec<&Vec<f32>> = looking.iter().map(|thought| &thought.scores).collect();
        assert!((0..8).all(|one| (0..one).all(|other| scores[one] != scores[other])), "{scores:?}");
    }
}
