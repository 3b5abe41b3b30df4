//! What the scenarios of the plane differ in, and in what form they say what agents see, what is drawn, and their bytes.

use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;
use core::fmt::Debug;
use core::ops::Range;

use super::physics::{Mover, Point};
use crate::bytes::{LAYOUT, Reader};
use crate::environment::StateError;
use crate::picture::{Disc, Field, Outline, Picture, lettered};
use crate::random::Random;
use crate::rows::SparseRows;
use crate::spec::{Metric, Role};

/// Where something is, and how fast it moves, if it does.
pub type Spot<'w> = (&'w mut Point, Option<&'w mut Point>);

/// The rules of one scenario for teams of one size.
pub trait Scenario: Clone + Debug + Send + Sync + 'static {
    /// What an episode has beside its steps and its return.
    type World: Clone + Debug + Send + Sync;
    /// What episodes come to.
    const METRICS: &'static [Metric];

    /// Its agents, by what they see and do.
    fn roles(&self) -> Vec<Role>;

    /// Steps of every episode.
    fn episode_limit(&self) -> u32;

    /// Any world, to be [reset](Self::reset).
    fn world(&self) -> Self::World;

    /// Draws the start of an episode.
    fn reset(&self, world: &mut Self::World, random: &mut Random);

    /// Plays one step with possible actions, and writes what each agent earns.
    fn step(
        &self,
        world: &mut Self::World,
        actions: &[u16],
        random: &mut Random,
        rewards: &mut [f64],
    );

    /// What an episode of so many steps has come to, in the order of the metrics.
    fn metrics(&self, world: &Self::World, steps: u32) -> Vec<Option<f64>>;

    /// Adds the bytes of a world, always equally many.
    fn write(&self, world: &Self::World, bytes: &mut Vec<u8>);

    /// Reads what [`write`](Self::write) wrote; what the reader has refused is not looked at.
    fn read(&self, bytes: &mut Reader<'_>) -> Self::World;

    /// Writes what an agent sees.
    fn observe(&self, world: &Self::World, agent: usize, row: &mut Row<'_>);

    /// Where an agent or a thing is, with its velocity if it has one; agents come first. None of those that are nowhere.
    fn entity<'w>(&self, world: &'w mut Self::World, entity: usize) -> Option<Spot<'w>>;

    /// What a world looks like.
    fn picture(&self, world: &Self::World) -> Picture;

    /// Writes the actions of a team that knows the whole world.
    fn script(&self, world: &Self::World, actions: &mut [u16]);

    /// How far an agent is from what it should be at next, by which rewards are shaped.
    fn distance_to_go(&self, world: &Self::World, agent: usize) -> f64 {
        let _ = (world, agent);
        0.0
    }
}

const LENGTH: &str = "half sides of the square";
const SPEED: &str = "half sides in ten steps";
const FLAG: &str = "flag";

/// The names and units of what an agent sees.
#[derive(Default)]
pub(super) struct Names {
    names: Vec<String>,
    units: Vec<&'static str>,
}

impl Names {
    fn pair(mut self, name: &str, unit: &'static str) -> Self {
        for axis in ["x", "y"] {
            self.names.push(format!("{name}{axis}"));
            self.units.push(unit);
        }
        self
    }

    /// A place, or the way to one.
    pub(super) fn place(self, prefix: &str) -> Self {
        self.pair(prefix, LENGTH)
    }

    pub(super) fn velocity(self, prefix: &str) -> Self {
        self.pair(&format!("{prefix}velocity-"), SPEED)
    }

    /// So many flags, of which one is set or none.
    pub(super) fn flags(mut self, prefix: &str, count: usize) -> Self {
        self.names.extend((0..count).map(|flag| format!("{prefix}{flag}")));
        self.units.resize(self.names.len(), FLAG);
        self
    }

    /// The same for each of so many things.
    pub(super) fn each(self, what: &str, count: usize, add: impl Fn(Self, &str) -> Self) -> Self {
        (0..count).fold(self, |names, thing| add(names, &format!("{what}-{thing}-")))
    }

    /// A role whose agents see this.
    pub(super) fn role(self, name: &'static str, agents: Range<usize>, actions: &[&str]) -> Role {
        let actions = actions.iter().map(ToString::to_string).collect();
        Role { name, agents, features: self.names, units: self.units, actions }
    }
}

/// Writes what an agent sees, in the order of its names.
pub struct Row<'a> {
    rows: &'a mut SparseRows,
    column: usize,
}

impl<'a> Row<'a> {
    pub(super) fn new(rows: &'a mut SparseRows) -> Self {
        Self { rows, column: 0 }
    }

    #[inline]
    pub(super) fn pair(&mut self, pair: Point) {
        let column = self.column as u16;
        let [x, y] = pair.map(|number| number as f32);
        // Hardly anything is ever exactly zero.
        if x != 0.0 && y != 0.0 {
            self.rows.push_all(&[(column, x), (column + 1, y)]);
        } else {
            self.rows.push_unless_zero(self.column, x);
            self.rows.push_unless_zero(self.column + 1, y);
        }
        self.skip(2);
    }

