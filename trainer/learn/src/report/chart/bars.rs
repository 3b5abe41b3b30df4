//! A number of each label in each group, as bars side by side.

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::{
    Canvas, Drawn, FAINT_INK, GRID, INK, MARGIN, TITLE_HEIGHT, WIDTH, colour, fitting, picture,
    text, text_width,
};
use crate::error::LearnError;
use crate::report::{Comparison, Spread, TeamSummary};

const LABEL_SIZE: i32 = 20;
/// The widest name of a group at its usual size.
const GROUP_ROOM: i32 = 400;
/// Thickness of a bar and pixels between the groups.
const BAR: i32 = 14;
const GAP: i32 = 14;
/// Height of a line of the legend, and pixels from a key to its label.
const LEGEND_STEP: i32 = 34;
const KEY: i32 = 26;
/// Height of the strip with the axis and the caption.
const AXIS_HEIGHT: i32 = 116;
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
    /// What it is drawn against.
    pub axis: Axis,
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

/// Where an axis begins, how far apart its marks are and how many steps it has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    first: f64,
    step: f64,
    steps: u32,
}

impl Axis {
    /// That of shares.
    pub const SHARE: Self = Self { first: 0.0, step: 0.2, steps: 5 };
    /// Most steps.
    const STEPS: f64 = 8.0;

    /// One that has room for zero and for these.
    pub fn of<'a>(spreads: impl Iterator<Item = &'a Spread>) -> Self {
        let (least, most) = spreads.fold((0.0_f64, 0.0_f64), |(least, most), spread| {
            (least.min(spread.min), most.max(spread.max))
        });
        let span = most - least;
        if span == 0.0 {
            return Self { first: 0.0, step: 1.0, steps: 1 };
        }
        let power = 10.0_f64.powf((span / Self::STEPS).log10().floor());
        let fits = |step: &f64| span / step <= Self::STEPS - 2.0;
        let step = [1.0, 2.0, 5.0, 10.0].map(|part| part * power).into_iter().find(fits);
        let step = step.unwrap_or(20.0 * power);
        let first = (least / step).floor();
        let last = (most / step).ceil();
        Self { first: first * step, step, steps: (last - first).max(1.0) as u32 }
    }

    fn mark(&self, number: u32) -> f64 {
        self.first + f64::from(number) * self.step
    }

    fn text(&self, number: u32) -> String {
        let digits = (-self.step.log10().floor()).max(0.0) as usize;
        // Minus zero reads oddly.
        format!("{:.digits$}", self.mark(number) + 0.0)
    }

    /// Where a number stands, as a share of the axis.
    fn share(&self, number: f64) -> f64 {
        (number - self.first) / (f64::from(self.steps) * self.step)
    }
}

/// Draws success by team, with the range of the seeds as a thin line; none where no label has a final evaluation.
pub fn teams<'a>(title: &str, comparison: &'a Comparison) -> Result<Option<String>, LearnError> {
    if comparison.teams.is_empty() {
        return Ok(None);
    }
    let labels: Vec<&str> = comparison.groups.iter().map(|group| group.label.as_str()).collect();
    let bar = |team: &'a TeamSummary| {
        let label = labels.iter().position(|label| *label == team.label)?;
        Some(Bar { group: &team.team, label, spread: team.success })
    };
    let bars: Vec<Bar<'a>> = comparison.teams.iter().filter_map(bar).collect();
    let bars = Bars { about: "share of solved episodes", labels, bars, axis: Axis::SHARE };
    draw_bars(title, &bars).map(Some)
}

/// Draws a bar per group and label, with the range of the seeds as a thin line.
pub fn draw_bars(title: &str, bars: &Bars<'_>) -> Result<String, LearnError> {
    let layout = Layout::new(bars);
    let height = (layout.bottom() + AXIS_HEIGHT) as u32;
    picture(height, title, |canvas| draw(canvas, bars, &layout))
}

/// Where things stand, in pixels.
struct Layout<'a> {
    axis: Axis,
    /// Labels with their place in the order of all, which is that of their colour.
    labels: Vec<(usize, &'a str)>,
    /// The place of each label in the legend.
    keys: Vec<(i32, i32)>,
    groups: Vec<&'a str>,
    left: i32,
    top: i32,
}

impl<'a> Layout<'a> {
    fn new(bars: &Bars<'a>) -> Self {
        let has_bars = |label: usize| bars.bars.iter().any(|bar| bar.label == label);
        let labels = bars.labels.iter().copied().enumerate();
        let mut groups: Vec<&str> = bars.bars.iter().map(|bar| bar.group).collect();
        groups.dedup();
        let widest = groups.iter().map(|group| text_width(group, LABEL_SIZE)).max().unwrap_or(0);
        let labels: Vec<(usize, &str)> = labels.filter(|(label, _)| has_bars(*label)).collect();
        let keys = keys(&labels);
        let top = keys.last().map_or(TITLE_HEIGHT, |(_, middle)| middle + LEGEND_STEP);
        let left = MARGIN + 34 + widest.min(GROUP_ROOM);
        Self { axis: bars.axis, labels, keys, groups, left, top }
    }

    fn group_height(&self) -> i32 {
        self.labels.len() as i32 * BAR + GAP
    }

    fn group_top(&self, group: usize) -> i32 {
        self.top + GAP / 2 + group as i32 * self.group_height()
    }

    fn bottom(&self) -> i32 {
        self.top + self.groups.len() as i32 * self.group_height()
    }

