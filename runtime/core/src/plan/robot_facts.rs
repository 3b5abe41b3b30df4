//! A robot's facts as files, messages and other languages have them.

use std::collections::BTreeMap;
use std::ffi::CStr;
use std::format;
use std::string::{String, ToString};
use std::vec::Vec;

use serde::{Deserialize, Serialize};

use super::robot::{Fact, MAGIC, Normaliser, Robot};
use crate::checksum::crc32c;

/// What a robot must know of its policy beside the numbers; lists of which nothing is known are empty.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RobotFacts {
    /// Joints in the order of actions.
    pub joint_names: Vec<String>,
    /// Angles or lengths in which the robot stands, radians or metres.
    pub default_joint_pos: Vec<f32>,
    /// What an action is multiplied by; one number, or one for each joint.
    pub action_scale: Vec<f32>,
    /// Gains of the joints' position control, Nm/rad or N/m.
    pub stiffness: Vec<f32>,
    /// Gains of their velocity, Nms/rad or Ns/m.
    pub damping: Vec<f32>,
    /// What the observation consists of.
    pub observation_names: Vec<String>,
    /// Whether the network itself normalises what the robot observes.
    pub normaliser: Normaliser,
}

/// The names that exporters of Isaac Lab, mjlab and RSL-RL have for each list.
const WRITTEN: [(Fact, &[&str]); 6] = [
    (Fact::JointNames, &["joint_names"]),
    (Fact::DefaultJointPos, &["default_joint_pos", "default_joint_positions"]),
    (Fact::ActionScale, &["action_scale", "action_scales"]),
    (Fact::Stiffness, &["joint_stiffness", "stiffness"]),
    (Fact::Damping, &["joint_damping", "damping"]),
    (Fact::ObservationNames, &["observation_names"]),
];

impl RobotFacts {
    /// What the metadata of an exported file says: lists whose parts commas divide, in brackets and quotes or without. A list
    /// of numbers with a part that is none is left out.
    pub fn of_metadata(metadata: &BTreeMap<String, String>, normaliser: Normaliser) -> Self {
        let mut facts = Self { normaliser, ..Self::default() };
        for (fact, keys) in WRITTEN {
            let Some(text) = keys.iter().find_map(|key| metadata.get(*key)) else { continue };
            let around = |letter: char| letter.is_whitespace() || "[]()'\"".contains(letter);
            let parts = text.split(',').map(|part| part.trim_matches(around));
            let parts: Vec<&str> = parts.filter(|part| !part.is_empty()).collect();
            if let Some(names) = facts.names_mut(fact) {
                *names = parts.iter().map(ToString::to_string).collect();
            } else if let Some(numbers) = facts.numbers_mut(fact) {
                let read = parts.iter().map(|part| part.parse::<f32>().ok());
                let read = read.map(|number| number.filter(|number| number.is_finite()));
                *numbers = read.collect::<Option<_>>().unwrap_or_default();
            }
        }
        facts
    }

    /// Those of a plan's bytes, where there are any.
    pub fn of_plan(plan: &[u8]) -> Option<Self> {
        Robot::of_plan(plan).map(Self::from)
    }

    /// Writes them behind all that stands in a plan; names with a zero in them lose what is behind it.
    pub fn append_to(&self, plan: &mut Vec<u8>) {
        let mut body = Vec::from([self.normaliser as u8]);
        for fact in Fact::ALL {
            let mut list = Vec::new();
            for name in self.names(fact) {
                list.extend(name.bytes().take_while(|byte| *byte != 0).chain([0]));
            }
            list.extend(self.numbers(fact).iter().flat_map(|number| number.to_le_bytes()));
            body.extend_from_slice(&(list.len() as u32).to_le_bytes());
            body.append(&mut list);
        }
        plan.extend_from_slice(&MAGIC);
        plan.extend_from_slice(&(body.len() as u32).to_le_bytes());
        plan.extend_from_slice(&crc32c(&body).to_le_bytes());
        plan.append(&mut body);
    }

    /// The first contradiction to what somebody states, who may leave lists out; numbers are written with three decimals.
    pub fn contradiction(&self, stated: &Self) -> Option<String> {
        for (fact, keys) in WRITTEN {
            let name = keys.first().unwrap_or(&"a list");
            let (here, there) = (stated.names(fact), self.names(fact));
            if !here.is_empty() && !there.is_empty() && here != there {
                return Some(format!(
                    "{name} is {} here, {} there",
                    here.join(","),
                    there.join(",")
                ));
            }
            let (here, there) = (stated.numbers(fact), self.numbers(fact));
            if !here.is_empty() && !there.is_empty() && !are_close(here, there) {
                return Some(format!("{name} is {here:?} here, {there:?} there"));
            }
        }
        let (here, there) = (stated.normaliser, self.normaliser);
        let is_known = here != Normaliser::Unknown && there != Normaliser::Unknown;
        (is_known && here != there)
            .then(|| format!("the normaliser is {here:?} here, {there:?} there").to_lowercase())
    }

    /// The list of a fact that has names; empty for others.
    pub fn names(&self, fact: Fact) -> &[String] {
        match fact {
            Fact::JointNames => &self.joint_names,
            Fact::ObservationNames => &self.observation_names,
            _ => &[],
        }
    }

    /// The list of a fact that has numbers; empty for others.
    pub fn numbers(&self, fact: Fact) -> &[f32] {
        match fact {
            Fact::DefaultJointPos => &self.default_joint_pos,
            Fact::ActionScale => &self.action_scale,
            Fact::Stiffness => &self.stiffness,
            Fact::Damping => &self.damping,
            _ => &[],
        }
    }

