//! Routing as an [`Environment`]: many tours at once, and what they say of themselves.

use alloc::boxed::Box;
use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;
use core::ops::RangeInclusive;

use rand_core::Rng;
use serde::Deserialize;

use super::VERSION;
use super::exact::optimum;
use super::frames::{reader, rebuilt};
use super::instance::{CUSTOMERS, Instance};
use super::observation::{FIXED, Layout, ROW_ENTRIES, TURNS, feature_names};
use super::picture::picture;
use super::rules::{RULES, Scene, follow};
use super::tour::Tour;
use crate::bytes::{LAYOUT, known};
use crate::entry::{Choice, Entry, EnvironmentError};
use crate::environment::{Environment, Episode, Split, StateError, Step, StepError};
use crate::frame::Frame;
use crate::observation::{EntitySet, Observation, TaskSet};
use crate::picture::Picture;
use crate::random::{Random, below};
use crate::spec::{Metric, Shape, Spec};

/// How `--env` finds it.
pub const ENTRY: Entry = Entry {
    name: "routing",
    about: "Vehicles of limited capacity serve customers on short routes (dissertation section 7.4, figure 7.3)",
    version: VERSION,
    sets: || SETS.map(String::from).to_vec(),
    open: |choice| Ok(Box::new(open(choice)?)),
    rules: RULES,
    reader: Some(reader),
    #[cfg(feature = "std")]
    recordings: None,
};

const SETS: [&str; 5] = ["5-15", "5-15-sequential", "5-15x1", "15", "20"];
/// Customers that sets of as many or fewer have room for, and what a vehicle holds in them, as in the literature for so many.
const SIZES: [(usize, u8); 4] = [(15, 25), (31, 30), (50, 40), (CUSTOMERS, 50)];
/// Most trips that one vehicle alone has to make where there are no more customers than in the smallest of these sets.
const TRIPS: usize = 4;
/// What the name of a set ends with whose vehicles may leave the depot while others are outside.
const SEQUENTIAL: &str = "-sequential";

const METRICS: &[Metric] = &[
    Metric::reported("over_optimum", "times", "length of all routes, by that of the shortest"),
    Metric::reported("length", "sides", "length of all routes"),
    Metric::reported("vehicles", "vehicles", "vehicles that left the depot"),
    Metric::reported("waves", "rounds", "rounds in which vehicles left the depot"),
    Metric::recorded("trips", "trips", "trips of all vehicles"),
    Metric::recorded("forced", "rounds", "rounds in which nobody moved by itself"),
];

/// Instances of each size to measure on; those to learn from have seeds of 33 bits and more.
const MEASURED: usize = 1_000;
const MEASURED_SEEDS: u64 = 1_000_000;
const FIRST_SEED: u64 = 1 << 32;

/// What can be set.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Settings {
    vehicles: usize,
    /// What a vehicle holds; 0: what is usual for so many customers.
    capacity: u8,
    /// What each wave after the first costs where vehicles leave together, while learning alone: 1, and nothing where there is
    /// one vehicle, each of whose trips is a wave.
    wave_cost: Option<f64>,
}

impl Default for Settings {
    fn default() -> Self {
        Self { vehicles: 4, capacity: 0, wave_cost: None }
    }
}

/// Tours, many instances in one object.
#[derive(Clone, Debug)]
pub struct Routing {
    spec: Spec,
    layout: Layout,
    sizes: RangeInclusive<usize>,
    /// As many as serve every instance: one of each vehicle, more of one that is alone.
    trips: usize,
    capacity: u8,
    wave_cost: f64,
    split: Split,
    tours: Vec<Tour>,
}

impl Routing {
    /// An instance to measure on, by its number below 1,000.
    pub fn measured(&self, customers: usize, number: usize) -> Instance {
        let seed = customers as u64 * MEASURED_SEEDS + number as u64;
        self.drawn(seed, customers)
    }

    fn drawn(&self, seed: u64, customers: usize) -> Instance {
        Instance::drawn(seed, customers, self.capacity, self.trips).0
    }

    /// Begins an episode with an instance that has places for these vehicles; what is measured knows the shortest routes.
    pub fn begin(&mut self, instance: usize, routed: Instance) {
        let vehicles = self.layout.vehicles;
        self.tours[instance] = match self.split {
            Split::Train => Tour { wave_cost: self.wave_cost, ..Tour::new(routed, vehicles, None) },
            Split::Test => {
                let best = optimum(&routed, self.trips);
                Tour::new(routed, vehicles, best)
            }
        };
    }

    fn read(&self, state: &[u8]) -> Result<Tour, StateError> {
        let wanted = self.spec.state_bytes;
        let (&found, bytes) = state.split_first().ok_or(StateError::Length { found: 0, wanted })?;
        if found != LAYOUT {
            return Err(StateError::Version { found, wanted: LAYOUT });
        }
        let tour: Option<Tour> = postcard::from_bytes(bytes).ok();
        tour.filter(|tour| self.knows(tour))
            .ok_or_else(|| StateError::Impossible("it is no tour of these vehicles".into()))
    }

