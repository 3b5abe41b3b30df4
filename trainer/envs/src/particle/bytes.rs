//! Episodes as bytes: version, steps and return, then what a scenario has.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use super::physics::Mover;
use super::plane::Point;
use super::scenario::Scenario;
use crate::environment::StateError;

/// The version of the layout.
const LAYOUT: u8 = 1;
/// Bytes before the world: the layout, the steps, the return.
const HEAD: usize = 1 + 4 + 8;
/// The byte of what is not there.
const NONE: u8 = u8::MAX;

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
pub(super) fn write<S: Scenario>(
    scenario: &S,
    (steps, episode_return, world): (u32, f64, &S::World),
    bytes: &mut Vec<u8>,
) {
    bytes.push(LAYOUT);
    bytes.extend_from_slice(&steps.to_le_bytes());
    write_number(episode_return, bytes);
    scenario.write(world, bytes);
}

/// Reads what [`write`] wrote, which has so many bytes.
pub(super) fn read<S: Scenario>(
    scenario: &S,
    wanted: usize,
    bytes: &[u8],
) -> Result<State<S::World>, StateError> {
    match bytes.first() {
        Some(&found) if found != LAYOUT => {
            return Err(StateError::Version { found, wanted: LAYOUT });
        }
        Some(_) if bytes.len() == wanted => {}
        _ => return Err(StateError::Length { found: bytes.len(), wanted }),
    }
    let mut reader = Reader(&bytes[1..]);
    let mut state = || {
        let steps = reader.count();
        if steps > scenario.episode_limit() {
            return Err(format!("it is {steps} steps long"));
        }
        let episode_return = reader.number()?;
        Ok(State { steps, episode_return, world: scenario.read(&mut reader)? })
    };
    state().map_err(StateError::Impossible)
}

/// Reads the bytes of a state, of which there are enough.
pub struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    #[inline]
    fn take<const COUNT: usize>(&mut self) -> [u8; COUNT] {
        let (taken, rest) = self.0.split_first_chunk().expect("the length was checked");
        self.0 = rest;
        *taken
    }

    pub(super) fn count(&mut self) -> u32 {
        u32::from_le_bytes(self.take())
    }

    #[inline]
    pub(super) fn number(&mut self) -> Result<f64, String> {
        let number = f64::from_le_bytes(self.take());
        if number.is_finite() { Ok(number) } else { Err("one of its numbers is none".into()) }
    }

    #[inline]
    pub(super) fn point(&mut self) -> Result<Point, String> {
        Ok([self.number()?, self.number()?])
    }

    #[inline]
    pub(super) fn mover(&mut self) -> Result<Mover, String> {
        Ok(Mover { position: self.point()?, velocity: self.point()? })
    }

    /// One of so many things.
    #[inline]
    pub(super) fn index(&mut self, what: &str, count: usize) -> Result<u8, String> {
        let [index] = self.take();
        if usize::from(index) < count { Ok(index) } else { Err(format!("{what} {index}")) }
    }

    /// One of so many things, or none of them.
    #[inline]
    pub(super) fn choice(&mut self, what: &str, count: usize) -> Result<Option<u8>, String> {
        if self.0.first() == Some(&NONE) {
            self.0 = &self.0[1..];
            return Ok(None);
        }
        self.index(what, count).map(Some)
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
