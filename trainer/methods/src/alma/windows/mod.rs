//! ALMA as published (dissertation chapter 7 and its public code): the preset `paper`.
//!
//! Both levels learn from windows of whole episodes. The low level learns the utilities of teams
//! through an attention mixer, one value per subtask; the high level learns a critic of allocations
//! and a policy that proposes them (amortised Q-learning). Nothing here is shortened: what is faster
//! than the public code is an exact rewrite of it.

pub mod allocation;
pub mod config;
mod deciding;
mod export;
pub mod low_level;
mod method;
mod popart;
mod sampling;

use sortie_envs::{ActionSet, Shape, Spec};
use sortie_learn::networks::Targets;
use sortie_nn::layers::matrix::Store;
use sortie_nn::layers::{SparseRows, elementwise};

pub use sortie_envs::UNASSIGNED as NO_TASK;
pub use sortie_learn::subtasks::NO_ACTION;

pub use config::{Config, Exploration};
pub use deciding::ProposalAllocator;
pub use export::{ProposalGraphs, export_proposals};
pub use method::WindowLearner;
pub use popart::PopArt;
pub use sampling::{Note, Replay, SampleShape, cut_windows, draw_episodes};

/// Sizes of a batch of windows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WindowShape {
    /// Windows W.
    pub windows: usize,
    /// Steps S of a window; each but the last may have a transition to the next.
    pub steps: usize,
    /// Agents A.
    pub agents: usize,
    /// Entities N, of which the agents are the first.
    pub entities: usize,
    /// Subtasks T.
    pub tasks: usize,
    /// Actions U.
    pub actions: usize,
    /// Features d of an entity, without its last action.
    pub features: usize,
    /// What actions aim at.
    pub targets: Targets,
}

impl WindowShape {
    /// Sizes of an environment, as a batch of no windows.
    pub fn of(spec: &Spec) -> Self {
        let Shape { agents, entities, tasks, actions, features } = spec.shape;
        let targets = Targets::of(spec);
        Self { windows: 0, steps: 0, agents, entities, tasks, actions, features, targets }
    }

    /// States of all windows, W S.
    pub fn states(&self) -> usize {
        self.windows * self.steps
    }
}

/// A batch of windows. State `i` is step `i % S` of window `i / S`.
///
/// Windows may reach over the ends of episodes. Every array is row-major, with all states in front.
#[derive(Clone, Debug, PartialEq)]
pub struct Windows {
    /// The sizes.
    pub shape: WindowShape,
    /// Features of all entities, W S N rows; those of absent entities are empty.
    pub features: SparseRows,
    /// `[W S, N]`: the entities that exist.
    pub present: Vec<bool>,
    /// `[W S, A, N]`: the entities that each agent can observe.
    pub observable: Vec<bool>,
    /// `[W S, N]`: the subtask of every entity, the first of several, or [`NO_TASK`]; of agents, the allocation in
    /// force.
    pub entity_task: Vec<u8>,
    /// `[W S, T]`: the subtasks that exist and are not finished.
    pub open: Vec<bool>,
    /// `[W S, A]`: what each agent may do.
    pub available: Vec<ActionSet>,
    /// `[W S, A]`: what the agents did.
    pub actions: Vec<u8>,
    /// `[W S, A]`: what they had done in the step before, or [`NO_ACTION`].
    pub last_actions: Vec<u8>,
    /// `[W S, A]`: the allocation that was in force before this step, or [`NO_TASK`].
    pub last_allocation: Vec<u8>,
    /// `[W S]`: whether agents were allocated anew in this step.
    pub decision: Vec<bool>,
    /// `[W S]`: the reward of the whole team.
    pub reward: Vec<f32>,
    /// `[W S, T]`: the reward of every subtask.
    pub task_reward: Vec<f32>,
    /// `[W S]`: the step ended the episode truly: what comes next is worth nothing.
    pub terminated: Vec<bool>,
    /// `[W S]`: the step ended the episode, truly or by its time limit.
    pub reset: Vec<bool>,
    /// `[W S, T]`: the subtask was finished in this step or before.
    pub task_terminated: Vec<bool>,
    /// `[W S]`: the state was followed by a step of the same episode, which can be learned from.
    pub has_transition: Vec<bool>,
    /// `[W S, T]`: the subtask was unfinished before this step, so that it can be learned from.
    pub task_unfinished: Vec<bool>,
    /// `[W S]`: environment steps of the run when the state's episode began.
    pub added: Vec<u64>,
}

impl Windows {
    /// An empty batch of a shape: nobody is present, nothing is learned from.
    pub fn new(shape: WindowShape) -> Self {
        let states = shape.states();
        let (agents, entities) = (states * shape.agents, states * shape.entities);
        let tasks = states * shape.tasks;
        let mut features = SparseRows::default();
        (0..entities).for_each(|_| features.end_row());
        Self {
            shape,
            features,
            present: vec![false; entities],
            observable: vec![false; agents * shape.entities],
            entity_task: vec![NO_TASK; entities],
            open: vec![false; tasks],
            available: vec![0; agents],
            actions: vec![0; agents],
            last_actions: vec![NO_ACTION; agents],
            last_allocation: vec![NO_TASK; agents],
            decision: vec![false; states],
            reward: vec![0.0; states],
            task_reward: vec![0.0; tasks],
            terminated: vec![false; states],
            reset: vec![false; states],
            task_terminated: vec![false; tasks],
            has_transition: vec![false; states],
            task_unfinished: vec![false; tasks],
            added: vec![0; states],
        }
    }

    /// The allocation `[A]` in force at a state.
    pub fn allocation(&self, state: usize) -> &[u8] {
        let WindowShape { agents, entities, .. } = self.shape;
        &self.entity_task[state * entities..][..agents]
    }
}

/// Adds up the gradients of lanes in their order, which gives the same bits by any number of threads.
fn add_up<'a>(gradients: impl Iterator<Item = &'a Vec<f32>>, sum: &mut Vec<f32>) {
    sum.clear();
    for gradient in gradients {
        sum.resize(gradient.len(), 0.0);
        elementwise::scale(1.0, gradient, Store::Add, sum);
    }
}
