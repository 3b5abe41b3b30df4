//! Networks over pictures: what they are shown of one, and weights that learn.

mod convolution;
mod heads;
mod learner;
mod network;
mod shown;

pub(crate) use heads::{Heads, best};
pub(crate) use learner::Learner;
pub use network::Body;
pub(crate) use network::{Network, NetworkShape, Space, slopes};
pub(crate) use shown::Shown;
