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
    AllocationRule, CityDecoder, CityRows, DecodeError, RELATIONS, SaveTheCity,
};
use sortie_envs::{EntitySet, Environment, Observation, Random, StepError};

use super::tally::{FinishedEpisode, Tally};

/// The finished episodes, shared with whoever reports them.
pub(crate) type SharedTally = Rc<RefCell<Tally>>;

/// One city that a team of processes acts in, shared with the onlooker that draws it.
pub(crate) struct CityWorld {
    pub(crate) city: Rc<RefCell<SaveTheCity>>,
    pub(crate) tally: SharedTally,
    random: Random,
    seen: RefCell<Seen>,
}

/// Space for what there is to see.
#[derive(Default)]
struct Seen {
    state: Vec<u8>,
    observation: Observation,
}

impl CityWorld {
    /// A world over the first instance of `city`, which begins an episode.
    pub(crate) fn new(mut city: SaveTheCity, mut random: Random) -> Self {
        city.reset(0, &mut random);
        Self {
            city: Rc::new(RefCell::new(city)),
            tally: SharedTally::default(),
            random,
            seen: RefCell::default(),
        }
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
        self.city.borrow_mut().reset(0, &mut self.random);
    }

    fn observe(&self, frame: &mut FrameMut<'_>) {
        let (city, mut seen) = (self.city.borrow(), self.seen.borrow_mut());
        let Seen { state, observation } = &mut *seen;
        state.clear();
        city.save(0, state);
        city.observe(state, 0, EntitySet::MAX, observation);
        write_frame(observation, &city.shape(), frame);
    }

    fn step(&mut self, actions: &[u16]) -> Result<StepOutcome, UnavailableAction> {
        let mut city = self.city.borrow_mut();
        let outcome = city.step(0, actions, &mut self.random).map_err(|error| match error {
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

/// Writes what there is to see into the frame that the team's processes read.
fn write_frame(seen: &Observation, shape: &sortie_envs::Shape, frame: &mut FrameMut<'_>) {
    let stride = frame.layout().stride();
    for (entity, row) in frame.rows_mut().chunks_exact_mut(stride).enumerate().take(shape.entities)
    {
        let row = &mut row[..shape.features];
        if seen.entities >> entity & 1 == 1 {
            seen.rows.write_dense(seen.row_of(entity), row);
        } else {
            row.fill(0.0);
        }
    }
    frame.set_present(&entity_mask(seen.present));
    frame.set_open_tasks(seen.open_tasks);
    for (agent, (entities, available)) in seen.observable.iter().zip(&seen.available).enumerate() {
        frame.set_observable(agent, &entity_mask(*entities));
        for (action, code) in frame.available_mut(agent).iter_mut().enumerate() {
            *code = (available >> action & 1) as u16;
        }
    }
    for (entity, tasks) in seen.entity_task.iter().enumerate().skip(shape.agents) {
        frame.set_entity_task(entity, *tasks);
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
