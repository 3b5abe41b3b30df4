//! Networks over entities, on the tape, for whatever method: agents that attend to what they see, and mixers that make the
//! value of a team from the utilities of its agents.
//!
//! An [`EntityBatch`] is any number of states, whose entities are rows. An [`EntityAgent`] says what each agent's actions are
//! worth, a [`Mixer`] what that is worth to each team:
//!
//! ```
//! # use sortie_envs::{EntitySet, Observation, Split, random::generator};
//! # use sortie_learn::networks::*;
//! # use sortie_nn::tape::{Parameters, Tape};
//! # let mut ring = sortie_envs::open("group-matching/3x6x1", Split::Train, 1, &Default::default())?;
//! # let (mut random, mut state, mut seen) = (generator(1), Vec::new(), Observation::default());
//! # ring.reset(0, &mut random);
//! # ring.save(0, &mut state);
//! let (input, actions) = (ring.spec().shape.features, ring.spec().shape.actions);
//! let looking = LookShape { input, active_inputs: 3, width: 16, heads: 4 };
//! let (mut parameters, agent) = (Parameters::default(), AgentShape { looking, actions, skip: true, memory: 0, targets: Targets::default() });
//! let agents = EntityAgent::new(&mut parameters, agent, &mut random);
//! let kind = MixerKind::Linear;
//! let mixer = MixerShape { kind, hypernetworks: Hypernetworks::Shared, weights_sum: WeightsSum::One, looking, mixing: 8 };
//! let mixer = Mixer::new(&mut parameters, mixer, &mut random);
//!
//! let mut batch = EntityBatch::default();
//! ring.observe(&state, 0, EntitySet::MAX, &mut seen);
//! batch.push(&seen);
//! batch.finish(false);
//! let mut tape = Tape::default();
//! let mut pass = tape.begin(&parameters.values);
//! let utilities = agents.utilities(&mut pass, &batch, batch.seen(), &mut []);
//! let chosen = pass.pick(utilities, &[0, 1, 0]);
//! let value = mixer.mix(&mut pass, batch.teams(), chosen).real;
//! assert_eq!(pass.size(value), [1, 1]);
//! # Ok::<(), sortie_envs::EnvironmentError>(())
//! ```
//!
//! For imagined utilities (REFIL, dissertation section 5.4) a batch is [finished](EntityBatch::finish) for that: agents
//! then have three blocks of utilities, of everything that they see, of their part of a partition, and of the rest, at the
//! price of little more than one.

mod acting;
mod agent;
mod aims;
mod attention;
mod batch;
mod deployed;
mod mixer;

pub use acting::{Acting, Greedy, best, chances, draw, drawn};
pub use agent::{AgentShape, EntityAgent};
pub use aims::{AimView, AimedHead, Aims, Targets};
pub use attention::{Attended, EntityAttention, LookShape};
pub use batch::{EntityBatch, Moment, Teams, View};
pub use deployed::{OwnPass, OwnView, deployed};
pub use mixer::{Hypernetworks, Mixed, Mixer, MixerKind, MixerShape, WeightsSum};
pub use sortie_nn::layers::split_attention::BLOCKS;

#[cfg(test)]
mod tests;
