//! Cooperative Navigation: agents cover landmarks without touching each other.

use alloc::vec::Vec;
use alloc::{format, vec};

use super::physics::{
    Body, MOVES, Mover, Point, advance, anywhere, from_to, pair_nearest, squared_distance, touch,
    towards,
};
use super::scenario::{
    Names, Row, Scenario, Spot, agent, drawn, landmarks, write_movers, write_number, write_point,
};
use crate::bytes::Reader;
use crate::picture::Picture;
use crate::random::Random;
use crate::spec::{Metric, Role};

/// Numbers of an utterance, which nobody makes.
const UTTERANCE: usize = 2;

const BODY: Body =
    Body { radius: 0.15, mass: 1.0, thrust: 5.0, max_speed: f64::INFINITY, collides: true };

/// Agents that cover as many landmarks.
#[derive(Clone, Debug, PartialEq)]
pub struct Navigation {
    bodies: Vec<Body>,
    episode_limit: u32,
}

/// Where everything is.
#[derive(Clone, Debug, PartialEq)]
pub struct Navigated {
    /// The agents.
    pub movers: Vec<Mover>,
    /// Where the landmarks are.
    pub landmarks: Vec<Point>,
    /// Steps of touching pairs so far.
    pub collisions: u32,
    /// Sum over steps and landmarks of the distance to the nearest agent.
    pub uncovered: f64,
}

impl Navigation {
    /// So many agents, and as many landmarks.
    pub fn new(agents: usize, episode_limit: u32) -> Self {
        Self { bodies: vec![BODY; agents], episode_limit }
    }

    fn agents(&self) -> usize {
        self.bodies.len()
    }

    /// Writes what each agent earns, with a collision of each with itself as in the reference.
    fn reward(&self, world: &mut Navigated, rewards: &mut [f64]) {
        let agents = || world.movers.iter().map(|mover| mover.position);
        let nearest = |landmark: &Point| {
            let squared = agents().map(|place| squared_distance(place, *landmark));
            libm::sqrt(squared.fold(f64::INFINITY, f64::min))
        };
        let uncovered: f64 = world.landmarks.iter().map(nearest).sum();
        rewards.fill(-uncovered - 1.0);
        for (one, place) in agents().enumerate() {
            for (other, its) in agents().enumerate().skip(one + 1) {
                if touch(2.0 * BODY.radius, squared_distance(place, its)) {
                    rewards[one] -= 1.0;
                    rewards[other] -= 1.0;
                    world.collisions += 1;
                }
            }
        }
        world.uncovered += uncovered;
    }
}

impl Scenario for Navigation {
    type World = Navigated;

    const METRICS: &'static [Metric] = &[
        Metric::reported(
            "uncovered",
            "half sides",
            "distance from landmarks to the nearest agent, summed, mean over steps",
        ),
        Metric::reported("collisions", "pairs", "pairs of agents that touch, summed over steps"),
    ];

    fn roles(&self) -> Vec<Role> {
        let (agents, others) = (self.agents(), self.agents() - 1);
        let names = Names::default()
            .velocity("")
            .place("")
            .each("landmark", agents, Names::place)
            .each("other", others, Names::place)
            .each("other", others, |names, other| names.flags(&format!("{other}says-"), UTTERANCE));
        vec![names.role("agent", 0..agents, &MOVES)]
    }

    fn episode_limit(&self) -> u32 {
        self.episode_limit
    }

    fn world(&self) -> Navigated {
        let agents = self.agents();
        Navigated {
            movers: vec![Mover::default(); agents],
            landmarks: vec![[0.0; 2]; agents],
            collisions: 0,
            uncovered: 0.0,
        }
    }

    fn reset(&self, world: &mut Navigated, random: &mut Random) {
        for mover in &mut world.movers {
            *mover = Mover { position: anywhere(random, 1.0), velocity: [0.0; 2] };
        }
        world.landmarks.fill_with(|| anywhere(random, 1.0));
        (world.collisions, world.uncovered) = (0, 0.0);
    }

    fn step(&self, world: &mut Navigated, actions: &[u16], _: &mut Random, rewards: &mut [f64]) {
        advance(&mut world.movers, &self.bodies, actions);
        self.reward(world, rewards);
    }

    fn metrics(&self, world: &Navigated, steps: u32) -> Vec<Option<f64>> {
        let uncovered = (steps > 0).then(|| world.uncovered / f64::from(steps));
        vec![uncovered, Some(world.collisions.into())]
    }

    fn write(&self, world: &Navigated, bytes: &mut Vec<u8>) {
        write_movers(&world.movers, bytes);
        world.landmarks.iter().for_each(|landmark| write_point(*landmark, bytes));
        bytes.extend_from_slice(&world.collisions.to_le_bytes());
        write_number(world.uncovered, bytes);
    }

    fn read(&self, bytes: &mut Reader<'_>) -> Navigated {
        Navigated {
            movers: (0..self.agents()).map(|_| bytes.mover()).collect(),
            landmarks: (0..self.agents()).map(|_| bytes.point()).collect(),
            collisions: bytes.u32(),
            uncovered: bytes.number(),
        }
    }

    fn observe(&self, world: &Navigated, agent: usize, row: &mut Row<'_>) {
        let own = &world.movers[agent];
        row.pair(own.velocity);
        row.pair(own.position);
        for landmark in &world.landmarks {
            row.pair(from_to(own.position, *landmark));
        }
        for (_, other) in world.movers.iter().enumerate().filter(|(other, _)| *other != agent) {
            row.pair(from_to(own.position, other.position));
        }
    }

    fn entity<'w>(&self, world: &'w mut Navigated, entity: usize) -> Option<Spot<'w>> {
        if let Some(mover) = world.movers.get_mut(entity) {
            return Some((&mut mover.position, Some(&mut mover.velocity)));
        }
        let landmark = entity.checked_sub(self.agents())?;
        Some((world.landmarks.get_mut(landmark)?, None))
    }

    fn picture(&self, world: &Navigated) -> Picture {
        let movers = world.movers.iter().enumerate();
        let agents = movers
            .map(|(number, mover)| agent("agent", number, Some((mover.position, BODY.radius))));
        drawn(agents.collect(), landmarks(&world.landmarks))
    }

    /// The nearest agent goes to the nearest landmark, then the nearest of the rest to the nearest that is left.
    fn script(&self, world: &Navigated, actions: &mut [u16]) {
        let agents = world.movers.iter().map(|mover| mover.position).enumerate().collect();
        let landmarks = world.landmarks.iter().copied().enumerate().collect();
        for (agent, landmark) in pair_nearest(agents, landmarks) {
            actions[agent] = towards(&BODY, &world.movers[agent], world.landmarks[landmark]);
        }
    }
}
