//! The learning curve: one point per evaluation.

use std::collections::BTreeMap;

use serde::{Deserialize, Deserializer, Serialize};

/// What one evaluation during training found, and what training did since the one before.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CurvePoint {
    /// Environment steps taken.
    pub env_steps: u64,
    /// Optimiser steps of the agents.
    pub updates: u64,
    /// Decisions of who allocates.
    pub decisions: u64,
    /// Seconds since the run began, interruptions left out.
    pub wall_s: f64,
    /// Seconds of processor time, all threads together.
    pub cpu_s: f64,
    /// Who allocated in the evaluation.
    pub allocation: String,
    /// Share of greedy episodes that were solved, played with the averaged weights.
    pub success: f64,
    /// 95 % Wilson interval of the success.
    pub success_ci95: [f64; 2],
    /// Share of those episodes that ran out of time.
    pub timeouts: f64,
    /// Means of the environment's metrics in those episodes, by their names.
    #[serde(flatten)]
    pub metrics: BTreeMap<String, f64>,
    /// Mean return of those episodes.
    pub return_mean: f64,
    /// Mean steps of those episodes.
    pub length_mean: f64,
    /// Episodes of the evaluation.
    pub episodes: usize,
    /// Mean loss of the agents' updates since the last point.
    #[serde(deserialize_with = "number_or_null")]
    pub loss: f64,
    /// Mean norm of the agents' gradients since the last point, before clipping.
    #[serde(deserialize_with = "number_or_null")]
    pub gradient_norm: f64,
    /// Optimiser steps of the allocator.
    pub allocator_updates: u64,
    /// Mean loss of the allocator's updates since the last point; 0 where none is learned.
    #[serde(deserialize_with = "number_or_null")]
    pub allocator_loss: f64,
    /// Exploration at this point, before the instances' factors.
    pub epsilon: f32,
    /// Learning rate of the agents at this point.
    pub learning_rate: f32,
    /// Success of the exploring episodes since the last point.
    pub training_success: f64,
}

/// Reads a number that was not finite when it was written: JSON has only null for it.
fn number_or_null<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f64::NAN))
}

/// One JSON object a line.
pub(super) fn to_lines(curve: &[CurvePoint]) -> serde_json::Result<String> {
    let mut text = String::new();
    for point in curve {
        text += &serde_json::to_string(point)?;
        text.push('\n');
    }
    Ok(text)
}

/// Reads what [`to_lines`] wrote.
pub(super) fn from_lines(text: &str) -> serde_json::Result<Vec<CurvePoint>> {
    text.lines().map(serde_json::from_str).collect()
}

/// A curve within a form that does not describe itself.
pub(super) mod as_lines {
    use serde::de::Error as _;
    use serde::ser::Error as _;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use super::{CurvePoint, from_lines, to_lines};

    pub(in crate::run) fn serialize<S: Serializer>(
        curve: &[CurvePoint],
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        to_lines(curve).map_err(S::Error::custom)?.serialize(serializer)
    }

    pub(in crate::run) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Vec<CurvePoint>, D::Error> {
        from_lines(&String::deserialize(deserializer)?).map_err(D::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_with_a_loss_that_was_no_number_can_be_read() {
        let text = r#"{"env_steps":8,"updates":1,"decisions":1,"wall_s":1.0,"cpu_s":1.0,"allocation":"learned",
            "success":0.0,"success_ci95":[0.0,0.1],"timeouts":1.0,"none_burned":0.0,"return_mean":-1.0,
            "length_mean":9.0,"episodes":4,"loss":null,"gradient_norm":null,"allocator_updates":0,
            "allocator_loss":0.0,"epsilon":1.0,"learning_rate":0.1,"training_success":0.0}"#
            .replace('\n', "");
        let curve = from_lines(&text).unwrap();
        assert!(curve[0].loss.is_nan() && curve[0].gradient_norm.is_nan());
        assert_eq!(curve[0].metrics, [("none_burned".to_owned(), 0.0)].into());
        let counters = crate::run::Counters { curve, ..Default::default() };
        let kept = postcard::to_stdvec(&counters).unwrap();
        let back: crate::run::Counters = postcard::from_bytes(&kept).unwrap();
        assert!(back.curve[0].loss.is_nan() && back.curve[0].allocator_loss == 0.0);
    }
}
