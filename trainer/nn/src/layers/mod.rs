//! Network layers with explicit forward and backward passes over plain slices.
//!
//! Every function writes into buffers that its caller owns; none allocates, blocks or reads a clock.
//! Matrices are row-major. A weight matrix is `[out, in]` as in PyTorch, except that of
//! [`sparse_linear`], whose input picks rows of an `[in, out]` matrix.
//! `backward` functions *add* to weight gradients and *overwrite* input gradients unless they say otherwise.

pub(crate) mod absorbed_attention;
pub mod attention;
pub mod elementwise;
pub mod gru;
pub mod linear;
mod lists;
pub mod matrix;
pub mod normalise;
pub mod products;
pub mod softmax;
pub mod sparse_linear;
pub mod split_attention;
pub mod team_attention;
pub mod unfold;
pub mod vectors;

pub use lists::VisibleLists;
pub use sparse_linear::SparseRows;
pub use team_attention::TeamLists;
