//! Acting while learning: episodes in many instances, explored, and what is kept of them.

use sortie_envs::{Observation, Spec};
use sortie_learn::subtasks::Places;
use sortie_learn::{LearnError, Scenes, State, Transition};
use sortie_nn::random::Generator;

use super::config::Config;
use super::deciding::{Deciding, Decisions};
use super::replay::{Moment, Replay, Taken};
use super::team_value::Segments;
use crate::alma::agents::{Conditioning, UtilityView};
use crate::alma::teams::{Agents, Players};

/// Who acts and allocates in a step.
#[derive(Clone, Copy, Debug)]
pub struct Behaviour<'a> {
    /// The agents' utility network.
    pub agents: UtilityView<'a>,
    /// How often agents act at random, before the instances' factors.
    pub epsilon: f32,
    /// The team-value network; without one, rules decide in its stead.
    pub allocator: Option<UtilityView<'a>>,
}

/// The instances of a run and the buffers to act in them.
#[derive(Debug)]
pub struct Rollout {
    conditioning: Conditioning,
    places: Places,
    decisions: Vec<Decisions>,
    deciding: Deciding,
    spread: Vec<f32>,
    players: Players,
    seen: Observation,
    agents: usize,
}

impl Rollout {
    /// Instances of an environment, none of which has begun an episode.
    pub fn new(config: &Config, spec: &Spec) -> Self {
        Self {
            conditioning: config.network.subtask,
            places: Places::new(config.allocation.interval),
            decisions: (0..config.environment.instances).map(Decisions::new).collect(),
            deciding: Deciding::new(config, spec),
            spread: config.exploration.spread.clone(),
            players: Players::new(config.network.subtask),
            seen: Observation::default(),
            agents: spec.shape.agents,
        }
    }

    /// Floating-point operations up to now, those of passes.
    pub fn operations(&self) -> u64 {
        self.players.operations + self.deciding.search.operations()
    }

    /// An instance is about to start an episode.
    pub fn begin(&mut self, instance: usize, generator: &mut Generator) {
        self.decisions[instance].restart(&self.deciding, generator);
    }

    /// Decides where that is due and writes the actions `[scenes, A]` of all agents; keeps the segments that a decision
    /// completes. Returns the number of decisions.
    ///
    /// `random` draws allocations and exploration of each instance.
    ///
    /// # Errors
    /// The allocator does not fit the environment.
    pub fn act(
        &mut self,
        scenes: &Scenes<'_>,
        random: &mut [Generator],
        behaviour: Behaviour<'_>,
        mut segments: Option<&mut Segments>,
        actions: &mut [u16],
    ) -> Result<u64, LearnError> {
        let Behaviour { agents, epsilon, allocator } = behaviour;
        let Self { conditioning, places, decisions, deciding, spread, players, .. } = self;
        let mut decided = 0;
        for scene in scenes.scenes {
            let place = places.look(scenes.environment, scene);
            if place.is_due {
                let (episode, at) =
                    (&mut decisions[scene.instance], (scenes.environment, scene.state));
                let (generator, segments) = (&mut random[scene.instance], segments.as_deref_mut());
                deciding.decide(episode, at, place, generator, allocator, segments)?;
                decided += 1;
            }
        }
        let explores = |world: usize| epsilon * spread[world % spread.len()];
        let rest = *conditioning == Conditioning::Mask;
        let shown = places.scenes(scenes);
        players.explore(Agents::new(agents), &shown, random, (explores, rest), actions)?;
        places.note(scenes, actions);
        Ok(decided)
    }

    /// Keeps a step, and the segment that it completes.
    pub fn remember(
        &mut self,
        transition: &Transition<'_>,
        replay: &mut Replay,
        segments: Option<&mut Segments>,
    ) {
        let Transition { environment, instance, state, actions, next, .. } = *transition;
        let (place, episode) = (self.places.of(instance), &mut self.decisions[instance]);
        environment.observe(next, 0, 0, &mut self.seen);
        let did: Vec<u8> = actions.iter().map(|action| *action as u8).collect();
        let (allocation, last_actions) = (&place.allocation, &place.last_actions);
        let moment = Moment { state, allocation, last_actions, actions: &did };
        let (seen, open_then) = (&place.seen, self.seen.open_tasks);
        replay.push(Taken { transition, seen, open_then, moment, before: &episode.before });
        episode.before.clone_from(allocation);
        episode.remember(transition, self.deciding.allocator.discount, segments);
    }

    /// Names what the instances remember.
    ///
    /// # Errors
    /// What is read does not fit.
    pub fn visit(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        let instances = self.decisions.len();
        state.value("decisions", &mut self.decisions)?;
        if self.decisions.len() != instances {
            return Err(LearnError::Config("the checkpoint has other instances".to_owned()));
        }
        self.places.visit(state, self.agents)
    }
}

#[cfg(test)]
mod tests;
