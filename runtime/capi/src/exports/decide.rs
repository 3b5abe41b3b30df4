//! Decisions, one call each.

use sortie_core::limits::{ACTIONS, ENTITIES};
use sortie_core::plan::{Given, Network};
use sortie_core::{DecideError, Decision, EntityMask, Observation};

use super::sizes::{input_lengths, output_lengths};
use crate::border::{Array, Span};
use crate::errors::SortieError;
use crate::placed::Placed;
use crate::policy::SortiePolicy;

/// Stands for the last action of an agent that has not acted yet.
pub const SORTIE_NO_ACTION: u16 = 0xFFFF;

const _: () = assert!(SORTIE_NO_ACTION == sortie_core::NO_ACTION);

/// Numbers that a policy reads.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct SortieInput {
    /// The numbers, all of them finite.
    pub values: *const f32,
    /// How many there are.
    pub length: usize,
}

/// Room for numbers that a policy writes.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct SortieOutput {
    /// Where the numbers go.
    pub values: *mut f32,
    /// How many there are.
    pub length: usize,
}

/// The chosen action and what the network said of it.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct SortieDecision {
    /// Index of the action.
    pub action: u32,
    /// Its utility, score or logit.
    pub utility: f32,
}

/// What one agent of a team sees in one step.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct SortieObservation {
    /// A row of features for every entity, agents first.
    pub rows: *const f32,
    /// Number of entities.
    pub entities: usize,
    /// Numbers from one row to the next, at least `sortie_features`.
    pub stride: usize,
    /// The last action of every agent, `SORTIE_NO_ACTION` where there was none.
    pub last_actions: *const u16,
    /// Number of last actions.
    pub agents: usize,
    /// For every entity, 0 where the agent does not see it. NULL: it sees all.
    pub visible: *const u8,
    /// The agent's own row.
    pub own: usize,
    /// For every action, 0 where it is not available. NULL with a length of 0: all are available.
    pub available: *const u8,
    /// Number of actions.
    pub actions: usize,
}

/// Writes the outputs of a policy and replaces its recurrent states, which the caller keeps, `sortie_state_numbers` in
/// all. Where that fails no state has changed, and outputs hold nothing to be used.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_respond(
    policy: *mut SortiePolicy,
    inputs: *const SortieInput,
    input_count: usize,
    states: *mut f32,
    state_numbers: usize,
    outputs: *const SortieOutput,
    output_count: usize,
) -> SortieError {
    let respond = || {
        // SAFETY: as the caller promises.
        let policy = unsafe { SortiePolicy::at_mut(policy) }?;
        policy.check_network(Network::Policy)?;
        if policy.outputs.is_empty() {
            return Err(SortieError::WrongKind);
        }
        // SAFETY: as the caller promises.
        let inputs = unsafe { listed(inputs, input_count, policy.inputs.len()) }?;
        // SAFETY: as the caller promises.
        let outputs = unsafe { listed(outputs, output_count, policy.outputs.len()) }?;
        let states = Array::of(states, state_numbers, policy.plan.hidden())?;
        check_inputs(policy, inputs)?;
        for (output, want) in outputs.iter().zip(output_lengths(&policy.plan)) {
            Array::of(output.values, output.length, want)?;
        }
        let written = outputs.iter().map(SortieOutput::span).chain([states.span()]);
        policy.check_apart(written, inputs.iter().map(SortieInput::span))?;
        for (slot, output) in policy.outputs.iter_mut().zip(outputs) {
            // SAFETY: of the plan's length and apart from all else, as was checked; the caller promises the memory.
            *slot = unsafe { Array::new(output.values, output.length).write() };
        }
        // SAFETY: as of the outputs.
        let states = unsafe { given(policy, inputs, states) };
        let answer = policy.plan.respond(policy.arena, policy.inputs, states, policy.outputs);
        forget(policy);
        answer.map_err(SortieError::from)
    };
    respond().into()
}

/// Chooses an action greedily among the available ones, the first of several, and replaces the recurrent states.
/// `available` has a byte for every action, 0 where it is not available; NULL with 0 actions: all are available.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_choose(
    policy: *mut SortiePolicy,
    inputs: *const SortieInput,
    input_count: usize,
    available: *const u8,
    actions: usize,
    states: *mut f32,
    state_numbers: usize,
    decision: *mut SortieDecision,
) -> SortieError {
    let (inputs, available) = ((inputs, input_count), (available, actions));
    let states = (states, state_numbers);
    // SAFETY: as the caller promises.
    unsafe { choice(policy, inputs, available, states, decision, None) }.into()
}

