//! Cooperative Treasure Collection: collectors take treasures to banks of their kind (dissertation chapter 3).

mod rules;
mod script;
mod seen;
mod world;

use alloc::string::String;
use alloc::vec;
use alloc::vec::Vec;

use serde::Deserialize;

use super::bytes::Reader;
use super::columns::Row;
use super::physics::{Body, Mover};
use super::picture::{Disc, Drawn, Picture, Thing};
use super::plane::{Point, anywhere};
use super::scenario::Scenario;
use crate::random::{Random, below};
use crate::spec::{Metric, Role};

pub use world::{Hand, Hoard, Stage, Treasure};

/// One of so many agents is a bank.
pub(super) const AGENTS_PER_BANK: usize = 4;
/// Half side of the square that treasures lie in.
const FIELD: f64 = 0.95;
const TREASURE_RADIUS: f64 = 0.025;

const COLLECTOR: Body =
    Body { radius: 0.05, mass: 1.0, thrust: 2.25, max_speed: 1.0, collides: true };
const BANK: Body = Body { radius: 0.075, mass: 2.25, ..COLLECTOR };

/// What agents see of a treasure that was taken, until another one is there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub enum DeadTreasures {
    /// It is of its old kind and lies far away, as in the reference.
    Far,
    /// Zeros: nothing that a network would have to be normalised for.
    #[default]
    Zeros,
}

impl TryFrom<String> for DeadTreasures {
    type Error = &'static str;

    fn try_from(name: String) -> Result<Self, Self::Error> {
        match name.as_str() {
            "far" => Ok(Self::Far),
            "zeros" => Ok(Self::Zeros),
            _ => Err("`dead_treasures` is `far` or `zeros`"),
        }
    }
}

/// Collectors, and behind them banks: bank b takes treasures of kind b.
#[derive(Clone, Debug, PartialEq)]
pub struct TreasureCollection {
    bodies: Vec<Body>,
    collectors: usize,
    dead_treasures: DeadTreasures,
    episode_limit: u32,
}

impl TreasureCollection {
    /// So many banks, with three collectors and three treasures each.
    pub fn new(banks: usize, dead_treasures: DeadTreasures, episode_limit: u32) -> Self {
        let collectors = (AGENTS_PER_BANK - 1) * banks;
        let bodies = [vec![COLLECTOR; collectors], vec![BANK; banks]].concat();
        Self { bodies, collectors, dead_treasures, episode_limit }
    }

    fn agents(&self) -> usize {
        self.bodies.len()
    }

    fn banks(&self) -> usize {
        self.agents() - self.collectors
    }

    /// There are as many as collectors.
    fn treasures(&self) -> usize {
        self.collectors
    }

    /// The agent that takes treasures of a kind.
    fn bank_of(&self, kind: u8) -> usize {
        self.collectors + usize::from(kind)
    }

    /// Draws where a treasure lies and of which kind it is.
    fn draw(&self, random: &mut Random) -> (Point, u8) {
        (anywhere(random, FIELD), below(random, self.banks()) as u8)
    }
}

impl Scenario for TreasureCollection {
    type World = Hoard;

    const METRICS: &'static [Metric] = &[
        Metric {
            name: "treasures",
            unit: "treasures",
            about: "treasures that were taken",
            is_reported: true,
        },
        Metric {
            name: "deliveries",
            unit: "treasures",
            about: "treasures that were brought to their bank",
            is_reported: true,
        },
        Metric {
            name: "collisions",
            unit: "pairs",
            about: "pairs of collectors that touch, summed over steps",
            is_reported: true,
        },
    ];

    fn roles(&self) -> Vec<Role> {
        self.named_roles()
    }

    fn episode_limit(&self) -> u32 {
        self.episode_limit
    }

    fn world(&self) -> Hoard {
        Hoard {
            movers: vec![Mover::default(); self.agents()],
            hands: vec![Hand::default(); self.collectors],
            treasures: vec![Treasure::default(); self.treasures()],
            ..Hoard::default()
        }
    }

    fn reset(&self, world: &mut Hoard, random: &mut Random) {
        for mover in &mut world.movers {
            *mover = Mover { position: anywhere(random, 1.0), velocity: [0.0; 2] };
        }
        world.hands.fill(Hand::default());
        for treasure in &mut world.treasures {
            let (position, kind) = self.draw(random);
            *treasure = Treasure { position, kind, ..Treasure::default() };
        }
        (world.taken, world.delivered, world.collisions) = (0, 0, 0);
    }

    fn step(&self, world: &mut Hoard, actions: &[u16], random: &mut Random, rewards: &mut [f64]) {
        self.step_by(world, actions, rewards, |_| self.draw(random));
    }

    fn metrics(&self, world: &Hoard, _: u32) -> Vec<Option<f64>> {
        let counts = [world.taken, world.delivered, world.collisions];
        counts.map(|count| Some(count.into())).to_vec()
    }

    fn write(&self, world: &Hoard, bytes: &mut Vec<u8>) {
        world.write(bytes);
    }

    fn read(&self, bytes: &mut Reader<'_>) -> Hoard {
        Hoard::read(self.agents(), self.collectors, bytes)
    }

    fn observe(&self, world: &Hoard, agent: usize, row: &mut Row<'_>) {
        self.see(world, agent, row);
    }

    fn entity<'w>(
        &self,
        world: &'w mut Hoard,
        entity: usize,
    ) -> Option<(&'w mut Point, Option<&'w mut Point>)> {
        if let Some(mover) = world.movers.get_mut(entity) {
            return Some((&mut mover.position, Some(&mut mover.velocity)));
        }
        let treasure = world.treasures.get_mut(entity.checked_sub(self.agents())?)?;
        treasure.is_alive().then_some((&mut treasure.position, None))
    }

    fn picture(&self, world: &Hoard) -> Picture {
        let agent = |(agent, mover): (usize, &Mover)| Drawn {
            disc: Some(Disc { place: mover.position, radius: self.bodies[agent].radius }),
            takes: agent.checked_sub(self.collectors).map(|kind| kind as u8),
            holds: world.hands.get(agent).and_then(|hand| hand.now),
            ..Drawn::default()
        };
        let thing = |treasure: &Treasure| {
            let disc = Disc { place: treasure.position, radius: TREASURE_RADIUS };
            Thing { disc: treasure.is_alive().then_some(disc), kind: Some(treasure.kind) }
        };
        Picture {
            agents: world.movers.iter().enumerate().map(agent).collect(),
            things: world.treasures.iter().map(thing).collect(),
        }
    }

    fn script(&self, world: &Hoard, actions: &mut [u16]) {
        self.collect(world, actions);
    }

    fn distance_to_go(&self, world: &Hoard, agent: usize) -> f64 {
        self.missing(world, agent)
    }
}
