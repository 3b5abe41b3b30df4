//! Agents that run options: their networks in any engine, and their golden episodes.

use sortie_bundle::{Bundle, OptionsContract};
use sortie_core::options::{OptionNetworks, OptionPolicy, PlanNetworks, Pursuit};
use sortie_core::plan::{AlignedBytes, Plan, PlanError};
use sortie_core::{DecideError, EntityMask, Observation, Policy};
use zerocopy::FromBytes;

use crate::comparison::{Comparison, cannot_run};
use crate::error::CompileError;
use crate::golden::GOLDEN_FAMILY;
use crate::policy::FlatPolicy;

/// The plans of controller, meta-controller and affordances as networks, over [`option_arena`].
///
/// # Errors
/// They are not three, or cannot be loaded.
pub fn option_networks<'a>(
    plans: &'a [AlignedBytes],
    arena: &'a mut AlignedBytes,
) -> Result<PlanNetworks<'a>, PlanError> {
    let [controller, meta, affordance] = plans else { return Err(PlanError::WrongNetwork) };
    let [controller, meta, affordance] =
        [controller, meta, affordance].map(|plan| Plan::load(plan.as_slice()));
    PlanNetworks::new([controller?, meta?, affordance?], arena.as_mut_slice())
}

/// What they write to.
///
/// # Errors
/// A plan cannot be loaded.
pub fn option_arena(plans: &[AlignedBytes]) -> Result<AlignedBytes, PlanError> {
    let bytes = |plan: &AlignedBytes| Ok(Plan::load(plan.as_slice())?.arena_bytes());
    let bytes: Vec<usize> = plans.iter().map(bytes).collect::<Result<_, PlanError>>()?;
    Ok(AlignedBytes::zeroed(bytes.into_iter().max().unwrap_or(0)))
}

/// An agent over the plans of controller, meta-controller and affordances.
///
/// Its two arenas are one for the plans, and room for what they are shown.
pub(crate) fn over_plans<'a>(
    (options, actions): (&OptionsContract, usize),
    plans: &'a [AlignedBytes],
    arenas: &'a mut [AlignedBytes],
) -> Result<Box<dyn Policy + Send + 'a>, PlanError> {
    let [arena, row] = arenas else { return Err(PlanError::WrongNetwork) };
    let networks = option_networks(plans, arena)?;
    let row = <[f32]>::mut_from_bytes(row.as_mut_slice()).map_err(|_| PlanError::WrongNetwork)?;
    let rules = options.rules(actions).map_err(|_| PlanError::WrongNetwork)?;
    let policy = OptionPolicy::new(rules, networks, row).ok_or(PlanError::WrongNetwork)?;
    Ok(Box::new(policy))
}

/// Room for its plans and for what they are shown.
pub(crate) fn arenas(
    options: &OptionsContract,
    plans: &[AlignedBytes],
) -> Result<Vec<AlignedBytes>, PlanError> {
    let shown = options.shown().map_err(|_| PlanError::WrongNetwork)?;
    Ok(vec![option_arena(plans)?, AlignedBytes::zeroed(4 * shown.columns())])
}

/// An agent of so many actions over networks in any engine.
///
/// # Errors
/// The rules do not hold together.
pub fn option_policy<N: OptionNetworks>(
    (options, actions): (&OptionsContract, usize),
    networks: N,
) -> Result<OptionPolicy<N, Vec<f32>>, CompileError> {
    let unfit = |reason: String| CompileError::NoAgent { reason };
    let rules = options.rules(actions).map_err(unfit)?;
    let row = vec![0.0; options.shown().map_err(unfit)?.columns()];
    let policy = OptionPolicy::new(rules, networks, row);
    policy.ok_or_else(|| unfit("its picture cannot be shown".to_owned()))
}

/// The same over the three graphs in an engine.
///
/// # Errors
/// As [`option_policy`].
pub fn options_over_graphs(
    bundle: &Bundle,
    options: &OptionsContract,
    graphs: [Box<dyn FlatPolicy>; 3],
) -> Result<Box<dyn Policy + Send>, CompileError> {
    let actions = bundle.contract().actions.into();
    Ok(Box::new(option_policy((options, actions), GraphNetworks(graphs))?))
}

/// Controller, meta-controller and affordances in an engine.
pub struct GraphNetworks(pub [Box<dyn FlatPolicy>; 3]);

impl GraphNetworks {
    fn run(&mut self, which: usize, given: &[&[f32]], to: &mut [f32]) -> Result<(), DecideError> {
        let graph = self.0.get_mut(which).ok_or(DecideError::BadLength)?;
        let answers = graph.run(given, &mut []).map_err(|_| DecideError::NonFinite)?;
        let numbers = answers.first().map(|answer| answer.numbers.as_slice());
        let numbers = numbers.filter(|numbers| numbers.len() == to.len());
        to.copy_from_slice(numbers.ok_or(DecideError::BadLength)?);
        Ok(())
    }
}

impl OptionNetworks for GraphNetworks {
    fn actions(
        &mut self,
        shown: &[f32],
        goal: usize,
        values: &mut [f32],
    ) -> Result<(), DecideError> {
        self.run(0, &[shown, &[goal as f32]], values)
    }

    fn goals(&mut self, shown: &[f32], values: &mut [f32]) -> Result<(), DecideError> {
        self.run(1, &[shown], values)
    }

    fn affordances(&mut self, shown: &[f32], likelihoods: &mut [f32]) -> Result<(), DecideError> {
        self.run(2, &[shown], likelihoods)
    }
}

/// Plays the golden episodes of a bundle tick by tick: goals, where they are chosen, and actions have to be the recorded
/// ones. There is nothing to compare where a bundle has none.
///
/// # Errors
/// The policy cannot decide.
pub fn compare_with_golden_episodes(
    policy: &mut dyn Policy,
    bundle: &Bundle,
) -> Result<Comparison, CompileError> {
    let mut found = Comparison::new(GOLDEN_FAMILY);
    let (features, actions) = (bundle.contract().features.into(), policy.actions());
    let available = vec![1; actions];
    for episode in &bundle.golden().episodes {
        let mut memory = vec![0.0; policy.hidden()];
        for tick in &episode.ticks {
            let unreadable = |reason| CompileError::Unreadable { reason };
            let row = tick.row(features).map_err(unreadable)?;
            let seen = Observation {
                rows: &row,
                stride: features,
                last_actions: &[],
                visible: EntityMask::first(1),
                self_index: 0,
                available: &available,
            };
            let decision = policy.decide_with(&seen, &mut memory);
            let decision = decision.map_err(cannot_run)?;
            let pursuit = Pursuit::of(&memory);
            let same = decision.action == tick.action
                && pursuit.is_some_and(|it| it.goal == usize::from(tick.goal))
                && pursuit.is_some_and(|it| (it.steps == 1) == tick.chose);
            found.add_error(0.0, same);
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests;
