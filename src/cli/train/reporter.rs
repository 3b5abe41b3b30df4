//! What a person or a script sees of a run while it learns.

use console::Term;
use indicatif::{HumanCount, ProgressBar, ProgressDrawTarget, ProgressStyle};
use sortie_learn::evaluate::{Evaluation, Score};
use sortie_learn::run::{CurvePoint, Observer, RunResult, TrainingPoint};
use sortie_learn::{Now, Session};

use crate::output::{Common, print_json, say, tell};
use crate::terminal::terminal_curve;

/// Lines of the curve below the progress bar.
const CURVE_HEIGHT: usize = 11;

/// Shows a run while it learns.
pub(super) struct Reporter {
    bar: ProgressBar,
    /// How training itself went lately.
    training: Option<TrainingPoint>,
    /// What says how good the team is.
    score: Score,
    /// Environment steps and score of the evaluations up to now.
    curve: Vec<(f64, f64)>,
    /// Updates of the allocator up to the last evaluation.
    allocator_updates: u64,
    common: Common,
}

impl Reporter {
    pub(super) fn new(session: &Session, common: Common) -> Self {
        let hidden = common.json || common.quiet;
        if !hidden {
            // Before the bar is drawn, which would be left standing above these lines.
            tell_of_allocator(session);
        }
        let target =
            if hidden { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr() };
        let bar =
            ProgressBar::with_draw_target(Some(session.description().config.run.steps), target);
        let style = ProgressStyle::with_template(
            "{bar:20} {percent:>3} % of {human_len} steps, {eta} left\n{msg}",
        );
        bar.set_style(style.expect("the template is a constant"));
        bar.set_position(session.env_steps());
        bar.reset_eta();
        let score = session.score();
        let curve = session.curve().iter().map(|point| place(score, point)).collect();
        let allocator_updates = session.curve().last().map_or(0, |point| point.allocator_updates);
        let reporter = Self { bar, training: None, score, curve, allocator_updates, common };
        reporter.show();
        reporter
    }

    /// Shows the newest figures and the curve below them.
    fn show(&self) {
        let figure = |name: &str, value: Option<f64>, digits: usize| {
            value.map(|value| format!("{name} {value:.digits$}"))
        };
        let training = self.training.as_ref();
        let score = self.curve.last();
        let figures = [
            training.map(|point| format!("{:.0} steps/s", point.steps_per_second)),
            training.and_then(|point| figure("training return", point.return_mean, 2)),
            training.and_then(|point| figure("loss", point.loss, 4)),
            training.and_then(|point| figure("allocator's loss", point.allocator_loss, 4)),
            score.map(|(_, score)| format!("{} {}", self.score.name(), self.score.text(*score))),
        ];
        let mut lines = vec![figures.into_iter().flatten().collect::<Vec<_>>().join("  ")];
        if score.is_some() {
            let width = usize::from(Term::stderr().size().1);
            lines.extend(terminal_curve(&self.curve, self.score, width, CURVE_HEIGHT));
        }
        self.bar.set_message(lines.join("\n"));
    }

    /// An evaluation on one line of at most 80 columns.
    fn line(&self, point: &CurvePoint) -> String {
        let CurvePoint { env_steps, wall_s, timeouts, loss, allocator_loss, .. } = point;
        let losses = if point.updates == 0 {
            "nothing learned yet".to_owned()
        } else if point.allocator_updates == self.allocator_updates {
            format!("loss {loss:.4}")
        } else {
            format!("losses {loss:.3}, {allocator_loss:.3}")
        };
        let came = match self.score {
            Score::Success => format!("success {:.3}  time-outs {timeouts:.3}", point.success),
            Score::Return => format!("return {:8.2}", point.return_mean),
        };
        format!("{env_steps:>8} steps  {wall_s:>5.0} s  {came}  {losses}")
    }
}

impl Drop for Reporter {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// Says when a learned allocator begins its work, of which a short run sees little.
fn tell_of_allocator(session: &Session) {
    let Some([learns, decides]) = session.method().allocator_steps() else { return };
    let steps = session.description().config.run.steps;
    let (learns, decides) = (HumanCount(learns), HumanCount(decides));
    tell!("the allocator learns from step {learns} on and decides from step {decides} on");
    tell!("of two losses the first is the agents', the second the allocator's");
    if decides.0 >= steps {
        let steps = HumanCount(steps);
        tell!("warning: this run ends at step {steps}: its allocator will never have decided");
    }
}

fn place(score: Score, point: &CurvePoint) -> (f64, f64) {
    (point.env_steps as f64, score.pick(point.success, point.return_mean))
}

impl Observer for Reporter {
    fn progress(&mut self, progress: Now) {
        self.bar.set_position(progress.env_steps);
    }

    fn trained(&mut self, point: &TrainingPoint) {
        self.training = Some(*point);
        if !self.bar.is_hidden() {
            self.show();
        }
    }

    fn evaluated(&mut self, point: &CurvePoint) {
        self.curve.push(place(self.score, point));
        self.show();
        if self.common.json {
            print_json(point);
        } else if !self.common.quiet {
            let line = self.line(point);
            self.bar.suspend(|| say!("{line}"));
        }
        self.allocator_updates = point.allocator_updates;
    }

    fn finished(&mut self, result: &RunResult) {
        let RunResult { allocation, evaluation, .. } = result;
        if self.common.json {
            print_json(result);
        } else {
            let under = match allocation.as_str() {
                "none" => String::new(),
                name => format!(" under {name} allocation"),
            };
            let Evaluation { episodes, success, return_mean, return_sd, .. } = evaluation;
            let [low, high] = evaluation.success_ci95;
            let came = match self.score {
                Score::Success => format!("success {success:.3} ({low:.3} to {high:.3})"),
                Score::Return => format!("return {return_mean:.2} (sd {return_sd:.2})"),
            };
            let line = format!("{episodes} fresh episodes{under}: {came}");
            self.bar.suspend(|| say!("{line}"));
        }
    }
}
