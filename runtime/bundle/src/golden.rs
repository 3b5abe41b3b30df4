//! `golden.json`: observations with the answers that every engine must give.
//!
//! Rows are written sparsely and by feature name, so that a person can read what an agent saw:
//! `{"x": 0.25, "health": 1}`. Features that are not named are 0. Bundles with an allocator add allocation
//! states, see [`GoldenAllocation`].

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use sortie_core::{EntityMask, NO_ACTION, Observation};

use crate::allocation::{AllocationCase, GoldenAllocation};
use crate::contract::ContractV1;

/// Fewest cases of a bundle.
pub const MIN_CASES: usize = 64;
/// Fewest allocation states of a bundle with an allocator.
pub const MIN_ALLOCATIONS: usize = 16;

const FORMAT: &str = "sortie-golden-1";

/// The golden observations of a bundle.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Golden {
    /// The cases, at least [`MIN_CASES`] in a bundle.
    pub cases: Vec<GoldenCase>,
    /// What the allocator must answer, at least [`MIN_ALLOCATIONS`] in a bundle that has one.
    pub allocations: Vec<GoldenAllocation>,
    /// Whole episodes of an agent that runs options.
    pub episodes: Vec<GoldenEpisode>,
}

/// A whole episode of an agent that runs options.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GoldenEpisode {
    /// Its ticks, in order.
    pub ticks: Vec<GoldenTick>,
}

/// What such an agent saw and did in a tick.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GoldenTick {
    /// The features that are 1.
    pub ones: Vec<u16>,
    /// Other features that are not 0, and what they are.
    pub others: Vec<(u16, f32)>,
    /// The milestone that it went for.
    pub goal: u16,
    /// Whether it chose that in this tick.
    pub chose: bool,
    /// What it did.
    pub action: u16,
}

impl GoldenTick {
    /// A row as a tick keeps it: what is 1, and what is something else than 0.
    pub fn sparse(row: &[f32]) -> (Vec<u16>, Vec<(u16, f32)>) {
        let lit = (0..).zip(row.iter().copied()).filter(|(_, value)| *value != 0.0);
        let (ones, others): (Vec<_>, Vec<_>) = lit.partition(|(_, value)| *value == 1.0);
        (ones.into_iter().map(|(column, _)| column).collect(), others)
    }

    /// The row, of so many features.
    ///
    /// # Errors
    /// It has other features.
    pub fn row(&self, features: usize) -> Result<Vec<f32>, String> {
        let mut row = vec![0.0; features];
        let ones = self.ones.iter().map(|column| (*column, 1.0));
        for (column, value) in ones.chain(self.others.iter().copied()) {
            let to = row.get_mut(usize::from(column));
            *to.ok_or_else(|| format!("there is no feature {column}"))? = value;
        }
        Ok(row)
    }
}

/// One observation and its expected answer.
#[derive(Clone, Debug, PartialEq)]
pub struct GoldenCase {
    /// What the agent saw.
    pub observation: OwnedObservation,
    /// Expected utilities `[U]`.
    pub utilities: Vec<f32>,
    /// Expected greedy action.
    pub action: u16,
}

#[derive(Serialize, Deserialize)]
struct File {
    format: String,
    cases: Vec<Case>,
    #[serde(default)]
    allocations: Vec<AllocationCase>,
    #[serde(default)]
    episodes: Vec<Vec<GoldenTick>>,
}

#[derive(Serialize, Deserialize)]
struct Case {
    entities: Vec<BTreeMap<String, f32>>,
    last_actions: Vec<Option<u16>>,
    visible: Vec<usize>,
    #[serde(rename = "self")]
    self_index: usize,
    available: Vec<u16>,
    utilities: Vec<f32>,
    action: u16,
}