/// Draws an action by 32 random bits, with the probabilities that the policy gives to the available ones, and replaces
/// the recurrent states. The same bits draw the same action everywhere.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_draw(
    policy: *mut SortiePolicy,
    inputs: *const SortieInput,
    input_count: usize,
    available: *const u8,
    actions: usize,
    states: *mut f32,
    state_numbers: usize,
    random: u32,
    decision: *mut SortieDecision,
) -> SortieError {
    let (inputs, available) = ((inputs, input_count), (available, actions));
    let states = (states, state_numbers);
    // SAFETY: as the caller promises.
    unsafe { choice(policy, inputs, available, states, decision, Some(random)) }.into()
}

/// Decides greedily for one agent of a team, and replaces its recurrent state.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_decide(
    policy: *mut SortiePolicy,
    observation: *const SortieObservation,
    states: *mut f32,
    state_numbers: usize,
    decision: *mut SortieDecision,
) -> SortieError {
    // SAFETY: as the caller promises.
    unsafe { seen(policy, observation, (states, state_numbers), decision, None) }.into()
}

/// Draws the action of one agent of a team by 32 random bits, and replaces its recurrent state.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_sample(
    policy: *mut SortiePolicy,
    observation: *const SortieObservation,
    states: *mut f32,
    state_numbers: usize,
    random: u32,
    decision: *mut SortieDecision,
) -> SortieError {
    // SAFETY: as the caller promises.
    unsafe { seen(policy, observation, (states, state_numbers), decision, Some(random)) }.into()
}

/// A policy's choice.
///
/// # Safety
/// As of `sortie_respond`.
unsafe fn choice(
    policy: *mut SortiePolicy,
    (inputs, input_count): (*const SortieInput, usize),
    (available, actions): (*const u8, usize),
    (states, state_numbers): (*mut f32, usize),
    decision: *mut SortieDecision,
    random: Option<u32>,
) -> Result<(), SortieError> {
    // SAFETY: as the caller promises.
    let policy = unsafe { SortiePolicy::at_mut(policy) }?;
    policy.check_network(Network::Policy)?;
    if !policy.plan.chooses() {
        return Err(SortieError::WrongKind);
    }
    // SAFETY: as the caller promises.
    let inputs = unsafe { listed(inputs, input_count, policy.inputs.len()) }?;
    // SAFETY: as the caller promises; copied before anything is written.
    let mask = unsafe { Availability::of(available, actions, policy.plan.actions()) }?;
    let states = Array::of(states, state_numbers, policy.plan.hidden())?;
    let decision = Array::of(decision, 1, 1)?;
    check_inputs(policy, inputs)?;
    policy.check_apart(
        [states.span(), decision.span()].into_iter(),
        inputs.iter().map(SortieInput::span),
    )?;
    // SAFETY: of the plan's length and apart from all else, as was checked; the caller promises the memory.
    let states = unsafe { given(policy, inputs, states) };
    let given = Given { inputs: policy.inputs, available: mask.codes() };
    let answer = match random {
        None => policy.plan.choose(policy.arena, &given, states),
        Some(random) => policy.plan.draw(policy.arena, &given, states, random),
    };
    forget(policy);
    // SAFETY: as of the states.
    unsafe { tell(answer, decision) }
}

/// An agent's decision.
///
/// # Safety
/// As of `sortie_decide`.
unsafe fn seen(
    policy: *mut SortiePolicy,
    observation: *const SortieObservation,
    (states, state_numbers): (*mut f32, usize),
    decision: *mut SortieDecision,
    random: Option<u32>,
) -> Result<(), SortieError> {
    // SAFETY: as the caller promises.
    let policy = unsafe { SortiePolicy::at_mut(policy) }?;
    policy.check_network(Network::Agent)?;
    let of_observation = Array::of(observation, 1, 1)?;
    // SAFETY: as the caller promises.
    let seen = *unsafe { of_observation.read() }.first().ok_or(SortieError::Null)?;
    if seen.entities > ENTITIES {
        return Err(SortieError::TooManyEntities);
    }
    let numbers = seen.entities.checked_mul(seen.stride).ok_or(SortieError::WrongLength)?;
    let rows = Array::of(seen.rows, numbers, numbers)?;
    let last_actions = Array::of(seen.last_actions, seen.agents, seen.agents)?;
    // SAFETY: as the caller promises; copied before anything is written.
    let mask = unsafe { Availability::of(seen.available, seen.actions, policy.plan.actions()) }?;
    // SAFETY: as the caller promises; copied too.
    let visible = unsafe { visible(seen.visible, seen.entities) }?;
    let states = Array::of(states, state_numbers, policy.plan.hidden())?;
    let decision = Array::of(decision, 1, 1)?;
    policy.check_apart(
        [states.span(), decision.span()].into_iter(),
        [rows.span(), last_actions.span()].into_iter(),
    )?;
    // SAFETY: no longer than they say, and apart from what is written, as was checked; the caller promises the memory.
    let (rows, last_actions, states) =
        unsafe { (rows.read(), last_actions.read(), states.write()) };
    let observation = Observation {
        rows,
        stride: seen.stride,
        last_actions,
        visible,
        self_index: seen.own,
        available: mask.codes(),
    };
    let answer = match random {
        None => policy.plan.decide(policy.arena, &observation, Some(states)),
        Some(random) => policy.plan.sample(policy.arena, &observation, Some(states), random),
    };
    // SAFETY: as above.
    unsafe { tell(answer, decision) }
}

