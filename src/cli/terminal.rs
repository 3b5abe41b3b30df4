//! What a terminal can show: colours, bars while something takes long, a learning curve as text; and its Ctrl-C.

use std::env;
use std::time::Duration;

use clap::ValueEnum;
use console::Term;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use sortie_envs::Step;
use sortie_ipc::Stop;
use sortie_learn::LearnError;
use sortie_learn::evaluate::Score;
use sortie_learn::play::{Onlooker, Watched};
use sortie_learn::report::numbers::count;

use crate::failure::{Exit, Failure};
use crate::output::Common;

/// When output has colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum Color {
    /// On a terminal, unless NO_COLOR is set or TERM is `dumb`
    #[default]
    Auto,
    /// In pipes and files too
    Always,
    /// Nowhere
    Never,
}

impl Color {
    /// Has everything that this program draws follow.
    pub(crate) fn apply(self) {
        match self {
            Self::Auto => {}
            Self::Always | Self::Never => {
                console::set_colors_enabled(self == Self::Always);
                console::set_colors_enabled_stderr(self == Self::Always);
            }
        }
    }
}

/// Whether pictures and bars may change in place there: no paper, no pipe, no terminal that only writes lines.
pub(crate) fn redraws(terminal: &Term) -> bool {
    terminal.is_term() && env::var_os("TERM").is_some_and(|name| name != "dumb")
}

/// Whether the locale's characters are Unicode.
pub(crate) fn is_unicode() -> bool {
    let set = |name| env::var(name).ok().filter(|value| !value.is_empty());
    is_unicode_locale(["LC_ALL", "LC_CTYPE", "LANG"].into_iter().find_map(set).as_deref())
}

/// Containers seldom set a locale, and nearly every terminal shows Unicode: it takes a locale that says otherwise.
fn is_unicode_locale(locale: Option<&str>) -> bool {
    locale.is_none_or(|locale| {
        let locale = locale.to_ascii_lowercase();
        locale.contains("utf-8") || locale.contains("utf8")
    })
}

/// Characters of a line in tables and lists for people: those of the terminal, at most what is easily read.
pub(crate) fn line_width() -> usize {
    const READABLE: usize = 100;
    usize::from(Term::stdout().size().1).clamp(40, READABLE)
}

/// A bar over so many things; it shows nothing where nobody looks, or where quiet or JSON was wanted.
pub fn bar(common: Common, length: u64, things: &str) -> ProgressBar {
    let template =
        format!("{{bar:30}} {{human_pos}} of {{human_len}} {things}, {{eta}} left{{msg}}");
    let style = ProgressStyle::with_template(&template).expect("the template is sound");
    let characters = if is_unicode() { "█▉▊▋▌▍▎▏ " } else { "#- " };
    ProgressBar::with_draw_target(Some(length), target(common))
        .with_style(style.progress_chars(characters))
}

/// What is being done, and for how long, where nobody knows how much of it is left.
pub fn spinner(common: Common) -> ProgressBar {
    const FRAME: Duration = Duration::from_millis(100);
    let spinner = ProgressBar::with_draw_target(None, target(common));
    let style = ProgressStyle::with_template("{spinner} {msg}, {elapsed}");
    let frames = if is_unicode() { "⠁⠂⠄⡀⢀⠠⠐⠈ " } else { "|/-\\ " };
    spinner.set_style(style.expect("the template is sound").tick_chars(frames));
    spinner.enable_steady_tick(FRAME);
    spinner
}

fn target(common: Common) -> ProgressDrawTarget {
    match common.json || common.quiet || !redraws(&Term::stderr()) {
        true => ProgressDrawTarget::hidden(),
        false => ProgressDrawTarget::stderr(),
    }
}

/// Counts finished episodes on a bar, and passes all on to another onlooker.
pub struct CountedEpisodes<'a> {
    pub bar: &'a ProgressBar,
    pub next: &'a mut dyn Onlooker,
}

impl Onlooker for CountedEpisodes<'_> {
    fn started(&mut self, watched: Watched<'_>) -> Result<(), LearnError> {
        self.next.started(watched)
    }

    fn stepped(
        &mut self,
        watched: Watched<'_>,
        actions: &[u16],
        outcome: &Step,
    ) -> Result<(), LearnError> {
        if outcome.done() {
            self.bar.inc(1);
        }
        self.next.stepped(watched, actions, outcome)
    }
}

