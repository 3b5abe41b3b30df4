//! What runs a policy that is served, and decides on what messages carry with the memory that it needs.

use sortie_core::choose::{masked_argmax, masked_sample};
use sortie_core::plan::{AlignedBytes, Plan};
use sortie_core::wire::Reason;

use super::schema::{MOST_PORTS, PolicySchema};

/// An engine with the recurrent state of the policy that it runs.
pub(super) struct Decider<'e> {
    engine: &'e mut dyn Engine,
    inputs: Vec<usize>,
    outputs: Vec<usize>,
    actions: usize,
    states: Vec<f32>,
    /// What actions are drawn with; `None` = the best is taken.
    random: Option<Random>,
}

impl<'e> Decider<'e> {
    pub(super) fn new(
        engine: &'e mut dyn Engine,
        schema: &PolicySchema,
        seed: Option<u64>,
    ) -> Self {
        Self {
            engine,
            inputs: schema.inputs.iter().map(|port| port.length).collect(),
            outputs: schema.outputs.iter().map(|port| port.length).collect(),
            actions: schema.actions,
            states: vec![0.0; schema.states.iter().map(|state| state.length).sum()],
            random: seed.map(Random::new),
        }
    }

    /// Brings near what decisions read and write, and forgets what that came to.
    pub(super) fn warm(&mut self) {
        self.engine.warm();
        let unused = self.random.clone();
        let inputs = vec![0.0; self.inputs.iter().sum()];
        let mut outputs = vec![0.0; self.outputs.iter().sum()];
        // Zeros may be no observation that this policy decides on.
        let _ = self.decide(&inputs, &vec![1; self.actions], &mut outputs);
        self.forget();
        self.random = unused;
    }

    /// Begins an episode.
    pub(super) fn forget(&mut self) {
        self.states.fill(0.0);
    }

    /// Writes the outputs; returns the action, where the policy chooses one. An error leaves the state as it was.
    pub(super) fn decide(
        &mut self,
        mut inputs: &[f32],
        available: &[u16],
        outputs: &mut [f32],
    ) -> Result<Option<u16>, Reason> {
        if self.actions != 0 && available.iter().all(|&code| code == 0) {
            return Err(Reason::NoAvailableAction);
        }
        let mut given: [&[f32]; MOST_PORTS] = [&[]; MOST_PORTS];
        for (place, &length) in given.iter_mut().zip(&self.inputs) {
            *place = inputs.split_off(..length).ok_or(Reason::Length)?;
        }
        let given = given.get(..self.inputs.len()).ok_or(Reason::Length)?;
        let mut places: [&mut [f32]; MOST_PORTS] = Default::default();
        let mut rest = &mut *outputs;
        for (place, &length) in places.iter_mut().zip(&self.outputs) {
            *place = rest.split_off_mut(..length).ok_or(Reason::Length)?;
        }
        let places = places.get_mut(..self.outputs.len()).ok_or(Reason::Length)?;
        self.engine.respond(given, &mut self.states, places)?;
        if self.actions == 0 {
            return Ok(None);
        }
        let scores = outputs.get(..self.actions).ok_or(Reason::Length)?;
        let decision = match &mut self.random {
            None => masked_argmax(scores, available),
            Some(random) => masked_sample(scores, available, (random.draw() >> 32) as u32),
        };
        Ok(Some(decision.map_err(Reason::from)?.action))
    }
}

/// What runs a policy: its plan, or whatever else gives the same outputs.
pub trait Engine {
    /// Writes all outputs, in the schema's order, and replaces the recurrent states, which lie one behind the other.
    ///
    /// # Errors
    /// Why it cannot: the states are as before then. [`Reason::NonFinite`] where an input, a state or an output is no
    /// finite number.
    fn respond(
        &mut self,
        inputs: &[&[f32]],
        states: &mut [f32],
        outputs: &mut [&mut [f32]],
    ) -> Result<(), Reason>;

    /// First 16 bytes of its network's id.
    fn model(&self) -> [u8; 16];

    /// Whether it runs the network's graph: it allocates, and promises nothing about bits or time.
    fn is_graph(&self) -> bool {
        false
    }

    /// Brings near what it reads.
    fn warm(&mut self) {}
}

/// A plan with its arena. A decision takes nothing from the heap.
pub(super) struct PlanEngine<'p> {
    plan: &'p Plan<'p>,
    arena: AlignedBytes,
}

impl<'p> PlanEngine<'p> {
    pub(super) fn new(plan: &'p Plan<'p>) -> Self {
        Self { plan, arena: AlignedBytes::zeroed(plan.arena_bytes()) }
    }
}

impl Engine for PlanEngine<'_> {
    fn respond(
        &mut self,
        inputs: &[&[f32]],
        states: &mut [f32],
        outputs: &mut [&mut [f32]],
    ) -> Result<(), Reason> {
        self.plan.respond(self.arena.as_mut_slice(), inputs, states, outputs).map_err(Reason::from)
    }

    fn model(&self) -> [u8; 16] {
        self.plan.header().source.first_chunk().copied().unwrap_or_default()
    }

    fn warm(&mut self) {
        self.plan.warm();
    }
}

/// SplitMix64 (Steele, Lea and Flood, 2014).
#[derive(Clone, Debug)]
struct Random(u64);

impl Random {
    fn new(seed: u64) -> Self {
        Self(seed)
    }

    fn draw(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }
}
