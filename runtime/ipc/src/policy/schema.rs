//! What a served policy takes and gives, stated by its server in a file of the domain, and what is done where it does not
//! answer.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use sortie_core::identity::fnv1a;
use sortie_core::plan::{Network, Plan, RobotFacts};
use sortie_core::wire::{ABI, ServedFormat};

use crate::domain::{Domain, nanoseconds, read_file, write_file};
use crate::error::Error;

const FILE: &str = "policy.toml";
/// Most inputs, and most outputs.
pub(super) const MOST_PORTS: usize = 32;

/// An input, an output or a recurrent state.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Port {
    /// Its name; empty where the plan does not say.
    pub name: String,
    /// Its numbers.
    pub length: usize,
}

/// What a policy takes and gives.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PolicySchema {
    /// Actions U among which it chooses; 0 where its outputs are the action.
    pub actions: usize,
    /// Inputs, in the plan's order.
    pub inputs: Vec<Port>,
    /// Outputs, in the plan's order; the first is the scores of actions, where it chooses.
    pub outputs: Vec<Port>,
    /// Recurrent states, which the server keeps.
    #[serde(default)]
    pub states: Vec<Port>,
    /// What a robot must know of the policy beside the numbers, as far as its plan says.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<RobotFacts>,
}

/// What a robot's program gives and wants: names with lengths. An empty name fits any.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Expected<'a> {
    /// Inputs.
    pub inputs: &'a [(&'a str, usize)],
    /// Outputs.
    pub outputs: &'a [(&'a str, usize)],
    /// Actions U among which the policy chooses; 0 = it does not choose.
    pub actions: usize,
}

impl PolicySchema {
    /// What a plan takes and gives, without names.
    ///
    /// # Errors
    /// It is no policy's, has no outputs, or has more inputs or outputs than a server takes.
    pub fn of_plan(plan: &Plan<'_>) -> Result<Self, Error> {
        let bad = |problem: String| Error::NotServed { problem };
        plan.check_network(Network::Policy).map_err(|error| bad(error.to_string()))?;
        let port = |length: usize| Port { name: String::new(), length };
        let inputs: Vec<Port> = plan.inputs().map(port).collect();
        let outputs: Vec<Port> = plan.outputs().map(port).collect();
        let states = plan.states().map(port).collect();
        for (what, count) in [("inputs", inputs.len()), ("outputs", outputs.len())] {
            if count == 0 || count > MOST_PORTS {
                return Err(bad(format!("it has {count} {what}, from 1 to {MOST_PORTS} are")));
            }
        }
        // A choice is made of the first output's scores.
        let scores = outputs.first().map_or(0, |output| output.length);
        let chooses = plan.chooses() && scores == plan.actions();
        Ok(Self { actions: if chooses { scores } else { 0 }, inputs, outputs, states, robot: None })
    }