impl Golden {
    /// Writes the cases as JSON, one case a line.
    pub fn to_json(&self, contract: &ContractV1) -> Result<Vec<u8>, serde_json::Error> {
        let cases = self.cases.iter().map(|case| Case::from_case(case, contract));
        let mut text = format!("{{\"format\":\"{FORMAT}\",\"cases\":[\n");
        text += &lines(cases)?;
        if !self.allocations.is_empty() {
            let allocations = self.allocations.iter();
            text += "],\"allocations\":[\n";
            text += &lines(allocations.map(|case| AllocationCase::from_case(case, contract)))?;
        }
        if !self.episodes.is_empty() {
            let episodes: Vec<String> =
                self.episodes.iter().map(|it| lines(it.ticks.iter())).collect::<Result<_, _>>()?;
            text += &format!("],\"episodes\":[[\n{}]", episodes.join("],[\n"));
        }
        Ok((text + "]}\n").into_bytes())
    }

    /// Reads cases and checks them against the contract; the error says what is wrong.
    pub fn from_json(json: &[u8], contract: &ContractV1) -> Result<Self, String> {
        let file: File = serde_json::from_slice(json).map_err(|error| error.to_string())?;
        if file.format != FORMAT {
            return Err(format!("format `{}`, want `{FORMAT}`", file.format));
        }
        let cases = file.cases.into_iter().enumerate().map(|(index, case)| {
            case.into_case(contract).map_err(|reason| format!("case {index}: {reason}"))
        });
        let allocations = file.allocations.into_iter().enumerate().map(|(index, case)| {
            case.into_case(contract).map_err(|reason| format!("allocation {index}: {reason}"))
        });
        let episode = |(index, ticks): (usize, Vec<GoldenTick>)| {
            let wrong = |tick: &GoldenTick| tick.row(contract.features.into()).err();
            match ticks.iter().find_map(wrong) {
                Some(reason) => Err(format!("episode {index}: {reason}")),
                None => Ok(GoldenEpisode { ticks }),
            }
        };
        let episodes = file.episodes.into_iter().enumerate().map(episode);
        Ok(Self {
            episodes: episodes.collect::<Result<_, _>>()?,
            cases: cases.collect::<Result<_, _>>()?,
            allocations: allocations.collect::<Result<_, _>>()?,
        })
    }
}

/// Values as JSON, one a line.
fn lines(cases: impl Iterator<Item = impl Serialize>) -> Result<String, serde_json::Error> {
    let lines = cases.map(|case| serde_json::to_string(&case)).collect::<Result<Vec<_>, _>>()?;
    Ok(lines.join(",\n") + "\n")
}

impl Case {
    fn from_case(case: &GoldenCase, contract: &ContractV1) -> Self {
        let observation = &case.observation;
        let named = |row: &[f32]| contract.named(row);
        let last = |action: &u16| (*action != NO_ACTION).then_some(*action);
        Self {
            entities: observation.rows.chunks(observation.features.max(1)).map(named).collect(),
            last_actions: observation.last_actions.iter().map(last).collect(),
            visible: observation.visible.iter().collect(),
            self_index: observation.self_index,
            available: observation.available.clone(),
            utilities: case.utilities.clone(),
            action: case.action,
        }
    }

    fn into_case(self, contract: &ContractV1) -> Result<GoldenCase, String> {
        let (features, actions) = (usize::from(contract.features), usize::from(contract.actions));
        let entities = self.entities.len();
        let rows = contract.rows(&self.entities)?;
        if self.available.len() != actions || self.utilities.len() != actions {
            return Err(format!("availability and utilities need {actions} entries each"));
        }
        if self.self_index >= entities || self.visible.iter().any(|&entity| entity >= entities) {
            return Err(format!("an index lies beyond the {entities} entities"));
        }
        if self.last_actions.len() > entities
            || self.last_actions.iter().flatten().any(|&action| action >= contract.actions)
        {
            return Err("a last action does not exist".to_owned());
        }
        let mut visible = EntityMask::EMPTY;
        self.visible.iter().for_each(|&entity| visible.insert(entity));
        let observation = OwnedObservation {
            rows,
            features,
            last_actions: self.last_actions.iter().map(|last| last.unwrap_or(NO_ACTION)).collect(),
            visible,
            self_index: self.self_index,
            available: self.available,
        };
        Ok(GoldenCase { observation, utilities: self.utilities, action: self.action })
    }
}

