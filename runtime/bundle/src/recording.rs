//! Recorded observations: what the agents of a team saw, frame by frame, as one file.
//!
//! Evaluations write them (`sortie eval --dump`), benchmarks and quantisation read them. The format is
//! little-endian:
//!
//! | bytes | field |
//! | --- | --- |
//! | 0 to 7 | magic `SORTIEOB` |
//! | 8 to 9, 10 to 11 | version, 1; zero |
//! | 12 to 15 | CRC-32C of all bytes from 16 on |
//! | 16 to 23 | contract hash |
//! | 24 to 27, 28 to 31 | features d, actions U |
//! | 32 to 35, 36 to 39 | number of frames; zero |
//! | from 40 on | the frames |
//!
//! A frame: entities N, agents A, observations B and a zero, each u16; rows f32 `[N, d]`; last actions u16 `[A]`,
//! 0xFFFF where there was none; then for each observation its own row u16, availability u16 `[U]` and the mask
//! of visible entities, two u64, entity 0 in the lowest bit of the first.

use sortie_core::internal::checksum::crc32c;
use sortie_core::{EntityMask, NO_ACTION, Observation, limits};

const MAGIC: &[u8; 8] = b"SORTIEOB";
const VERSION: u16 = 1;
/// First byte that the checksum covers.
const CHECKED_FROM: usize = 16;

/// Why a file of observations cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// The file is something else.
    #[error("these are no recorded observations: `sortie eval BUNDLE --dump FILE` writes them")]
    BadMagic,
    /// The file was written by a newer program.
    #[error("recorded observations of version {got}, this program reads {VERSION}: update sortie")]
    Version {
        /// Its version.
        got: u16,
    },
    /// The file ends too early, or goes on after its last frame.
    #[error("the file was cut off, or something was appended: record the observations again")]
    Truncated,
    /// The content is not what was written.
    #[error("the file was damaged, its checksum differs: record the observations again")]
    Checksum,
    /// A frame contradicts itself or the limits of this program.
    #[error("frame {frame}: {reason}")]
    Invalid {
        /// Number of the frame, from 0.
        frame: usize,
        /// What is wrong.
        reason: &'static str,
    },
}

/// Observations of one policy.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// Hash of the contract that the policy was trained for.
    pub contract: u64,
    /// Features d of an entity.
    pub features: usize,
    /// Actions U.
    pub actions: usize,
    /// The frames, in order.
    pub frames: Vec<RecordedFrame>,
}

/// What all agents of a team saw in one step; they share the rows.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedFrame {
    /// Features `[N, d]`.
    pub rows: Vec<f32>,
    /// Last action `[A]` of every agent, [`NO_ACTION`] where there was none.
    pub last_actions: Vec<u16>,
    /// The agents that decided.
    pub agents: Vec<RecordedAgent>,
}

/// What differs from agent to agent.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedAgent {
    /// Its own row.
    pub self_index: usize,
    /// The entities that it may attend to.
    pub visible: EntityMask,
    /// Availability mask `[U]`: 0 = not available.
    pub available: Vec<u16>,
}

impl Recording {
    /// A recording without frames.
    pub fn new(contract: u64, features: usize, actions: usize) -> Self {
        Self { contract, features, actions, frames: Vec::new() }
    }

    /// Adds what the next agent sees: to the last frame where it has the same rows and stands further down.
    pub fn add(&mut self, observation: &Observation<'_>) {
        let rows = observation.rows.chunks(observation.stride.max(1));
        let rows = rows.flat_map(|row| row.iter().take(self.features)).copied();
        let agent = RecordedAgent {
            self_index: observation.self_index,
            visible: observation.visible,
            available: observation.available.to_vec(),
        };
        if let Some(frame) = self.frames.last_mut()
            && frame.agents.last().is_some_and(|last| last.self_index < agent.self_index)
            && frame.last_actions == observation.last_actions
            && frame.rows.iter().map(|value| value.to_bits()).eq(rows.clone().map(f32::to_bits))
        {
            frame.agents.push(agent);
            return;
        }
        let last_actions = observation.last_actions.to_vec();
        self.frames.push(RecordedFrame { rows: rows.collect(), last_actions, agents: vec![agent] });
    }

