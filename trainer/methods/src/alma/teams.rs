//! What a team of ALMA is made of: who allocates, and agents that act in many worlds at once, alone, with a memory, or told
//! strategies by a coach.

use sortie_envs::random::{chance, member};
use sortie_envs::{Observation, UNASSIGNED};
use sortie_learn::networks::best;
use sortie_learn::subtasks::{self, AllocatedScene, MaskedViews};
use sortie_learn::{LearnError, Thought};
use sortie_nn::random::Generator;
use sortie_nn::tape::{Gru, Tape};

use crate::alma::agents::{
    Columns, Conditioning, NO_ACTION, NetworkPolicy, TeamBatch, UtilityLayers, UtilityShape,
    UtilityView,
};
use crate::alma::coach::{Advice, Coach};

/// Agents that learn or have learned, greedy, on all scenes at once.
#[derive(Debug)]
pub struct NetworkAgents<'a> {
    agents: Agents<'a>,
    players: Players,
    advice: Option<Advice<'a>>,
}

impl<'a> NetworkAgents<'a> {
    /// Acts by agents that see subtasks as they were trained to, and are told their strategies if they have a coach.
    pub fn new(agents: Agents<'a>, conditioning: Conditioning) -> Self {
        let advice = agents.coach.map(Advice::new);
        Self { agents, players: Players::new(conditioning), advice }
    }
}

impl subtasks::Agents for NetworkAgents<'_> {
    fn act(
        &mut self,
        scenes: &[AllocatedScene<'_>],
        actions: &mut [u16],
        slots: usize,
    ) -> Result<(), LearnError> {
        self.players.act(self.agents, scenes, slots, |scene, agent, utilities| {
            let available = scenes[scene].seen.available[agent];
            actions[scene * slots + agent] = best(utilities, available) as u16;
        })
    }

    fn advise(&mut self, seen: &Observation, strategies: &mut Vec<f32>) -> Result<(), LearnError> {
        self.advice.as_mut().map_or(Ok(()), |advice| advice.mean(seen, strategies))
    }

    /// Of agents that decide by what the subtask mask shows and nothing else, whom they attend to can be told.
    fn thoughts(&mut self, scenes: &[AllocatedScene<'_>]) -> Vec<Thought> {
        let Agents { network, unit, .. } = self.agents;
        if self.players.conditioning != Conditioning::Mask || unit.is_some() {
            return Vec::new();
        }
        let (mut policy, mut views) = (NetworkPolicy::new(network), MaskedViews::default());
        let mut thoughts = Vec::new();
        for scene in scenes {
            views.look(scene);
            let slots = thoughts.len() + scene.allocation.len();
            for observation in views.observations() {
                // The rows are those that the network has just acted on.
                let scores = policy.utilities(&observation).unwrap_or_default();
                let attention = policy.attention(&observation);
                let attention = attention.map(|(entity, weights)| (entity, weights.to_vec()));
                let attention = attention.collect();
                thoughts.push(Thought { scores, attention, ..Thought::default() });
            }
            thoughts.resize(slots, Thought::default());
        }
        thoughts
    }
}

/// What agents act by.
#[derive(Clone, Copy, Debug)]
pub struct Agents<'a> {
    /// Their utility network.
    pub network: UtilityView<'a>,
    /// The recurrent unit of their memory among the same parameters, if they have one.
    pub unit: Option<Gru>,
    /// What tells them their strategies at decision points, if anything does (COPA).
    pub coach: Option<Coach<'a>>,
}

impl<'a> Agents<'a> {
    /// Agents without memory and coach.
    pub fn new(network: UtilityView<'a>) -> Self {
        Self { network, unit: None, coach: None }
    }
}

/// The buffers to act with, and what agents remember of the running episodes.
#[derive(Debug, Default)]
pub struct Players {
    conditioning: Conditioning,
    batch: TeamBatch,
    tape: Tape,
    /// (scene, agent) of every row of the batch.
    actors: Vec<(usize, usize)>,
    /// `[worlds, A, R]`: what every agent remembers.
    memory: Vec<f32>,
    /// `[rows, R]`: the same of those who act.
    remembered: Vec<f32>,
    /// Floating-point operations of all passes up to now.
    pub operations: u64,
}

impl Players {
    /// Buffers for agents that see teams so; nobody remembers anything.
    pub fn new(conditioning: Conditioning) -> Self {
        Self { conditioning, ..Self::default() }
    }

