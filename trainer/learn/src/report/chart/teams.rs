//! Success by team, as bars side by side.

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::{
    Canvas, Drawn, FAINT_INK, GRID, INK, MARGIN, TITLE_HEIGHT, WIDTH, colour, fitting, picture,
    text, text_width,
};
use crate::error::LearnError;
use crate::report::{Comparison, Spread, TeamSummary};

const LABEL_SIZE: i32 = 20;
/// The widest name of a team at its usual size.
const TEAM_ROOM: i32 = 400;
/// Thickness of a bar and pixels between the teams.
const BAR: i32 = 14;
const GAP: i32 = 14;
/// Height of a line of the legend, and pixels from a key to its label.
const LEGEND_STEP: i32 = 34;
const KEY: i32 = 26;
/// Height of the strip with the axis and the caption.
const AXIS_HEIGHT: i32 = 116;
const CAPTION: &str = "Bars: mean of the runs. Thin lines: from the worst run to the best.";

/// Draws a bar per team and label, with the range of the seeds as a thin line; none where no label
/// has a final evaluation.
pub fn teams(title: &str, comparison: &Comparison) -> Result<Option<String>, LearnError> {
    if comparison.teams.is_empty() {
        return Ok(None);
    }
    let layout = Layout::new(comparison);
    let height = (layout.bottom() + AXIS_HEIGHT) as u32;
    picture(height, title, |canvas| draw(canvas, comparison, &layout)).map(Some)
}

/// Where things stand, in pixels.
struct Layout<'a> {
    /// Labels with their place in the order of all, which is that of their colour.
    labels: Vec<(usize, &'a str)>,
    /// The place of each label in the legend.
    keys: Vec<(i32, i32)>,
    teams: Vec<&'a str>,
    left: i32,
    top: i32,
}

impl<'a> Layout<'a> {
    fn new(comparison: &'a Comparison) -> Self {
        let has_teams = |label: &str| comparison.teams.iter().any(|team| team.label == label);
        let labels = comparison.groups.iter().map(|group| group.label.as_str()).enumerate();
        let mut teams: Vec<&str> = comparison.teams.iter().map(|team| team.team.as_str()).collect();
        teams.dedup();
        let widest = teams.iter().map(|team| text_width(team, LABEL_SIZE)).max().unwrap_or(0);
        let labels: Vec<(usize, &str)> = labels.filter(|(_, label)| has_teams(label)).collect();
        let keys = keys(&labels);
        let top = keys.last().map_or(TITLE_HEIGHT, |(_, middle)| middle + LEGEND_STEP);
        Self { labels, keys, teams, left: MARGIN + 34 + widest.min(TEAM_ROOM), top }
    }

    fn team_height(&self) -> i32 {
        self.labels.len() as i32 * BAR + GAP
    }

    fn team_top(&self, team: usize) -> i32 {
        self.top + GAP / 2 + team as i32 * self.team_height()
    }

    fn bottom(&self) -> i32 {
        self.top + self.teams.len() as i32 * self.team_height()
    }

    fn x(&self, share: f64) -> i32 {
        let right = WIDTH as i32 - MARGIN - 16;
        self.left + (share * f64::from(right - self.left)).round() as i32
    }
}

fn draw(canvas: &Canvas<'_>, comparison: &Comparison, layout: &Layout<'_>) -> Drawn {
    draw_axis(canvas, layout)?;
    draw_legend(canvas, layout)?;
    for (row, team) in layout.teams.iter().enumerate() {
        let top = layout.team_top(row);
        let middle = top + layout.labels.len() as i32 * BAR / 2;
        let size = fitting(team, LABEL_SIZE, TEAM_ROOM);
        text(canvas, team, (layout.left - 14, middle), size, INK, HPos::Right)?;
        for (place, (index, label)) in layout.labels.iter().enumerate() {
            let is_meant = |s: &&TeamSummary| s.team == *team && s.label == *label;
            if let Some(summary) = comparison.teams.iter().find(is_meant) {
                draw_bar(canvas, layout, top + place as i32 * BAR, summary.success, *index)?;
            }
        }
    }
    let base = [(layout.left, layout.top), (layout.left, layout.bottom())];
    canvas.draw(&PathElement::new(base, FAINT_INK.stroke_width(2)))
}

fn draw_bar(
    canvas: &Canvas<'_>,
    layout: &Layout<'_>,
    top: i32,
    success: Spread,
    index: usize,
) -> Drawn {
    let corners = [(layout.left, top), (layout.x(success.mean), top + BAR - 2)];
    canvas.draw(&Rectangle::new(corners, colour(index).filled()))?;
    if success.min < success.max {
        let middle = top + BAR / 2 - 1;
        let range = [(layout.x(success.min), middle), (layout.x(success.max), middle)];
        canvas.draw(&PathElement::new(range, INK.stroke_width(2)))?;
    }
    Ok(())
}

fn draw_axis(canvas: &Canvas<'_>, layout: &Layout<'_>) -> Drawn {
    for tenth in (0..=10).step_by(2) {
        let x = layout.x(f64::from(tenth) / 10.0);
        let line = [(x, layout.top), (x, layout.bottom())];
        canvas.draw(&PathElement::new(line, GRID.stroke_width(1)))?;
        let label = format!("{:.1}", f64::from(tenth) / 10.0);
        text(canvas, &label, (x, layout.bottom() + 18), LABEL_SIZE, INK, HPos::Center)?;
    }
    let place = (layout.x(0.5), layout.bottom() + 54);
    text(canvas, "share of solved episodes", place, LABEL_SIZE + 2, INK, HPos::Center)?;
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
    fn without_final_evaluations_there_is_no_picture() {
        let comparison = Comparison::of("t", &[group("bare", vec![run(1, &[(10.0, 0.5)])])]);
        assert_eq!(teams("t", &comparison).unwrap(), None);
    }
}
