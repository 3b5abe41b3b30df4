//! How rows of the team-value network are laid out.

use sortie_envs::Spec;

/// What the columns of a row are: an entity's features, its part in the question, its relation to the subtask.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TeamColumns {
    features: usize,
    relations: usize,
}

impl TeamColumns {
    /// Those of an environment.
    pub fn of(spec: &Spec) -> Self {
        Self { features: spec.shape.features, relations: spec.relations }
    }

    /// Their number.
    pub fn count(self) -> usize {
        self.relation() + self.relations
    }

    /// Marks the subtask's thing that the value is about.
    pub(super) fn own(self) -> usize {
        self.features
    }

    /// Marks the agents of the team.
    pub(super) fn in_team(self) -> usize {
        self.features + 1
    }

    /// First of the columns that say how an entity stands to the subtask.
    pub(super) fn relation(self) -> usize {
        self.features + 2
    }
}
