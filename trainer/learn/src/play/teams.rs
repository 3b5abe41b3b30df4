//! Teams that do not learn: a deployed policy, and play without a thought, which everything that is learned has to beat.

use sortie_core::DecideError;
use sortie_core::policy::{NO_ACTION, Observation as Seen, Policy};
use sortie_envs::random::{generator, member};
use sortie_envs::{EntitySet, Environment, Observation, Random};

use crate::act::{Act, Ask, Scene, Shown, mask, write_actions};
use crate::error::Result;

/// A deployed policy, agent by agent, on what each of them would see.
#[derive(Debug)]
pub struct PolicyTeam<P> {
    policy: P,
    seen: Observation,
    shown: Shown,
    /// `[instances][A]`
    last_actions: Vec<Vec<u16>>,
    /// `[instances][A, R]`
    memories: Vec<Vec<f32>>,
}

impl<P: Policy> PolicyTeam<P> {
    /// Acts by a policy that sees everything that is observable.
    pub fn new(policy: P) -> Self {
        let (seen, shown) = Default::default();
        Self { policy, seen, shown, last_actions: Vec::new(), memories: Vec::new() }
    }

    /// Lays out what an instance shows.
    fn look(&mut self, environment: &dyn Environment, scene: &Scene<'_>) {
        let Self { policy, seen, shown, last_actions, memories } = self;
        let shape = environment.spec().shape;
        environment.observe(scene.state, 0, EntitySet::MAX, seen);
        shown.look(seen, shape);
        let places = last_actions.len().max(scene.instance + 1);
        last_actions.resize(places, Vec::new());
        memories.resize(places, Vec::new());
        if scene.begins {
            memories[scene.instance] = vec![0.0; shape.agents * policy.hidden()];
            last_actions[scene.instance] = vec![NO_ACTION; shape.agents];
        }
    }
}

impl<P: Policy> Act for PolicyTeam<P> {
    fn act(&mut self, Ask { scenes, actions, .. }: Ask<'_>) -> Result<()> {
        let slots = scenes.environment.spec().shape.agents;
        for (scene, actions) in scenes.scenes.iter().zip(actions.chunks_exact_mut(slots)) {
            self.look(scenes.environment, scene);
            let Self { policy, seen, shown, last_actions, memories } = self;
            let (last_actions, agents) = (&mut last_actions[scene.instance], seen.agents());
            let see = |agent: usize| {
                let visible = mask(seen.observable[agent] & seen.present);
                shown.to(agent, visible, last_actions)
            };
            let observations: Vec<Seen<'_>> = (0..agents).map(see).collect();
            let mut decisions = vec![Err(DecideError::BadLength); agents];
            let states = &mut memories[scene.instance][..agents * policy.hidden()];
            policy.decide_batch_with(&observations, states, &mut decisions);
            write_actions(actions, decisions)?;
            last_actions.copy_from_slice(actions);
        }
        Ok(())
    }
}

/// Agents that take any available action.
#[derive(Debug)]
pub struct RandomTeam {
    random: Random,
    seen: Observation,
}

impl RandomTeam {
    /// Agents that draw from the generator of a seed.
    pub fn new(seed: u64) -> Self {
        Self { random: generator(seed), seen: Observation::default() }
    }
}

impl Act for RandomTeam {
    fn act(&mut self, Ask { scenes, actions, .. }: Ask<'_>) -> Result<()> {
        let agents = scenes.environment.spec().shape.agents;
        for (scene, actions) in scenes.scenes.iter().zip(actions.chunks_exact_mut(agents)) {
            scenes.environment.observe(scene.state, 0, 0, &mut self.seen);
            for (action, available) in actions.iter_mut().zip(&self.seen.available) {
                *action = member(&mut self.random, *available).unwrap_or(0) as u16;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::play::watch;
    use sortie_core::Decision;
    use sortie_envs::Split;

    /// Always goes right; notes what the agents of each team are told that they did.
    #[derive(Debug, Default)]
    struct Noting(Vec<Vec<u16>>);

    impl Policy for Noting {
        fn actions(&self) -> usize {
            3
        }

        fn utilities(&mut self, seen: &Seen<'_>, utilities: &mut [f32]) -> Result<(), DecideError> {
            if seen.self_index == 0 {
                self.0.push(seen.last_actions.to_vec());
            }
            utilities.copy_from_slice(&[0.0, 1.0, 2.0]);
            Ok(())
        }

        fn decide(&mut self, seen: &Seen<'_>) -> Result<Decision, DecideError> {
            let mut utilities = [0.0; 3];
            self.utilities(seen, &mut utilities)?;
            Ok(Decision { action: 2, utility: 2.0 })
        }
    }

    #[test]
    fn agents_are_told_what_they_did_in_their_own_episode() {
        let ring = sortie_envs::open("group-matching/4x3x2", Split::Test, 1, &Default::default());
        let mut noting = Noting::default();
        let mut team = PolicyTeam::new(&mut noting);
        let played = watch(&mut *ring.unwrap(), &mut team, 0..3, 1, &mut ()).unwrap();
        let mut told = noting.0.into_iter();
        for episode in played {
            assert!(episode.steps > 1);
            assert_eq!(told.next(), Some(vec![NO_ACTION; 4]));
            assert!(told.by_ref().take(episode.steps as usize - 1).all(|last| last == [2; 4]));
        }
        assert_eq!(told.next(), None);
    }
}
