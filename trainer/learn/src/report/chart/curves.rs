//! Learning curves of several methods in one picture; and how times grow with sizes, a line for each label.

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::{
    Canvas, Drawn, FAINT_INK, GRID, INK, LABEL_SIZE, MARGIN, TITLE_HEIGHT, colour, dash, fitting,
    picture, stroke, text, text_width,
};
use crate::error::Result;
use crate::evaluate::Score;
use crate::report::group::score;
use crate::report::numbers::{TimeUnit, count};
use crate::report::{Axis, Group, Spread};

/// Height of a picture whose legend is not longer than that.
const HEIGHT: i32 = 680;
const CAPTION_HEIGHT: i32 = 44;
const CAPTION: &str = "Lines: mean of the runs. Bands: from the worst run to the best. \
                       Between evaluations and after its end, a run counts with its last value.";
/// The widest label at its usual size.
const LABEL_ROOM: i32 = 420;
/// Length of the line beside a label.
const KEY: i32 = 52;
/// Pixels above the legend, and between its lines.
const LEGEND_TOP: i32 = 34;
const LEGEND_STEP: i32 = 58;
/// Height of a picture of growth, and pixels between the lines of its legend.
const GROWTH_HEIGHT: u32 = 640;
const GROWTH_STEP: i32 = 36;

/// Draws mean success, or return, against environment steps or processor time, one line per group, with the range
/// of its seeds behind it.
pub fn curves(title: &str, groups: &[Group], axis: Axis) -> Result<String> {
    let score = score(groups);
    let curves: Vec<_> = groups.iter().map(|group| group.curve(axis, score)).collect();
    let last = curves.iter().filter_map(|curve| curve.last()).map(|(x, _)| *x);
    let scale = Scale::new(axis, last.fold(0.0, f64::max));
    let legend_height = LEGEND_TOP + LEGEND_STEP * groups.len() as i32;
    let height = HEIGHT.max(TITLE_HEIGHT + legend_height + CAPTION_HEIGHT);
    picture(height as u32, title, |canvas| {
        let (_, below) = canvas.split_vertically(TITLE_HEIGHT);
        let (width, _) = below.dim_in_pixel();
        let (below, caption) = below.split_vertically(height - TITLE_HEIGHT - CAPTION_HEIGHT);
        let (plot, legend) = below.split_horizontally(width as i32 - legend_width(groups));
        draw_plot(&plot, &curves, &scale, score)?;
        draw_legend(&legend, groups)?;
        let place = (MARGIN, CAPTION_HEIGHT / 2 - 6);
        text(&caption, CAPTION, place, LABEL_SIZE - 4, FAINT_INK, HPos::Left)
    })
}

/// A curve: what the seeds come to at each place of the axis.
type Curve = Vec<(f64, Spread)>;

/// The horizontal axis.
struct Scale {
    name: String,
    end: f64,
    /// What one unit of the labels is on the axis.
    unit: f64,
}

impl Scale {
    fn new(axis: Axis, end: f64) -> Self {
        let end = if end > 0.0 { end } else { 1.0 };
        match axis {
            Axis::Steps => Self { name: "environment steps".to_owned(), end, unit: 1.0 },
            Axis::Cpu => {
                let unit = TimeUnit::fitting(end);
                let name = format!("processor time in {}, all threads together", unit.plural);
                Self { name, end, unit: unit.seconds }
            }
        }
    }

    fn of(&self, x: f64) -> f64 {
        x / self.unit
    }
}

fn draw_plot(plot: &Canvas<'_>, curves: &[Curve], scale: &Scale, score: Score) -> Drawn {
    let spreads = curves.iter().flatten().map(|(_, spread)| spread);
    let [low, high] = score.range(spreads.flat_map(|spread| [spread.min, spread.max]));
    let places = usize::from(high - low < 10.0);
    let mut chart = ChartBuilder::on(plot)
        .margin_left(MARGIN - 8)
        .margin_right(MARGIN)
        .margin_bottom(8)
        .margin_top(8)
        .x_label_area_size(66)
        .y_label_area_size(80)
        .build_cartesian_2d(0.0..scale.of(scale.end), low..high)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .bold_line_style(GRID)
        .light_line_style(TRANSPARENT)
        .axis_style(FAINT_INK)
        .x_desc(&scale.name)
        .y_desc(score.about())
        .x_labels(11)
        .y_labels(6)
        .x_label_formatter(&|x| count(*x))
        .y_label_formatter(&|value| format!("{value:.places$}"))
        .label_style(("sans-serif", LABEL_SIZE, &INK))
        .axis_desc_style(("sans-serif", LABEL_SIZE + 2, &INK))
        .draw()?;
    for (index, curve) in curves.iter().enumerate() {
        if curve.iter().any(|(_, spread)| spread.min < spread.max) {
            let upper = curve.iter().map(|(x, spread)| (scale.of(*x), spread.max));
            let lower = curve.iter().rev().map(|(x, spread)| (scale.of(*x), spread.min));
            let band: Vec<_> = upper.chain(lower).collect();
            chart.draw_series([Polygon::new(band, colour(index).mix(0.16))])?;
        }
    }
    for (index, curve) in curves.iter().enumerate() {
        let at = |(x, spread): &(f64, Spread)| (scale.of(*x), spread.mean);
        let (mean, style) = (curve.iter().map(at), colour(index).stroke_width(4));
        match dash(index) {
            None => chart.draw_series(LineSeries::new(mean, style))?,
            Some((drawn, left_out)) => {
                chart.draw_series(DashedLineSeries::new(mean, drawn, left_out, style))?
            }
        };
        let end = curve.last().map(at);
        chart.draw_series(end.map(|end| Circle::new(end, 6, colour(index).filled())))?;
    }
    Ok(())
}

