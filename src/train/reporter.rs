//! What a person or a script sees of a run while it learns.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use sortie_learn::methods::alma::{Observer, Progress, Trainer};
use sortie_learn::run::{CurvePoint, RunResult};

use crate::arguments::Common;
use crate::output::print_json;

/// Shows a run while it learns.
pub(super) struct Reporter {
    bar: ProgressBar,
    common: Common,
}

impl Reporter {
    pub(super) fn new(trainer: &Trainer, common: Common) -> Self {
        let hidden = common.json || common.quiet;
        let target =
            if hidden { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr() };
        let bar =
            ProgressBar::with_draw_target(Some(trainer.description().config.run.steps), target);
        let style = ProgressStyle::with_template(
            "{bar:30} {percent:>3} % of {human_len} steps, {eta} left, {msg}",
        );
        bar.set_style(style.expect("the template is a constant"));
        bar.set_message("success not measured yet");
        bar.set_position(trainer.env_steps());
        bar.reset_eta();
        Self { bar, common }
    }

    /// Clears the progress bar.
    pub(super) fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

impl Observer for Reporter {
    fn progress(&mut self, progress: &Progress) {
        self.bar.set_position(progress.env_steps);
    }

    fn evaluated(&mut self, point: &CurvePoint) {
        self.bar.set_message(format!("success {:.3}", point.success));
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
            self.bar.suspend(|| println!("{line}"));
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
            self.bar.suspend(|| println!("{line}"));
        }
    }
}
