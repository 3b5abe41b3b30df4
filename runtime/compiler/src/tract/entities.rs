//! The source graph of a network over all entities, run by tract: the reference for plans.

use sortie_core::Entities;
use tract_onnx::prelude::*;

use crate::graph::{EntityRoles, Graph, guarded};
use sortie_plans::CompileError;

/// A network over all entities that runs the ONNX graph with tract. It allocates.
#[derive(Debug)]
pub(crate) struct TractEntities {
    state: TypedSimpleState,
    roles: EntityRoles,
    features: usize,
}

impl TractEntities {
    pub(crate) fn from_graph(graph: &Graph) -> Result<Self, CompileError> {
        let (roles, features) = (graph.entity_roles()?, graph.columns);
        Ok(Self { state: graph.runnable()?, roles, features })
    }

    /// The values of every output, in the graph's order. All rows are given to the graph.
    pub(crate) fn run(&mut self, entities: &Entities<'_>) -> Result<Vec<Vec<f32>>, CompileError> {
        let Self { roles, features, .. } = *self;
        let count = entities.groups.len();
        let rows = entities.rows.chunks(entities.stride.max(1)).take(count);
        let features_of = |row: &[f32]| row.iter().take(features).copied().collect::<Vec<_>>();
        let rows: Vec<f32> = rows.flat_map(features_of).collect();
        let mask = |holds: &dyn Fn(usize) -> bool| (0..count).map(holds).collect::<Vec<bool>>();
        let groups = roles.group_count;
        let belongs = entities.groups.iter().flat_map(|bits| {
            (0..groups as u32).map(|group| bits.checked_shr(group).unwrap_or(0) & 1 == 1)
        });
        let belongs: Vec<bool> = belongs.collect();
        let present = mask(&|entity| entities.present.contains(entity));
        let agents = mask(&|entity| entities.agents.contains(entity));
        let run = || {
            let mut inputs: Vec<(usize, Tensor)> = vec![
                (roles.entities, Tensor::from_shape(&[count, features], &rows)?),
                (roles.present, Tensor::from_shape(&[count], &present)?),
            ];
            if let Some(place) = roles.is_agent {
                inputs.push((place, Tensor::from_shape(&[count], &agents)?));
            }
            if let Some(place) = roles.groups {
                inputs.push((place, Tensor::from_shape(&[count, groups], &belongs)?));
            }
            inputs.sort_by_key(|(slot, _)| *slot);
            let outputs = self.state.run(inputs.into_iter().map(|(_, t)| t.into()).collect())?;
            let values = outputs
                .iter()
                .map(|output| Ok(output.to_plain_array_view::<f32>()?.iter().copied().collect()));
            values.collect()
        };
        guarded(run).map_err(|reason| CompileError::Run { reason })
    }
}