    /// What every agent saw, in the order of recording.
    pub fn observations(&self) -> impl Iterator<Item = Observation<'_>> {
        self.frames.iter().flat_map(|frame| frame.observations(self.features))
    }

    /// One of `every` frames, from the first on, and all others.
    pub fn split(&self, every: usize) -> [Self; 2] {
        let mut parts = [(); 2].map(|()| Self::new(self.contract, self.features, self.actions));
        for (number, frame) in self.frames.iter().enumerate() {
            let [chosen, others] = &mut parts;
            let part = if number % every.max(1) == 0 { chosen } else { others };
            part.frames.push(frame.clone());
        }
        parts
    }

    /// The file.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut body = Vec::new();
        body.extend(self.contract.to_le_bytes());
        for size in [self.features, self.actions, self.frames.len(), 0] {
            body.extend((size as u32).to_le_bytes());
        }
        self.frames.iter().for_each(|frame| frame.write(self.features, &mut body));
        let mut bytes = MAGIC.to_vec();
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend([0; 2]);
        bytes.extend(crc32c(&body).to_le_bytes());
        bytes.extend(body);
        bytes
    }

    /// Reads a file and checks all of it.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, RecordingError> {
        let mut from = Reader(bytes);
        if from.take(8) != Some(MAGIC) {
            return Err(RecordingError::BadMagic);
        }
        let version = from.number::<2>()? as u16;
        if version != VERSION {
            return Err(RecordingError::Version { got: version });
        }
        from.number::<2>()?;
        let checksum = from.number::<4>()?;
        if bytes.get(CHECKED_FROM..).map(crc32c).map(u64::from) != Some(checksum) {
            return Err(RecordingError::Checksum);
        }
        let contract = from.number::<8>()?;
        let [features, actions, frames] =
            [from.number::<4>()?, from.number::<4>()?, from.number::<4>()?].map(|n| n as usize);
        from.number::<4>()?;
        if features > limits::FEATURES || actions > limits::ACTIONS {
            let reason = "the header has more features or actions than this program handles";
            return Err(RecordingError::Invalid { frame: 0, reason });
        }
        let mut recording = Self::new(contract, features, actions);
        for number in 0..frames {
            let frame = RecordedFrame::read(&mut from, features, actions)?;
            if let Some(reason) = frame.flaw(features, actions) {
                return Err(RecordingError::Invalid { frame: number, reason });
            }
            recording.frames.push(frame);
        }
        if from.0.is_empty() { Ok(recording) } else { Err(RecordingError::Truncated) }
    }
}

impl RecordedFrame {
    /// Number of entity rows N.
    pub fn entities(&self, features: usize) -> usize {
        self.rows.len().checked_div(features).unwrap_or(0)
    }

    /// What every agent saw.
    pub fn observations(&self, features: usize) -> impl Iterator<Item = Observation<'_>> {
        self.agents.iter().map(move |agent| Observation {
            rows: &self.rows,
            stride: features,
            last_actions: &self.last_actions,
            visible: agent.visible,
            self_index: agent.self_index,
            available: &agent.available,
        })
    }

    fn write(&self, features: usize, to: &mut Vec<u8>) {
        let sizes = [self.entities(features), self.last_actions.len(), self.agents.len(), 0];
        sizes.iter().for_each(|size| to.extend((*size as u16).to_le_bytes()));
        self.rows.iter().for_each(|value| to.extend(value.to_le_bytes()));
        self.last_actions.iter().for_each(|action| to.extend(action.to_le_bytes()));
        for agent in &self.agents {
            to.extend((agent.self_index as u16).to_le_bytes());
            agent.available.iter().for_each(|code| to.extend(code.to_le_bytes()));
            agent.visible.words().iter().for_each(|word| to.extend(word.to_le_bytes()));
        }
    }

    fn read(
        from: &mut Reader<'_>,
        features: usize,
        actions: usize,
    ) -> Result<Self, RecordingError> {
        let [entities, agents, observations] =
            [from.number::<2>()?, from.number::<2>()?, from.number::<2>()?].map(|n| n as usize);
        from.number::<2>()?;
        let rows = from.list::<4>(entities * features)?;
        let rows = rows.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
        let shorts = |bytes: &[[u8; 2]]| bytes.iter().map(|two| u16::from_le_bytes(*two)).collect();
        let last_actions = shorts(from.list::<2>(agents)?);
        let mut frame = Self { rows, last_actions, agents: Vec::new() };
        for _ in 0..observations {
            let self_index = from.number::<2>()? as usize;
            let available = shorts(from.list::<2>(actions)?);
            let words = from.list::<8>(EntityMask::EMPTY.words().len())?;
            let words: Vec<u64> = words.iter().map(|bytes| u64::from_le_bytes(*bytes)).collect();
            let visible = EntityMask::from_words(&words);
            frame.agents.push(RecordedAgent { self_index, visible, available });
        }
        Ok(frame)
    }

    /// The first thing that contradicts itself.
    fn flaw(&self, features: usize, actions: usize) -> Option<&'static str> {
        let entities = self.entities(features);
        let every = EntityMask::first(entities);
        let unknown = |action: &u16| *action != NO_ACTION && usize::from(*action) >= actions;
        if entities > limits::ENTITIES {
            Some("it has more entities than this program handles")
        } else if self.last_actions.len() > entities || self.last_actions.iter().any(unknown) {
            Some("a last action, or its agent, does not exist")
        } else if self.agents.iter().any(|agent| agent.self_index >= entities) {
            Some("an agent's own row does not exist")
        } else if self.agents.iter().any(|agent| agent.visible.and(&every) != agent.visible) {
            Some("an agent sees a row that does not exist")
        } else {
            None
        }
    }
}

