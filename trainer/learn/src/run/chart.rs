//! The learning curve as a picture.

use std::fmt::Display;

use plotters::prelude::*;

use super::curve::CurvePoint;
use crate::evaluate::Score;

const SIZE: (u32, u32) = (720, 420);
const LINE: RGBColor = RGBColor(0x1f, 0x5f, 0xa8);

/// Draws success with its 95 % interval, or return, against environment steps, as SVG text.
pub fn learning_curve(
    title: &str,
    score: Score,
    curve: &[CurvePoint],
) -> Result<String, impl Display> {
    let mut svg = String::new();
    draw(&mut svg, title, score, curve).map(|()| svg).map_err(|error| error.to_string())
}

type DrawResult = Result<(), DrawingAreaErrorKind<std::io::Error>>;

fn draw(svg: &mut String, title: &str, score: Score, curve: &[CurvePoint]) -> DrawResult {
    let area = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    area.fill(&WHITE)?;
    let thousands = |steps: u64| steps as f64 / 1000.0;
    let last = curve.last().map_or(1.0, |point| thousands(point.env_steps).max(1.0));
    let value = |point: &CurvePoint| score.pick(point.success, point.return_mean);
    let [low, high] = score.range(curve.iter().map(value));
    let places = usize::from(high - low < 10.0);
    let mut chart = ChartBuilder::on(&area)
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
    area.present()
}

#[cfg(test)]
mod tests {
    use super::*;

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
