//! What a robot must know of its policy beside the numbers: the order of its joints, and what turns actions into targets.
//!
//! It stands behind the annex of a plan, written where the plan is made, and is read where it stands: nothing is copied.

use core::ffi::CStr;

use super::sections::Sections;
use crate::checksum::crc32c;

pub(super) const MAGIC: [u8; 8] = *b"SORTIERO";

/// A list that is known of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fact {
    /// Joints in the order of actions, names.
    JointNames,
    /// Angles or lengths in which the robot stands, radians or metres.
    DefaultJointPos,
    /// What an action is multiplied by; one number, or one for each joint.
    ActionScale,
    /// Gains of the joints' position control, Nm/rad or N/m.
    Stiffness,
    /// Gains of their velocity, Nms/rad or Ns/m.
    Damping,
    /// What the observation consists of, names.
    ObservationNames,
}

impl Fact {
    /// All, in the order in which they stand in a plan.
    pub const ALL: [Self; 6] = [
        Self::JointNames,
        Self::DefaultJointPos,
        Self::ActionScale,
        Self::Stiffness,
        Self::Damping,
        Self::ObservationNames,
    ];
}

/// Whether the network itself normalises what the robot observes by the means and deviations of its training.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "std", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "std", serde(rename_all = "lowercase"))]
pub enum Normaliser {
    /// The plan does not say.
    #[default]
    Unknown,
    /// It does not: whoever calls it normalises, if it was trained so.
    None,
    /// It does.
    File,
}

/// The facts of a robot that stand in a plan.
#[derive(Clone, Copy, Debug)]
pub struct Robot<'p> {
    body: &'p [u8],
}

impl<'p> Robot<'p> {
    /// Those of a plan's bytes; none where there are none, or where they are damaged.
    pub fn of_plan(plan: &'p [u8]) -> Option<Self> {
        let section = Sections::of_plan(plan).ok()?.find(|section| section.magic == MAGIC)?;
        (crc32c(section.body) == section.checksum).then_some(Self { body: section.body })
    }

    /// Whether the network normalises what it sees.
    pub fn normaliser(&self) -> Normaliser {
        match self.body.first() {
            Some(1) => Normaliser::None,
            Some(2) => Normaliser::File,
            _ => Normaliser::Unknown,
        }
    }

    /// The names of a list of names; of numbers none.
    pub fn names(&self, fact: Fact) -> impl Iterator<Item = &'p CStr> + use<'p> {
        let is_of_names = matches!(fact, Fact::JointNames | Fact::ObservationNames);
        let list: &'p [u8] = if is_of_names { self.list(fact) } else { &[] };
        list.split_inclusive(|byte| *byte == 0)
            .filter_map(|name| CStr::from_bytes_with_nul(name).ok())
    }

    /// The numbers of a list of numbers; of names none.
    pub fn numbers(&self, fact: Fact) -> impl Iterator<Item = f32> + use<'p> {
        let is_of_names = matches!(fact, Fact::JointNames | Fact::ObservationNames);
        let list: &'p [u8] = if is_of_names { &[] } else { self.list(fact) };
        list.as_chunks::<4>().0.iter().map(|number| f32::from_le_bytes(*number))
    }

    fn list(&self, fact: Fact) -> &'p [u8] {
        let mut rest = self.body.get(1..).unwrap_or_default();
        for other in Fact::ALL {
            let Some((length, behind)) = rest.split_first_chunk() else { return &[] };
            let length = u32::from_le_bytes(*length) as usize;
            let Some((list, behind)) = behind.split_at_checked(length) else { return &[] };
            if other == fact {
                return list;
            }
            rest = behind;
        }
        &[]
    }
}
