//! A number of each label in each group, as bars side by side.

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::{
    Canvas, Drawn, FAINT_INK, GRID, INK, LABEL_SIZE, MARGIN, TITLE_HEIGHT, WIDTH, colour, fitting,
    picture, text, text_width,
};
use crate::error::Result;
use crate::report::{Comparison, Spread, TeamSummary};

/// The widest name of a group at its usual size.
const GROUP_ROOM: i32 = 400;
/// Thickness of a bar and pixels between the groups.
const BAR: i32 = 14;
const GAP: i32 = 14;
/// Height of a line of the legend, and pixels from a key to its label.
const LEGEND_STEP: i32 = 34;
const KEY: i32 = 26;
/// Heights of the strips with the axis, and with the caption.
const AXIS_HEIGHT: i32 = 70;
const CAPTION_HEIGHT: i32 = 46;
const CAPTION: &str = "Bars: mean of the runs. Thin lines: from the worst run to the best.";

/// A number of each label in each group.
#[derive(Clone, Debug)]
pub struct Bars<'a> {
    /// What the number is.
    pub about: &'a str,
    /// The labels; their places are those of their colours.
    pub labels: Vec<&'a str>,
    /// Group by group.
    pub bars: Vec<Bar<'a>>,
    /// Where its axis begins and ends.
    pub ends: [f64; 2],
}

/// The number of one label in one group.
#[derive(Clone, Copy, Debug)]
pub struct Bar<'a> {
    /// The group.
    pub group: &'a str,
    /// The place of the label.
    pub label: usize,
    /// The number over the seeds.
    pub spread: Spread,
}

/// The ends of an axis that has room for zero and for these.
pub fn ends<'a>(spreads: impl Iterator<Item = &'a Spread>) -> [f64; 2] {
    let [least, most] = spreads
        .fold([0.0_f64; 2], |[least, most], spread| [least.min(spread.min), most.max(spread.max)]);
    if least < most { [least, most] } else { [0.0, 1.0] }
}

/// Draws success by team, with the range of the seeds as a thin line; none where no label has a final evaluation.
pub fn teams<'a>(title: &str, comparison: &'a Comparison) -> Result<Option<String>> {
    if comparison.teams.is_empty() {
        return Ok(None);
    }
    let labels: Vec<&str> = comparison.groups.iter().map(|group| group.label.as_str()).collect();
    let bar = |team: &'a TeamSummary| {
        let label = labels.iter().position(|label| *label == team.label)?;
        Some(Bar { group: &team.team, label, spread: team.success })
    };
    let bars: Vec<Bar<'a>> = comparison.teams.iter().filter_map(bar).collect();
    let bars = Bars { about: "share of solved episodes", labels, bars, ends: [0.0, 1.0] };
    draw_bars(title, &bars).map(Some)
}

/// Draws a bar per group and label, with the range of the seeds as a thin line.
pub fn draw_bars(title: &str, bars: &Bars<'_>) -> Result<String> {
    let has_bars = |label: usize| bars.bars.iter().any(|bar| bar.label == label);
    let labels = bars.labels.iter().copied().enumerate();
    let labels: Vec<(usize, &str)> = labels.filter(|(label, _)| has_bars(*label)).collect();
    let mut groups: Vec<&str> = bars.bars.iter().map(|bar| bar.group).collect();
    groups.dedup();
    let keys = keys(&labels);
    let top = keys.last().map_or(TITLE_HEIGHT, |(_, middle)| middle + LEGEND_STEP);
    let rows = groups.len() as i32 * (labels.len() as i32 * BAR + GAP);
    let bottom = top + rows + AXIS_HEIGHT;
    picture((bottom + CAPTION_HEIGHT) as u32, title, |canvas| {
        draw_legend(canvas, &keys, &labels)?;
        let (_, below) = canvas.split_vertically(top);
        let (plot, caption) = below.split_vertically(rows + AXIS_HEIGHT);
        draw_plot(&plot, bars, &groups, &labels, rows.into())?;
        let place = (MARGIN, CAPTION_HEIGHT - 26);
        text(&caption, CAPTION, place, LABEL_SIZE - 4, FAINT_INK, HPos::Left)
    })
}

/// Draws the bars over so many pixels, by which they are placed downwards.
fn draw_plot(
    plot: &Canvas<'_>,
    bars: &Bars<'_>,
    groups: &[&str],
    labels: &[(usize, &str)],
    rows: f64,
) -> Drawn {
    let [low, high] = bars.ends;
    let places = (1.0 - (high - low).log10().floor()).max(0.0) as usize;
    let widest = groups.iter().map(|group| text_width(group, LABEL_SIZE)).max().unwrap_or(0);
    let mut chart = ChartBuilder::on(plot)
        .margin_left(MARGIN)
        .margin_right(MARGIN + 16)
        .x_label_area_size(AXIS_HEIGHT)
        .y_label_area_size(34 + widest.min(GROUP_ROOM))
        .build_cartesian_2d(low..high, rows..0.0)?;
    chart
        .configure_mesh()
        .axis_style(GRID)
        .disable_y_mesh()
        .bold_line_style(GRID)
        .light_line_style(TRANSPARENT)
        .x_desc(bars.about)
        .x_labels(9)
        .y_labels(0)
        .x_label_formatter(&|x| format!("{x:.places$}"))
        .label_style(("sans-serif", LABEL_SIZE, &INK))
        .axis_desc_style(("sans-serif", LABEL_SIZE + 2, &INK))
        .draw()?;
    let height = rows / groups.len() as f64;
    for (row, group) in groups.iter().enumerate() {
        let top = row as f64 * height + f64::from(GAP / 2);
        for (place, (label, _)) in labels.iter().enumerate() {
            let is_meant = |bar: &&Bar<'_>| bar.group == *group && bar.label == *label;
            let Some(bar) = bars.bars.iter().find(is_meant) else { continue };
            let Spread { mean, min, max, .. } = bar.spread;
            let top = top + (place as i32 * BAR) as f64;
            let corners = [(0.0, top), (mean, top + f64::from(BAR - 2))];
            chart.draw_series([Rectangle::new(corners, colour(*label).filled())])?;
            let middle = top + f64::from(BAR / 2 - 1);
            let range = (min < max).then_some([(min, middle), (max, middle)]);
            let line = |range| PathElement::new(range, INK.stroke_width(2));
            chart.draw_series(range.map(line))?;
        }
        let (left, middle) = chart.backend_coord(&(low, (row as f64 + 0.5) * height));
        let (size, above) = (fitting(group, LABEL_SIZE, GROUP_ROOM), plot.get_base_pixel().1);
        text(plot, group, (left - 14, middle - above), size, INK, HPos::Right)?;
    }
    let base = PathElement::new([(0.0, 0.0), (0.0, rows)], FAINT_INK.stroke_width(2));
    chart.draw_series([base])?;
    Ok(())
}

