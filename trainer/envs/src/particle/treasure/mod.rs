//! Cooperative Treasure Collection: collectors take treasures to banks of their kind (dissertation chapter 3).

mod world;

use alloc::string::String;
use alloc::vec::Vec;
use alloc::{format, vec};

use serde::Deserialize;

use super::physics::{
    Body, MOVES, Mover, Nearest, Point, SEEN, anywhere, distance, from_to, pair_nearest,
    squared_distance, towards,
};
use super::scenario::{Names, Row, Scenario, Spot, agent, drawn};
use crate::bytes::Reader;
use crate::picture::{Disc, Outline, Picture, lettered};
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
        Metric::reported("treasures", "treasures", "treasures that were taken"),
        Metric::reported("deliveries", "treasures", "treasures that were brought to their bank"),
        Metric::reported(
            "collisions",
            "pairs",
            "pairs of collectors that touch, summed over steps",
        ),
    ];

    fn roles(&self) -> Vec<Role> {
        let (agents, kinds) = (self.agents(), self.banks());
        let other = |names: Names, other: &str| {
            let names = names.place(other).velocity(other);
            names.flags(&format!("{other}bank-"), kinds).flags(&format!("{other}holds-"), kinds)
        };
        let treasure = |names: Names, treasure: &str| {
            names.place(treasure).flags(&format!("{treasure}kind-"), kinds)
        };
        let own = || Names::default().place("").velocity("");
        let around = |own: Names| {
            own.each("other", SEEN.min(agents - 1), other).each(
                "treasure",
                SEEN.min(self.treasures()),
                treasure,
            )
        };
        vec![
            around(own().flags("holds-", kinds)).role("collector", 0..self.collectors, &MOVES),
            around(own()).role("bank", self.collectors..agents, &MOVES),
        ]
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
        let (own, kinds) = (&world.movers[agent], self.banks());
        row.mover(own);
        if let Some(hand) = world.hands.get(agent) {
            row.flags(hand.seen, kinds);
        }
        let others = world.movers.iter().map(|mover| mover.position).enumerate();
        let others = Nearest::to(own.position, others.filter(|(other, _)| *other != agent));
        for other in others.things() {
            let mover = &world.movers[other];
            row.pair(from_to(own.position, mover.position));
            row.pair(mover.velocity);
            row.flags(other.checked_sub(self.collectors).map(|bank| bank as u8), kinds);
            row.flags(world.hands.get(other).and_then(|hand| hand.seen), kinds);
        }
        let treasures = world.treasures.iter().map(|treasure| treasure.seen_place());
        for treasure in Nearest::to(own.position, treasures.enumerate()).things() {
            let treasure = &world.treasures[treasure];
            if treasure.is_seen_dead() && self.dead_treasures == DeadTreasures::Zeros {
                row.skip(2 + kinds);
            } else {
                row.pair(from_to(own.position, treasure.seen_place()));
                row.flags(Some(treasure.seen_kind()), kinds);
            }
        }
    }

    fn entity<'w>(&self, world: &'w mut Hoard, entity: usize) -> Option<Spot<'w>> {
        if let Some(mover) = world.movers.get_mut(entity) {
            return Some((&mut mover.position, Some(&mut mover.velocity)));
        }
        let treasure = world.treasures.get_mut(entity.checked_sub(self.agents())?)?;
        treasure.is_alive().then_some((&mut treasure.position, None))
    }

    fn picture(&self, world: &Hoard) -> Picture {
        let letter = |kind: u8| lettered(kind.into()).to_lowercase();
        let movers = world.movers.iter().enumerate();
        let agents = movers.map(|(number, mover)| {
            let disc = Some((mover.position, self.bodies[number].radius));
            if let Some(kind) = number.checked_sub(self.collectors).map(|kind| kind as u8) {
                let label = format!("{number}{}", lettered(kind.into()));
                let (outline, about) = (Outline::Square, format!("takes {}", letter(kind)));
                return Disc {
                    label,
                    colour: Some(kind),
                    outline,
                    about,
                    ..agent("bank", number, disc)
                };
            }
            let colour = world.hands[number].now;
            let holds = colour.map(letter);
            let label = holds.as_ref().map_or(String::new(), |kind| format!("{number}{kind}"));
            let status = format!("holds {}", holds.as_deref().unwrap_or("nothing"));
            Disc { label, colour, status, ..agent("collector", number, disc) }
        });
        let thing = |treasure: &Treasure| Disc {
            name: letter(treasure.kind),
            kind: "treasure",
            outline: Outline::Diamond,
            colour: Some(treasure.kind),
            place: treasure.is_alive().then_some(treasure.position),
            ..Disc::default()
        };
        drawn(agents.collect(), world.treasures.iter().map(thing).collect())
    }

    /// Writes everybody's action.
    ///
    /// Free collectors go to treasures, nearest pairs first, holders to their bank, banks to the nearest holder of
    /// their kind.
    fn script(&self, world: &Hoard, actions: &mut [u16]) {
        let place = |agent: usize| world.movers[agent].position;
        let free = (0..self.collectors).filter(|collector| world.hands[*collector].now.is_none());
        let lie = world.treasures.iter().enumerate().filter(|(_, treasure)| treasure.is_alive());
        let pairs = pair_nearest(
            free.map(|collector| (collector, place(collector))).collect(),
            lie.map(|(number, treasure)| (number, treasure.position)).collect(),
        );
        actions[..self.collectors].fill(0);
        for (collector, treasure) in pairs {
            let goal = world.treasures[treasure].position;
            actions[collector] = towards(&COLLECTOR, &world.movers[collector], goal);
        }
        for (collector, hand) in world.hands.iter().enumerate() {
            if let Some(kind) = hand.now {
                let goal = place(self.bank_of(kind));
                actions[collector] = towards(&COLLECTOR, &world.movers[collector], goal);
            }
        }
        for kind in 0..self.banks() as u8 {
            let bank = self.bank_of(kind);
            let goal = self.nearest_holder(world, kind).unwrap_or_else(|| self.waiting_place(kind));
            actions[bank] = towards(&BANK, &world.movers[bank], goal);
        }
    }

    fn distance_to_go(&self, world: &Hoard, agent: usize) -> f64 {
        let own = world.movers[agent].position;
        let Some(hand) = world.hands.get(agent) else {
            let kind = (agent - self.collectors) as u8;
            let holder = self.nearest_holder(world, kind);
            return holder.map_or(NO_HOLDER, |holder| distance(own, holder).min(NO_HOLDER));
        };
        if let Some(kind) = hand.now {
            return distance(own, world.movers[self.bank_of(kind)].position);
        }
        let lie = world.treasures.iter().filter(|treasure| treasure.is_alive());
        let apart = lie.map(|treasure| distance(own, treasure.position));
        apart.fold(NO_TREASURE, f64::min)
    }
}

/// Half of the line, through the middle of the square, along which banks wait.
const LINE: f64 = 0.6;
/// Most that a free collector without a treasure, or a bank without a holder, is away from what it waits for.
const NO_TREASURE: f64 = 2.0;
const NO_HOLDER: f64 = 1.0;

impl TreasureCollection {
    /// Where the nearest holder of a bank's kind is.
    fn nearest_holder(&self, world: &Hoard, kind: u8) -> Option<Point> {
        let own = world.movers[self.bank_of(kind)].position;
        let holders = world.hands.iter().zip(&world.movers);
        let holders = holders.filter(|(hand, _)| hand.now == Some(kind));
        let apart = |place: &Point| squared_distance(own, *place);
        holders
            .map(|(_, mover)| mover.position)
            .min_by(|one, other| apart(one).total_cmp(&apart(other)))
    }

    /// Banks wait side by side, each in the middle of its share of the line.
    fn waiting_place(&self, kind: u8) -> Point {
        let share = (2.0 * f64::from(kind) + 1.0) / self.banks() as f64;
        [LINE * (share - 1.0), 0.0]
    }
}