/// Reads from the front of what is left.
struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, bytes: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(bytes)?;
        self.0 = rest;
        Some(taken)
    }

    /// `count` values of `SIZE` bytes each.
    fn list<const SIZE: usize>(
        &mut self,
        count: usize,
    ) -> Result<&'a [[u8; SIZE]], RecordingError> {
        let bytes = count.checked_mul(SIZE).and_then(|bytes| self.take(bytes));
        Ok(bytes.ok_or(RecordingError::Truncated)?.as_chunks().0)
    }

    /// A number of `SIZE` bytes, at most eight.
    fn number<const SIZE: usize>(&mut self) -> Result<u64, RecordingError> {
        let bytes = self.list::<SIZE>(1)?.as_flattened();
        Ok(bytes.iter().rev().fold(0, |number, byte| number << 8 | u64::from(*byte)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recording() -> Recording {
        let mut recording = Recording::new(0x0123_4567_89ab_cdef, 3, 2);
        for step in 0..4_u16 {
            let rows: Vec<f32> = (0..12).map(|index| f32::from(step) + index as f32).collect();
            for self_index in 0..2 {
                recording.add(&Observation {
                    rows: &rows,
                    stride: 4,
                    last_actions: &[NO_ACTION, 1],
                    visible: EntityMask::first(self_index + 1),
                    self_index,
                    available: &[1, step],
                });
            }
        }
        recording
    }

    #[test]
    fn a_header_that_says_more_than_can_be_handled_is_refused() {
        let read = |features: usize, actions: usize| {
            Recording::from_bytes(&Recording::new(1, features, actions).to_bytes())
        };
        assert!(read(limits::FEATURES, limits::ACTIONS).is_ok());
        for (features, actions) in [(limits::FEATURES + 1, 1), (1, limits::ACTIONS + 1)] {
            let refused = read(features, actions);
            assert!(
                matches!(refused, Err(RecordingError::Invalid { frame: 0, .. })),
                "{refused:?}"
            );
        }
    }

    #[test]
    fn agents_of_one_step_share_a_frame_without_the_unused_columns() {
        let recording = recording();
        assert_eq!(recording.frames.len(), 4);
        assert_eq!(recording.frames[0].rows, [0.0, 1.0, 2.0, 4.0, 5.0, 6.0, 8.0, 9.0, 10.0]);
        assert_eq!(recording.observations().count(), 8);
        assert!(recording.observations().all(|seen| seen.stride == 3));
    }

    #[test]
    fn parts_of_a_recording_share_no_frame() {
        let recording = recording();
        let [chosen, others] = recording.split(3);
        let frames = |numbers: [usize; 2]| numbers.map(|number| recording.frames[number].clone());
        assert_eq!([chosen.frames.as_slice(), &others.frames], [frames([0, 3]), frames([1, 2])]);
        assert_eq!((chosen.contract, others.actions), (recording.contract, recording.actions));
    }

    #[test]
    fn comes_back_as_it_was() {
        let recording = recording();
        assert_eq!(Recording::from_bytes(&recording.to_bytes()), Ok(recording));
    }

    #[test]
    fn every_damaged_byte_and_every_cut_is_noticed() {
        let bytes = recording().to_bytes();
        for place in (0..bytes.len()).filter(|place| !(10..12).contains(place)) {
            let mut damaged = bytes.clone();
            damaged[place] ^= 0x10;
            assert!(Recording::from_bytes(&damaged).is_err(), "byte {place}");
            assert!(Recording::from_bytes(&bytes[..place]).is_err(), "cut at {place}");
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        let read = |change: &dyn Fn(&mut Recording)| {
            let mut recording = recording();
            change(&mut recording);
            Recording::from_bytes(&recording.to_bytes()).unwrap_err()
        };
        let reason = |error: RecordingError| match error {
            RecordingError::Invalid { frame, reason } => (frame, reason),
            other => panic!("{other}"),
        };
        let error = read(&|recording| recording.frames[1].agents[0].self_index = 3);
        assert_eq!(reason(error), (1, "an agent's own row does not exist"));
        let error = read(&|r| r.frames[2].agents[1].visible = EntityMask::first(4));
        assert_eq!(reason(error), (2, "an agent sees a row that does not exist"));
        let error = read(&|recording| recording.frames[0].last_actions[1] = 2);
        assert_eq!(reason(error), (0, "a last action, or its agent, does not exist"));
        assert_eq!(Recording::from_bytes(b"something else"), Err(RecordingError::BadMagic));
        let mut newer = recording().to_bytes();
        newer[8] = 2;
        assert_eq!(Recording::from_bytes(&newer), Err(RecordingError::Version { got: 2 }));
    }
}
