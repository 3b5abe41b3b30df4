//! What the utility network looks at.

use sortie_nn::layers::{SparseRows, VisibleLists};

/// What the network looks at: the entities of any number of independent samples.
///
/// Query i belongs to row i: the rows of all acting agents come first, then the other entities.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UtilityInput {
    /// Features `[rows, D]` of every entity, last actions included.
    pub rows: SparseRows,
    /// For each acting agent the rows that it sees, its own among them where it is visible.
    pub visible: VisibleLists,
}

impl UtilityInput {
    /// Forgets all samples, keeps the memory.
    pub fn clear(&mut self) {
        self.rows.clear();
        self.visible.clear();
    }
}

/// The first `length` numbers of a buffer that grows but never shrinks; their content is whatever
/// stood there.
pub(crate) fn sized(buffer: &mut Vec<f32>, length: usize) -> &mut [f32] {
    if buffer.len() < length {
        buffer.resize(length, 0.0);
    }
    &mut buffer[..length]
}
