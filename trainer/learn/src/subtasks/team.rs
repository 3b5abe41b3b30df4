//! Agents and who allocates them, as one team that plays anywhere.

use sortie_envs::{Environment, Random};

use super::{Agents, Allocate, Places, ToAllocate};
use crate::act::{Act, Ask, Scene, Scenes, Thought};
use crate::error::Result;

/// A team whose agents are allocated at decision points.
pub struct AllocatedTeam<'a> {
    agents: Box<dyn Agents + 'a>,
    allocator: Box<dyn Allocate + 'a>,
    pub(crate) places: Places,
}

impl<'a> AllocatedTeam<'a> {
    /// Agents that are allocated every so many steps, and whenever the open tasks change.
    pub fn new(
        agents: Box<dyn Agents + 'a>,
        allocator: Box<dyn Allocate + 'a>,
        interval: u32,
    ) -> Self {
        Self { agents, allocator, places: Places::new(interval) }
    }

    /// Other actions were taken in an instance than the team chose last.
    pub fn did(&mut self, instance: usize, actions: &[u16]) {
        self.places.did(instance, actions);
    }

    /// Observes a scene, and allocates where that is due; whether it was.
    pub(crate) fn decide(
        &mut self,
        environment: &dyn Environment,
        scene: &Scene<'_>,
        random: &mut Random,
    ) -> Result<bool> {
        let place = self.places.look(environment, scene);
        if place.is_due {
            let (state, allocation) = (scene.state, &mut place.allocation[..]);
            self.allocator.allocate(ToAllocate { environment, state, random, allocation })?;
            self.agents.advise(&place.seen, &mut place.strategies)?;
        }
        Ok(place.is_due)
    }

    /// Lets the agents act in scenes that were [decided](Self::decide).
    pub(crate) fn choose(&mut self, scenes: &Scenes<'_>, actions: &mut [u16]) -> Result<()> {
        let slots = scenes.environment.spec().shape.agents;
        self.agents.act(&self.places.scenes(scenes), actions, slots)?;
        self.places.note(scenes, actions);
        Ok(())
    }
}

impl Act for AllocatedTeam<'_> {
    fn act(&mut self, Ask { scenes, random, actions }: Ask<'_>) -> Result<()> {
        for scene in scenes.scenes {
            self.decide(scenes.environment, scene, &mut random[scene.instance])?;
        }
        self.choose(scenes, actions)
    }

    fn allocation(&self, instance: usize) -> &[u8] {
        &self.places.of(instance).allocation
    }

    fn thoughts(&mut self, scenes: &Scenes<'_>, _: &[u16]) -> Vec<Thought> {
        self.agents.thoughts(&self.places.scenes(scenes))
    }
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use super::*;
    use crate::play::{Onlooker, Watched, watch};
    use crate::subtasks::{AllocatedScene, NO_ACTION, RuleAllocator, ScriptedAgents};
    use sortie_envs::{Split, Step};

    /// What agents and their allocator are shown, and what comes of it.
    #[derive(Default)]
    struct Shown {
        decided: Vec<bool>,
        last_actions: Vec<Vec<u8>>,
        actions: Vec<Vec<u16>>,
        tasks_changed: Vec<bool>,
    }

    struct Noting<'a, T>(T, &'a RefCell<Shown>);

    impl<T: Agents> Agents for Noting<'_, T> {
        fn act(
            &mut self,
            scenes: &[AllocatedScene<'_>],
            actions: &mut [u16],
            slots: usize,
        ) -> Result<()> {
            let mut shown = self.1.borrow_mut();
            shown.last_actions.push(scenes[0].last_actions.to_vec());
            let states = shown.last_actions.len();
            shown.decided.resize(states, false);
            self.0.act(scenes, actions, slots)
        }
    }

    impl<A: Allocate> Allocate for Noting<'_, A> {
        fn allocate(&mut self, to: ToAllocate<'_>) -> Result<()> {
            let mut shown = self.1.borrow_mut();
            let states = shown.last_actions.len();
            shown.decided.resize(states, false);
            shown.decided.push(true);
            self.0.allocate(to)
        }
    }

    struct Watching<'a>(&'a RefCell<Shown>);

    impl Onlooker for Watching<'_> {
        fn started(&mut self, _: Watched<'_>) -> Result<()> {
            Ok(())
        }

        fn stepped(&mut self, _: Watched<'_>, actions: &[u16], step: &Step) -> Result<()> {
            let mut shown = self.0.borrow_mut();
            shown.actions.push(actions.to_vec());
            shown.tasks_changed.push(step.tasks_changed);
            Ok(())
        }
    }

    #[test]
    fn agents_see_what_they_did_and_are_allocated_at_decision_points() {
        let worlds =
            sortie_envs::open("save-the-city/2-5a_2-5b", Split::Test, 1, &Default::default());
        let shown = RefCell::new(Shown::default());
        let agents = Box::new(Noting(ScriptedAgents::new(1), &shown));
        let allocator = Box::new(Noting(RuleAllocator("coordinated"), &shown));
        let mut team = AllocatedTeam::new(agents, allocator, 4);
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

    #[test]
    fn agents_see_what_was_done_instead() {
        let city = sortie_envs::open("save-the-city", Split::Test, 1, &Default::default());
        let (mut city, mut random) =
            (city.unwrap(), crate::random::generator(1, crate::random::Purpose::Rollout, 0));
        let (shown, mut state) = (RefCell::new(Shown::default()), Vec::new());
        city.reset(0, &mut random);
        city.save(0, &mut state);
        let agents = Box::new(Noting(ScriptedAgents::new(1), &shown));
        let mut team = AllocatedTeam::new(agents, Box::new(RuleAllocator("coordinated")), 4);
        let mut actions = vec![0; city.spec().shape.agents];
        let mut scene = Scene { instance: 0, state: &state, begins: true, tasks_changed: false };
        for begins in [true, false] {
            scene.begins = begins;
            let scenes = Scenes { environment: &*city, scenes: &[scene] };
            let random = &mut [random.clone()];
            team.act(Ask { scenes: &scenes, random, actions: &mut actions }).unwrap();
            team.did(0, &vec![3; actions.len()]);
        }
        drop(team);
        assert!(shown.into_inner().last_actions[1].iter().all(|last| *last == 3));
    }
}