/// Braille characters have two columns and four rows of dots.
const DOTS: (usize, usize) = (2, 4);
/// The dots of a braille character by row, for its left and its right column.
const BITS: [[u8; 4]; 2] = [[0x01, 0x02, 0x04, 0x40], [0x08, 0x10, 0x20, 0x80]];

/// Draws a score against environment steps, in ascending order, on so many lines of so many characters; two of the
/// lines are the axis.
///
/// Too little room gives no line at all.
pub(crate) fn terminal_curve(
    points: &[(f64, f64)],
    score: Score,
    width: usize,
    height: usize,
) -> Vec<String> {
    let Some((end, _)) = points.last() else { return Vec::new() };
    let [low, high] = score.range(points.iter().map(|(_, value)| *value));
    let places = usize::from(high - low < 10.0);
    let labels =
        [0.0, 0.5, 1.0].map(|share| (share, format!("{:.places$}", low + share * (high - low))));
    // A label, a space and the axis.
    let left = labels.iter().map(|(_, label)| label.len()).max().unwrap_or(0) + 2;
    if width < left + 30 || height < 5 {
        return Vec::new();
    }
    let shares: Vec<(f64, f64)> =
        points.iter().map(|(x, value)| (*x, (value - low) / (high - low))).collect();
    let mut plot = Plot::new(width - left, height - 2);
    plot.draw(&shares, end.max(f64::MIN_POSITIVE));
    let mut lines = plot.lines(&labels, left);
    lines.extend(axis(*end, left, width - left));
    lines
}

/// Characters of dots, row by row.
struct Plot {
    width: usize,
    height: usize,
    cells: Vec<u8>,
}

impl Plot {
    fn new(width: usize, height: usize) -> Self {
        Self { width, height, cells: vec![0; width * height] }
    }

    /// The row of dots of a share, from the top.
    fn dot_row(&self, share: f64) -> usize {
        let last = self.height * DOTS.1 - 1;
        ((1.0 - share.clamp(0.0, 1.0)) * last as f64).round() as usize
    }

    fn draw(&mut self, points: &[(f64, f64)], end: f64) {
        let last = self.width * DOTS.0 - 1;
        let place = |(x, share): &(f64, f64)| ((x / end).clamp(0.0, 1.0) * last as f64, *share);
        let mut before = points.first().map(place);
        for (x, share) in points.iter().map(place) {
            let (from_x, from_share) = before.replace((x, share)).unwrap_or((x, share));
            self.draw_segment((from_x, from_share), (x, share));
        }
    }

    /// Every column from one place to another, its dots joined to those of the column before.
    fn draw_segment(&mut self, from: (f64, f64), to: (f64, f64)) {
        let columns = from.0.round() as usize..=to.0.round() as usize;
        let mut row_before = self.dot_row(from.1);
        for column in columns {
            let along =
                if to.0 > from.0 { (column as f64 - from.0) / (to.0 - from.0) } else { 1.0 };
            let row = self.dot_row(from.1 + along.clamp(0.0, 1.0) * (to.1 - from.1));
            for row in row.min(row_before)..=row.max(row_before) {
                self.set(column, row);
            }
            row_before = row;
        }
    }

    fn set(&mut self, column: usize, row: usize) {
        let cell = row / DOTS.1 * self.width + column / DOTS.0;
        self.cells[cell] |= BITS[column % DOTS.0][row % DOTS.1];
    }

    /// The lines, with labels at their shares in so many characters before them.
    fn lines(&self, labels: &[(f64, String)], left: usize) -> Vec<String> {
        let line = |(row, cells): (usize, &[u8])| {
            let mut labels = labels.iter();
            let label = labels.find(|(share, _)| self.dot_row(*share) / DOTS.1 == row);
            let (label, rule) = label.map_or(("", '│'), |(_, label)| (label, '┤'));
            let left = format!("{label:>0$} {rule}", left - 2);
            let dots: String = cells.iter().map(|cell| braille(*cell)).collect();
            left + dots.trim_end()
        };
        self.cells.chunks(self.width).enumerate().map(line).collect()
    }
}

/// The character of some dots; none of them is a space, which every font has.
fn braille(dots: u8) -> char {
    if dots == 0 { ' ' } else { char::from_u32(0x2800 + u32::from(dots)).unwrap_or(' ') }
}