    /// Computes the utilities `[U]` of all agents of all scenes and gives them to `each` with scene and agent.
    ///
    /// A world has `slots` agents at most. Who has not acted yet in its episode remembers nothing.
    ///
    /// # Errors
    /// The network marks fewer subtasks than a scene has.
    pub fn act(
        &mut self,
        agents: Agents<'_>,
        scenes: &[AllocatedScene<'_>],
        slots: usize,
        mut each: impl FnMut(usize, usize, &[f32]),
    ) -> Result<(), LearnError> {
        self.look(agents.network.shape, scenes)?;
        let Agents { network, unit, coach } = agents;
        let shape = network.shape;
        self.recall(scenes, slots, shape.base, unit.is_none());
        let Self { batch, tape, actors, remembered, operations, .. } = self;
        let mut t = tape.begin_forward(network.parameters);
        let layers = UtilityLayers::of(shape);
        let mut looked = layers.look(&mut t, batch.input().view());
        if coach.is_some() {
            let mut told = vec![0.0; actors.len() * shape.base];
            for (told, (scene, agent)) in told.chunks_exact_mut(shape.base).zip(&*actors) {
                let own = agent * shape.base..(agent + 1) * shape.base;
                if let Some(own) = scenes[*scene].strategies.get(own) {
                    told.copy_from_slice(own);
                }
            }
            let told = t.input(shape.base, &told);
            looked.base = t.add(looked.base, told);
        }
        if let Some(unit) = unit {
            looked.base = t.gru(looked.base, unit, &vec![true; actors.len()], remembered);
        }
        let utilities = layers.head(&mut t, looked, batch.input().aims.all());
        *operations += t.operations(false);
        let rows = t.values(utilities).chunks_exact(shape.actions);
        for ((scene, agent), utilities) in actors.iter().zip(rows) {
            each(*scene, *agent, utilities);
        }
        self.keep(scenes, slots, shape.base);
        Ok(())
    }

    /// Writes the actions `[scenes, A]` of agents that learn: the best by their utilities, or a random one as often as is
    /// tried out in a world, by its generator. Where they `rest`, those without a subtask do nothing.
    ///
    /// # Errors
    /// The network marks fewer subtasks than a scene has.
    pub fn explore(
        &mut self,
        agents: Agents<'_>,
        scenes: &[AllocatedScene<'_>],
        random: &mut [Generator],
        (epsilon, rest): (impl Fn(usize) -> f32, bool),
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        let Some(AllocatedScene { environment, .. }) = scenes.first() else { return Ok(()) };
        let slots = environment.spec().shape.agents;
        actions.fill(environment.spec().safe_action.unwrap_or(0));
        self.act(agents, scenes, slots, |place, agent, utilities| {
            let AllocatedScene { world, seen, allocation, .. } = scenes[place];
            if rest && allocation[agent] == UNASSIGNED {
                return;
            }
            let (available, generator) = (seen.available[agent], &mut random[world]);
            let action = if chance(generator, epsilon(world).into()) {
                member(generator, available).unwrap_or(0)
            } else {
                best(utilities, available)
            };
            actions[place * slots + agent] = action as u16;
        })
    }

    /// Writes what all agents see.
    fn look(
        &mut self,
        shape: UtilityShape,
        scenes: &[AllocatedScene<'_>],
    ) -> Result<(), LearnError> {
        let Self { batch, actors, .. } = self;
        let spec = scenes.first().map(|scene| scene.environment.spec());
        let columns = spec.map(|spec| Columns::of(&spec.shape, shape.targets));
        batch.clear(self.conditioning, columns.unwrap_or_default());
        actors.clear();
        let tasks = scenes.iter().map(|scene| scene.seen.tasks()).max().unwrap_or(0);
        if batch.columns(tasks) > shape.input {
            let reason = format!("the network marks fewer subtasks than the {tasks} of this state");
            return Err(LearnError::Config(reason));
        }
        for (place, scene) in scenes.iter().enumerate() {
            let added = |agent| actors.push((place, agent));
            batch.push_teams(scene.seen, scene.allocation, scene.last_actions, added);
        }
        for (place, scene) in scenes.iter().enumerate() {
            let added = |agent| actors.push((place, agent));
            batch.push_unassigned(scene.seen, scene.allocation, scene.last_actions, added);
        }
        batch.finish();
        Ok(())
    }

    /// Lists what those who act remember, nothing where they have just begun or have no memory at all.
    fn recall(&mut self, scenes: &[AllocatedScene<'_>], slots: usize, width: usize, nothing: bool) {
        self.remembered.clear();
        if nothing {
            return;
        }
        for (scene, agent) in self.actors.iter().copied() {
            let place = (scenes[scene].world * slots + agent) * width;
            self.memory.resize(self.memory.len().max(place + width), 0.0);
            let memory = &mut self.memory[place..place + width];
            if scenes[scene].last_actions[agent] == NO_ACTION {
                memory.fill(0.0);
            }
            self.remembered.extend_from_slice(memory);
        }
    }

    /// Writes down what those who act remember now.
    fn keep(&mut self, scenes: &[AllocatedScene<'_>], slots: usize, width: usize) {
        for ((scene, agent), after) in self.actors.iter().zip(self.remembered.chunks_exact(width)) {
            let place = (scenes[*scene].world * slots + agent) * width;
            self.memory[place..place + width].copy_from_slice(after);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alma::agents::UtilityNetwork;
    use crate::alma::records::Config;
    use sortie_envs::Split;
    use sortie_learn::evaluate::Evaluation;
    use sortie_learn::play::evaluate;
    use sortie_learn::random::{Purpose, generator};
    use sortie_learn::subtasks::{AllocatedTeam, PolicyAgents, RuleAllocator};
    use sortie_learn::{Act, Ask, Scene, Scenes};

    /// So large weights that whatever is seen decides what is done.
    fn network(environment: &dyn sortie_envs::Environment) -> UtilityNetwork {
        let shape = Config::default().network.shape(environment.spec());
        crate::alma::agents::network(shape, 0.02, 4)
    }

    fn city() -> Box<dyn sortie_envs::Environment> {
        let city =
            sortie_envs::open("save-the-city/2-5a_2-5b", Split::Test, 1, &Default::default());
        city.unwrap()
    }

    #[test]
    fn a_policy_acts_as_the_network_that_it_is_made_of() {
        let (city, network) = (city(), network(&*city()));
        let play = |agents: Box<dyn subtasks::Agents + '_>| -> Evaluation {
            let mut team = AllocatedTeam::new(agents, Box::new(RuleAllocator("heuristic")), 5);
            evaluate(&*city, &mut team, 40, 11).unwrap()
        };
        let agents = Agents::new(network.view());
        let by_network = play(Box::new(NetworkAgents::new(agents, Conditioning::Mask)));
        let by_policy =
            play(Box::new(PolicyAgents::new(NetworkPolicy::new(network.view()).deployed())));
        assert_eq!(by_network, by_policy);
        assert!(by_network.length_mean > 10.0);
    }

    #[test]
    fn agents_tell_what_they_acted_on() {
        let (mut city, network) = (city(), network(&*city()));
        let (mut random, mut state) = (generator(2, Purpose::Rollout, 0), Vec::new());
        city.reset(0, &mut random);
        city.save(0, &mut state);
        let slots = city.spec().shape.agents;
        for (conditioning, told) in [(Conditioning::Mask, true), (Conditioning::None, false)] {
            let agents = NetworkAgents::new(Agents::new(network.view()), conditioning);
            let rule = Box::new(RuleAllocator("coordinated"));
            let mut team = AllocatedTeam::new(Box::new(agents), rule, 5);
            let scene = Scene { instance: 0, state: &state, begins: true, tasks_changed: false };
            let scenes = Scenes { environment: &*city, scenes: &[scene] };
            let mut actions = vec![0; slots];
            let random = &mut [random.clone()];
            team.act(Ask { scenes: &scenes, random, actions: &mut actions }).unwrap();
            let thoughts = team.thoughts(&scenes, &actions);
            assert_eq!(thoughts.len(), if told { slots } else { 0 });
            let mut seen = Observation::default();
            city.observe(&state, 0, 0, &mut seen);
            for (agent, thought) in thoughts.iter().enumerate().take(seen.agents()) {
                let best = best(&thought.scores, seen.available[agent]);
                assert_eq!(best as u16, actions[agent], "agent {agent}");
                let of_first: f32 = thought.attention.iter().map(|(_, weights)| weights[0]).sum();
                assert!((of_first - 1.0).abs() < 1e-5, "{of_first}");
            }
        }
    }
}