    /// Whether an episode of these sizes can have come to this.
    fn knows(&self, tour: &Tour) -> bool {
        tour.is_sound(self.layout.vehicles)
            && self.sizes.contains(&tour.instance.customers())
            && tour.instance.capacity == self.capacity
    }

    /// Where agents head for by their actions, once all of them are available.
    fn goals(&self, instance: usize, actions: &[u16]) -> Result<Vec<Option<u8>>, StepError> {
        let tour = &self.tours[instance];
        let agents = self.layout.vehicles;
        if tour.is_over() {
            return Err(StepError::EpisodeOver);
        }
        let too_few = StepError::TooFewActions { agents, actions: actions.len() };
        let actions = actions.get(..agents).ok_or(too_few)?;
        let goal = |(agent, action): (usize, &u16)| {
            let open = self.layout.available(tour, agent);
            match open.checked_shr((*action).into()) {
                Some(open) if open & 1 == 1 => Ok(self.layout.goal(*action)),
                _ => Err(StepError::Unavailable { agent, action: *action }),
            }
        };
        actions.iter().enumerate().map(goal).collect()
    }
}

pub(super) fn open(choice: &Choice<'_>) -> Result<Routing, EnvironmentError> {
    let settings: Settings = choice.settings()?;
    let set = choice.set.unwrap_or(SETS[0]);
    let (numbers, sequential) = match set.strip_suffix(SEQUENTIAL) {
        Some(numbers) => (numbers, true),
        None => (set, false),
    };
    let (sizes, of_set) = sizes(numbers).ok_or_else(|| {
        EnvironmentError::Set(format!(
            "no set `{set}`; there are numbers of customers from 1 to {CUSTOMERS}, such as `15`, and ranges, such as `5-15`, \
             where there are not four vehicles with their number, such as `31x8`, or `50x1`, of one that drives all trips, and all may end with `{SEQUENTIAL}`: \
             vehicles leave the depot one by one"
        ))
    })?;
    let Settings { vehicles, capacity, wave_cost } = settings;
    let vehicles = of_set.unwrap_or(vehicles);
    let wave_cost = wave_cost.unwrap_or(if vehicles == 1 { 0.0 } else { 1.0 });
    let of_size = SIZES.into_iter().find(|(customers, _)| sizes.end() <= customers);
    let (customers, usual) = of_size.unwrap_or(SIZES[0]);
    let capacity = if capacity == 0 { usual } else { capacity };
    let refused = |reason: &str| Err(EnvironmentError::Setting(reason.to_string()));
    if !(1..=24).contains(&vehicles) {
        return refused("`vehicles` is from 1 to 24");
    }
    let trips = match vehicles {
        1 if customers == SIZES[0].0 => TRIPS,
        1 => customers,
        _ => vehicles,
    };
    // Demands are 5 in the mean: what is drawn should not be drawn again too often.
    if capacity < 9 || usize::from(capacity) * trips < 6 * sizes.end() {
        return refused(
            "`capacity` is at least 9, and all vehicles together hold 6 for each customer, one alone in four trips where \
             there are 15 or fewer",
        );
    }
    if !(0.0..=100.0).contains(&wave_cost) {
        return refused("`wave_cost` is from 0 to 100");
    }
    let wave_cost = if sequential { 0.0 } else { wave_cost };
    // Sets of alike numbers have the same shape, so that what learned on one plays on the others.
    let layout = Layout { vehicles, customers, sequential };
    let spec = spec(layout);
    let over = Tour::new(Instance::default(), vehicles, None);
    let tours = alloc::vec![over; choice.instances];
    Ok(Routing { spec, layout, sizes, trips, capacity, wave_cost, split: choice.split, tours })
}

/// The numbers of customers of a set, and the number of its vehicles where it tells that.
fn sizes(set: &str) -> Option<(RangeInclusive<usize>, Option<usize>)> {
    let (sizes, vehicles) = match set.split_once('x') {
        Some((sizes, vehicles)) => (sizes, Some(vehicles.parse().ok()?)),
        None => (set, None),
    };
    let (least, most) = sizes.split_once('-').unwrap_or((sizes, sizes));
    let (least, most) = (least.parse().ok()?, most.parse().ok()?);
    (1 <= least && least <= most && most <= CUSTOMERS).then_some((least..=most, vehicles))
}

fn spec(layout: Layout) -> Spec {
    let Layout { vehicles: agents, customers, .. } = layout;
    let tasks = customers + 1;
    let (features, actions) = (feature_names(), layout.action_names());
    Spec {
        name: ENTRY.name.into(),
        version: VERSION,
        shape: Shape {
            agents,
            entities: layout.entities(),
            tasks,
            actions: actions.len(),
            features: features.len(),
        },
        features,
        actions,
        targets: agents..layout.entities(),
        fixed: FIXED,
        safe_action: Some(Layout::STAY),
        has_success: false,
        metrics: METRICS.to_vec(),
        turns: TURNS,
        rules: RULES.to_vec(),
        row_entries: ROW_ENTRIES,
        state_bytes: state_bytes(layout),
        episode_limit: 2 * customers as u32,
        ..Spec::default()
    }
}

