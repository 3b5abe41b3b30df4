//! MAAC as a [`Method`].

use sortie_envs::{Environment, Random};
use sortie_learn::export::DeployedAgents;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{Rates, Reports};
use sortie_learn::session::Opening;
use sortie_learn::{Act, Ask, LearnError, Method, Now, Scenes, State, Thought, Transition};

use super::Config;
use super::attention::thoughts;
use super::experience::Experience;
use crate::actor_critic::acting::{Acting, Actors, deployed};
use crate::actor_critic::critic::Batch;
use crate::actor_critic::groups::Groups;
use crate::actor_critic::learner::ActorCritic;

/// Agents that learn from rewards of their own, and what they have seen.
#[derive(Debug)]
pub struct Maac {
    config: Config,
    learner: ActorCritic,
    experience: Experience,
    /// Draws records and actions.
    random: Random,
    /// Environment steps before the first update.
    first: u64,
    updates: u64,
    batch: Batch,
    /// Actions of an agent, the most of any.
    actions: usize,
}

impl Maac {
    /// Draws the first weights.
    pub fn new(config: Config, opening: &Opening<'_>) -> Self {
        let Opening { setup, environment, seed, threads } = *opening;
        let (spec, instances) = (environment.spec(), setup.environment.instances);
        let groups = Groups::new(spec, config.network.shared, config.network.identity);
        let mut weights = generator(seed, Purpose::Weights, 0);
        // Every instance needs to have played for longer than a record looks ahead.
        let first = config.replay.first.max(4 * config.returns.steps * instances);
        Self {
            learner: config.learner(groups, threads, &mut weights),
            experience: Experience::new(&config, spec, instances),
            random: generator(seed, Purpose::Replay, 0),
            first: (first * config.returns.decision_interval) as u64,
            updates: 0,
            batch: Batch::default(),
            actions: spec.shape.actions,
            config,
        }
    }

    /// The policies that are measured, and deployed.
    fn measured(&self) -> Actors<'_> {
        self.config.actors(&self.learner, &self.learner.policy_learner.average)
    }
}

impl Method for Maac {
    /// What is learned from once is all of one policy.
    fn waits(&self) -> bool {
        self.config.replay.on_policy
    }

    fn act(&mut self, Ask { scenes, random, actions }: Ask<'_>, _: Now) -> Result<(), LearnError> {
        let Self { config, learner, experience, .. } = self;
        let actors = config.actors(learner, &learner.policy_learner.online.values);
        experience.act(actors, scenes, random, actions);
        Ok(())
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        self.experience.remember(transition);
        Ok(())
    }

    fn update(&mut self, environment: &dyn Environment, now: Now) -> Result<Reports, LearnError> {
        let rule = &self.config.replay;
        let due = match now.env_steps.checked_sub(self.first) {
            None => 0,
            Some(_) if rule.on_policy => self.updates + 1,
            Some(steps) => steps / rule.steps_per_period * rule.updates_per_period,
        };
        let entropy = self.config.entropy.at(now.env_steps);
        let mut reports = Reports::default();
        while self.updates < due {
            self.updates += 1;
            let Self { config, learner, experience, random, batch, .. } = self;
            experience.gather(environment, config, learner, random, batch);
            reports.agents.push(learner.update(batch, entropy, random));
        }
        Ok(reports)
    }

    fn rates(&self, _: Now) -> Rates {
        Rates { epsilon: 0.0, learning_rate: self.config.optimiser.policy_rate }
    }

    fn team(&self) -> Box<dyn Act + '_> {
        Box::new(Greedy { maac: self, acting: Acting::default() })
    }

    fn deployed(&self) -> Result<DeployedAgents<'_>, LearnError> {
        Ok(deployed(self.measured(), self.actions))
    }

    fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        self.experience.state(state)?;
        self.learner.state(state)?;
        state.value("random", &mut self.random)?;
        state.value("updates", &mut self.updates)
    }
}

/// Agents that take the action that they think the likeliest.
struct Greedy<'a> {
    maac: &'a Maac,
    acting: Acting,
}

impl Act for Greedy<'_> {
    fn act(&mut self, Ask { scenes, actions, .. }: Ask<'_>) -> Result<(), LearnError> {
        self.acting.act(self.maac.measured(), scenes, None, actions);
        Ok(())
    }

    fn thoughts(&mut self, scenes: &Scenes<'_>, actions: &[u16]) -> Vec<Thought> {
        self.acting.look(self.maac.measured(), scenes);
        thoughts(&self.maac.learner, &self.acting, actions)
    }
}