/// What one agent saw in one step, kept.
#[derive(Clone, Debug, PartialEq)]
pub struct OwnedObservation {
    /// Features `[N, features]`.
    pub rows: Vec<f32>,
    /// Columns d of a row.
    pub features: usize,
    /// Last action `[A]` of every agent, `NO_ACTION` where there was none.
    pub last_actions: Vec<u16>,
    /// The entities that the agent may attend to.
    pub visible: EntityMask,
    /// The agent's own row.
    pub self_index: usize,
    /// Availability mask `[U]`: 0 = not available.
    pub available: Vec<u16>,
}

impl OwnedObservation {
    /// The observation as policies take it.
    pub fn view(&self) -> Observation<'_> {
        Observation {
            rows: &self.rows,
            stride: self.features,
            last_actions: &self.last_actions,
            visible: self.visible,
            self_index: self.self_index,
            available: &self.available,
        }
    }

    /// A copy of an observation with `features` columns.
    pub fn copy_of(observation: &Observation<'_>, features: usize) -> Self {
        let rows = observation.rows.chunks(observation.stride.max(1));
        let rows = rows.flat_map(|row| row.iter().take(features)).copied().collect();
        Self {
            rows,
            features,
            last_actions: observation.last_actions.to_vec(),
            visible: observation.visible,
            self_index: observation.self_index,
            available: observation.available.to_vec(),
        }
    }

    /// Number of entity rows N.
    pub fn entities(&self) -> usize {
        self.rows.len().checked_div(self.features).unwrap_or(0)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::contract::tests::contract;

    pub(crate) fn golden(cases: usize) -> Golden {
        let case = |index: usize| GoldenCase {
            observation: OwnedObservation {
                rows: vec![0.1 * index as f32, 0.0, 1.0, 0.0, -0.3, 0.0],
                features: 3,
                last_actions: vec![1, NO_ACTION],
                visible: EntityMask::first(index % 3),
                self_index: 0,
                available: vec![1, 0],
            },
            utilities: vec![0.123_456_79, -1.0e-7],
            action: 0,
        };
        Golden { cases: (0..cases).map(case).collect(), ..Golden::default() }
    }

    #[test]
    fn comes_back_bit_for_bit() {
        let golden = golden(5);
        let json = golden.to_json(&contract()).unwrap();
        assert_eq!(Golden::from_json(&json, &contract()), Ok(golden));
    }

    #[test]
    fn reads_like_a_sentence() {
        let json = golden(2).to_json(&contract()).unwrap();
        let text = String::from_utf8(json).unwrap();
        assert!(text.contains(r#""entities":[{"health":1.0,"x":0.1},{"y":-0.3}]"#), "{text}");
        assert!(text.contains(r#""last_actions":[1,null],"visible":[0],"self":0"#), "{text}");
    }

    #[test]
    fn names_what_is_wrong() {
        let json = String::from_utf8(golden(1).to_json(&contract()).unwrap()).unwrap();
        let error = |from: &str, to: &str| {
            Golden::from_json(json.replace(from, to).as_bytes(), &contract()).unwrap_err()
        };
        assert_eq!(error("health", "wealth"), "case 0: `wealth` is not a feature");
        assert_eq!(error("[1,null]", "[2,null]"), "case 0: a last action does not exist");
        assert_eq!(
            error("\"self\":0", "\"self\":9"),
            "case 0: an index lies beyond the 2 entities"
        );
        assert!(error("sortie-golden-1", "other").contains("format `other`"));
        assert!(error("]}", "").contains("EOF"));
    }
}
