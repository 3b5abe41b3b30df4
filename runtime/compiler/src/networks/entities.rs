//! A graph over all entities.

use sortie_core::Entities;
use sortie_plans::{CompileError, cannot_run};

use super::feature_rows;
use crate::engine::{Engine, Tensors, flag};
use crate::graph::{EntityRoles, Graph};

/// A graph over all entities in an engine.
#[derive(Debug)]
pub(crate) struct EntityGraph<E: Engine> {
    pub(super) engine: E,
    roles: EntityRoles,
    features: usize,
    /// Entities, present, and where the graph has them is_agent and groups.
    tensors: Tensors<E::Number>,
}

impl<E: Engine> EntityGraph<E> {
    pub(crate) fn new(graph: &Graph, engine: E) -> Result<Self, CompileError> {
        let (roles, features) = (graph.entity_roles()?, graph.columns);
        let inputs = [roles.entities, roles.present].into_iter();
        let inputs = inputs.chain(roles.is_agent).chain(roles.groups);
        let tensors = Tensors::new(inputs.map(|input| graph.input_name(input)));
        Ok(Self { engine, roles, features, tensors })
    }

    /// The values of every output, in the graph's order. All rows are given to the graph.
    pub(crate) fn run(
        &mut self,
        entities: &Entities<'_>,
    ) -> Result<Vec<Vec<E::Number>>, CompileError> {
        let Self { engine, roles, features, tensors } = self;
        let (count, groups) = (entities.groups.len(), roles.group_count);
        let rows = feature_rows(0..count, entities.rows, entities.stride, *features);
        tensors.fill(0, &[count, *features], rows.map_err(cannot_run)?);
        tensors.fill(1, &[count], (0..count).map(|row| flag(entities.present.contains(row))));
        let mut place = 2;
        if roles.is_agent.is_some() {
            let is_agent = (0..count).map(|row| flag(entities.agents.contains(row)));
            tensors.fill(place, &[count], is_agent);
            place += 1;
        }
        if roles.groups.is_some() {
            let bit = |bits: u32, group: u32| bits.checked_shr(group).unwrap_or(0) & 1 == 1;
            let belongs = entities
                .groups
                .iter()
                .flat_map(|bits| (0..groups as u32).map(move |group| flag(bit(*bits, group))));
            tensors.fill(place, &[count, groups], belongs);
        }
        engine.run(&tensors.named())
    }
}
