//! Steps on values of fixed sizes, of which policies of any shape are made; one file each.
//!
//! A value is a place of the arena. Matrices stand row behind row, without padding, unless a step says otherwise.
//! What has an own operator beside these (a layer, a recurrent unit, an attention) stands between them in one program.

mod arrange;
mod cells;
mod combine;
mod constant;
mod convolve;
mod dense_rows;
mod input;
mod look_up;
mod map;
mod multiply;
mod normalise;
pub(super) mod patches;
mod reduce;
mod select;
mod softmax;
mod state;

pub use arrange::Arrange;
pub use cells::{GruCell, LstmCell};
pub use combine::{Combination, Combine};
pub use constant::Constant;
pub use convolve::Convolve;
pub use dense_rows::DenseRows;
pub use input::{Input, Meaning};
pub use look_up::{Choice, LookUp};
pub use map::{Function, Map};
pub use multiply::Multiply;
pub use normalise::Normalise;
pub use patches::{ConvolvePatches, FoldPatches};
pub use reduce::{Reduce, Reduction};
pub use select::Select;
pub use softmax::Softmax;
pub use state::State;
