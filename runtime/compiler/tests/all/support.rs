//! What several tests ask for.

use sortie_compiler::compare_with_files;
use sortie_plans::{Comparison, NetworkFiles, NetworkInput};

/// A plan beside the network that it was made from, in double precision.
pub(crate) fn beside_truth<T: Into<NetworkInput>>(
    plan: &[u8],
    onnx: &[u8],
    inputs: impl IntoIterator<Item = T>,
) -> Comparison {
    let inputs = inputs.into_iter().map(Into::into).collect();
    compare_with_files(plan, &NetworkFiles::One(onnx), inputs, 1).expect("plan and file can be run")
}
