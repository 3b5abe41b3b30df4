//! What a policy takes and gives. Where there is no policy, or none of what is asked for, the answer is 0.

use sortie_core::plan::Network;

use crate::operators::Plan;
use crate::placed::Placed;
use crate::policy::SortiePolicy;

/// What a plan is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(i32)]
pub enum SortieKind {
    /// There is no policy.
    None = 0,
    /// A policy over inputs of fixed sizes: `sortie_respond`, `sortie_choose`, `sortie_draw`.
    Policy = 1,
    /// One agent of a team, which sees entities: `sortie_decide`, `sortie_sample`.
    Agent = 2,
}

/// What the plan of a policy is.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_kind(policy: *const SortiePolicy) -> SortieKind {
    let kind = |plan: &Plan<'_>| match plan.header().network {
        Network::Policy => SortieKind::Policy,
        Network::Agent => SortieKind::Agent,
        _ => SortieKind::None,
    };
    // SAFETY: as the caller promises.
    unsafe { SortiePolicy::at(policy) }.map_or(SortieKind::None, |policy| kind(&policy.plan))
}

/// Number of inputs of a policy, in the order in which `sortie inspect` shows them.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_input_count(policy: *const SortiePolicy) -> usize {
    // SAFETY: as the caller promises.
    unsafe { told(policy, |plan| Some(plan.program().input_count())) }
}

/// Numbers of the input at `index`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_input_length(policy: *const SortiePolicy, index: usize) -> usize {
    // SAFETY: as the caller promises.
    unsafe { told(policy, |plan| input_lengths(plan).nth(index)) }
}

/// Number of outputs of a policy, 0 where it only chooses.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_output_count(policy: *const SortiePolicy) -> usize {
    // SAFETY: as the caller promises.
    unsafe { told(policy, |plan| Some(plan.program().output_count())) }
}

/// Numbers of the output at `index`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_output_length(policy: *const SortiePolicy, index: usize) -> usize {
    // SAFETY: as the caller promises.
    unsafe { told(policy, |plan| output_lengths(plan).nth(index)) }
}

/// Number of recurrent states: of a policy as many as the network has, of an agent one or none.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_state_count(policy: *const SortiePolicy) -> usize {
    // SAFETY: as the caller promises.
    unsafe { told(policy, |plan| Some(state_lengths(plan).count())) }
}

/// Numbers of the recurrent state at `index`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_state_length(policy: *const SortiePolicy, index: usize) -> usize {
    // SAFETY: as the caller promises.
    unsafe { told(policy, |plan| state_lengths(plan).nth(index)) }
}

/// Numbers of all recurrent states, which the caller keeps one behind the other and sets to 0 where an episode begins.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_state_numbers(policy: *const SortiePolicy) -> usize {
    // SAFETY: as the caller promises.
    unsafe { told(policy, |plan| Some(plan.hidden())) }
}

/// Number of actions that a policy or an agent chooses among, 0 where it makes no choice.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_actions(policy: *const SortiePolicy) -> usize {
    // SAFETY: as the caller promises.
    unsafe { told(policy, |plan| plan.chooses().then(|| plan.actions())) }
}

/// Whether actions can be drawn: `sortie_draw`, `sortie_sample`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_draws(policy: *const SortiePolicy) -> bool {
    // SAFETY: as the caller promises.
    unsafe { SortiePolicy::at(policy) }.is_ok_and(|policy| policy.plan.draws())
}

/// Features of an entity that an agent sees, its last action not counted.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_features(policy: *const SortiePolicy) -> usize {
    // SAFETY: as the caller promises.
    unsafe { told(policy, |plan| Some(of_agent(plan)?.header().features as usize)) }
}

/// Most entities that an agent sees at a time.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_most_entities(policy: *const SortiePolicy) -> usize {
    // SAFETY: as the caller promises.
    unsafe { told(policy, |plan| Some(of_agent(plan)?.header().n_max as usize)) }
}

/// # Safety
/// `policy` is null or comes from `sortie_load`.
unsafe fn told(
    policy: *const SortiePolicy,
    number: impl FnOnce(&Plan<'static>) -> Option<usize>,
) -> usize {
    // SAFETY: as the caller promises.
    unsafe { SortiePolicy::at(policy) }.ok().and_then(|policy| number(&policy.plan)).unwrap_or(0)
}

fn of_agent<'p, 'a>(plan: &'p Plan<'a>) -> Option<&'p Plan<'a>> {
    (plan.header().network == Network::Agent).then_some(plan)
}

/// Numbers of every input.
pub(crate) fn input_lengths(plan: &Plan<'_>) -> impl Iterator<Item = usize> {
    plan.inputs()
}

/// Numbers of every output.
pub(crate) fn output_lengths(plan: &Plan<'_>) -> impl Iterator<Item = usize> {
    plan.outputs()
}

fn state_lengths(plan: &Plan<'_>) -> impl Iterator<Item = usize> {
    let of_agent = (plan.hidden() > 0).then(|| plan.hidden());
    let of_agent = of_agent.filter(|_| plan.header().network == Network::Agent);
    plan.states().chain(of_agent)
}
