//! Utility networks as checkpoints hold them.

use sortie_learn::LearnError;
use sortie_learn::run::checkpoint::{Checkpoint, SavedShape};
use sortie_learn::state;

use super::utility::{UtilityNetwork, UtilityShape};

/// What a network of this shape is built by.
pub(crate) fn saved_shape(shape: UtilityShape) -> Result<SavedShape, LearnError> {
    SavedShape::new(&shape, tensors(shape))
}

/// The tensors of a network of this shape, as checkpoints have them.
pub(crate) fn tensors(shape: UtilityShape) -> Vec<state::Tensor> {
    let tensor = |tensor: super::Tensor| state::Tensor {
        name: tensor.name.to_owned(),
        shape: vec![tensor.rows, tensor.columns],
        range: tensor.range,
    };
    shape.tensors().into_iter().map(tensor).collect()
}

/// A network by one of its vectors, as in `agents`, `online`.
pub(crate) fn saved_network(
    checkpoint: &Checkpoint,
    network: &str,
    vector: &str,
) -> Result<UtilityNetwork, LearnError> {
    let shape = checkpoint.shape(network)?;
    let parameters = saved_vector(checkpoint, network, vector)?;
    let misfit = || checkpoint.bad(format!("`{network}/{vector}` does not fit its shape"));
    UtilityNetwork::from_parameters(shape, parameters).ok_or_else(misfit)
}

/// A network of a shape that is known.
pub(crate) fn network_of(
    checkpoint: &Checkpoint,
    name: &str,
    shape: UtilityShape,
) -> Result<UtilityNetwork, LearnError> {
    let parameters = checkpoint.vector(name, &tensors(shape))?;
    let misfit = || checkpoint.bad(format!("`{name}` does not fit its shape"));
    UtilityNetwork::from_parameters(shape, parameters).ok_or_else(misfit)
}

/// One vector of a network, such as those of its optimiser.
pub(crate) fn saved_vector(
    checkpoint: &Checkpoint,
    network: &str,
    vector: &str,
) -> Result<Vec<f32>, LearnError> {
    let tensors = tensors(checkpoint.shape(network)?);
    checkpoint.vector(&format!("{network}/{vector}"), &tensors)
}

#[cfg(test)]
mod tests {
    use sortie_learn::run::checkpoint::{Checkpoints, OpenFor, SavedNetwork};

    use super::*;

    const SHAPE: UtilityShape =
        UtilityShape { input: 3, width: 4, heads: 2, base: 2, actions: 2, skip: false };

    fn write(shape: UtilityShape, checkpoints: &Checkpoints, env_steps: u64) -> std::path::PathBuf {
        let vector: Vec<f32> = (0..shape.parameters()).map(|number| number as f32).collect();
        let agents = SavedNetwork {
            name: "agents",
            shape: Some(saved_shape(shape).unwrap()),
            vectors: vec![("average", &vector)],
        };
        checkpoints.write(env_steps, &[agents], &env_steps).unwrap()
    }

    #[test]
    fn a_skip_is_read_back_and_one_that_nobody_names_is_not_there() {
        let folder = tempfile::tempdir().unwrap();
        let checkpoints = Checkpoints::new(folder.path());
        write(UtilityShape { skip: true, ..SHAPE }, &checkpoints, 1);
        let read = || {
            let newest = checkpoints.newest(OpenFor::Use).unwrap().checkpoint;
            saved_network(&newest, "agents", "average").unwrap()
        };
        let network = read();
        assert!(network.shape().skip);
        assert_eq!(network.weights().skip_weight.len(), 16);
        let last = SHAPE.parameters() as f32 + 15.0;
        assert_eq!(network.weights().skip_weight.last(), Some(&last));

        let manifest = write(SHAPE, &checkpoints, 2).join("manifest.toml");
        let text = std::fs::read_to_string(&manifest).unwrap();
        let older = text.replace("skip = false\n", "");
        assert_ne!(older, text);
        std::fs::write(&manifest, older).unwrap();
        assert_eq!(read().shape(), SHAPE);
    }
}
