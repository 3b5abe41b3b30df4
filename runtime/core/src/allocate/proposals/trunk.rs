//! What is computed once for all proposals: embeddings of agents and subtasks (dissertation section 7.4).

use super::memory::{CriticMemory, Grid, StepMemory, TrunkMemory};
use super::scene::{Near, Product, RowMarks, Scene, add, copy, refused, tasks_in, vector};
use crate::allocator::AllocateError;
use crate::entity_mask::EntityMask;
use crate::kernels::Kernels;
use crate::kernels::mark::MARKED;
use crate::limits;
use crate::math::relu;

/// Embeds all entities, sums up the subtasks into the first nodes, and prepares what agents add to updates.
#[inline(always)]
pub(super) fn embed(
    kernels: impl Kernels,
    scene: &Scene<'_>,
    trunk: &mut TrunkMemory<'_>,
    step: &mut StepMemory<'_>,
    critic: &mut CriticMemory<'_>,
    scores: &mut Grid<'_, f32>,
) -> Result<(), AllocateError> {
    embed_entities(kernels, scene, trunk, critic)?;
    attend_within_tasks(kernels, scene, trunk, scores)?;
    let nodes = scene.tasks().saturating_mul(step.nodes.width);
    step.nodes.cells.get_mut(..nodes).ok_or(AllocateError::TooLarge)?.fill(0.0);
    for entity in placed(scene).iter() {
        for task in tasks_in(scene.tasks_of(entity)) {
            add(step.nodes.row_mut(task), trunk.attended.row(entity));
        }
    }
    let update = Product::new(&scene.network.step.from_agent, scene.weights, false)?;
    let (to, width) = (&mut trunk.from_agents.cells, trunk.from_agents.width);
    update.behind_relu().rows(kernels, &trunk.active, to, width, scene.present_agents());
    Ok(())
}

/// The first layers of policy and critic, which share where features are not zero.
#[inline(always)]
fn embed_entities(
    kernels: impl Kernels,
    scene: &Scene<'_>,
    trunk: &mut TrunkMemory<'_>,
    critic: &mut CriticMemory<'_>,
) -> Result<(), AllocateError> {
    let Scene { network, weights, .. } = *scene;
    let tasks = network.trunk.tasks.of(weights).map_err(refused)?;
    let layers = [&network.trunk.embed, &network.critic.embed];
    let [of_policy, of_critic] = layers.map(|layer| {
        layer.matrix(weights).and_then(|m| Ok((m, layer.around(weights, false)?))).map_err(refused)
    });
    let (of_policy, of_critic) = (of_policy?, of_critic?);
    let mut marks: RowMarks = [[0; 2]; limits::FEATURES / MARKED];
    for entity in scene.present.iter() {
        let inputs = scene.features(kernels, entity, &mut marks)?;
        let embedded = trunk.embedded.row_mut(entity);
        kernels.sparse_product(of_policy.0, inputs, of_policy.1, embedded);
        kernels.sparse_product(of_critic.0, inputs, of_critic.1, critic.bases.row_mut(entity));
        for task in tasks_in(scene.tasks_of(entity)) {
            add(embedded, vector(tasks, embedded.len(), task));
        }
        for (to, value) in trunk.active.row_mut(entity).iter_mut().zip(embedded) {
            *to = relu(*value);
        }
    }
    Ok(())
}

/// Those present that are no agents and belong to some subtask: nothing else goes into the sums.
fn placed(scene: &Scene<'_>) -> EntityMask {
    let mut placed = EntityMask::EMPTY;
    for entity in scene.present.iter().filter(|entity| *entity >= scene.state.agents) {
        if scene.tasks_of(entity) != 0 {
            placed.insert(entity);
        }
    }
    placed
}

/// Attention of all rows that are placed to those of the same subtasks.
#[inline(always)]
fn attend_within_tasks(
    kernels: impl Kernels,
    scene: &Scene<'_>,
    trunk: &mut TrunkMemory<'_>,
    scores: &mut Grid<'_, f32>,
) -> Result<(), AllocateError> {
    let attention = &scene.network.trunk.attention;
    let placed = placed(scene);
    let project = |layer, to: &mut Grid<'_, f32>| {
        let product = Product::new(layer, scene.weights, false)?.behind_relu();
        product.rows(kernels, &trunk.active, to.cells, to.width, placed.iter());
        Ok(())
    };
    project(&attention.value, &mut trunk.values)?;
    let peers_of = |entity: usize| {
        let tasks = scene.tasks_of(entity);
        placed.iter().filter(move |peer| scene.tasks_of(*peer) & tasks != 0)
    };
    let is_alone = |entity: usize| peers_of(entity).nth(1).is_none();
    if !placed.iter().all(is_alone) {
        project(&attention.query, &mut trunk.queries)?;
        project(&attention.key, &mut trunk.keys)?;
    }
    for entity in placed.iter() {
        let mixed = trunk.mixed.row_mut(entity);
        if is_alone(entity) {
            // The weight of the only row is 1.
            copy(trunk.values.row(entity), mixed);
            continue;
        }
        let mut slots = heapless::Vec::<u16, { limits::ENTITIES }>::new();
        for peer in peers_of(entity) {
            // There is room for every entity.
            let _ = slots.push(peer as u16);
        }
        let near = Near { attention, keys: &trunk.keys, values: &trunk.values, slots: &slots };
        near.attend(kernels, &trunk.queries, &[entity as u16], mixed, scores)?;
    }
    let output = Product::new(&attention.output, scene.weights, false)?;
    let (to, width) = (&mut trunk.attended.cells, trunk.attended.width);
    output.rows(kernels, &trunk.mixed, to, width, placed.iter());
    Ok(())
}
