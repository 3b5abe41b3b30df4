//! Observations of recorded episodes, by what an agent sees.

use sortie_bundle::Recording;
use sortie_core::{EntityMask, Observation, Policy};

use sortie_cli::output::tell;

/// Different observations of a case, which are taken in turn.
const OBSERVATIONS: usize = 256;
/// Entities of a frame whose mask is forced open.
const ALL: usize = 11;
/// Visible entities of the usual decision.
const FEW: usize = 4;

/// Observations that are decided on in turn.
pub(super) struct Case<'a> {
    pub(super) name: String,
    observations: Vec<Observation<'a>>,
}

/// Frames of so many entities with the mask forced open: what is masked by subtask never shows as many.
pub(super) fn all_visible(recordings: &[Recording]) -> Case<'_> {
    let observations = recordings.iter().flat_map(Recording::observations);
    let full = observations.filter(|seen| seen.rows.len() == ALL * seen.stride);
    let open = full.map(|seen| Observation { visible: EntityMask::first(ALL), ..seen });
    Case { name: format!("N = {ALL}, all visible"), observations: some(open.collect()) }
}

/// Recorded masks that show so many entities.
pub(super) fn few_visible(recordings: &[Recording]) -> Case<'_> {
    let observations = recordings.iter().flat_map(Recording::observations);
    let few = observations.filter(|seen| seen.visible.len() == FEW);
    Case { name: format!("N = {FEW}"), observations: some(few.collect()) }
}

/// All recorded masks of the bundle's own scenario set.
pub(super) fn recorded(recordings: &[Recording]) -> Case<'_> {
    let observations = recordings.iter().take(1).flat_map(Recording::observations);
    let observations = some(observations.collect());
    let visible: usize = observations.iter().map(|seen| seen.visible.len()).sum();
    let mean = visible as f64 / observations.len().max(1) as f64;
    Case { name: format!("recorded masks, {mean:.1} entities"), observations }
}

/// Some of many, from all parts of the episodes.
pub(super) fn some<T>(all: Vec<T>) -> Vec<T> {
    let step = (all.len() / OBSERVATIONS).max(1);
    all.into_iter().step_by(step).take(OBSERVATIONS).collect()
}

impl Case<'_> {
    pub(super) fn holds_any(&self, bundle: &str) -> bool {
        if self.observations.is_empty() {
            tell!("note: no observation of {bundle} for `{}`", self.name);
        }
        !self.observations.is_empty()
    }

    pub(super) fn decide(&self, policy: &mut dyn Policy, call: usize) {
        let observation = &self.observations[call % self.observations.len()];
        let decision = policy.decide(observation);
        std::hint::black_box(decision.expect("observations of episodes can be decided on"));
    }
}
