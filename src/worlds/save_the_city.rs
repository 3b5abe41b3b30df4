//! SaveTheCity as a world, and its allocation rules as allocators of a domain.

use std::cell::RefCell;
use std::rc::Rc;

use rand_xoshiro::Xoshiro256PlusPlus;
use sortie_core::allocate::TaskRelation;
use sortie_core::wire::FrameMut;
use sortie_core::world::{Shape, StepOutcome, UnavailableAction, World};
use sortie_core::{AllocateError, AllocationState, Allocator, EntityMask};
use sortie_envs::random::generator;
use sortie_envs::save_the_city::{
    ACTIONS, AllocationRule, CityDecoder, CityRows, DecodeError, MAX_AGENTS, MAX_BUILDINGS,
    RELATIONS, SaveTheCity,
};
use sortie_envs::{Environment, ObservationMut, StepError};

use super::tally::{FinishedEpisode, Tally};

/// The finished episodes, shared with whoever reports them.
pub(crate) type SharedTally = Rc<RefCell<Tally>>;

/// One city that a team of processes acts in, shared with the onlooker that draws it.
#[derive(Clone)]
pub(crate) struct CityWorld {
    pub(crate) city: Rc<RefCell<SaveTheCity>>,
    pub(crate) tally: SharedTally,
}

impl CityWorld {
    /// A world over the first instance of `city`.
    pub(crate) fn new(city: SaveTheCity) -> Self {
        Self { city: Rc::new(RefCell::new(city)), tally: SharedTally::default() }
    }
}

impl World for CityWorld {
    fn shape(&self) -> Shape {
        let shape = self.city.borrow().shape();
        Shape {
            agents: shape.agents,
            entities: shape.entities,
            tasks: shape.tasks,
            actions: shape.actions,
            features: shape.features,
        }
    }

    fn reset(&mut self) {
        self.city.borrow_mut().reset(0);
    }

    fn observe(&self, frame: &mut FrameMut<'_>) {
        let city = self.city.borrow();
        let mut present = 0;
        let mut observable = [0; MAX_AGENTS];
        let mut entity_task = [0; MAX_AGENTS + MAX_BUILDINGS];
        let mut available = [0; MAX_AGENTS * ACTIONS];
        let mut open_tasks = 0;
        let stride = frame.layout().stride();
        city.observe(
            0,
            &mut ObservationMut {
                rows: frame.rows_mut(),
                stride,
                present: &mut present,
                observable: &mut observable,
                entity_task: &mut entity_task,
                available: &mut available,
                open_tasks: &mut open_tasks,
            },
        );
        frame.set_present(&entity_mask(present));
        frame.set_open_tasks(open_tasks);
        let shape = city.shape();
        for (agent, (entities, codes)) in
            observable.iter().zip(available.chunks_exact(ACTIONS)).enumerate().take(shape.agents)
        {
            frame.set_observable(agent, &entity_mask(*entities));
            frame.available_mut(agent).copy_from_slice(codes);
        }
        for (entity, tasks) in entity_task.iter().enumerate().skip(shape.agents) {
            frame.set_entity_task(entity, *tasks);
        }
    }

    fn step(&mut self, actions: &[u16]) -> Result<StepOutcome, UnavailableAction> {
        let mut city = self.city.borrow_mut();
        let outcome = city.step(0, actions).map_err(|error| match error {
            StepError::Unavailable { agent, action } => UnavailableAction { agent, action },
            _ => UnavailableAction { agent: 0, action: sortie_core::NO_ACTION },
        })?;
        if outcome.done() {
            let team = city.city(0).agents.iter().map(|agent| agent.kind.letter()).collect();
            let metrics = *city.metrics(0);
            self.tally.borrow_mut().add(FinishedEpisode { team, metrics });
        }
        Ok(StepOutcome { episode_ended: outcome.done(), tasks_changed: outcome.tasks_changed })
    }
}

/// One of the environment's allocation rules, reading the city from the frame's rows.
pub(crate) struct CityAllocator {
    rule: AllocationRule,
    decoder: CityDecoder,
    generator: Xoshiro256PlusPlus,
}

impl CityAllocator {
    /// `seed` matters to the random rule only.
    pub(crate) fn new(rule: AllocationRule, seed: u64) -> Self {
        Self { rule, decoder: CityDecoder::new(), generator: generator(seed) }
    }
}

impl Allocator for CityAllocator {
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        state.check(allocation)?;
        let rows = city_rows(state);
        let allocated = self.decoder.allocate(self.rule, &rows, &mut self.generator, allocation);
        allocated.map_err(refusal)
    }
}

/// Travel times, which the learned allocator knows beside features.
pub(crate) struct CityRelation {
    decoder: CityDecoder,
}

impl CityRelation {
    pub(crate) fn new() -> Self {
        Self { decoder: CityDecoder::new() }
    }
}

impl TaskRelation for CityRelation {
    fn columns(&self) -> usize {
        RELATIONS
    }

    fn observe(&mut self, state: &AllocationState<'_>) -> Result<(), AllocateError> {
        self.decoder.decode(&city_rows(state)).map(drop).map_err(refusal)
    }

    fn write(&mut self, state: &AllocationState<'_>, task: usize, relation: &mut [f32]) {
        self.decoder.write_relation(&city_rows(state), task, relation);
    }
}

fn refusal(error: DecodeError) -> AllocateError {
    match error {
        DecodeError::TooLarge => AllocateError::TooLarge,
        DecodeError::BadLength => AllocateError::BadLength,
        _ => AllocateError::NonFinite,
    }
}

/// What the environment's decoder needs of a frame.
pub(crate) fn city_rows<'a>(state: &AllocationState<'a>) -> CityRows<'a> {
    CityRows {
        rows: state.rows,
        stride: state.stride,
        agents: state.agents,
        tasks: state.tasks,
        present: bits(&state.present),
        open_tasks: state.open_tasks,
    }
}

fn bits(entities: &EntityMask) -> u128 {
    let word = |index| u128::from(entities.words().get(index).copied().unwrap_or(0));
    word(0) | word(1) << 64
}

fn entity_mask(bits: u128) -> EntityMask {
    EntityMask::from_words(&[bits as u64, (bits >> 64) as u64])
}
