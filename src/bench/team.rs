//! The decisions of a whole team in one process, against one batched call of onnxruntime.

use sortie_bundle::{Bundle, RecordedFrame, Recording};
use sortie_compiler::TOLERANCE;
use sortie_compiler::onnxruntime::{BatchedAgents, OnnxRuntime};
use sortie_core::choose::masked_argmax;
use sortie_core::{Observation, Policy};

use super::decision::{engine, some};
use super::floor::Floor;
use super::rounds::{Pace, alternate};
use super::{FLOOR, Figures, OURS};
use crate::failure::{Failure, Outcome};

/// Agents, and entities of their frames.
pub(super) const SIZES: [(usize, usize); 2] = [(5, 11), (8, 17)];

/// What teams are measured with.
pub(super) struct Contest<'a> {
    pub(super) bundle: &'a Bundle,
    pub(super) runtime: Option<&'static OnnxRuntime>,
    pub(super) floor: &'a Floor,
    pub(super) recordings: &'a [Recording],
}

/// Measures teams of all sizes on recorded masks.
pub(super) fn measure(
    contest: &Contest<'_>,
    ours: &mut dyn Policy,
    figures: &mut Figures,
    paces: &[Pace],
    seconds: &dyn Fn(Pace) -> f64,
) -> Outcome {
    let features = contest.bundle.contract().features.into();
    let peer = contest.runtime.map(|runtime| {
        let onnx = contest.bundle.agent_onnx();
        let peer = BatchedAgents::new(runtime, onnx, features).map_err(Failure::from)?;
        Ok::<_, Failure>((peer, runtime.version()))
    });
    let mut peer = peer.transpose()?;
    for (agents, entities) in SIZES {
        let frames = frames(contest.recordings, agents, entities);
        let case = format!("{agents} agents, N = {entities}");
        if frames.is_empty() {
            eprintln!("note: no frame of `{case}` was recorded");
            continue;
        }
        if let Some((peer, _)) = &mut peer {
            check(&frames, ours, peer)?;
        }
        for pace in paces {
            let frame = |call: usize| &frames[call % frames.len()];
            let mut engines = vec![engine(OURS, env!("CARGO_PKG_VERSION"), |call| {
                one_by_one(frame(call), ours);
            })];
            if let Some((peer, version)) = &mut peer {
                let actions = usize::from(contest.bundle.contract().actions);
                let mut utilities = vec![0.0; agents * actions];
                engines.push(engine("onnxruntime", version, move |call| {
                    at_once(frame(call), peer, &mut utilities);
                }));
            }
            let floor = contest.floor;
            engines.push(engine(FLOOR, "", |_| floor.read()));
            let measured = alternate(&mut engines, *pace, seconds(*pace));
            figures.add("team", &format!("{case}, {}", pace.name()), &engines, &measured);
        }
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

/// A decision for each agent in turn.
fn one_by_one(frame: &[Observation<'_>], policy: &mut dyn Policy) {
    for observation in frame {
        let decision = policy.decide(observation);
        std::hint::black_box(decision.expect("observations of episodes can be decided on"));
    }
}

/// One call for all agents, and the choice of each.
fn at_once(frame: &[Observation<'_>], peer: &mut BatchedAgents, utilities: &mut [f32]) {
    peer.utilities(frame, utilities).expect("the batched graph takes every recorded frame");
    let actions = utilities.len() / frame.len().max(1);
    for (observation, utilities) in frame.iter().zip(utilities.chunks_exact(actions)) {
        let decision = masked_argmax(utilities, observation.available);
        std::hint::black_box(decision.expect("an action is available"));
    }
}

/// The batched graph must compute what the single one does, which our plan was proved against.
fn check(
    frames: &[Vec<Observation<'_>>],
    ours: &mut dyn Policy,
    peer: &mut BatchedAgents,
) -> Outcome {
    let actions = ours.actions();
    let mut want = vec![0.0; actions];
    for frame in frames {
        let mut got = vec![0.0; frame.len() * actions];
        peer.utilities(frame, &mut got)
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