#[cfg(test)]
mod tests {
    use sortie_envs::Split;
    use sortie_learn::Scene;
    use sortie_learn::trajectory::Place;

    use super::super::presets::MAAC;
    use super::*;

    /// Plays one instance for some steps; what is kept of its decisions has to be what was seen meanwhile.
    #[test]
    fn an_action_is_held_and_earns_what_comes_of_it_until_the_next() {
        const INTERVAL: usize = 3;
        let (discount, scale) = (0.9_f32, 10.0);
        let setup = MAAC.preset("fast").unwrap();
        let mut config: Config = setup.own().unwrap();
        config.returns.decision_interval = INTERVAL;
        config.returns.discount = discount;
        config.returns.shaping = scale;
        let world = sortie_envs::open("particle/treasure-4", Split::Train, 1, &Default::default());
        let mut world = world.unwrap();
        let opening = Opening { setup: &setup, environment: &*world, seed: 1, threads: 1 };
        let mut maac = Maac::new(config, &opening);
        let mut random = [generator(1, Purpose::Rollout, 0)];
        world.reset(0, &mut random[0]);
        let near = |world: &dyn Environment, state: &[u8], agent: usize| {
            world.potential(state, scale, 1 << agent, None)
        };
        let mut held = Vec::new();
        let mut rewards = Vec::new();
        for step in 0..2 * INTERVAL {
            let mut state = Vec::new();
            world.save(0, &mut state);
            let scene =
                Scene { instance: 0, state: &state, begins: step == 0, tasks_changed: false };
            let scenes = Scenes { environment: &*world, scenes: &[scene] };
            let mut actions = [0; 4];
            let ask = Ask { scenes: &scenes, random: &mut random, actions: &mut actions };
            maac.act(ask, Now::default()).unwrap();
            let first = step % INTERVAL == 0;
            if first {
                held = actions.to_vec();
                rewards = (0..4).map(|agent| -near(&*world, &state, agent)).collect();
            }
            assert_eq!(held, actions, "step {step}");
            let taken = world.step(0, &actions, &mut random[0]).unwrap();
            let mut next = Vec::new();
            world.save(0, &mut next);
            maac.remember(&Transition {
                environment: &*world,
                instance: 0,
                state: &state,
                actions: &actions,
                step: taken,
                task_rewards: &[],
                agent_rewards: world.agent_rewards(0),
                next: &next,
            })
            .unwrap();
            let factor = discount.powi((step % INTERVAL) as i32);
            for (sum, reward) in rewards.iter_mut().zip(world.agent_rewards(0)) {
                *sum += factor * *reward as f32;
            }
            if step % INTERVAL == INTERVAL - 1 {
                let place = Place::default().after(step / INTERVAL);
                let kept = maac.experience.replay.rewards(place).agents;
                for (agent, (kept, sum)) in kept.iter().zip(&rewards).enumerate() {
                    let want = sum + factor * discount * near(&*world, &next, agent);
                    assert!((kept - want).abs() < 1e-4, "agent {agent}: {kept} {want}");
                }
            }
        }
    }

    /// Has a method learn in a small world for some steps.
    fn learned(config: Config, periods: u64) -> (Maac, Reports, Box<dyn Environment>) {
        let mut setup = MAAC.preset("fast").unwrap();
        setup.environment.instances = 4;
        let world =
            sortie_envs::open("particle/rover-tower-2", Split::Train, 1, &Default::default());
        let world = world.unwrap();
        let opening = Opening { setup: &setup, environment: &*world, seed: 1, threads: 1 };
        let mut maac = Maac::new(config, &opening);
        let random = (0..4).map(|index| generator(1, Purpose::Rollout, index)).collect();
        let mut play = sortie_learn::play::Play::new(&*world, &mut maac, random);
        let mut reports = Reports::default();
        let (mut env_steps, mut counts) = (0, Default::default());
        while env_steps < 400 + 40 * periods {
            let now = Now { env_steps, of: 1000 };
            env_steps += play.round(&mut maac, now, &mut counts).unwrap();
            let found = maac.update(&*world, Now { env_steps, of: 1000 });
            reports.agents.extend(found.unwrap().agents);
        }
        (maac, reports, world)
    }

