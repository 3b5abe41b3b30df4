//! Success by team, as bars side by side.

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::{
    Canvas, Drawn, FAINT_INK, GRID, INK, MARGIN, TITLE_HEIGHT, WIDTH, colour, picture, text,
    text_width,
};
use crate::error::LearnError;
use crate::report::{Comparison, Spread, TeamSummary};

const LABEL_SIZE: i32 = 20;
/// Thickness of a bar and pixels between the teams.
const BAR: i32 = 13;
const GAP: i32 = 14;
/// Height of the strip with the legend, and of that with the axis.
const LEGEND_HEIGHT: i32 = 40;
const AXIS_HEIGHT: i32 = 84;

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
    teams: Vec<&'a str>,
    left: i32,
}

impl<'a> Layout<'a> {
    fn new(comparison: &'a Comparison) -> Self {
        let has_teams = |label: &str| comparison.teams.iter().any(|team| team.label == label);
        let labels = comparison.groups.iter().map(|group| group.label.as_str()).enumerate();
        let mut teams: Vec<&str> = comparison.teams.iter().map(|team| team.team.as_str()).collect();
        teams.dedup();
        let widest = teams.iter().map(|team| text_width(team, LABEL_SIZE)).max().unwrap_or(0);
        Self {
            labels: labels.filter(|(_, label)| has_teams(label)).collect(),
            teams,
            left: MARGIN + 34 + widest.min(400),
        }
    }

    fn top() -> i32 {
        TITLE_HEIGHT + LEGEND_HEIGHT
    }

    fn team_height(&self) -> i32 {
        self.labels.len() as i32 * BAR + GAP
    }

    fn team_top(&self, team: usize) -> i32 {
        Self::top() + GAP / 2 + team as i32 * self.team_height()
    }

    fn bottom(&self) -> i32 {
        Self::top() + self.teams.len() as i32 * self.team_height()
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
        text(canvas, team, (layout.left - 14, middle), LABEL_SIZE, INK, HPos::Right)?;
        for (place, (index, label)) in layout.labels.iter().enumerate() {
            let is_meant = |s: &&TeamSummary| s.team == *team && s.label == *label;
            if let Some(summary) = comparison.teams.iter().find(is_meant) {
                draw_bar(canvas, layout, top + place as i32 * BAR, summary.success, *index)?;
            }
        }
    }
    let base = [(layout.left, Layout::top()), (layout.left, layout.bottom())];
    canvas.draw(&PathElement::new(base, FAINT_INK.stroke_width(2)))
}

fn draw_bar(
    canvas: &Canvas<'_>,
    layout: &Layout<'_>,
    top: i32,
    success: Spread,
    index: usize,
) -> Drawn {
    let corners = [(layout.left, top), (layout.x(success.mean), top + BAR - 1)];
    canvas.draw(&Rectangle::new(corners, colour(index).filled()))?;
    if success.min < success.max {
        let middle = top + BAR / 2;
        let range = [(layout.x(success.min), middle), (layout.x(success.max), middle)];
        canvas.draw(&PathElement::new(range, WHITE.stroke_width(5)))?;
        canvas.draw(&PathElement::new(range, INK.stroke_width(2)))?;
    }
    Ok(())
}

fn draw_axis(canvas: &Canvas<'_>, layout: &Layout<'_>) -> Drawn {
    for tenth in (0..=10).step_by(2) {
        let x = layout.x(f64::from(tenth) / 10.0);
        let line = [(x, Layout::top()), (x, layout.bottom())];
        canvas.draw(&PathElement::new(line, GRID.stroke_width(1)))?;
        let label = format!("{:.1}", f64::from(tenth) / 10.0);
        text(canvas, &label, (x, layout.bottom() + 18), LABEL_SIZE, INK, HPos::Center)?;
    }
    let place = (layout.x(0.5), layout.bottom() + 54);
    text(canvas, "share of solved episodes", place, LABEL_SIZE + 2, INK, HPos::Center)
}

fn draw_legend(canvas: &Canvas<'_>, layout: &Layout<'_>) -> Drawn {
    let mut left = MARGIN;
    for (index, label) in &layout.labels {
        let middle = TITLE_HEIGHT + LEGEND_HEIGHT / 2 - 8;
        let corners = [(left, middle - 8), (left + 16, middle + 8)];
        canvas.draw(&Rectangle::new(corners, colour(*index).filled()))?;
        text(canvas, label, (left + 26, middle), LABEL_SIZE, INK, HPos::Left)?;
        left += 26 + text_width(label, LABEL_SIZE) + 24;
    }
    Ok(())
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
    fn without_final_evaluations_there_is_no_picture() {
        let comparison = Comparison::of("t", &[group("bare", vec![run(1, &[(10.0, 0.5)])])]);
        assert_eq!(teams("t", &comparison).unwrap(), None);
    }
}
