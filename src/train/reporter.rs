//! What a person or a script sees of a run while it learns.

use console::Term;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use sortie_learn::methods::Trainer;
use sortie_learn::run::{CurvePoint, Observer, Progress, RunResult};

use crate::arguments::Common;
use crate::output::{print_json, say};
use crate::terminal_curve::terminal_curve;

/// Lines of the curve below the progress bar.
const CURVE_HEIGHT: usize = 11;

/// Shows a run while it learns.
pub(super) struct Reporter {
    bar: ProgressBar,
    /// Environment steps and success of the evaluations up to now.
    curve: Vec<(f64, f64)>,
    common: Common,
}

impl Reporter {
    pub(super) fn new(trainer: &Trainer, common: Common) -> Self {
        let hidden = common.json || common.quiet;
        let target =
            if hidden { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr() };
        let bar = ProgressBar::with_draw_target(Some(trainer.steps()), target);
        let style = ProgressStyle::with_template(
            "{bar:30} {percent:>3} % of {human_len} steps, {eta} left, {msg}",
        );
        bar.set_style(style.expect("the template is a constant"));
        bar.set_position(trainer.env_steps());
        bar.reset_eta();
        let curve = trainer.curve().iter().map(place).collect();
        let reporter = Self { bar, curve, common };
        reporter.show_curve();
        reporter
    }

    /// Puts the newest success beside the progress bar and the curve below it.
    fn show_curve(&self) {
        let Some((_, success)) = self.curve.last() else {
            self.bar.set_message("success not measured yet");
            return;
        };
        let width = usize::from(Term::stderr().size().1);
        let mut lines = vec![format!("success {success:.3}")];
        lines.extend(terminal_curve(&self.curve, width, CURVE_HEIGHT));
        self.bar.set_message(lines.join("\n"));
    }

    /// Clears the progress bar.
    pub(super) fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

fn place(point: &CurvePoint) -> (f64, f64) {
    (point.env_steps as f64, point.success)
}

impl Observer for Reporter {
    fn progress(&mut self, progress: &Progress) {
        self.bar.set_position(progress.env_steps);
    }

    fn evaluated(&mut self, point: &CurvePoint) {
        self.curve.push(place(point));
        self.show_curve();
        if self.common.json {
            print_json(point);
        } else if !self.common.quiet {
            let line = format!(
                "{:>9} steps  {:>6.0} s  {:>6.0} CPU s  success {:.3}  time-outs {:.3}  loss {:.4}  allocator {:.4}",
                point.env_steps,
                point.wall_s,
                point.cpu_s,
                point.success,
                point.timeouts,
                point.loss,
                point.allocator_loss
            );
            self.bar.suspend(|| say!("{line}"));
        }
    }

    fn finished(&mut self, result: &RunResult) {
        let RunResult { allocation, evaluation, .. } = result;
        let [low, high] = evaluation.success_ci95;
        if self.common.json {
            print_json(result);
        } else if !self.common.quiet {
            let line = format!(
                "{} fresh episodes under {allocation} allocation: success {:.3} ({low:.3} to {high:.3})",
                evaluation.episodes, evaluation.success
            );
            self.bar.suspend(|| say!("{line}"));
        }
    }
}