/// Most bytes of a state: lengths and numbers of two bytes take three at most.
fn state_bytes(layout: Layout) -> usize {
    let places = layout.customers + 1;
    let instance = 2 + places * (16 + 1) + 1;
    1 + instance + 1 + 3 * layout.vehicles + 1 + 2 * places + 3 * 3 + 3 * 8 + 9
}

impl Environment for Routing {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn instances(&self) -> usize {
        self.tours.len()
    }

    fn open(&self, instances: usize, split: Split) -> Box<dyn Environment> {
        let over = Tour::new(Instance::default(), self.layout.vehicles, None);
        Box::new(Self { tours: alloc::vec![over; instances], split, ..self.clone() })
    }

    fn reset(&mut self, instance: usize, random: &mut Random) {
        let customers = self.sizes.start() + below(random, self.sizes.clone().count());
        let drawn = match self.split {
            Split::Train => self.drawn(random.next_u64() | FIRST_SEED, customers),
            Split::Test => self.measured(customers, below(random, MEASURED)),
        };
        self.begin(instance, drawn);
    }

    fn step(
        &mut self,
        instance: usize,
        actions: &[u16],
        _: &mut Random,
    ) -> Result<Step, StepError> {
        let goals = self.goals(instance, actions)?;
        let tour = &mut self.tours[instance];
        let reward = -tour.round(&goals, self.layout.sequential);
        // Every round asks anew who goes where.
        Ok(Step { reward, terminated: tour.is_over(), timed_out: false, tasks_changed: true })
    }

    fn save(&self, instance: usize, state: &mut Vec<u8>) {
        state.push(LAYOUT);
        let written = postcard::to_extend(&self.tours[instance], core::mem::take(state));
        *state = written.unwrap_or_default();
    }

    fn load(&mut self, instance: usize, state: &[u8]) -> Result<(), StateError> {
        self.tours[instance] = self.read(state)?;
        Ok(())
    }

    fn observe(&self, state: &[u8], turn: usize, wanted: EntitySet, seen: &mut Observation) {
        self.layout.observe(&known(self.read(state)), turn, wanted, seen);
    }

    fn rebuilt(&self, frame: &Frame<'_>) -> Option<Vec<u8>> {
        let tour = rebuilt(frame, self.layout, self.capacity).filter(|tour| self.knows(tour))?;
        postcard::to_extend(&tour, alloc::vec![LAYOUT]).ok()
    }

    fn picture(&self, state: &[u8]) -> Picture {
        picture(&known(self.read(state)), self.layout)
    }

    fn episode(&self, instance: usize) -> Episode {
        let tour = &self.tours[instance];
        let done = tour.is_over();
        let used = tour.vehicles.iter().filter(|vehicle| vehicle.trips > 0).count();
        let trips: u32 = tour.vehicles.iter().map(|vehicle| u32::from(vehicle.trips)).sum();
        let ratio = tour.optimum.filter(|_| done).map(|optimum| tour.length / optimum);
        let counts = [used as f64, tour.waves.into(), trips.into(), tour.forced.into()];
        Episode {
            steps: tour.rounds.into(),
            done,
            episode_return: -(tour.length + tour.costs),
            group: format!("{} customers", tour.instance.customers()),
            metrics: [ratio, Some(tour.length)].into_iter().chain(counts.map(Some)).collect(),
            ..Episode::default()
        }
    }

    /// The customer that a vehicle goes to, or the depot.
    fn subtask_of(&self, _: &[u8], _: usize, action: u16) -> Option<usize> {
        self.layout.goal(action).map(|place| self.layout.task_of(place.into()))
    }

    /// A customer is for one vehicle that may go there; the depot is for all.
    fn offers(&self, state: &[u8], offers: &mut Vec<TaskSet>) -> TaskSet {
        let (tour, layout) = (&known(self.read(state)), self.layout);
        let depot = 1 << layout.task_of(0);
        offers.clear();
        offers.extend((0..layout.vehicles).map(|vehicle| layout.offers(tour, vehicle) | depot));
        depot - 1
    }

    fn allocate(&self, rule: usize, state: &[u8], _: &mut Random, allocation: &mut [u8]) {
        Scene::of(&known(self.read(state)), self.layout).allocate(rule, allocation);
    }

    fn scripted(
        &self,
        state: &[u8],
        allocation: &[u8],
        _: &mut Random,
        actions: &mut [u16],
    ) -> bool {
        follow(&known(self.read(state)), self.layout, allocation, actions);
        true
    }
}