    /// So many flags, of which one is set or none.
    #[inline]
    pub(super) fn flags(&mut self, set: Option<u8>, count: usize) {
        let flag = self.column + usize::from(set.unwrap_or(0));
        self.rows.push_unless_zero(flag, f32::from(u8::from(set.is_some())));
        self.skip(count);
    }

    /// So many zeros.
    #[inline]
    pub(super) fn skip(&mut self, count: usize) {
        self.column += count;
    }

    /// Where a mover is, and how fast.
    #[inline]
    pub(super) fn mover(&mut self, mover: &Mover) {
        self.pair(mover.position);
        self.pair(mover.velocity);
    }
}

/// Half of the side that is drawn: most agents stay within.
const DRAWN: f64 = 1.25;
/// What links two agents of which one leads the other.
pub(super) const PAIR: &str = "pair";

/// What all scenarios look like.
pub(super) fn drawn(agents: Vec<Disc>, things: Vec<Disc>) -> Picture {
    let field = Some(Field::plane(DRAWN, 0.1));
    Picture { field, agents, things, ..Picture::default() }
}

/// An agent by its number, which is somewhere or nowhere.
pub(super) fn agent(kind: &'static str, number: usize, disc: Option<(Point, f64)>) -> Disc {
    let (place, radius) = disc.unzip();
    Disc { name: number.to_string(), kind, place, radius, ..Disc::default() }
}

/// Landmarks by their letters.
pub(super) fn landmarks(places: &[Point]) -> Vec<Disc> {
    let landmark = |(number, place): (usize, &Point)| Disc {
        name: lettered(number),
        kind: "landmark",
        outline: Outline::Cross,
        place: Some(*place),
        ..Disc::default()
    };
    places.iter().enumerate().map(landmark).collect()
}

/// The byte of what is not there.
const NONE: u8 = u8::MAX;

impl Reader<'_> {
    #[inline]
    pub(super) fn number(&mut self) -> f64 {
        let number = self.f64();
        self.refuse(!number.is_finite(), || "one of its numbers is none".into());
        number
    }

    #[inline]
    pub(super) fn point(&mut self) -> Point {
        [self.number(), self.number()]
    }

    #[inline]
    pub(super) fn mover(&mut self) -> Mover {
        Mover { position: self.point(), velocity: self.point() }
    }

    /// One of so many things.
    #[inline]
    pub(super) fn index(&mut self, what: &str, count: usize) -> u8 {
        let index = self.u8();
        self.refuse(usize::from(index) >= count, || format!("{what} {index}"));
        index
    }

    /// One of so many things, or none of them.
    #[inline]
    pub(super) fn choice(&mut self, what: &str, count: usize) -> Option<u8> {
        let index = self.u8();
        self.refuse(index != NONE && usize::from(index) >= count, || format!("{what} {index}"));
        (index != NONE).then_some(index)
    }
}

pub(super) fn write_number(number: f64, bytes: &mut Vec<u8>) {
    bytes.extend_from_slice(&number.to_le_bytes());
}

pub(super) fn write_point(point: Point, bytes: &mut Vec<u8>) {
    point.into_iter().for_each(|part| write_number(part, bytes));
}

pub(super) fn write_movers(movers: &[Mover], bytes: &mut Vec<u8>) {
    for mover in movers {
        write_point(mover.position, bytes);
        write_point(mover.velocity, bytes);
    }
}

pub(super) fn write_choice(choice: Option<u8>, bytes: &mut Vec<u8>) {
    bytes.push(choice.unwrap_or(NONE));
}

/// Bytes before the world: the layout, the steps, the return.
const HEAD: usize = 1 + 4 + 8;

/// What the bytes of a state say.
pub(super) struct State<W> {
    pub(super) steps: u32,
    pub(super) episode_return: f64,
    pub(super) world: W,
}

/// Bytes of every state of a scenario.
pub(super) fn state_bytes<S: Scenario>(scenario: &S) -> usize {
    let mut bytes = Vec::new();
    scenario.write(&scenario.world(), &mut bytes);
    HEAD + bytes.len()
}

/// Adds the bytes of a state.
pub(super) fn write_state<S: Scenario>(
    scenario: &S,
    (steps, episode_return, world): (u32, f64, &S::World),
    bytes: &mut Vec<u8>,
) {
    bytes.push(LAYOUT);
    bytes.extend_from_slice(&steps.to_le_bytes());
    write_number(episode_return, bytes);
    scenario.write(world, bytes);
}

/// Reads what [`write_state`] wrote, which has so many bytes.
pub(super) fn read_state<S: Scenario>(
    scenario: &S,
    wanted: usize,
    bytes: &[u8],
) -> Result<State<S::World>, StateError> {
    let mut reader = Reader::new(bytes, wanted)?;
    let steps = reader.u32();
    reader.refuse(steps > scenario.episode_limit(), || format!("it is {steps} steps long"));
    let state = State { steps, episode_return: reader.number(), world: scenario.read(&mut reader) };
    reader.sound(state)
}
