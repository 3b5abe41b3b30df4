//! Rover-Tower: each rover is led by words of a tower, which alone knows the goal (dissertation chapter 3).

use alloc::string::{String, ToString};
use alloc::vec::Vec;
use alloc::{format, vec};
use core::mem;

use super::physics::{
    ACTIONS, Body, MOVES, Mover, Point, advance, anywhere, squared_distance, towards,
};
use super::scenario::{
    Names, PAIR, Row, Scenario, Spot, agent, drawn, landmarks, write_choice, write_movers,
    write_point,
};
use crate::bytes::Reader;
use crate::picture::{Disc, Link, Outline, Picture, lettered};
use crate::random::{Random, below};
use crate::spec::{Metric, Role};

/// Landmarks, however many rovers there are.
const LANDMARKS: usize = 6;
const LANDMARK_RADIUS: f64 = 0.04;

const ROVER: Body =
    Body { radius: 0.075, mass: 1.0, thrust: 2.25, max_speed: 1.0, collides: false };

/// The square of a distance that counts as near: the reference compares it with a length.
const NEAR: f64 = 1.5 * (ROVER.radius + LANDMARK_RADIUS);
/// What a pair earns by a step near its goal.
const BONUS: f64 = 10.0;

/// Rovers, and as many towers.
#[derive(Clone, Debug, PartialEq)]
pub struct RoverTower {
    bodies: Vec<Body>,
    episode_limit: u32,
}

/// Where the rovers and landmarks are, and what the towers say. Towers have no place: nobody sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct Roved {
    /// The rovers.
    pub movers: Vec<Mover>,
    /// Where the landmarks are.
    pub landmarks: Vec<Point>,
    /// The towers.
    pub towers: Vec<Tower>,
    /// Steps of rovers near their goals so far.
    pub near: u32,
}

/// One tower.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tower {
    /// Its rover.
    pub rover: u8,
    /// The landmark that its rover should be at.
    pub goal: u8,
    /// What it said in the last step.
    pub said: Option<u8>,
}

impl RoverTower {
    /// So many rovers, and as many towers.
    pub fn new(rovers: usize, episode_limit: u32) -> Self {
        Self { bodies: vec![ROVER; rovers], episode_limit }
    }

    fn rovers(&self) -> usize {
        self.bodies.len()
    }

    /// Writes what both members of each pair earn.
    fn reward(&self, world: &mut Roved, rewards: &mut [f64]) {
        let (rovers, towers) = rewards.split_at_mut(self.rovers());
        for (tower, tower_earns) in world.towers.iter().zip(towers) {
            let rover = usize::from(tower.rover);
            let goal = world.landmarks[usize::from(tower.goal)];
            let squared = squared_distance(world.movers[rover].position, goal);
            let is_near = squared < NEAR;
            *tower_earns = if is_near { BONUS - squared } else { -squared };
            rovers[rover] = *tower_earns;
            world.near += u32::from(is_near);
        }
    }
}

impl Scenario for RoverTower {
    type World = Roved;

    const METRICS: &'static [Metric] =
        &[Metric::reported("near", "steps", "steps near the goal, mean over rovers")];

    fn roles(&self) -> Vec<Role> {
        let pairs = self.rovers();
        let rover =
            Names::default().flags("tower-", pairs).flags("says-", ACTIONS).place("").velocity("");
        let tower = Names::default().flags("rover-", pairs).place("rover-").place("goal-");
        let messages: Vec<String> = (0..ACTIONS).map(|message| format!("say-{message}")).collect();
        let messages: Vec<&str> = messages.iter().map(String::as_str).collect();
        vec![
            rover.role("rover", 0..pairs, &MOVES),
            tower.role("tower", pairs..2 * pairs, &messages),
        ]
    }

    fn episode_limit(&self) -> u32 {
        self.episode_limit
    }

    fn world(&self) -> Roved {
        let tower = |rover| Tower { rover: rover as u8, goal: 0, said: None };
        Roved {
            movers: vec![Mover::default(); self.rovers()],
            landmarks: vec![[0.0; 2]; LANDMARKS],
            towers: (0..self.rovers()).map(tower).collect(),
            near: 0,
        }
    }

    fn reset(&self, world: &mut Roved, random: &mut Random) {
        let pairs = self.rovers();
        for (rover, tower) in world.towers.iter_mut().enumerate() {
            let goal = below(random, LANDMARKS) as u8;
            *tower = Tower { rover: rover as u8, goal, said: None };
        }
        // Fisher and Yates 1938.
        for last in (1..pairs).rev() {
            let (other, its) = (below(random, last + 1), world.towers[last].rover);
            world.towers[last].rover = mem::replace(&mut world.towers[other].rover, its);
        }
        for mover in &mut world.movers {
            *mover = Mover { position: anywhere(random, 1.0), velocity: [0.0; 2] };
        }
        world.landmarks.fill_with(|| anywhere(random, 1.0));
        world.near = 0;
    }