    fn small() -> Config {
        let mut config = Config::default();
        config.replay.first = 400;
        config.replay.batch = 16;
        config.replay.steps_per_period = 40;
        config.replay.updates_per_period = 3;
        config
    }

    #[test]
    fn as_many_updates_are_made_as_are_due() {
        let (maac, reports, _) = learned(small(), 5);
        assert_eq!((reports.agents.len(), maac.updates), (15, 15));
        let mut clipped = small();
        clipped.optimiser.critic_clip = 1e-3;
        let (maac, reports, _) = learned(clipped, 1);
        let norm = maac
            .learner
            .critic_learner
            .gradient()
            .iter()
            .map(|slope| slope * slope)
            .sum::<f32>()
            .sqrt();
        assert!(norm <= 2.1e-3 && reports.agents[2].gradient_norm > 0.01, "{norm}");
    }

    #[test]
    fn what_is_learned_from_once_are_whole_episodes_in_their_order() {
        let mut config = small();
        (config.replay.on_policy, config.returns.steps) = (true, 1);
        config.update.own_actions = super::super::OwnActions::Drawn;
        let (maac, reports, world) = learned(config, 5);
        // Four episodes at a time, of which the first four are there before anything is learned.
        let steps = world.spec().episode_limit as usize;
        assert_eq!(maac.batch.records, 4 * steps);
        assert_eq!(
            reports.agents.len(),
            (400 + 40 * 5_usize).div_ceil(4 * steps) - 400 / (4 * steps) + 1
        );
        let ends: Vec<usize> = (0..maac.batch.records)
            .filter(|record| maac.batch.follows.get(*record) != Some(&true))
            .collect();
        assert_eq!(ends, [1, 2, 3, 4].map(|episode| episode * steps - 1));
        // What is seen next is what the record behind it sees.
        let group = &maac.learner.groups.0[0];
        let row = group.inputs() * group.agents.len();
        let Batch { observations, next, .. } = &maac.batch;
        assert_eq!(next[0][..row], observations[0][row..2 * row]);
        assert_ne!(next[0][(steps - 1) * row..steps * row], observations[0][steps * row..][..row]);
    }

    #[test]
    fn measured_are_the_averaged_policies() {
        let (mut maac, _, world) = learned(small(), 2);
        let policies = &mut maac.learner.policy_learner;
        assert_ne!(policies.average, policies.online.values);
        let act = |maac: &Maac| {
            let mut team = maac.team();
            let report = sortie_learn::play::evaluate(&*world, &mut *team, 20, 1).unwrap();
            report.return_mean
        };
        let before = act(&maac);
        maac.learner.policy_learner.online.values.iter_mut().for_each(|weight| *weight = -*weight);
        assert_eq!(act(&maac), before);
        maac.learner.policy_learner.average.iter_mut().for_each(|weight| *weight = -*weight);
        assert_ne!(act(&maac), before);
    }

    #[test]
    fn agents_do_what_they_think_best() {
        let (maac, _, mut world) = learned(small(), 1);
        world.reset(0, &mut generator(2, Purpose::Rollout, 0));
        let mut state = Vec::new();
        world.save(0, &mut state);
        let scene = Scene { instance: 0, state: &state, begins: true, tasks_changed: false };
        let scenes = Scenes { environment: &*world, scenes: &[scene] };
        let (mut team, mut actions) = (maac.team(), [0; 2]);
        team.act(Ask { scenes: &scenes, random: &mut [], actions: &mut actions }).unwrap();
        let thoughts = team.thoughts(&scenes, &actions);
        assert_eq!(thoughts.len(), 2);
        for (thought, action) in thoughts.iter().zip(actions) {
            let best = thought.scores.iter().copied().fold(f32::MIN, f32::max);
            assert_eq!(thought.scores[usize::from(action)], best);
        }
    }

    #[test]
    fn what_chance_is_worth_falls_by_the_same_factor_each_step() {
        let entropy = super::super::EntropyConfig { start: 0.16, end: 0.01, steps: 400 };
        for (steps, want) in [(0, 0.16), (100, 0.08), (200, 0.04), (400, 0.01), (900, 0.01)] {
            assert!((entropy.at(steps) - want).abs() < 1e-6, "{steps}");
        }
    }
}
