//! What is compiled for every build of the kernels.

use super::Kernels;

/// A computation by kernels of any build. Where `run` is always inlined, it is itself compiled for the build.
pub trait Work {
    /// What it computes.
    type Output;

    /// Computes it.
    fn run(self, kernels: impl Kernels) -> Self::Output;
}
