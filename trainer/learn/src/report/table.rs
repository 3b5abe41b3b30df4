//! A comparison as text: Markdown and CSV.

use std::collections::BTreeSet;

use super::numbers::{count, duration};
use super::{Comparison, GroupSummary, Reached, Spread};
use crate::evaluate::Score;

impl Comparison {
    /// A document with the tables and the notes.
    pub fn markdown(&self) -> String {
        let mut text = format!("# {}\n\n{}", self.title, self.success_table());
        text += "\nMean ± standard deviation over the runs, and their range in brackets.\n\n";
        text += &self.effort_table();
        if !self.teams.is_empty() {
            text += "\n## Success by team\n\n";
            let cells = self.teams.iter();
            let cells = cells.map(|s| (s.team.as_str(), s.label.as_str(), share(s.success)));
            text += &grid("team", cells);
        }
        if !self.causes.is_empty() {
            text += "\n## Why episodes failed\n\nShare of all episodes.\n\n";
            let cells = self.causes.iter();
            let cells = cells.map(|s| (s.cause.as_str(), s.label.as_str(), share(s.share)));
            text += &grid("cause", cells);
        }
        if !self.notes.is_empty() {
            text += "\n## Notes\n\n";
            text.extend(self.notes.iter().map(|note| format!("- {note}\n")));
        }
        text
    }

    fn success_table(&self) -> String {
        let metrics: BTreeSet<&str> =
            self.groups.iter().flat_map(|group| group.metrics.keys()).map(String::as_str).collect();
        let score = self.score;
        let mut header: Vec<String> = ["method", "runs", score.name()].map(str::to_owned).into();
        header.extend(metrics.iter().map(|name| escaped(&name.replace('_', " "))));
        if score == Score::Success {
            header.extend(["time-outs", "return"].map(str::to_owned));
        }
        header.push("steps an episode".to_owned());
        table(
            &header,
            self.groups.iter().map(|group| {
                let spread = |spread: Option<Spread>, score| {
                    spread.map_or(String::new(), |spread| spread_text(spread, score))
                };
                let share = |of: Option<Spread>| spread(of, Score::Success);
                let plain = |spread: Option<Spread>| {
                    spread.map_or(String::new(), |s| format!("{:.1}", s.mean))
                };
                let came = spread(group.of_score(score), score);
                let own = [escaped(&group.label), group.runs.to_string(), came];
                let metrics = metrics.iter().map(|name| share(group.metrics.get(*name).copied()));
                let mut cells: Vec<String> = own.into_iter().chain(metrics).collect();
                if score == Score::Success {
                    cells.extend([share(group.timeouts), plain(group.return_mean)]);
                }
                cells.push(plain(group.length_mean));
                cells
            }),
        )
    }

    fn effort_table(&self) -> String {
        let levels = self.levels();
        let mut header =
            vec!["method".to_owned(), "steps".into(), "CPU time".into(), "wall time".into()];
        for level in &levels {
            header.push(format!("steps until {level}"));
            header.push(format!("CPU time until {level}"));
        }
        let row = |group: &GroupSummary| {
            let mut cells = vec![
                escaped(&group.label),
                count(group.env_steps.mean),
                duration(group.cpu_s.mean),
                duration(group.wall_s.mean),
            ];
            for level in &levels {
                let Some(until) = group.until.get(*level) else {
                    cells.extend([String::new(), String::new()]);
                    continue;
                };
                let part = |reached: Option<Reached>, show: fn(f64) -> String| {
                    reached.map_or("never".to_owned(), |r| {
                        reached_text(r, until.reached, group.runs, show)
                    })
                };
                cells.push(part(until.env_steps, count));
                cells.push(part(until.cpu_s, duration));
            }
            cells
        };
        table(&header, self.groups.iter().map(row))
    }
}

/// `0.731 ± 0.020 (0.712–0.752)`, or the value alone of one run.
fn share(spread: Spread) -> String {
    spread_text(spread, Score::Success)
}

/// The same of any score.
fn spread_text(Spread { mean, sd, min, max }: Spread, score: Score) -> String {
    let [mean, min, max] = [mean, min, max].map(|value| score.text(value));
    match sd {
        Some(sd) => format!("{mean} ± {} ({min}–{max})", score.text(sd)),
        None => mean,
    }
}