    fn x(&self, number: f64) -> i32 {
        let right = WIDTH as i32 - MARGIN - 16;
        let share = self.axis.share(number);
        self.left + (share * f64::from(right - self.left)).round() as i32
    }
}

fn draw(canvas: &Canvas<'_>, bars: &Bars<'_>, layout: &Layout<'_>) -> Drawn {
    draw_axis(canvas, bars.about, layout)?;
    draw_legend(canvas, layout)?;
    for (row, group) in layout.groups.iter().enumerate() {
        let top = layout.group_top(row);
        let middle = top + layout.labels.len() as i32 * BAR / 2;
        let size = fitting(group, LABEL_SIZE, GROUP_ROOM);
        text(canvas, group, (layout.left - 14, middle), size, INK, HPos::Right)?;
        for (place, (label, _)) in layout.labels.iter().enumerate() {
            let is_meant = |bar: &&Bar<'_>| bar.group == *group && bar.label == *label;
            if let Some(bar) = bars.bars.iter().find(is_meant) {
                draw_bar(canvas, layout, top + place as i32 * BAR, bar)?;
            }
        }
    }
    let base = [(layout.x(0.0), layout.top), (layout.x(0.0), layout.bottom())];
    canvas.draw(&PathElement::new(base, FAINT_INK.stroke_width(2)))
}

fn draw_bar(canvas: &Canvas<'_>, layout: &Layout<'_>, top: i32, bar: &Bar<'_>) -> Drawn {
    let Spread { mean, min, max, .. } = bar.spread;
    let [one, other] = [layout.x(0.0), layout.x(mean)];
    let corners = [(one.min(other), top), (one.max(other), top + BAR - 2)];
    canvas.draw(&Rectangle::new(corners, colour(bar.label).filled()))?;
    if min < max {
        let middle = top + BAR / 2 - 1;
        let range = [(layout.x(min), middle), (layout.x(max), middle)];
        canvas.draw(&PathElement::new(range, INK.stroke_width(2)))?;
    }
    Ok(())
}

fn draw_axis(canvas: &Canvas<'_>, about: &str, layout: &Layout<'_>) -> Drawn {
    let axis = &layout.axis;
    for mark in 0..=axis.steps {
        let x = layout.x(axis.mark(mark));
        let line = [(x, layout.top), (x, layout.bottom())];
        canvas.draw(&PathElement::new(line, GRID.stroke_width(1)))?;
        let place = (x, layout.bottom() + 18);
        text(canvas, &axis.text(mark), place, LABEL_SIZE, INK, HPos::Center)?;
    }
    let middle = (layout.x(axis.mark(0)) + layout.x(axis.mark(axis.steps))) / 2;
    let place = (middle, layout.bottom() + 54);
    text(canvas, about, place, LABEL_SIZE + 2, INK, HPos::Center)?;
    let place = (MARGIN, layout.bottom() + AXIS_HEIGHT - 26);
    text(canvas, CAPTION, place, LABEL_SIZE - 4, FAINT_INK, HPos::Left)
}

fn draw_legend(canvas: &Canvas<'_>, layout: &Layout<'_>) -> Drawn {
    for (key, (index, label)) in layout.keys.iter().zip(&layout.labels) {
        let (left, middle) = *key;
        let corners = [(left, middle - 8), (left + 16, middle + 8)];
        canvas.draw(&Rectangle::new(corners, colour(*index).filled()))?;
        let size = fitting(label, LABEL_SIZE, WIDTH as i32 - 2 * MARGIN - KEY);
        text(canvas, label, (left + KEY, middle), size, INK, HPos::Left)?;
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
    fn an_axis_has_room_for_zero_and_all_numbers_at_round_marks() {
        let of = |numbers: &[f64]| {
            let spreads: Vec<Spread> =
                numbers.iter().filter_map(|number| Spread::of([*number])).collect();
            let axis = Axis::of(spreads.iter());
            (axis.text(0), axis.text(1), axis.text(axis.steps))
        };
        let texts = |[first, second, last]: [&str; 3]| {
            (first.to_owned(), second.to_owned(), last.to_owned())
        };
        assert_eq!(of(&[128.3, -5.4]), texts(["-50", "0", "150"]));
        assert_eq!(of(&[2.0, 1.5]), texts(["0.0", "0.5", "2.0"]));
        assert_eq!(of(&[-1.74]), texts(["-2.0", "-1.5", "0.0"]));
        assert_eq!(of(&[0.0]).0, "0");
    }

    #[test]
    fn bars_of_losses_lead_to_the_left_of_zero() {
        let spread = Spread::of([-30.0, -50.0]).unwrap();
        let bars = vec![Bar { group: "g", label: 0, spread }];
        let axis = Axis::of([spread].iter());
        let bars = Bars { about: "return", labels: vec!["one"], bars, axis };
        let layout = Layout::new(&bars);
        assert!(layout.x(-40.0) < layout.x(0.0) && layout.x(-50.0) >= layout.left);
        let svg = draw_bars("Losses", &bars).unwrap();
        for part in ["Losses", "return", "\ng\n", "-40", "one"] {
            assert!(svg.contains(part), "no `{part}` in {svg}");
        }
    }

    #[test]
    fn without_final_evaluations_there_is_no_picture() {
        let comparison = Comparison::of("t", &[group("bare", vec![run(1, &[(10.0, 0.5)])])]);
        assert_eq!(teams("t", &comparison).unwrap(), None);
    }
}