/// The horizontal axis, and what it means.
fn axis(end: f64, left: usize, width: usize) -> [String; 2] {
    let middle = width / 2;
    let rule = |column| match column {
        column if column == middle || column + 1 == width => '┴',
        _ => '─',
    };
    let line = format!("{:>left$}", '└') + &(0..width).map(rule).collect::<String>();
    let (half, whole) = (count(end / 2.0), format!("{} steps", count(end)));
    let before_half = left + middle - half.chars().count() / 2;
    let before_whole = (left + width).saturating_sub(whole.chars().count());
    let first = format!("{:left$}0", "");
    let labels = format!("{first:<before_half$}{half}");
    [line, format!("{labels:<before_whole$}{whole}")]
}

/// A flag that the first signal sets; one that comes half a second later, or after that, ends the program at once.
pub fn stop_on_signals() -> Result<Stop, Failure> {
    stop_saying("")
}

/// The same; these words are told as soon as the signal comes.
pub fn stop_saying(words: &'static str) -> Result<Stop, Failure> {
    Stop::on_signals_saying(words)
        .map_err(|error| Failure::new(Exit::InputOutput, format!("signal handlers: {error}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_locale_that_says_so_is_not_unicode() {
        for unicode in [None, Some("C.UTF-8"), Some("de_DE.utf8"), Some("en_US.UTF-8")] {
            assert!(is_unicode_locale(unicode), "{unicode:?}");
        }
        for other in ["C", "POSIX", "de_DE.ISO-8859-1"] {
            assert!(!is_unicode_locale(Some(other)), "{other}");
        }
    }

    #[test]
    fn a_rising_curve_goes_from_the_lower_left_to_the_upper_right() {
        let lines = terminal_curve(&[(0.0, 0.0), (1e6, 1.0)], Score::Success, 40, 7);
        let expected = "\
1.0 ┤                            ⢀⣀⡤⠤⠖⠒⠋
    │                     ⣀⣀⡤⠤⠖⠚⠉⠉
0.5 ┤              ⣀⣠⠤⠴⠒⠚⠉⠁
    │      ⢀⣀⣠⠤⠖⠒⠋⠉⠁
0.0 ┤⣀⡤⠤⠖⠒⠋⠉
    └─────────────────┴────────────────┴
     0              500 k      1 M steps";
        assert_eq!(lines.join("\n"), expected, "\n{}", lines.join("\n"));
    }

    #[test]
    fn returns_reach_from_the_lowest_to_the_highest() {
        let lines = terminal_curve(&[(0.0, -8.0), (1e6, 128.0)], Score::Return, 40, 7);
        let labels: Vec<&str> = lines.iter().map(|line| line.split(' ').next().unwrap()).collect();
        assert_eq!(labels[0], "128");
        assert!(lines[2].starts_with(" 60 ┤") && lines[4].starts_with(" -8 ┤⣀"), "{lines:?}");
    }

    #[test]
    fn every_line_fits() {
        let points: Vec<(f64, f64)> =
            (1..200).map(|i| (f64::from(i) * 5e3, f64::from(i * 37 % 100) / 99.0)).collect();
        for (width, height) in [(35, 5), (80, 11), (211, 12)] {
            for score in [Score::Success, Score::Return] {
                let lines = terminal_curve(&points, score, width + 1, height);
                assert_eq!(lines.len(), height);
                let fits = lines.iter().all(|line| line.chars().count() <= width + 1);
                assert!(fits, "{}", lines.join("\n"));
            }
        }
    }

    #[test]
    fn one_point_is_a_dot_and_none_is_nothing() {
        let dots = |lines: &[String]| {
            lines.iter().flat_map(|line| line.chars()).filter(|c| ('⠁'..='⣿').contains(c)).count()
        };
        assert_eq!(dots(&terminal_curve(&[(50.0, 0.5)], Score::Success, 60, 8)), 1);
        assert_eq!(dots(&terminal_curve(&[(0.0, f64::NAN)], Score::Success, 60, 8)), 1);
        assert!(terminal_curve(&[], Score::Return, 60, 8).is_empty());
        assert!(terminal_curve(&[(50.0, 0.5)], Score::Success, 10, 8).is_empty());
    }
}
