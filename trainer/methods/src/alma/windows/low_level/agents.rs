//! The agents' utility network as the learner uses it (dissertation section 7.3).
//!
//! With the subtask mask an agent sees its team only; without it ("no mask") it sees everything, and a
//! subtask's embedding is added to what `fc1` gives for an entity: further rows of `fc1` for one-hot marks
//! behind the features. Which mark stands for which subtask is shuffled before each pass, so that no
//! subtask is special; spare marks let one network serve more subtasks than it was trained with.

use sortie_nn::random::Generator;

use super::super::batch::WindowShape;
use super::config::LowLevelConfig;
use crate::alma::agents::UtilityNetwork;

/// Draws a network uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does, of the embedding's first
/// layer as configured; marks are a layer of their own.
pub(super) fn initialise(
    config: &LowLevelConfig,
    sizes: WindowShape,
    generator: &mut Generator,
) -> UtilityNetwork {
    let shape = config.shape(sizes);
    let features = sizes.features + sizes.actions;
    let active = if config.active_inputs > 0.0 { config.active_inputs } else { features as f32 };
    let mut network = UtilityNetwork::initialise(shape, active, generator);
    let marks = shape.input - features;
    let factor = (active / marks.max(1) as f32).sqrt();
    let rows = &mut network.parameters_mut()[features * shape.width..shape.input * shape.width];
    rows.iter_mut().for_each(|weight| *weight *= factor);
    network
}
