//! The sizes and chances of a ring.

use alloc::string::String;
use core::fmt;

use serde::Deserialize;

use crate::spec::Shape;

/// Most agents.
pub const MAX_AGENTS: usize = Shape::AGENTS;
/// Most cells: a cell is one byte of a state.
pub const MAX_CELLS: usize = 256;
/// Most groups.
pub const MAX_GROUPS: usize = 128;

/// The names of sets that reports and lists show; every `AGENTSxCELLSxGROUPS` is one.
pub const SET_NAMES: [&str; 2] = ["8x6x2", "8x6x2-fixed"];

/// What the rules leave open, with the dissertation's values as default. Settings say all but the sizes, which the name
/// of the set says.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Parameters {
    /// Agents.
    #[serde(skip)]
    pub agents: usize,
    /// Cells of the ring.
    #[serde(skip)]
    pub cells: usize,
    /// Groups.
    #[serde(skip)]
    pub groups: usize,
    /// Chance per agent and step that its action is replaced by a random one.
    pub noise: f64,
    /// Most steps of an episode.
    pub episode_limit: u32,
    /// Whether all episodes have the same groups, of agents that stand beside each other in number.
    #[serde(skip)]
    pub fixed_groups: bool,
    /// Whether oracles are told the groups in an episode's first state only, and later that everybody is
    /// one, as in the public code.
    pub groups_known_at_first: bool,
    /// A size of groups that is kept for measuring: starts to learn from have no group of it, those to
    /// measure on have one. 0 for none.
    pub held_out: usize,
    /// Starts in which two groups have so many members or more are kept for measuring. 0 for none.
    pub held_out_members: usize,
    /// The share of all ways to group the agents that is kept for measuring.
    pub held_out_share: f64,
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            agents: 8,
            cells: 6,
            groups: 2,
            noise: 0.1,
            episode_limit: 50,
            fixed_groups: false,
            groups_known_at_first: false,
            held_out: 0,
            held_out_members: 0,
            held_out_share: 0.0,
        }
    }
}

impl Parameters {
    /// The parameters of a set such as `8x6x2`: agents, cells, groups; `-fixed` for the same groups always.
    pub fn named(name: &str) -> Result<Self, ParametersError> {
        let unknown = || ParametersError::UnknownSet(name.into());
        let sizes = name.strip_suffix("-fixed").unwrap_or(name);
        let mut sizes = sizes.split('x').map(|size| size.parse().map_err(|_| unknown()));
        let mut size = || sizes.next().ok_or_else(unknown)?;
        let parameters = Self {
            agents: size()?,
            cells: size()?,
            groups: size()?,
            fixed_groups: name.ends_with("-fixed"),
            ..Self::default()
        };
        if sizes.next().is_some() {
            return Err(unknown());
        }
        parameters.check()?;
        Ok(parameters)
    }

    /// Refuses what the rules do not allow.
    pub fn check(&self) -> Result<(), ParametersError> {
        for (what, count, most) in [
            ("agents", self.agents, MAX_AGENTS),
            ("cells", self.cells, MAX_CELLS),
            ("groups", self.groups, MAX_GROUPS),
        ] {
            if !(1..=most).contains(&count) {
                return Err(ParametersError::Size { what, count, most });
            }
        }
        if !(0.0..=1.0).contains(&self.noise) {
            return Err(ParametersError::Noise);
        }
        if self.episode_limit == 0 {
            return Err(ParametersError::NoSteps);
        }
        Ok(())
    }

    /// Whether some starts are kept for measuring.
    pub(super) fn holds_out(&self) -> bool {
        self.held_out > 0 || self.held_out_members > 0 || self.held_out_share > 0.0
    }

    /// Columns of a feature row.
    pub fn features(&self) -> usize {
        self.cells + self.groups + self.agents
    }
}

/// Parameters that the rules do not allow.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ParametersError {
    /// A name that says no sizes.
    UnknownSet(String),
    /// A size outside its range.
    Size {
        /// What there would be so many of.
        what: &'static str,
        /// How many.
        count: usize,
        /// The most that there may be.
        most: usize,
    },
    /// The noise is no probability.
    Noise,
    /// Episodes without a step.
    NoSteps,
    /// Held-out starts where none or all are.
    HeldOut,
}

impl fmt::Display for ParametersError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UnknownSet(name) => write!(
                f,
                "no set `{name}`; a set is named AGENTSxCELLSxGROUPS, such as `8x6x2`, and may end \
                 in `-fixed`"
            ),
            Self::Size { what, count, most } => {
                write!(f, "{count} {what} are not possible: from 1 to {most} are")
            }
            Self::Noise => f.write_str("the noise is not a probability from 0 to 1"),
            Self::HeldOut => f.write_str(
                "what is held out leaves no starts to learn from, or none to measure on",
            ),
            Self::NoSteps => f.write_str("an episode limit of 0 steps leaves no episode"),
        }
    }
}

impl core::error::Error for ParametersError {}