    /// The same with names, where there are as many as ports.
    pub fn named<'a>(
        mut self,
        inputs: impl IntoIterator<Item = &'a str>,
        outputs: impl IntoIterator<Item = &'a str>,
        states: impl IntoIterator<Item = &'a str>,
    ) -> Self {
        name(&mut self.inputs, inputs);
        name(&mut self.outputs, outputs);
        name(&mut self.states, states);
        self
    }

    /// The same without names and whatever a plan's program does not say.
    pub(super) fn unnamed(mut self) -> Self {
        self.robot = None;
        let ports = [&mut self.inputs, &mut self.outputs, &mut self.states];
        ports.into_iter().flatten().for_each(|port| port.name.clear());
        self
    }

    /// Checks that a fallback action is one.
    pub(super) fn check_fallback(&self, fallback: Fallback) -> Result<(), Error> {
        let problem = match (fallback, self.actions) {
            (Fallback::Action(_), 0) => {
                "it does not choose among actions: its fallback is `hold` or `zero`".to_owned()
            }
            (Fallback::Action(action), actions) if usize::from(action) >= actions => {
                format!("its actions are 0 to {}, the fallback is {action}", actions - 1)
            }
            _ => return Ok(()),
        };
        Err(Error::NotServed { problem })
    }

    /// Checks that there is something to draw where that is asked for.
    pub(super) fn check_draw(&self, seed: Option<u64>) -> Result<(), Error> {
        if seed.is_some() && self.actions == 0 {
            let problem = "it does not choose among actions: there is none to draw".to_owned();
            return Err(Error::NotServed { problem });
        }
        Ok(())
    }

    /// FNV-1a over all lengths and names: each list as its count, then length, length of the name and name of each
    /// port, and at last the actions; numbers as little-endian `u32`.
    pub fn hash(&self) -> u64 {
        let mut bytes = Vec::new();
        let number = |bytes: &mut Vec<u8>, number: usize| {
            bytes.extend_from_slice(&(number as u32).to_le_bytes());
        };
        for ports in [&self.inputs, &self.outputs, &self.states] {
            number(&mut bytes, ports.len());
            for Port { name, length } in ports {
                number(&mut bytes, *length);
                number(&mut bytes, name.len());
                bytes.extend_from_slice(name.as_bytes());
            }
        }
        number(&mut bytes, self.actions);
        fnv1a(&bytes)
    }

    /// Its messages.
    ///
    /// # Errors
    /// They would be too long.
    pub fn format(&self) -> Result<ServedFormat, Error> {
        let sum = |ports: &[Port]| {
            ports.iter().fold(0_usize, |sum, port| sum.saturating_add(port.length))
        };
        let (inputs, outputs) = (sum(&self.inputs), sum(&self.outputs));
        ServedFormat::new(self.hash(), inputs, outputs, self.actions).map_err(|_| {
            let problem = format!(
                "messages take less than 1 MiB and 256 actions, not {inputs} inputs, {outputs} outputs and {} actions",
                self.actions
            );
            Error::NotServed { problem }
        })
    }

    /// Checks that the policy of `domain`, which this is of, is the one that somebody expects.
    ///
    /// # Errors
    /// [`Error::OtherPolicy`] with the first difference.
    pub fn check(&self, domain: &Domain, expected: &Expected<'_>) -> Result<(), Error> {
        self.difference(expected).map_or(Ok(()), |detail| Err(other(domain, detail)))
    }

    /// Checks what a robot's program states of its robot: joints, gains and whatever else the plan knows too.
    ///
    /// # Errors
    /// [`Error::OtherPolicy`] with the first contradiction.
    pub fn check_robot(&self, domain: &Domain, stated: &RobotFacts) -> Result<(), Error> {
        let found = self.robot.as_ref().and_then(|robot| robot.contradiction(stated));
        found.map_or(Ok(()), |detail| Err(other(domain, detail)))
    }

    /// The first difference from what somebody expects.
    fn difference(&self, expected: &Expected<'_>) -> Option<String> {
        let lists =
            [("input", expected.inputs, &self.inputs), ("output", expected.outputs, &self.outputs)];
        let mut found =
            lists.into_iter().filter_map(|(what, here, there)| first_difference(what, here, there));
        found.next().or_else(|| {
            let (here, there) = (expected.actions, self.actions);
            (here != there).then(|| format!("actions are {here} here, {there} there"))
        })
    }
}

fn name<'a>(ports: &mut [Port], names: impl IntoIterator<Item = &'a str>) {
    let names: Vec<&str> = names.into_iter().collect();
    if names.len() == ports.len() {
        for (port, name) in ports.iter_mut().zip(names) {
            port.name = name.to_owned();
        }
    }
}

