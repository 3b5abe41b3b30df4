//! Agents and who allocates them, as one team that plays anywhere.

use sortie_envs::{DecisionPoints, EntitySet, Environment, Observation, Random, UNASSIGNED};

use super::{Agents, Allocate, AllocatedScene, NO_ACTION};
use crate::act::{Act, Scene, Scenes, Thought};
use crate::error::LearnError;

/// What an instance remembers between steps.
#[derive(Clone, Debug)]
struct Place {
    points: DecisionPoints,
    allocation: Vec<u8>,
    /// What the agents had done when they came into the state that is seen.
    last_actions: Vec<u8>,
    /// What they do in it.
    actions: Vec<u8>,
    strategies: Vec<f32>,
    seen: Observation,
}

impl Place {
    fn new(interval: u32, agents: usize) -> Self {
        Self {
            points: DecisionPoints::every(interval),
            allocation: vec![UNASSIGNED; agents],
            last_actions: vec![NO_ACTION; agents],
            actions: vec![NO_ACTION; agents],
            strategies: Vec::new(),
            seen: Observation::default(),
        }
    }
}

/// A team whose agents are allocated at decision points.
pub struct AllocatedTeam<'a> {
    agents: Box<dyn Agents + 'a>,
    allocator: Box<dyn Allocate + 'a>,
    interval: u32,
    places: Vec<Place>,
}

impl<'a> AllocatedTeam<'a> {
    /// Agents that are allocated every so many steps, and whenever the open tasks change.
    pub fn new(
        agents: Box<dyn Agents + 'a>,
        allocator: Box<dyn Allocate + 'a>,
        interval: u32,
    ) -> Self {
        Self { agents, allocator, interval, places: Vec::new() }
    }

    /// Other actions were taken in an instance than the team chose last.
    pub fn did(&mut self, instance: usize, actions: &[u16]) {
        note(&mut self.places[instance].actions, actions);
    }

    /// Observes a scene, and allocates where that is due; whether it was.
    pub(crate) fn decide(
        &mut self,
        environment: &dyn Environment,
        scene: &Scene<'_>,
        random: &mut Random,
    ) -> Result<bool, LearnError> {
        let Self { agents, allocator, interval, places } = self;
        let new = || Place::new(*interval, environment.spec().shape.agents);
        places.resize_with(places.len().max(scene.instance + 1), new);
        let place = &mut places[scene.instance];
        if scene.begins {
            *place = new();
        }
        let Place { points, allocation, last_actions, actions, strategies, seen } = place;
        last_actions.copy_from_slice(actions);
        environment.observe(scene.state, 0, EntitySet::MAX, seen);
        let is_due = points.is_due(scene.tasks_changed);
        if is_due {
            allocator.allocate(environment, scene.state, random, allocation)?;
            agents.advise(seen, strategies)?;
        }
        Ok(is_due)
    }

    /// Lets the agents act in scenes that were [decided](Self::decide).
    pub(crate) fn choose(
        &mut self,
        scenes: &Scenes<'_>,
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        let slots = scenes.environment.spec().shape.agents;
        self.agents.act(&allocated(&self.places, scenes), actions, slots)?;
        for (scene, actions) in scenes.scenes.iter().zip(actions.chunks_exact(slots)) {
            note(&mut self.places[scene.instance].actions, actions);
        }
        Ok(())
    }

    /// What the agents of an instance see.
    pub(crate) fn seen(&self, instance: usize) -> &Observation {
        &self.places[instance].seen
    }

    /// Gives the agents of an instance other subtasks.
    pub(crate) fn reallocate(&mut self, instance: usize, allocation: &[u8]) {
        self.places[instance].allocation.copy_from_slice(allocation);
    }

    /// Has a second instance go on from where a first one stands.
    pub(crate) fn copy(&mut self, from: usize, to: usize) {
        let place = self.places[from].clone();
        self.places.resize(self.places.len().max(to + 1), place.clone());
        self.places[to] = place;
    }
}

/// The scenes as agents see them.
fn allocated<'a>(places: &'a [Place], scenes: &Scenes<'a>) -> Vec<AllocatedScene<'a>> {
    let environment = scenes.environment;
    let shown = scenes.scenes.iter().map(|scene| {
        let Place { allocation, last_actions, strategies, seen, .. } = &places[scene.instance];
        let (world, state) = (scene.instance, scene.state);
        AllocatedScene { world, environment, state, seen, allocation, last_actions, strategies }
    });
    shown.collect()
}

/// Environments have few actions.
fn note(actions: &mut [u8], taken: &[u16]) {
    actions.iter_mut().zip(taken).for_each(|(noted, taken)| *noted = *taken as u8);
}

impl Act for AllocatedTeam<'_> {
    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        random: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        for scene in scenes.scenes {
            self.decide(scenes.environment, scene, &mut random[scene.instance])?;
        }
        self.choose(scenes, actions)
    }

    fn allocation(&self, instance: usize) -> &[u8] {
        &self.places[instance].allocation
    }

    fn thoughts(&mut self, scenes: &Scenes<'_>, _: &[u16]) -> Vec<Thought> {
        self.agents.thoughts(&allocated(&self.places, scenes))
    }
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use super::*;
    use crate::play::{Onlooker, Watched, watch};
    use crate::subtasks::{RuleAllocator, ScriptedAgents};
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
        ) -> Result<(), LearnError> {
            let mut shown = self.1.borrow_mut();
            shown.last_actions.push(scenes[0].last_actions.to_vec());
            let states = shown.last_actions.len();
            shown.decided.resize(states, false);
            self.0.act(scenes, actions, slots)
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
            team.act(&scenes, &mut [random.clone()], &mut actions).unwrap();
            team.did(0, &vec![3; actions.len()]);
        }
        drop(team);
        assert!(shown.into_inner().last_actions[1].iter().all(|last| *last == 3));
    }
}
