//! A team small enough for thousands of ticks a second: agents come and go, subtasks close, actions
//! are now and then not available at all, and the policy now and then refuses.

use sortie_core::allocate::{CostAllocator, CostMethod, CostModel};
use sortie_core::wire::FrameMut;
use sortie_core::{
    AllocateError, AllocationState, Allocator, DecideError, Decision, EntityMask, NO_ACTION,
    Observation, Policy, Shape, StepOutcome, UNASSIGNED, UnavailableAction, World,
};

use super::random::{Random, mix};

pub(crate) const TASKS: usize = 3;
pub(crate) const ACTIONS: usize = 4;
/// The contract's safe action.
pub(crate) const SAFE: u16 = 2;

pub(crate) fn shape(agents: usize) -> Shape {
    Shape { agents, entities: agents + TASKS, tasks: TASKS, actions: ACTIONS, features: 2 }
}

pub(crate) struct ToyWorld {
    random: Random,
    agents: usize,
    steps_left: u64,
    present: u64,
    open: u32,
    available: Vec<[u16; ACTIONS]>,
    /// Everything that has happened, as one number that the features show.
    state: u64,
}

impl ToyWorld {
    pub(crate) fn new(agents: usize, seed: u64) -> Self {
        let mut world = Self {
            random: Random::new(seed),
            agents,
            steps_left: 1,
            present: 0,
            open: 0,
            available: vec![[0; ACTIONS]; agents],
            state: seed,
        };
        world.reset();
        world
    }

    fn draw_available(&mut self) {
        for codes in &mut self.available {
            let has_none = self.random.chance(10);
            let bits = self.random.next();
            for (action, code) in codes.iter_mut().enumerate() {
                let is_available = action == 1 || bits >> action & 1 == 1;
                *code = u16::from(is_available && !has_none);
            }
        }
    }

    /// Closes, now and then, one open subtask; opens all once none is.
    fn draw_open(&mut self) -> bool {
        let before = self.open;
        if self.random.chance(60) {
            self.open &= !(1 << self.random.below(TASKS as u64));
        }
        if self.open == 0 {
            self.open = (1 << TASKS) - 1;
        }
        self.open != before
    }
}

impl World for ToyWorld {
    fn shape(&self) -> Shape {
        shape(self.agents)
    }

    fn reset(&mut self) {
        self.steps_left = self.random.between(15, 60);
        self.present = (1 << self.agents) - 1;
        self.open = (1 << TASKS) - 1;
        self.draw_available();
    }

    fn observe(&self, frame: &mut FrameMut<'_>) {
        let entities = self.agents + TASKS;
        let objects = ((1_u64 << TASKS) - 1) << self.agents;
        frame.set_present(&EntityMask::from_words(&[self.present | objects]));
        for entity in 0..entities {
            for (column, feature) in frame.row_mut(entity).iter_mut().enumerate() {
                *feature =
                    (mix(self.state ^ (entity * 8 + column) as u64) >> 40) as f32 / 16_777_216.0;
            }
            if entity >= self.agents {
                frame.set_entity_task(entity, 1 << (entity - self.agents));
            }
        }
        for (agent, available) in self.available.iter().enumerate() {
            frame.set_observable(agent, &EntityMask::first(entities));
            frame.available_mut(agent).copy_from_slice(available);
        }
        frame.set_open_tasks(self.open);
    }

    fn step(&mut self, actions: &[u16]) -> Result<StepOutcome, UnavailableAction> {
        for (agent, (&action, codes)) in actions.iter().zip(&self.available).enumerate() {
            let is_available = codes.get(usize::from(action)).is_some_and(|&code| code != 0);
            let is_present = self.present >> agent & 1 == 1;
            if action != NO_ACTION && !(is_available && is_present) {
                return Err(UnavailableAction { agent, action });
            }
            self.state = mix(self.state ^ u64::from(action));
        }
        for agent in 0..self.agents {
            let is_present = self.present >> agent & 1 == 1;
            if self.random.chance(if is_present { 40 } else { 200 }) {
                self.present ^= 1 << agent;
            }
        }
        self.draw_available();
        self.steps_left -= 1;
        Ok(StepOutcome { episode_ended: self.steps_left == 0, tasks_changed: self.draw_open() })
    }
}

/// Chooses by what it sees; refuses now and then.
pub(crate) struct ToyPolicy;

impl Policy for ToyPolicy {
    fn actions(&self) -> usize {
        ACTIONS
    }

    fn utilities(
        &mut self,
        seen: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        for (action, utility) in utilities.iter_mut().enumerate() {
            let features = seen.visible.iter().map(|entity| seen.rows[entity * seen.stride]);
            *utility = features.map(|feature| (feature * (action + 1) as f32).fract()).sum();
        }
        let own = seen.rows[seen.self_index * seen.stride];
        if own < 0.01 { Err(DecideError::NonFinite) } else { Ok(()) }
    }

    fn decide(&mut self, seen: &Observation<'_>) -> Result<Decision, DecideError> {
        let mut utilities = [0.0; ACTIONS];
        self.utilities(seen, &mut utilities)?;
        let mut best: Option<Decision> = None;
        for (action, (&utility, &code)) in utilities.iter().zip(seen.available).enumerate() {
            if code != 0 && best.is_none_or(|best| utility > best.utility) {
                best = Some(Decision { action: action as u16, utility });
            }
        }
        best.ok_or(DecideError::NoAvailableAction)
    }
}

/// Gives every agent an open subtask or none, by its feature and its last subtask.
pub(crate) struct ToyAllocator {
    /// It refuses now and then.
    pub(crate) refuses: bool,
}

impl Allocator for ToyAllocator {
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        tasks: &mut [u8],
    ) -> Result<(), AllocateError> {
        for (agent, task) in tasks.iter_mut().enumerate() {
            let feature = state.rows[agent * state.stride];
            if self.refuses && feature < 0.002 {
                return Err(AllocateError::NonFinite);
            }
            let wish = ((feature * 1024.0) as u32).wrapping_add(state.entity_task[agent])
                % (TASKS as u32 + 1);
            let is_open = wish < TASKS as u32 && state.open_tasks >> wish & 1 == 1;
            *task = if is_open { wish as u8 } else { UNASSIGNED };
        }
        Ok(())
    }
}

/// Costs that only the frame decides, so that all agents agree.
pub(crate) struct ToyCosts;

impl CostModel for ToyCosts {
    fn costs(
        &mut self,
        state: &AllocationState<'_>,
        costs: &mut [f32],
    ) -> Result<(), AllocateError> {
        for (agent, row) in costs.chunks_exact_mut(state.tasks).enumerate() {
            let feature = state.rows[agent * state.stride];
            for (task, cost) in row.iter_mut().enumerate() {
                *cost = (feature - task as f32 / TASKS as f32).abs();
            }
        }
        Ok(())
    }
}

/// The fallback rule of agents and allocators.
pub(crate) fn heuristic(costs: &mut [f32]) -> CostAllocator<'_, ToyCosts> {
    CostAllocator { model: ToyCosts, method: CostMethod::Greedy, team_max: 2, costs }
}
