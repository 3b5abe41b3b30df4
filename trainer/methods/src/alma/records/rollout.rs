//! Acting while learning: episodes in many instances, explored, and what is kept of them.

use serde::{Deserialize, Serialize};
use sortie_envs::random::{chance, member};
use sortie_envs::{EntitySet, Observation, Spec, UNASSIGNED};
use sortie_learn::networks::best;
use sortie_learn::subtasks::AllocatedScene;
use sortie_learn::{LearnError, Scenes, State, Transition};
use sortie_nn::random::Generator;

use super::config::Config;
use super::deciding::{Deciding, Decisions, Reached};
use super::replay::{Moment, Replay, Taken};
use super::team_value::Segments;
use crate::alma::agents::{Conditioning, NO_ACTION, UtilityView};
use crate::alma::teams::{Agents, Players};

/// What an instance remembers between steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Instance {
    decisions: Decisions,
    last_actions: Vec<u8>,
    /// The allocation of the step before; nothing at the begin of an episode.
    before: Vec<u8>,
    /// What there is to see in the state in which its agents act.
    #[serde(skip)]
    seen: Observation,
}

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
    instances: Vec<Instance>,
    deciding: Deciding,
    spread: Vec<f32>,
    players: Players,
    seen: Observation,
}

impl Rollout {
    /// Instances of an environment, none of which has begun an episode.
    pub fn new(config: &Config, spec: &Spec) -> Self {
        let agents = spec.shape.agents;
        let instance = |number| Instance {
            decisions: Decisions::new(number, config.allocation.interval, agents),
            last_actions: vec![NO_ACTION; agents],
            before: Vec::new(),
            seen: Observation::default(),
        };
        Self {
            conditioning: config.network.subtask,
            instances: (0..config.environment.instances).map(instance).collect(),
            deciding: Deciding::new(config, spec),
            spread: config.exploration.spread.clone(),
            players: Players::new(config.network.subtask),
            seen: Observation::default(),
        }
    }

    /// Floating-point operations up to now, those of passes.
    pub fn operations(&self) -> u64 {
        self.players.operations + self.deciding.search.operations()
    }

    /// An instance is about to start an episode.
    pub fn begin(&mut self, instance: usize, generator: &mut Generator) {
        let instance = &mut self.instances[instance];
        instance.decisions.restart(&self.deciding, generator);
        instance.last_actions.fill(NO_ACTION);
        instance.before.clear();
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
        let mut decided = 0;
        let environment = scenes.environment;
        for scene in scenes.scenes {
            let Instance { decisions, seen, .. } = &mut self.instances[scene.instance];
            let (state, tasks_changed) = (scene.state, scene.tasks_changed);
            environment.observe(state, 0, EntitySet::MAX, seen);
            let at = Reached { environment, state, seen, tasks_changed };
            let (generator, network) = (&mut random[scene.instance], behaviour.allocator);
            let segments = segments.as_deref_mut();
            let due = self.deciding.decide(decisions, at, generator, network, segments)?;
            decided += u64::from(due);
        }
        self.choose(scenes, random, behaviour, actions)?;
        Ok(decided)
    }

    /// Writes the actions of all agents: the best by the network, or a random one.
    fn choose(
        &mut self,
        scenes: &Scenes<'_>,
        random: &mut [Generator],
        behaviour: Behaviour<'_>,
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        let Self { conditioning, instances, players, spread, .. } = self;
        let environment = scenes.environment;
        let shown = scenes.scenes.iter().map(|scene| {
            let Instance { decisions, last_actions, seen, .. } = &instances[scene.instance];
            let (world, state, allocation) = (scene.instance, scene.state, &decisions.allocation);
            let strategies = &[];
            AllocatedScene { world, environment, state, seen, allocation, last_actions, strategies }
        });
        let shown: Vec<AllocatedScene<'_>> = shown.collect();
        let slots = environment.spec().shape.agents;
        // An agent without a subtask does nothing.
        actions.fill(environment.spec().safe_action.unwrap_or(0));
        players.act(Agents::new(behaviour.agents), &shown, slots, |place, agent, utilities| {
            let AllocatedScene { world, seen, allocation, .. } = shown[place];
            if *conditioning == Conditioning::Mask && allocation[agent] == UNASSIGNED {
                return;
            }
            let explore = behaviour.epsilon * spread[world % spread.len()];
            let (available, generator) = (seen.available[agent], &mut random[world]);
            let action = if chance(generator, explore.into()) {
                member(generator, available.into()).unwrap_or(0)
            } else {
                best(utilities, available)
            };
            actions[place * slots + agent] = action as u16;
        })
    }

    /// Keeps a step, and the segment that it completes.
    pub fn remember(
        &mut self,
        transition: &Transition<'_>,
        replay: &mut Replay,
        segments: Option<&mut Segments>,
    ) {
        let Transition { environment, state, actions, next, .. } = *transition;
        let Instance { decisions, last_actions, before, seen } =
            &mut self.instances[transition.instance];
        environment.observe(next, 0, 0, &mut self.seen);
        let did: Vec<u8> = actions.iter().map(|action| *action as u8).collect();
        let allocation = &decisions.allocation;
        let moment = Moment { state, allocation, last_actions, actions: &did };
        let open_then = self.seen.open_tasks;
        replay.push(Taken { transition, seen, open_then, moment, before });
        before.clone_from(&decisions.allocation);
        last_actions.copy_from_slice(&did);
        decisions.remember(transition, self.deciding.allocator.discount, segments);
    }

    /// Names what the instances remember.
    ///
    /// # Errors
    /// What is read does not fit.
    pub fn visit(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        let sizes = |instances: &[Instance]| -> Vec<[usize; 2]> {
            let size = |it: &Instance| [it.decisions.allocation.len(), it.last_actions.len()];
            instances.iter().map(size).collect()
        };
        let before = sizes(&self.instances);
        state.value("instances", &mut self.instances)?;
        if sizes(&self.instances) != before {
            return Err(LearnError::Config("the checkpoint has other instances".to_owned()));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
