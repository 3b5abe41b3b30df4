//! How times grow with sizes, a line for each label.

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::{
    Drawn, FAINT_INK, GRID, INK, MARGIN, TITLE_HEIGHT, colour, dash, picture, stroke, text,
    text_width,
};
use crate::error::LearnError;

const HEIGHT: u32 = 640;
const LABEL_SIZE: i32 = 20;
/// Length of the line beside a label, and pixels between the labels.
const KEY: i32 = 52;
const LEGEND_STEP: i32 = 36;

/// What one label comes to at each size.
#[derive(Clone, Debug)]
pub struct Line {
    /// Its name.
    pub label: String,
    /// Sizes, in rising order, and what is more than zero at each.
    pub points: Vec<(f64, f64)>,
}

/// Draws what several labels come to by sizes, by powers of ten; axes are named across, then up.
///
/// # Errors
/// The picture cannot be drawn.
pub fn growth(title: &str, axes: [&str; 2], lines: &[Line]) -> Result<String, LearnError> {
    let widest = lines.iter().map(|line| text_width(&line.label, LABEL_SIZE)).max().unwrap_or(0);
    picture(HEIGHT, title, |canvas| {
        let (_, below) = canvas.split_vertically(TITLE_HEIGHT);
        let width = below.dim_in_pixel().0 as i32;
        let (plot, legend) = below.split_horizontally(width - widest - KEY - 14 - MARGIN);
        draw_plot(&plot, axes, lines)?;
        for (index, line) in lines.iter().enumerate() {
            let middle = LEGEND_STEP * (index as i32 + 1);
            stroke(&legend, vec![(0, middle), (KEY, middle)], index)?;
            text(&legend, &line.label, (KEY + 14, middle), LABEL_SIZE, INK, HPos::Left)?;
        }
        Ok(())
    })
}

fn draw_plot(plot: &super::Canvas<'_>, [across, up]: [&str; 2], lines: &[Line]) -> Drawn {
    let points = || lines.iter().flat_map(|line| &line.points);
    let last = points().map(|point| point.0).fold(1.0, f64::max);
    let low = points().map(|point| point.1).fold(f64::INFINITY, f64::min).min(1e9);
    let high = points().map(|point| point.1).fold(low, f64::max);
    let [low, high] = [low.log10().floor(), (high.log10() + 1e-9).ceil()].map(|x| 10_f64.powf(x));
    let mut chart = ChartBuilder::on(plot)
        .margin_left(MARGIN - 8)
        .margin_right(MARGIN)
        .margin_bottom(8)
        .x_label_area_size(66)
        .y_label_area_size(90)
        .build_cartesian_2d(0.0..last * 1.05, (low..high).log_scale())?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .bold_line_style(GRID)
        .light_line_style(TRANSPARENT)
        .axis_style(FAINT_INK)
        .x_desc(across)
        .y_desc(up)
        .x_label_formatter(&|x| format!("{x:.0}"))
        .y_label_formatter(&|y| format!("{y}"))
        .label_style(("sans-serif", LABEL_SIZE, &INK))
        .axis_desc_style(("sans-serif", LABEL_SIZE + 2, &INK))
        .draw()?;
    for (index, line) in lines.iter().enumerate() {
        let (points, style) = (line.points.iter().copied(), colour(index).stroke_width(4));
        match dash(index) {
            None => chart.draw_series(LineSeries::new(points.clone(), style))?,
            Some((drawn, left_out)) => {
                chart.draw_series(DashedLineSeries::new(points.clone(), drawn, left_out, style))?
            }
        };
        chart.draw_series(points.map(|point| Circle::new(point, 6, colour(index).filled())))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_size_is_a_dot_and_the_axis_has_powers_of_ten() {
        let line = |label: &str, points: &[_]| Line { label: label.into(), points: points.into() };
        let lines =
            [line("few & small", &[(10.0, 3.0), (20.0, 40.0)]), line("one", &[(15.0, 9.0)])];
        let svg = growth("Times", ["customers", "us"], &lines).unwrap();
        for part in ["Times", "few &amp; small", "one", "customers", "\n100\n", "</svg>"] {
            assert!(svg.contains(part), "no `{part}`: {svg}");
        }
        assert_eq!(svg.matches("<circle").count(), 3);
        assert!(growth("Times", ["", ""], &[]).unwrap().contains("</svg>"));
    }
}
