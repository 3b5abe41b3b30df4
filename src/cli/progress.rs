//! Bars on standard error while something takes long.

use std::time::Duration;

use console::Term;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use sortie_envs::Step;
use sortie_learn::LearnError;
use sortie_learn::play::{Onlooker, Watched};

use crate::options::Common;
use crate::terminal;

/// A bar over so many things; it shows nothing where nobody looks, or where quiet or JSON was wanted.
pub fn bar(common: Common, length: u64, things: &str) -> ProgressBar {
    let template =
        format!("{{bar:30}} {{human_pos}} of {{human_len}} {things}, {{eta}} left{{msg}}");
    let style = ProgressStyle::with_template(&template).expect("the template is sound");
    let characters = if terminal::is_unicode() { "█▉▊▋▌▍▎▏ " } else { "#- " };
    ProgressBar::with_draw_target(Some(length), target(common))
        .with_style(style.progress_chars(characters))
}

/// What is being done, and for how long, where nobody knows how much of it is left.
pub fn spinner(common: Common) -> ProgressBar {
    const FRAME: Duration = Duration::from_millis(100);
    let spinner = ProgressBar::with_draw_target(None, target(common));
    let style = ProgressStyle::with_template("{spinner} {msg}, {elapsed}");
    let frames = if terminal::is_unicode() { "⠁⠂⠄⡀⢀⠠⠐⠈ " } else { "|/-\\ " };
    spinner.set_style(style.expect("the template is sound").tick_chars(frames));
    spinner.enable_steady_tick(FRAME);
    spinner
}

fn target(common: Common) -> ProgressDrawTarget {
    match common.json || common.quiet || !terminal::redraws(&Term::stderr()) {
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