fn draw_legend(canvas: &Canvas<'_>, keys: &[(i32, i32)], labels: &[(usize, &str)]) -> Drawn {
    for ((left, middle), (index, label)) in keys.iter().zip(labels) {
        let corners = [(*left, middle - 8), (left + 16, middle + 8)];
        canvas.draw(&Rectangle::new(corners, colour(*index).filled()))?;
        let size = fitting(label, LABEL_SIZE, WIDTH as i32 - 2 * MARGIN - KEY);
        text(canvas, label, (left + KEY, *middle), size, INK, HPos::Left)?;
    }
    Ok(())
}

/// Where the keys of the legend begin: in lines that are full before the next one is begun.
fn keys(labels: &[(usize, &str)]) -> Vec<(i32, i32)> {
    let mut place = (MARGIN, TITLE_HEIGHT + LEGEND_STEP / 2 - 10);
    let key = |(_, label): &(usize, &str)| {
        let width = KEY + text_width(label, LABEL_SIZE);
        if place.0 > MARGIN && place.0 + width > WIDTH as i32 - MARGIN {
            place = (MARGIN, place.1 + LEGEND_STEP);
        }
        let key = place;
        place.0 += width + 16;
        key
    };
    labels.iter().map(key).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::comparison::tests::evaluated;
    use crate::report::group::tests::{group, run};

    #[test]
    fn a_label_keeps_its_colour_where_another_has_no_teams() {
        let bare = group("bare", vec![run(1, &[(10.0, 0.5)])]);
        let full = group("full", vec![evaluated(1, 0.5, &[("ab", 5), ("b", 0)])]);
        let comparison = Comparison::of("t", &[bare, full]);
        let svg = teams("Teams", &comparison).unwrap().unwrap();
        assert!(svg.contains("#D55E00") && !svg.contains("#0072B2"), "{svg}");
        for part in ["Teams", "full", "ab", "</svg>"] {
            assert!(svg.contains(part), "no `{part}`");
        }
        assert!(!svg.contains("bare"));
    }

    #[test]
    fn a_legend_that_is_too_long_goes_on_below() {
        let long = "a label of many words that fills a good part of a line";
        let places = keys(&[(0, long), (1, long), (2, "short")]);
        assert_eq!(places[0].0, places[1].0);
        assert!(places[0].1 < places[1].1);
        assert_eq!(places[1].1, places[2].1);
    }

    #[test]
    fn an_axis_has_room_for_zero_and_all_numbers() {
        let of = |numbers: &[f64]| {
            let spreads: Vec<Spread> =
                numbers.iter().filter_map(|number| Spread::of([*number])).collect();
            ends(spreads.iter())
        };
        assert_eq!(of(&[128.3, -5.4]), [-5.4, 128.3]);
        assert_eq!(of(&[2.0, 1.5]), [0.0, 2.0]);
        assert_eq!(of(&[-1.74]), [-1.74, 0.0]);
        assert_eq!(of(&[0.0]), [0.0, 1.0]);
    }

    #[test]
    fn bars_of_losses_lead_to_the_left_of_zero() {
        let spread = Spread::of([-30.0, -50.0]).unwrap();
        let bars = vec![Bar { group: "g", label: 0, spread }];
        let ends = ends([spread].iter());
        let bars = Bars { about: "return", labels: vec!["one"], bars, ends };
        let svg = draw_bars("Losses", &bars).unwrap();
        for part in ["Losses", "return", "\ng\n", "-40", "one"] {
            assert!(svg.contains(part), "no `{part}` in {svg}");
        }
        // Of four fifths of the axis, whose right end is zero.
        let bar = svg.lines().rfind(|line| line.contains("fill=\"#0072B2\""));
        let number = |name: &str| -> f64 {
            let rest = bar.and_then(|bar| bar.split_once(&format!(" {name}=\"")));
            rest.and_then(|(_, rest)| rest.split('"').next()?.parse().ok()).unwrap()
        };
        let end = f64::from(WIDTH as i32 - MARGIN - 16);
        assert!((number("x") + number("width") - end).abs() < 3.0, "{svg}");
    }

    #[test]
    fn without_final_evaluations_there_is_no_picture() {
        let comparison = Comparison::of("t", &[group("bare", vec![run(1, &[(10.0, 0.5)])])]);
        assert_eq!(teams("t", &comparison).unwrap(), None);
    }
}
