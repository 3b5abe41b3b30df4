//! What an agent sees, column by column: names, units and values in the same order.

use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;
use core::ops::Range;

use super::physics::Mover;
use super::plane::Point;
use crate::rows::SparseRows;
use crate::spec::Role;

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
        for number in pair {
            if number != 0.0 {
                self.rows.push(self.column, number as f32);
            }
            self.column += 1;
        }
    }

    /// So many flags, of which one is set or none.
    #[inline]
    pub(super) fn flags(&mut self, set: Option<u8>, count: usize) {
        if let Some(flag) = set {
            self.rows.push(self.column + usize::from(flag), 1.0);
        }
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