fn first_difference(what: &str, here: &[(&str, usize)], there: &[Port]) -> Option<String> {
    if here.len() != there.len() {
        return Some(format!("{} {what}s here, {} there", here.len(), there.len()));
    }
    let mut pairs = here.iter().zip(there).enumerate();
    pairs.find_map(|(index, ((name, length), port))| {
        let is_named = !name.is_empty() && !port.name.is_empty();
        let differs = *length != port.length || (is_named && *name != port.name);
        differs.then(|| {
            let Port { name: its_name, length: its_length } = port;
            format!("{what} {index} is `{name}` [{length}] here, `{its_name}` [{its_length}] there")
        })
    })
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ServedFacts {
    abi: u16,
    deadline_ns: u64,
    pub(crate) fallback: Fallback,
    pub(crate) schema: PolicySchema,
}

impl ServedFacts {
    pub(super) fn new(schema: PolicySchema, deadline: Duration, fallback: Fallback) -> Self {
        // TOML has no unsigned 64-bit numbers; its largest is 292 years.
        let deadline_ns = nanoseconds(deadline).min(i64::MAX as u64);
        Self { abi: ABI, deadline_ns, fallback, schema }
    }

    pub(crate) fn deadline(&self) -> Duration {
        Duration::from_nanos(self.deadline_ns)
    }

    pub(super) fn write(&self, domain: &Domain) -> Result<(), Error> {
        write_file(domain, FILE, self)
    }

    pub(crate) fn read(domain: &Domain) -> Result<Option<Self>, Error> {
        read_file(domain, FILE)
    }

    /// Checks that a client fits; one that expects nothing in particular fits every policy of its ABI.
    ///
    /// # Errors
    /// [`Error::OtherPolicy`] with the first difference.
    pub(crate) fn check(
        &self,
        domain: &Domain,
        expected: Option<&Expected<'_>>,
    ) -> Result<(), Error> {
        let abi = self.abi;
        if abi != ABI {
            return Err(other(domain, format!("messages are of ABI {ABI} here, {abi} there")));
        }
        expected.map_or(Ok(()), |expected| self.schema.check(domain, expected))
    }
}

fn other(domain: &Domain, detail: String) -> Error {
    Error::OtherPolicy { domain: domain.id().to_string(), detail }
}

/// What is done where the policy does not answer, or not in time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub enum Fallback {
    /// The last outputs and the last action once more; zeros before the first.
    #[default]
    Hold,
    /// Outputs of zeros, action 0.
    Zero,
    /// This action, and outputs of zeros.
    Action(u16),
}

impl Fallback {
    /// Replaces the last outputs; returns the action. One that is not available gives way to the first that is;
    /// `None` where none is, or the policy does not choose.
    pub(super) fn apply(
        self,
        outputs: &mut [f32],
        last: Option<u16>,
        available: &[u16],
    ) -> Option<u16> {
        let wanted = match self {
            Self::Hold => last,
            Self::Zero => Some(0),
            Self::Action(action) => Some(action),
        };
        if self != Self::Hold {
            outputs.fill(0.0);
        }
        let is_available = |action: &u16| available.get(usize::from(*action)) > Some(&0);
        let first = || (0..).zip(available).find(|(_, code)| **code != 0).map(|(action, _)| action);
        wanted.filter(is_available).or_else(first)
    }
}

impl fmt::Display for Fallback {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Hold => f.write_str("hold"),
            Self::Zero => f.write_str("zero"),
            Self::Action(action) => write!(f, "{action}"),
        }
    }
}

impl FromStr for Fallback {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "hold" => Ok(Self::Hold),
            "zero" => Ok(Self::Zero),
            number => number
                .parse()
                .map(Self::Action)
                .map_err(|_| "expected `hold`, `zero`, or the number of an action"),
        }
    }
}

impl From<Fallback> for String {
    fn from(fallback: Fallback) -> Self {
        fallback.to_string()
    }
}

