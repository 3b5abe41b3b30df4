//! An agent's policy before another that is to give the same answers, on inputs of all kinds.

use sortie_bundle::OwnedObservation;
use sortie_core::choose::masked_argmax;
use sortie_core::{Observation, Policy};

use crate::comparison::Comparison;
use crate::families::{Family, Rows, Standard};

/// Writes the utilities `[U]` of one observation, of which the graph gets some rows; whether they are all finite.
pub type Answers<'a> = dyn FnMut(&Observation<'_>, Rows, &mut [f32]) -> bool + 'a;

/// Compares an agent's policy with what a graph answers. An agent with memory is judged with an empty one.
pub fn compare_agents(
    policy: &mut dyn Policy,
    answers: &mut Answers<'_>,
    family: &Family<OwnedObservation>,
) -> Comparison {
    let mut comparison = family.comparison();
    let (mut got, mut want) = (vec![0.0; policy.actions()], vec![0.0; policy.actions()]);
    for observation in &family.inputs {
        let view = observation.view();
        let mut memory = vec![0.0; policy.hidden()];
        let ours = policy.utilities_with(&view, &mut memory, &mut got).is_ok();
        let theirs = answers(&view, family.rows, &mut want);
        if family.standard == Standard::Refusal {
            comparison.add_no_number(!ours, theirs);
            continue;
        }
        if !ours || !theirs {
            comparison.add_refusal(ours == theirs);
            continue;
        }
        // The choice is a path of its own in a plan.
        memory.fill(0.0);
        let chosen = policy.decide_with(&view, &mut memory).map(|decision| decision.action);
        let wanted = masked_argmax(&want, view.available).map(|decision| decision.action);
        if chosen.is_ok() && wanted.is_ok() {
            comparison.add(&got, &want, chosen == wanted);
        } else {
            comparison.add_unchosen(&got, &want, chosen == wanted);
        }
    }
    comparison
}