impl SortieInput {
    fn span(&self) -> Span {
        Array::new(self.values, self.length).span()
    }
}

impl SortieOutput {
    fn span(&self) -> Span {
        Array::new(self.values, self.length).span()
    }
}

/// Which actions are available, as the core wants it.
struct Availability {
    codes: [u16; ACTIONS],
    actions: usize,
}

impl Availability {
    /// # Safety
    /// `available` is null or points to so many bytes.
    unsafe fn of(available: *const u8, len: usize, actions: usize) -> Result<Self, SortieError> {
        let mut codes = [1; ACTIONS];
        if !(available.is_null() && len == 0) {
            // SAFETY: as the caller promises.
            let bytes = unsafe { Array::of(available, len, actions)?.read() };
            codes.iter_mut().zip(bytes).for_each(|(code, byte)| *code = u16::from(*byte));
        }
        Ok(Self { codes, actions })
    }

    fn codes(&self) -> &[u16] {
        self.codes.get(..self.actions).unwrap_or(&[])
    }
}

/// # Safety
/// `visible` is null or points to a byte for every entity.
unsafe fn visible(visible: *const u8, entities: usize) -> Result<EntityMask, SortieError> {
    if visible.is_null() {
        return Ok(EntityMask::first(entities));
    }
    // SAFETY: as the caller promises.
    let bytes = unsafe { Array::of(visible, entities, entities)?.read() };
    let mut mask = EntityMask::EMPTY;
    let seen = bytes.iter().enumerate().filter(|(_, byte)| **byte != 0);
    seen.for_each(|(entity, _)| mask.insert(entity));
    Ok(mask)
}

/// Arrays of a list, as many as the plan has.
///
/// # Safety
/// `list` is null or points to so many arrays.
unsafe fn listed<'a, T: Copy>(
    list: *const T,
    count: usize,
    want: usize,
) -> Result<&'a [T], SortieError> {
    if count != want {
        return Err(SortieError::WrongCount);
    }
    // SAFETY: as the caller promises.
    Ok(unsafe { Array::of(list, count, want)?.read() })
}

/// The inputs are of the plan's lengths.
fn check_inputs(policy: &SortiePolicy, inputs: &[SortieInput]) -> Result<(), SortieError> {
    for (input, want) in inputs.iter().zip(input_lengths(&policy.plan)) {
        Array::of(input.values, input.length, want)?;
    }
    Ok(())
}

/// Hands the inputs to the policy; the states, to be written.
///
/// # Safety
/// All of them come from [`Array::of`], lie apart from each other where they are written, and belong to this call.
unsafe fn given<'a>(
    policy: &mut SortiePolicy,
    inputs: &[SortieInput],
    states: Array<f32>,
) -> &'a mut [f32] {
    for (slot, input) in policy.inputs.iter_mut().zip(inputs) {
        // SAFETY: as the caller promises.
        *slot = unsafe { Array::new(input.values, input.length).read() };
    }
    // SAFETY: as the caller promises.
    unsafe { states.write() }
}

/// The arrays of a call are the caller's again.
fn forget(policy: &mut SortiePolicy) {
    policy.inputs.iter_mut().for_each(|slot| *slot = &[]);
    policy.outputs.iter_mut().for_each(|slot| *slot = &mut []);
}

/// Writes a decision.
///
/// # Safety
/// As of [`Array::write`].
unsafe fn tell(
    answer: Result<Decision, DecideError>,
    to: Array<SortieDecision>,
) -> Result<(), SortieError> {
    let Decision { action, utility } = answer?;
    // SAFETY: as the caller promises.
    unsafe { to.write() }.fill(SortieDecision { action: action.into(), utility });
    Ok(())
}