impl TryFrom<String> for Fallback {
    type Error = &'static str;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn schema() -> PolicySchema {
        let port = |name: &str, length| Port { name: name.to_owned(), length };
        PolicySchema {
            actions: 0,
            inputs: vec![port("joints", 12), port("", 3)],
            outputs: vec![port("torques", 12)],
            states: vec![port("h", 64)],
            robot: None,
        }
    }

    #[test]
    fn the_first_difference_is_named() {
        let expected = Expected {
            inputs: &[("joints", 12), ("gravity", 3)],
            outputs: &[("", 12)],
            actions: 0,
        };
        assert_eq!(schema().difference(&expected), None);
        let differs = |expected: Expected<'_>| schema().difference(&expected).unwrap_or_default();
        assert_eq!(
            differs(Expected { inputs: &[("joints", 12)], ..expected }),
            "1 inputs here, 2 there"
        );
        assert_eq!(
            differs(Expected { inputs: &[("joints", 12), ("gravity", 4)], ..expected }),
            "input 1 is `gravity` [4] here, `` [3] there"
        );
        assert_eq!(
            differs(Expected { outputs: &[("forces", 12)], ..expected }),
            "output 0 is `forces` [12] here, `torques` [12] there"
        );
        assert_eq!(differs(Expected { actions: 5, ..expected }), "actions are 5 here, 0 there");
    }

    #[test]
    fn every_length_and_name_changes_the_hash() {
        let changes: [fn(&mut PolicySchema); 6] = [
            |schema| schema.actions = 12,
            |schema| schema.inputs[0].length = 13,
            |schema| schema.inputs[1].name.push('x'),
            |schema| schema.outputs[0].name.clear(),
            |schema| schema.states[0].length = 65,
            |schema| schema.states.clear(),
        ];
        for (index, change) in changes.into_iter().enumerate() {
            let mut other = schema();
            change(&mut other);
            assert_ne!(other.hash(), schema().hash(), "{index}");
        }
    }

    #[test]
    fn what_a_server_states_is_read_again() {
        let domain = Domain::new(&format!("stated-{}", std::process::id())).unwrap();
        let _member = domain.enter().unwrap();
        assert_eq!(ServedFacts::read(&domain).unwrap(), None);
        let facts = ServedFacts::new(schema(), Duration::from_millis(2), Fallback::Action(3));
        facts.write(&domain).unwrap();
        assert_eq!(ServedFacts::read(&domain).unwrap(), Some(facts));
    }

    #[test]
    fn a_fallback_is_available_or_gives_way() {
        let apply = |fallback: Fallback, last, available: &[u16]| {
            let mut outputs = [1.0, 2.0];
            (fallback.apply(&mut outputs, last, available), outputs)
        };
        let (held, zeros) = ([1.0, 2.0], [0.0; 2]);
        assert_eq!(apply(Fallback::Hold, Some(2), &[1, 1, 1]), (Some(2), held));
        assert_eq!(apply(Fallback::Hold, Some(2), &[0, 1, 0]), (Some(1), held));
        assert_eq!(apply(Fallback::Hold, None, &[0, 1, 1]), (Some(1), held));
        assert_eq!(apply(Fallback::Zero, Some(2), &[1, 1, 1]), (Some(0), zeros));
        assert_eq!(apply(Fallback::Action(1), Some(2), &[1, 1, 1]), (Some(1), zeros));
        assert_eq!(apply(Fallback::Action(9), Some(2), &[0, 0, 1]), (Some(2), zeros));
        assert_eq!(apply(Fallback::Action(1), None, &[0, 0]), (None, zeros));
        assert_eq!(apply(Fallback::Hold, None, &[]), (None, held));
    }

    #[test]
    fn a_fallback_is_read_as_it_is_written() {
        for fallback in [Fallback::Hold, Fallback::Zero, Fallback::Action(3)] {
            assert_eq!(fallback.to_string().parse(), Ok(fallback));
        }
        for text in ["", "still", "-1", "70000"] {
            assert!(text.parse::<Fallback>().is_err(), "{text}");
        }
    }
}
