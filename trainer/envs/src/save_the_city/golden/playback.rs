//! Plays a recorded episode step by step, for whoever wants to look at it.

use super::super::simulator::SaveTheCity;
use super::Labels;
use super::replay::{Moves, read_moves, restore};
use crate::environment::{Step, StepError};
use crate::recorded::Field;
use crate::recorded::GoldenError;

/// A recorded episode in a world of its own.
///
/// Nothing but the actions and the collision losers is taken from the file; [`replay`](super::replay())
/// says whether the rest agrees.
pub struct Playback {
    labels: Labels,
    world: SaveTheCity,
    moves: Vec<Moves>,
    played: usize,
}

impl Playback {
    /// Reads an episode given as text and sets up its first state.
    pub fn new(text: &str) -> Result<Self, GoldenError> {
        let value = serde_json::from_str(text).map_err(GoldenError::Json)?;
        let root = Field::root(&value);
        let labels = Labels {
            name: root.get("name")?.text()?.into(),
            policy: root.get("policy")?.text()?.into(),
            seed: root.get("seed")?.integer(0..=u64::MAX)?,
        };
        let world = restore(&root)?;
        let agents = world.city(0).agents.len();
        let steps = root.get("steps")?.items()?;
        let moves = steps.iter().map(|step| read_moves(step, agents)).collect::<Result<_, _>>()?;
        Ok(Self { labels, world, moves, played: 0 })
    }

    /// What the episode is called.
    pub fn labels(&self) -> &Labels {
        &self.labels
    }

    /// The world in its current state, as instance 0.
    pub fn world(&self) -> &SaveTheCity {
        &self.world
    }

    /// The actions that the next step takes; `None` at the end.
    pub fn next_actions(&self) -> Option<&[u16]> {
        self.moves.get(self.played).map(|moves| moves.actions.as_slice())
    }

    /// Takes the next step; `None` at the end.
    pub fn step(&mut self) -> Result<Option<Step>, StepError> {
        let Some(moves) = self.moves.get(self.played) else { return Ok(None) };
        let outcome = moves.play(&mut self.world)?;
        self.played += 1;
        Ok(Some(outcome))
    }
}
