//! The learning curve: one point per evaluation, and its picture; and what a finished run is worth.

use std::collections::BTreeMap;
use std::fmt::Display;

use plotters::prelude::*;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de, ser};

use crate::evaluate::{Evaluation, Score};
use crate::report::chart::{Canvas, Drawn, svg};

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

pub(super) fn from_lines(text: &str) -> serde_json::Result<Vec<CurvePoint>> {
    text.lines().map(serde_json::from_str).collect()
}

/// Writes a curve within a form that does not describe itself.
pub(super) fn write_lines<S: Serializer>(curve: &[CurvePoint], to: S) -> Result<S::Ok, S::Error> {
    to_lines(curve).map_err(ser::Error::custom)?.serialize(to)
}

pub(super) fn read_lines<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<CurvePoint>, D::Error> {
    from_lines(&String::deserialize(from)?).map_err(de::Error::custom)
}

/// Greedy episodes of the averaged weights at the end of a run, never used during the run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunResult {
    /// Environment and scenario set.
    pub env: String,
    /// Who allocated.
    pub allocation: String,
    /// Seed of the episodes, the same for all runs.
    pub seed: u64,
    /// How the team did.
    #[serde(flatten)]
    pub evaluation: Evaluation,
}

const SIZE: (u32, u32) = (720, 420);
const LINE: RGBColor = RGBColor(0x1f, 0x5f, 0xa8);

/// Draws success with its 95 % interval, or return, against environment steps, as SVG text.
pub(super) fn learning_curve(
    title: &str,
    score: Score,
    curve: &[CurvePoint],
) -> Result<String, impl Display> {
    svg(SIZE, |area| draw(area, title, score, curve))
}

fn draw(area: &Canvas<'_>, title: &str, score: Score, curve: &[CurvePoint]) -> Drawn {
    let thousands = |steps: u64| steps as f64 / 1000.0;
    let last = curve.last().map_or(1.0, |point| thousands(point.env_steps).max(1.0));
    let value = |point: &CurvePoint| score.pick(point.success, point.return_mean);
    let [low, high] = score.range(curve.iter().map(value));
    let places = usize::from(high - low < 10.0);
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 18))
        .margin(14)
        .x_label_area_size(42)
        .y_label_area_size(52)
        .build_cartesian_2d(0.0..last, low..high)?;
    chart
        .configure_mesh()
        .x_desc("environment steps (thousands)")
        .y_desc(score.about())
        .y_label_formatter(&|value| format!("{value:.places$}"))
        .x_label_formatter(&|steps| format!("{steps:.0}"))
        .light_line_style(TRANSPARENT)
        .draw()?;
    let at = |point: &CurvePoint, value: f64| (thousands(point.env_steps), value);
    if score == Score::Success {
        let band = curve
            .iter()
            .map(|point| at(point, point.success_ci95[1]))
            .chain(curve.iter().rev().map(|point| at(point, point.success_ci95[0])));
        chart.draw_series([Polygon::new(band.collect::<Vec<_>>(), LINE.mix(0.18))])?;
    }
    let line = curve.iter().map(|point| at(point, value(point)));
    chart.draw_series(LineSeries::new(line, LINE.stroke_width(2)))?;
    Ok(())
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

    #[test]
    fn the_picture_names_its_axes_even_without_points() {
        let drawn = |score| learning_curve("a run", score, &[]).map_err(|error| error.to_string());
        let svg = drawn(Score::Success).unwrap();
        for part in ["a run", "environment steps", "share of solved", "</svg>"] {
            assert!(svg.contains(part), "no `{part}`");
        }
        assert!(drawn(Score::Return).unwrap().contains("mean return"));
    }
}