    fn step(&self, world: &mut Roved, actions: &[u16], _: &mut Random, rewards: &mut [f64]) {
        let (moves, messages) = actions.split_at(self.rovers());
        advance(&mut world.movers, &self.bodies, moves);
        for (tower, message) in world.towers.iter_mut().zip(messages) {
            tower.said = Some(*message as u8);
        }
        self.reward(world, rewards);
    }

    fn metrics(&self, world: &Roved, _: u32) -> Vec<Option<f64>> {
        vec![Some(f64::from(world.near) / self.rovers() as f64)]
    }

    fn write(&self, world: &Roved, bytes: &mut Vec<u8>) {
        for Tower { rover, goal, said } in &world.towers {
            bytes.extend_from_slice(&[*rover, *goal]);
            write_choice(*said, bytes);
        }
        bytes.extend_from_slice(&world.near.to_le_bytes());
        write_movers(&world.movers, bytes);
        world.landmarks.iter().for_each(|landmark| write_point(*landmark, bytes));
    }

    fn read(&self, bytes: &mut Reader<'_>) -> Roved {
        let pairs = self.rovers();
        let mut tower = |_| Tower {
            rover: bytes.index("a tower leads rover", pairs),
            goal: bytes.index("a goal is landmark", LANDMARKS),
            said: bytes.choice("a tower says", ACTIONS),
        };
        let towers: Vec<Tower> = (0..pairs).map(&mut tower).collect();
        let near = bytes.u32();
        let led = towers.iter().fold(0_u64, |led, tower| led | 1 << (tower.rover % 64));
        let is_shared = led.count_ones() as usize != pairs;
        bytes.refuse(is_shared, || "two towers lead the same rover".into());
        Roved {
            movers: (0..pairs).map(|_| bytes.mover()).collect(),
            landmarks: (0..LANDMARKS).map(|_| bytes.point()).collect(),
            towers,
            near,
        }
    }

    fn observe(&self, world: &Roved, agent: usize, row: &mut Row<'_>) {
        let pairs = self.rovers();
        if let Some(own) = world.movers.get(agent) {
            let leads = |tower: &Tower| usize::from(tower.rover) == agent;
            let tower = world.towers.iter().position(leads);
            row.flags(tower.map(|tower| tower as u8), pairs);
            row.flags(tower.and_then(|tower| world.towers[tower].said), ACTIONS);
            row.mover(own);
        } else {
            let tower = world.towers[agent - pairs];
            row.flags(Some(tower.rover), pairs);
            row.pair(world.movers[usize::from(tower.rover)].position);
            row.pair(world.landmarks[usize::from(tower.goal)]);
        }
    }

    fn entity<'w>(&self, world: &'w mut Roved, entity: usize) -> Option<Spot<'w>> {
        if let Some(mover) = world.movers.get_mut(entity) {
            return Some((&mut mover.position, Some(&mut mover.velocity)));
        }
        let landmark = entity.checked_sub(2 * self.rovers())?;
        Some((world.landmarks.get_mut(landmark)?, None))
    }

    fn picture(&self, world: &Roved) -> Picture {
        let leader = |rover: usize| {
            let found = world.towers.iter().position(|tower| usize::from(tower.rover) == rover);
            found.map(|tower| (self.rovers() + tower, &world.towers[tower]))
        };
        let rovers = world.movers.iter().enumerate().map(|(rover, mover)| {
            let mut disc = agent("rover", rover, Some((mover.position, ROVER.radius)));
            if let Some((number, tower)) = leader(rover) {
                let place = world.landmarks[usize::from(tower.goal)];
                let goal = lettered(tower.goal.into());
                let is_near = squared_distance(mover.position, place) < NEAR;
                disc.status = format!("{} {goal}", if is_near { "near" } else { "away from" });
                disc.about = format!("led by {number} to {goal}; heard {}", said(tower));
            }
            disc
        });
        let towers = (self.rovers()..).zip(&world.towers).map(|(number, tower)| {
            let goal = lettered(tower.goal.into());
            let about = format!("leads {} to {goal}; said {}", tower.rover, said(tower));
            Disc { outline: Outline::Triangle, about, ..agent("tower", number, None) }
        });
        let links = (0..self.rovers()).filter_map(|rover| {
            let (leader, tower) = leader(rover)?;
            let goal = 2 * self.rovers() + usize::from(tower.goal);
            let way = |from| Link { name: "goal", from, to: goal };
            Some([Link { name: PAIR, from: rover, to: leader }, way(rover), way(leader)])
        });
        let agents = rovers.chain(towers).collect();
        Picture { links: links.flatten().collect(), ..drawn(agents, landmarks(&world.landmarks)) }
    }

    /// Rovers go straight to their goals, which they know; towers need not speak.
    fn script(&self, world: &Roved, actions: &mut [u16]) {
        for tower in &world.towers {
            let (rover, goal) = (usize::from(tower.rover), usize::from(tower.goal));
            actions[rover] = towards(&ROVER, &world.movers[rover], world.landmarks[goal]);
        }
        actions[self.rovers()..].fill(0);
    }
}

/// What a tower said last.
fn said(tower: &Tower) -> String {
    tower.said.map_or("nothing".into(), |message| message.to_string())
}
