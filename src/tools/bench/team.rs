//! The decisions of a whole team in one process, against one batched call of onnxruntime.

use sortie_bundle::{RecordedFrame, Recording};
use sortie_core::choose::masked_argmax;
use sortie_core::{DecideError, Observation, Policy};
use sortie_plans::{BatchedUtilities, TOLERANCE};

use super::cases::some;
use super::contestants::Contestants;
use super::rounds::{alternate, engine, our_engine};
use super::schedule::Schedule;
use super::{FLOOR, Figures};
use sortie_cli::failure::{Failure, Outcome};
use sortie_cli::output::tell;

/// Agents, and entities of their frames.
pub(super) const SIZES: [(usize, usize); 2] = [(5, 11), (8, 17)];
/// Agents of the largest team.
const LARGEST: usize = 8;

/// Measures teams of all sizes on recorded masks.
pub(super) fn measure(
    contestants: &mut Contestants<'_>,
    recordings: &[Recording],
    schedule: &Schedule<'_>,
    figures: &mut Figures,
) -> Outcome {
    for (agents, entities) in SIZES {
        let frames = frames(recordings, agents, entities);
        let case = format!("{}: {agents} agents, N = {entities}", contestants.name);
        if frames.is_empty() {
            tell!("note: no frame of `{case}` was recorded");
            continue;
        }
        check(&frames, contestants)?;
        measure_team(contestants, &case, &frames, schedule, figures)?;
    }
    Ok(())
}

/// Measures all decisions of a frame in one call of each engine.
fn measure_team(
    contestants: &mut Contestants<'_>,
    case: &str,
    frames: &[Vec<Observation<'_>>],
    schedule: &Schedule<'_>,
    figures: &mut Figures,
) -> Outcome {
    let agents = frames.first().map_or(0, Vec::len);
    let actions = usize::from(contestants.bundle.contract().actions);
    let Contestants { ours, onnxruntime, floor, .. } = contestants;
    let mut plans = Vec::new();
    for (profile, plan) in ours {
        plans.push((*profile, plan.team()?));
    }
    let mut utilities = vec![0.0; agents * actions];
    let frame = |call: usize| &frames[call % frames.len()];
    for pace in schedule.paces {
        let mut engines = Vec::new();
        for (profile, policy) in &mut plans {
            engines.push(our_engine(profile, |call| decide_together(frame(call), policy.as_mut())));
        }
        if let Some(peer) = onnxruntime
            && let Some(team) = &mut peer.team
        {
            let utilities = &mut utilities;
            let at_once = |call| at_once(frame(call), team.as_mut(), utilities);
            engines.push(engine("onnxruntime", peer.runtime.version(), at_once));
        }
        engines.push(engine(FLOOR, "", |_| floor.read()));
        let measured = alternate(&mut engines, *pace, schedule.seconds(*pace));
        figures.add("team", &format!("{case}, {}", pace.name()), &engines, &measured);
    }
    Ok(())
}

/// The frames in which so many agents decide among so many entities.
fn frames(recordings: &[Recording], agents: usize, entities: usize) -> Vec<Vec<Observation<'_>>> {
    let of = |recording: &Recording, frame: &RecordedFrame| {
        frame.agents.len() == agents && frame.entities(recording.features) == entities
    };
    let all = recordings.iter().flat_map(|recording| {
        let fits = recording.frames.iter().filter(move |frame| of(recording, frame));
        fits.map(|frame| frame.observations(recording.features).collect())
    });
    some(all.collect())
}

/// The decisions of all agents in one call.
fn decide_together(frame: &[Observation<'_>], policy: &mut dyn Policy) {
    let mut decisions = [Err(DecideError::BadLength); LARGEST];
    policy.decide_batch(frame, &mut decisions);
    for decision in decisions.iter().take(frame.len()) {
        std::hint::black_box(decision.expect("observations of episodes can be decided on"));
    }
}

/// One call for all agents, and the choice of each.
fn at_once(frame: &[Observation<'_>], peer: &mut dyn BatchedUtilities, utilities: &mut [f32]) {
    peer.utilities(frame, utilities).expect("the batched graph takes every recorded frame");
    let actions = utilities.len() / frame.len().max(1);
    for (observation, utilities) in frame.iter().zip(utilities.chunks_exact(actions)) {
        let decision = masked_argmax(utilities, observation.available);
        std::hint::black_box(decision.expect("an action is available"));
    }
}

/// The batched graph must compute what the single one does, which our plan was proved against.
fn check(frames: &[Vec<Observation<'_>>], contestants: &mut Contestants<'_>) -> Outcome {
    let Contestants { ours, onnxruntime: Some(peer), .. } = contestants else { return Ok(()) };
    let Some(team) = &mut peer.team else { return Ok(()) };
    let (_, exact) = ours.first_mut().expect("every machine runs the exact profile");
    let mut ours = exact.policy()?;
    let actions = ours.actions();
    let mut want = vec![0.0; actions];
    for frame in frames {
        let mut got = vec![0.0; frame.len() * actions];
        team.utilities(frame, &mut got)
            .map_err(|error| Failure::difference(format!("the batched graph: {error}")))?;
        for (observation, got) in frame.iter().zip(got.chunks_exact(actions)) {
            ours.utilities(observation, &mut want)
                .map_err(|error| Failure::difference(format!("the plan: {error}")))?;
            let largest = want.iter().fold(0.0, |largest: f32, value| largest.max(value.abs()));
            let distance = got.iter().zip(&want).map(|(got, want)| (got - want).abs());
            let error = distance.fold(0.0, f32::max) / (1.0 + largest);
            if error.is_nan() || error > TOLERANCE {
                let message =
                    format!("the batched graph differs from the single one by {error:.1e}");
                return Err(Failure::difference(message));
            }
        }
    }
    Ok(())
}
