//! Learning curves of several methods in one picture.

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::{
    Canvas, Drawn, FAINT_INK, GRID, INK, MARGIN, TITLE_HEIGHT, colour, dash, fitting, picture,
    stroke, text, text_width,
};
use crate::error::LearnError;
use crate::evaluate::Score;
use crate::report::group::score;
use crate::report::numbers::{TimeUnit, count};
use crate::report::{Axis, Group, Sample};

/// Height of a picture whose legend is not longer than that.
const HEIGHT: i32 = 680;
const LABEL_SIZE: i32 = 20;
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

/// Draws mean success, or return, against environment steps or processor time, one line per group, with the range
/// of its seeds behind it.
pub fn curves(title: &str, groups: &[Group], axis: Axis) -> Result<String, LearnError> {
    let score = score(groups);
    let curves: Vec<Vec<Sample>> = groups.iter().map(|group| group.curve(axis, score)).collect();
    let last = curves.iter().filter_map(|curve| curve.last()).map(|sample| sample.x);
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
        text(
            &caption,
            CAPTION,
            (MARGIN, CAPTION_HEIGHT / 2 - 6),
            LABEL_SIZE - 4,
            FAINT_INK,
            HPos::Left,
        )
    })
}

/// The horizontal axis.
struct Scale {
    name: String,
    end: f64,
    /// What one unit of the labels is on the axis.
    unit: f64,
    label: fn(f64) -> String,
}

impl Scale {
    fn new(axis: Axis, end: f64) -> Self {
        let end = if end > 0.0 { end } else { 1.0 };
        match axis {
            Axis::Steps => {
                Self { name: "environment steps".to_owned(), end, unit: 1.0, label: count }
            }
            Axis::Cpu => {
                let unit = TimeUnit::fitting(end);
                let name = format!("processor time in {}, all threads together", unit.plural);
                Self { name, end, unit: unit.seconds, label: count }
            }
        }
    }

    fn of(&self, x: f64) -> f64 {
        x / self.unit
    }
}

fn draw_plot(plot: &Canvas<'_>, curves: &[Vec<Sample>], scale: &Scale, score: Score) -> Drawn {
    let samples = curves.iter().flatten();
    let [low, high] = score.range(samples.flat_map(|sample| [sample.min, sample.max]));
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
        .x_label_formatter(&|x| (scale.label)(*x))
        .y_label_formatter(&|value| format!("{value:.places$}"))
        .label_style(("sans-serif", LABEL_SIZE, &INK))
        .axis_desc_style(("sans-serif", LABEL_SIZE + 2, &INK))
        .draw()?;
    for (index, curve) in curves.iter().enumerate() {
        let at =
            |share: fn(&Sample) -> f64| move |sample: &Sample| (scale.of(sample.x), share(sample));
        if curve.iter().any(|sample| sample.min < sample.max) {
            let upper = curve.iter().map(at(|sample| sample.max));
            let lower = curve.iter().rev().map(at(|sample| sample.min));
            let band: Vec<_> = upper.chain(lower).collect();
            chart.draw_series([Polygon::new(band, colour(index).mix(0.16))])?;
        }
    }
    for (index, curve) in curves.iter().enumerate() {
        let at = |sample: &Sample| (scale.of(sample.x), sample.mean);
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

fn draw_legend(legend: &DrawingArea<SVGBackend<'_>, Shift>, groups: &[Group]) -> Drawn {
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
}