/// `150 k (100 k–200 k)`, and how many runs reached it, where not all did.
fn reached_text(reached: Reached, runs: usize, of: usize, show: fn(f64) -> String) -> String {
    let mut text = show(reached.mean);
    if reached.min < reached.max {
        text += &format!(" ({}–{})", show(reached.min), show(reached.max));
    }
    if runs < of {
        text += &format!(", {runs} of {of} runs");
    }
    text
}

fn table<H: AsRef<str>>(header: &[H], rows: impl Iterator<Item = Vec<String>>) -> String {
    let line = |cells: Vec<&str>| format!("| {} |\n", cells.join(" | "));
    let mut text = line(header.iter().map(AsRef::as_ref).collect());
    text += &line(
        header.iter().enumerate().map(|(i, _)| if i == 0 { "---" } else { "---:" }).collect(),
    );
    for row in rows {
        text += &line(row.iter().map(String::as_str).collect());
    }
    text
}

/// A table of a row per name and a column per label, of cells (name, label, text).
fn grid<'a>(corner: &str, cells: impl Iterator<Item = (&'a str, &'a str, String)>) -> String {
    let cells: Vec<_> = cells.collect();
    let (mut names, mut labels) = (Vec::new(), Vec::new());
    for (name, label, _) in &cells {
        if !names.contains(name) {
            names.push(*name);
        }
        if !labels.contains(label) {
            labels.push(*label);
        }
    }
    let header = std::iter::once(corner.to_owned()).chain(labels.iter().map(|l| escaped(l)));
    let text = |name: &str, label: &str| {
        let cell = cells.iter().find(|(n, l, _)| *n == name && *l == label);
        cell.map_or(String::new(), |(_, _, text)| text.clone())
    };
    let row = |name: &&str| {
        let texts = labels.iter().map(|label| text(name, label));
        std::iter::once((*name).to_owned()).chain(texts).collect()
    };
    table(&header.collect::<Vec<_>>(), names.iter().map(row))
}

/// Text that stays within its cell.
fn escaped(text: &str) -> String {
    text.replace('|', "\\|")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::comparison::tests::evaluated;
    use crate::report::group::tests::{group, run};
    use crate::report::to_csv;

    fn comparison() -> Comparison {
        let alma = vec![evaluated(1, 0.5, &[("ab", 5)]), evaluated(2, 0.75, &[("ab", 7)])];
        let other = vec![run(1, &[(100.0, 0.25)])];
        Comparison::of("A title", &[group("alma", alma), group("a|b", other)])
    }

    #[test]
    fn the_document_has_every_table() {
        let text = comparison().markdown();
        for line in [
            "# A title",
            "| alma | 2 | 0.625 ± 0.177 (0.500–0.750) | 0.750 ± 0.000 (0.750–0.750) | 0.125 ± 0.000 (0.125–0.125) |  | 60.0 |",
            "| a\\|b | 1 | 0.250 |  |  |  |  |",
            "| method | steps | CPU time | wall time | steps until 0.60 | CPU time until 0.60 | steps until 0.80 | CPU time until 0.80 |",
            "| alma | 300 | 0.3 s | 0.6 s | 200 | 0.2 s | never | never |",
            "| burned_late | 0.100 ± 0.000 (0.100–0.100) |",
            "| ab | 0.600 ± 0.141 (0.500–0.700) |",
        ] {
            assert!(text.lines().any(|other| other == line), "{line}\n\n{text}");
        }
    }

    #[test]
    fn returns_stand_where_success_would() {
        let mut run = run(1, &[(100.0, 0.25)]);
        run.score = Score::Return;
        let comparison = Comparison::of("t", &[group("maac", vec![run])]);
        let text = comparison.markdown();
        for line in ["| method | runs | return | steps an episode |", "| maac | 1 | 25.00 |  |"] {
            assert!(text.lines().any(|other| other == line), "{line}\n\n{text}");
        }
        assert!(!text.contains("until") && !text.contains("team"), "{text}");
    }

    #[test]
    fn the_columns_of_the_csv_are_the_figures() {
        let text = to_csv(&comparison().groups).unwrap();
        let lines: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
        let cell = |row: usize, name: &str| {
            let column = lines[0].iter().position(|other| *other == name).expect(name);
            lines[row][column]
        };
        assert_eq!(cell(1, "label"), "alma");
        assert_eq!(cell(1, "runs"), "2");
        assert_eq!(cell(1, "success_mean"), "0.625");
        assert_eq!(cell(1, "until_0.60_env_steps_max"), "200.0");
        assert_eq!(cell(2, "success_sd"), "");
        assert_eq!(to_csv(&comparison().teams).unwrap().lines().count(), 2);
    }
}