fn runs(group: &Group) -> String {
    match group.runs.len() {
        1 => "1 run".to_owned(),
        count => format!("{count} runs"),
    }
}

fn legend_width(groups: &[Group]) -> i32 {
    let widths = groups.iter().map(|group| text_width(&group.label, LABEL_SIZE));
    let widest = widths.max().unwrap_or(0).clamp(80, LABEL_ROOM);
    KEY + 14 + widest + MARGIN
}

fn draw_legend(legend: &Canvas<'_>, groups: &[Group]) -> Drawn {
    for (index, group) in groups.iter().enumerate() {
        let middle = LEGEND_TOP + LEGEND_STEP * index as i32;
        stroke(legend, vec![(0, middle), (KEY, middle)], index)?;
        let place = |below| (KEY + 14, middle + below);
        let size = fitting(&group.label, LABEL_SIZE, LABEL_ROOM);
        text(legend, &group.label, place(0), size, INK, HPos::Left)?;
        text(legend, &runs(group), place(23), LABEL_SIZE - 4, FAINT_INK, HPos::Left)?;
    }
    Ok(())
}

/// What one label comes to at each size.
#[derive(Clone, Debug)]
pub struct Line {
    /// Its name.
    pub label: String,
    /// Sizes, in rising order, and what is more than zero at each.
    pub points: Vec<(f64, f64)>,
}

/// Draws what several labels come to by sizes, by powers of ten; axes are named across, then up.
pub fn growth(title: &str, axes: [&str; 2], lines: &[Line]) -> Result<String> {
    let widest = lines.iter().map(|line| text_width(&line.label, LABEL_SIZE)).max().unwrap_or(0);
    picture(GROWTH_HEIGHT, title, |canvas| {
        let (_, below) = canvas.split_vertically(TITLE_HEIGHT);
        let width = below.dim_in_pixel().0 as i32;
        let (plot, legend) = below.split_horizontally(width - widest - KEY - 14 - MARGIN);
        draw_growth(&plot, axes, lines)?;
        for (index, line) in lines.iter().enumerate() {
            let middle = GROWTH_STEP * (index as i32 + 1);
            stroke(&legend, vec![(0, middle), (KEY, middle)], index)?;
            text(&legend, &line.label, (KEY + 14, middle), LABEL_SIZE, INK, HPos::Left)?;
        }
        Ok(())
    })
}

fn draw_growth(plot: &Canvas<'_>, [across, up]: [&str; 2], lines: &[Line]) -> Drawn {
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
    use crate::report::group::tests::{group, run};

    fn groups() -> Vec<Group> {
        let many = vec![run(1, &[(10.0, 0.1), (4e5, 0.8)]), run(2, &[(10.0, 0.2), (3e5, 0.7)])];
        vec![group("first & best", many), group("second", vec![run(1, &[(10.0, 0.3), (2e5, 0.4)])])]
    }

    #[test]
    fn every_label_has_its_line_and_only_several_seeds_a_band() {
        let svg = curves("A title", &groups(), Axis::Steps).unwrap();
        for part in ["A title", "first &amp; best", "2 runs", "1 run", "200 k", "</svg>"] {
            assert!(svg.contains(part), "no `{part}`");
        }
        assert_eq!(svg.matches("<polygon").count(), 1);
    }

    #[test]
    fn returns_have_an_axis_of_their_own() {
        let mut run = run(1, &[(10.0, 0.1), (4e5, 0.8)]);
        run.score = Score::Return;
        let svg = curves("t", &[group("alone", vec![run])], Axis::Steps).unwrap();
        assert!(svg.contains("mean return") && svg.contains("\n80\n"), "{svg}");
    }

    #[test]
    fn processor_time_is_shown_in_a_unit_that_suits_it() {
        let svg = curves("t", &groups(), Axis::Cpu).unwrap();
        assert!(svg.contains("processor time in minutes"), "{svg}");
    }

    #[test]
    fn a_single_point_and_no_group_at_all_make_a_picture() {
        let alone = [group("alone", vec![run(1, &[(10.0, 0.5)])])];
        assert!(curves("t", &alone, Axis::Steps).unwrap().contains("<circle"));
        assert!(curves("t", &[], Axis::Steps).unwrap().contains("</svg>"));
    }

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
