//! The loop in which teams play: to learn, and to be measured.

mod episodes;
mod policy;
mod random;

use sortie_envs::{Environment, Random, Split};

pub use episodes::evaluate;
pub use policy::PolicyTeam;
pub use random::RandomTeam;

use crate::error::LearnError;
use crate::method::{Method, Now, Scene, Scenes, Transition};
use crate::run::EpisodeCounts;
use crate::state::State;

/// Instances that are played to learn from, each started anew as soon as its episode is over.
pub struct Play {
    worlds: Box<dyn Environment>,
    random: Random,
    running: Vec<Running>,
    actions: Vec<u16>,
    next: Vec<u8>,
}

/// The running episode of an instance.
#[derive(Clone, Debug, Default, serde::Serialize, serde::Deserialize)]
struct Running {
    state: Vec<u8>,
    begins: bool,
    episode_return: f64,
}

impl Play {
    /// Starts so many instances; `random` belongs to them and to whoever acts in them.
    pub fn new(environment: &dyn Environment, instances: usize, mut random: Random) -> Self {
        let mut worlds = environment.open(instances, Split::Train);
        let running = (0..instances).map(|instance| start(&mut *worlds, instance, &mut random));
        let running = running.collect();
        Self { worlds, random, running, actions: Vec::new(), next: Vec::new() }
    }

    /// What is played in.
    pub fn environment(&self) -> &dyn Environment {
        &*self.worlds
    }

    /// Steps every instance once.
    ///
    /// # Errors
    /// The method cannot act or remember, or chose an action that is not available.
    pub fn round(
        &mut self,
        method: &mut dyn Method,
        now: Now,
        episodes: &mut EpisodeCounts,
    ) -> Result<(), LearnError> {
        let agents = self.worlds.spec().shape.agents;
        self.actions.clear();
        self.actions.resize(self.running.len() * agents, 0);
        let running = self.running.iter().enumerate();
        let scenes: Vec<Scene<'_>> = running
            .map(|(instance, Running { state, begins, .. })| Scene {
                instance,
                state,
                begins: *begins,
            })
            .collect();
        let scenes = Scenes { environment: &*self.worlds, scenes: &scenes };
        method.act(&scenes, now, &mut self.random, &mut self.actions)?;
        let teams = self.running.iter_mut().zip(self.actions.chunks_exact(agents));
        for (instance, (running, actions)) in teams.enumerate() {
            let step = self.worlds.step(instance, actions, &mut self.random)?;
            self.next.clear();
            self.worlds.save(instance, &mut self.next);
            running.episode_return += step.reward;
            method.remember(&Transition {
                environment: &*self.worlds,
                instance,
                state: &running.state,
                actions,
                step,
                task_rewards: self.worlds.task_rewards(instance),
                agent_rewards: self.worlds.agent_rewards(instance),
                next: &self.next,
            })?;
            if step.done() {
                let episode = self.worlds.episode(instance);
                episodes.episodes += 1;
                episodes.solved += u64::from(episode.solved);
                episodes.timed_out += u64::from(step.timed_out);
                episodes.return_sum += running.episode_return;
                *running = start(&mut *self.worlds, instance, &mut self.random);
            } else {
                std::mem::swap(&mut running.state, &mut self.next);
                running.begins = false;
            }
        }
        Ok(())
    }

    /// Names what the rest of the play depends on.
    ///
    /// # Errors
    /// What is read does not fit.
    pub fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        state.value("play/random", &mut self.random)?;
        state.value("play/running", &mut self.running)?;
        for (instance, running) in self.running.iter().enumerate().filter(|_| state.is_reading()) {
            let loaded = self.worlds.load(instance, &running.state);
            loaded.map_err(|error| LearnError::Config(format!("instance {instance}: {error}")))?;
        }
        Ok(())
    }
}

/// Starts an episode.
fn start(worlds: &mut dyn Environment, instance: usize, random: &mut Random) -> Running {
    worlds.reset(instance, random);
    let mut running = Running { begins: true, ..Running::default() };
    worlds.save(instance, &mut running.state);
    running
}