    fn names_mut(&mut self, fact: Fact) -> Option<&mut Vec<String>> {
        match fact {
            Fact::JointNames => Some(&mut self.joint_names),
            Fact::ObservationNames => Some(&mut self.observation_names),
            _ => None,
        }
    }

    fn numbers_mut(&mut self, fact: Fact) -> Option<&mut Vec<f32>> {
        match fact {
            Fact::DefaultJointPos => Some(&mut self.default_joint_pos),
            Fact::ActionScale => Some(&mut self.action_scale),
            Fact::Stiffness => Some(&mut self.stiffness),
            Fact::Damping => Some(&mut self.damping),
            _ => None,
        }
    }
}

/// Whether numbers are the same to three decimals; one stands for all.
fn are_close(here: &[f32], there: &[f32]) -> bool {
    let count = here.len().max(there.len());
    let is_long = |list: &[f32]| list.len() == count || list.len() == 1;
    let pairs = here.iter().cycle().zip(there.iter().cycle()).take(count);
    let is_close =
        |(here, there): (&f32, &f32)| (here - there).abs() <= 1.0e-3 * (1.0 + there.abs());
    is_long(here) && is_long(there) && pairs.into_iter().all(is_close)
}

impl From<Robot<'_>> for RobotFacts {
    fn from(robot: Robot<'_>) -> Self {
        let mut facts = Self { normaliser: robot.normaliser(), ..Self::default() };
        let text = |name: &CStr| name.to_string_lossy().into_owned();
        for fact in Fact::ALL {
            if let Some(names) = facts.names_mut(fact) {
                *names = robot.names(fact).map(text).collect();
            } else if let Some(numbers) = facts.numbers_mut(fact) {
                *numbers = robot.numbers(fact).collect();
            }
        }
        facts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A plan that has an annex.
    const PLAN: &[u8] = include_bytes!("../../../../tests/golden/plans/policy-2.0.plan");

    fn metadata() -> BTreeMap<String, String> {
        let entries = [
            ("joint_names", "hip,knee,ankle"),
            ("default_joint_pos", "[0.0, -0.312, 0.669]"),
            ("action_scale", "0.250"),
            ("joint_stiffness", "40.000,60.000,20.000"),
            ("joint_damping", "{'.*': 2.0}"),
            ("observation_names", "['joint_pos', 'joint_vel']"),
            ("run_path", "none of a robot's"),
        ];
        entries.map(|(name, text)| (name.to_string(), text.to_string())).into()
    }

    #[test]
    fn what_exporters_write_is_read_from_the_plan() {
        let facts = RobotFacts::of_metadata(&metadata(), Normaliser::File);
        assert_eq!(facts.joint_names, ["hip", "knee", "ankle"]);
        assert_eq!(facts.default_joint_pos, [0.0, -0.312, 0.669]);
        assert_eq!((&facts.action_scale[..], &facts.damping[..]), (&[0.25][..], &[][..]));
        assert_eq!(facts.observation_names, ["joint_pos", "joint_vel"]);
        let mut plan = PLAN.to_vec();
        assert!(Robot::of_plan(&plan).is_none());
        facts.append_to(&mut plan);
        assert_eq!(RobotFacts::of_plan(&plan), Some(facts));
        let robot = Robot::of_plan(&plan).unwrap();
        assert_eq!(robot.names(Fact::JointNames).nth(1), Some(c"knee"));
        assert_eq!(robot.names(Fact::Stiffness).count(), 0);
        assert_eq!(robot.numbers(Fact::Stiffness).nth(2), Some(20.0));
        assert_eq!(robot.numbers(Fact::ObservationNames).count(), 0);
    }

    #[test]
    fn facts_that_are_cut_off_or_changed_are_none() {
        let mut plan = PLAN.to_vec();
        let end = plan.len();
        RobotFacts::of_metadata(&metadata(), Normaliser::None).append_to(&mut plan);
        for length in end..plan.len() {
            assert!(Robot::of_plan(&plan[..length]).is_none(), "{length}");
        }
        for place in end..plan.len() {
            let mut changed = plan.clone();
            changed[place] ^= 1;
            assert!(Robot::of_plan(&changed).is_none(), "{place}");
        }
    }

    #[test]
    fn what_is_stated_must_not_contradict() {
        let facts = RobotFacts::of_metadata(&metadata(), Normaliser::File);
        let stated = |change: fn(&mut RobotFacts)| {
            let mut stated = facts.clone();
            change(&mut stated);
            facts.contradiction(&stated)
        };
        assert_eq!(stated(|_| {}), None);
        assert_eq!(stated(|robot| robot.joint_names.clear()), None, "nothing is stated");
        assert_eq!(stated(|robot| robot.damping = Vec::from([1.0])), None, "nothing is known");
        assert_eq!(stated(|robot| robot.action_scale = Vec::from([0.2504; 3])), None);
        let other = stated(|robot| robot.joint_names.swap(0, 2)).unwrap();
        assert_eq!(other, "joint_names is ankle,knee,hip here, hip,knee,ankle there");
        assert!(stated(|robot| robot.stiffness[1] = 61.0).unwrap().contains("joint_stiffness"));
        assert!(stated(|robot| robot.default_joint_pos.truncate(2)).is_some());
        let other = stated(|robot| robot.normaliser = Normaliser::None).unwrap();
        assert_eq!(other, "the normaliser is none here, file there");
    }
}
