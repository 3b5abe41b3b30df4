//! Utility networks as checkpoints hold them.

use sortie_learn::LearnError;
use sortie_learn::run::checkpoint::Checkpoint;
use sortie_learn::state;

use super::utility::{UtilityNetwork, UtilityShape};

/// The tensors of a network of this shape, as checkpoints have them.
pub(crate) fn tensors(shape: UtilityShape) -> Vec<state::Tensor> {
    let tensor = |tensor: super::Tensor| state::Tensor {
        name: tensor.name.to_owned(),
        shape: vec![tensor.rows, tensor.columns],
        range: tensor.range,
    };
    shape.tensors().into_iter().map(tensor).collect()
}

/// A network by its name and vector, as in `agents/online`.
pub(crate) fn network_of(
    checkpoint: &Checkpoint,
    name: &str,
    shape: UtilityShape,
) -> Result<UtilityNetwork, LearnError> {
    let parameters = checkpoint.vector(name, &tensors(shape))?;
    let misfit = || checkpoint.bad(format!("`{name}` does not fit its shape"));
    UtilityNetwork::from_parameters(shape, parameters).ok_or_else(misfit)
}
