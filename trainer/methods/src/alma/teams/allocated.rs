//! A team and who allocates it, as one that plays anywhere.

use sortie_envs::{DecisionPoints, EntitySet, Observation, Random, UNASSIGNED};
use sortie_learn::{Act, LearnError, Scenes};

use super::{Allocate, Scene, Situation, Team};
use crate::alma::agents::NO_ACTION;

/// What an instance remembers between steps.
#[derive(Clone, Debug)]
struct Place {
    points: DecisionPoints,
    allocation: Vec<u8>,
    last_actions: Vec<u8>,
    strategies: Vec<f32>,
    seen: Observation,
}

/// A team that is allocated at decision points.
pub struct AllocatedTeam<'a> {
    team: Box<dyn Team + 'a>,
    allocator: Box<dyn Allocate + 'a>,
    interval: u32,
    places: Vec<Place>,
}

impl<'a> AllocatedTeam<'a> {
    /// A team that is allocated every so many steps, and whenever the open tasks change.
    pub fn new(team: Box<dyn Team + 'a>, allocator: Box<dyn Allocate + 'a>, interval: u32) -> Self {
        Self { team, allocator, interval, places: Vec::new() }
    }

    /// Observes every scene, and decides where that is due.
    fn decide(&mut self, scenes: &Scenes<'_>, random: &mut [Random]) -> Result<(), LearnError> {
        let environment = scenes.environment;
        let agents = environment.spec().shape.agents;
        let new = || Place {
            points: DecisionPoints::every(self.interval),
            allocation: vec![UNASSIGNED; agents],
            last_actions: vec![NO_ACTION; agents],
            strategies: Vec::new(),
            seen: Observation::default(),
        };
        for scene in scenes.scenes {
            let places = self.places.len().max(scene.instance + 1);
            self.places.resize_with(places, new);
            let place = &mut self.places[scene.instance];
            if scene.begins {
                *place = new();
            }
            environment.observe(scene.state, 0, EntitySet::MAX, &mut place.seen);
            if place.points.is_due(scene.tasks_changed) {
                let Place { seen, last_actions, allocation, strategies, .. } = place;
                let situation = Situation { environment, state: scene.state, last_actions };
                let generator = &mut random[scene.instance];
                self.allocator.decide(situation, &mut *self.team, generator, allocation)?;
                self.team.advise(seen, strategies)?;
            }
        }
        Ok(())
    }
}

impl Act for AllocatedTeam<'_> {
    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        random: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        self.decide(scenes, random)?;
        let environment = scenes.environment;
        let agents = environment.spec().shape.agents;
        let Self { team, places, .. } = self;
        let shown = scenes.scenes.iter().map(|scene| {
            let Place { allocation, last_actions, strategies, seen, .. } = &places[scene.instance];
            let (world, state) = (scene.instance, scene.state);
            Scene { world, environment, state, seen, allocation, last_actions, strategies }
        });
        let shown: Vec<Scene<'_>> = shown.collect();
        team.act(&shown, actions, agents)?;
        for (scene, actions) in scenes.scenes.iter().zip(actions.chunks_exact(agents)) {
            let last_actions = &mut places[scene.instance].last_actions;
            last_actions.iter_mut().zip(actions).for_each(|(last, action)| *last = *action as u8);
        }
        Ok(())
    }

    fn allocation(&self, instance: usize) -> &[u8] {
        &self.places[instance].allocation
    }
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use super::*;
    use crate::alma::teams::{RuleAllocator, ScriptedActors};
    use sortie_envs::{Environment, Split, Step};
    use sortie_learn::play::{Onlooker, Watched, watch};

    /// What a team and its allocator are shown, and what comes of it.
    #[derive(Default)]
    struct Shown {
        decided: Vec<bool>,
        last_actions: Vec<Vec<u8>>,
        actions: Vec<Vec<u16>>,
        tasks_changed: Vec<bool>,
    }

    struct Noting<'a, T>(T, &'a RefCell<Shown>);

    impl<T: Team> Team for Noting<'_, T> {
        fn act(
            &mut self,
            scenes: &[Scene<'_>],
            actions: &mut [u16],
            agents: usize,
        ) -> Result<(), LearnError> {
            let mut shown = self.1.borrow_mut();
            shown.last_actions.push(scenes[0].last_actions.to_vec());
            let states = shown.last_actions.len();
            shown.decided.resize(states, false);
            self.0.act(scenes, actions, agents)
        }
    }

    impl<A: Allocate> Allocate for Noting<'_, A> {
        fn allocate(
            &mut self,
            environment: &dyn Environment,
            state: &[u8],
            random: &mut Random,
            allocation: &mut [u8],
        ) -> Result<(), LearnError> {
            let mut shown = self.1.borrow_mut();
            let states = shown.last_actions.len();
            shown.decided.resize(states, false);
            shown.decided.push(true);
            self.0.allocate(environment, state, random, allocation)
        }
    }

    struct Watching<'a>(&'a RefCell<Shown>);

    impl Onlooker for Watching<'_> {
        fn started(&mut self, _: Watched<'_>) -> Result<(), LearnError> {
            Ok(())
        }

        fn stepped(
            &mut self,
            _: Watched<'_>,
            actions: &[u16],
            step: &Step,
        ) -> Result<(), LearnError> {
            let mut shown = self.0.borrow_mut();
            shown.actions.push(actions.to_vec());
            shown.tasks_changed.push(step.tasks_changed);
            Ok(())
        }
    }

    #[test]
    fn a_team_sees_what_it_did_and_is_allocated_at_decision_points() {
        let worlds =
            sortie_envs::open("save-the-city/2-5a_2-5b", Split::Test, 1, &Default::default());
        let shown = RefCell::new(Shown::default());
        let team = Box::new(Noting(ScriptedActors::new(1), &shown));
        let allocator = Box::new(Noting(RuleAllocator("coordinated"), &shown));
        let mut team = AllocatedTeam::new(team, allocator, 4);
        watch(&mut *worlds.unwrap(), &mut team, 0..1, 3, &mut Watching(&shown)).unwrap();
        drop(team);

        let Shown { decided, last_actions, actions, tasks_changed } = shown.into_inner();
        assert_eq!((decided.len(), last_actions.len()), (actions.len(), actions.len()));
        assert!(last_actions[0].iter().all(|last| *last == NO_ACTION));
        for (taken, seen) in actions.iter().zip(&last_actions[1..]) {
            assert!(taken.iter().zip(seen).all(|(taken, seen)| *taken == u16::from(*seen)));
        }
        let mut since = 4;
        for (state, decided) in decided.iter().enumerate() {
            let changed = state > 0 && tasks_changed[state - 1];
            assert_eq!(*decided, changed || since == 4, "state {state}");
            since = if *decided { 1 } else { since + 1 };
        }
        assert!(tasks_changed.contains(&true) && actions.len() > 20);
    }
}
