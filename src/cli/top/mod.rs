//! `sortie top`: who runs, leads, is late and fell back, while it happens.

mod lines;
mod metrics;
mod overview;
mod regret;
mod seat;
mod server;
mod team;
#[cfg(test)]
mod tests;
mod window;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use clap::Args;
use console::Term;
use sortie_core::link::Clock;
use sortie_ipc::{Domain, MonotonicClock, Stop};
use sortie_stage::rounded;

use crate::failure::{Failure, Outcome};
use crate::listener::Listener;
use crate::output::{self, print_json, say, tell};
use crate::screen::{Keyboard, Screen};
use crate::terminal::{redraws, stop_on_signals};
use lines::View;
use overview::Overview;
use regret::Judge;
use team::Team;

/// How often the terminal shows something else, and what is served changes.
const REFRESH: Duration = Duration::from_millis(250);

/// Watch a running team: who is there, leads, is late and fell back, and who works on what
///
/// On a terminal it is a screen: space holds it still, arrows scroll, q quits. Elsewhere it is one table. Figures are of the
/// last ten seconds, as far as somebody has listened. The team does not wait for who watches.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie top
  sortie top --bundle models/save-the-city        # with the regret of allocations
  sortie top --domain north --json                # once, after two seconds
  sortie top --json --follow --for 1              # a line a second
  sortie top --serve                              # a page and /metrics on http://127.0.0.1:9100
  sortie top --prometheus > team.prom             # once, for a collector of text files")]
pub(crate) struct TopArguments {
    /// Domain of the team
    #[arg(long, env = "SORTIE_DOMAIN", default_value = "default")]
    domain: String,
    /// The team's bundle, whose network tells how far allocations are from the best that it knows
    #[arg(long, value_name = "FOLDER")]
    bundle: Option<PathBuf>,
    /// Print JSON for scripts instead of text
    #[arg(long)]
    json: bool,
    /// Print the same numbers in the text format of Prometheus
    #[arg(long, conflicts_with = "json")]
    prometheus: bool,
    /// Serve a page at / and Prometheus' text at /metrics; a port alone is open to this machine only
    #[arg(
        long,
        value_name = "[ADDRESS:]PORT",
        value_parser = server::address,
        num_args = 0..=1,
        default_missing_value = "9100",
        conflicts_with_all = ["json", "prometheus"]
    )]
    serve: Option<SocketAddr>,
    /// Print a line of JSON after each such time, until the team ends
    #[arg(long, requires = "json")]
    follow: bool,
    /// How long to listen before something is printed
    #[arg(long = "for", value_name = "SECONDS", default_value = "2", value_parser = seconds)]
    span: Duration,
}

fn seconds(text: &str) -> Result<Duration, String> {
    let seconds = text.parse().ok().filter(|seconds| (0.1..=3600.0).contains(seconds));
    seconds.map(Duration::from_secs_f64).ok_or_else(|| "expected 0.1 to 3600".to_owned())
}

pub(crate) fn run(arguments: &TopArguments) -> Outcome {
    let stop = stop_on_signals()?;
    let mut watch = Watch::enter(&arguments.domain, arguments.bundle.as_deref(), stop)?;
    if let Some(address) = arguments.serve {
        return serve(&mut watch, address);
    }
    if arguments.follow {
        return follow(&mut watch, arguments.span);
    }
    let is_for_people = !arguments.json && !arguments.prometheus;
    if is_for_people && redraws(&Term::stdout()) {
        return show(&mut watch);
    }
    watch.listen(arguments.span)?;
    let team = watch.overview();
    if arguments.json {
        print_json(&team);
    } else if arguments.prometheus {
        say!("{}", metrics::text(&team).trim_end());
    } else {
        lines::all(&team).iter().for_each(|line| say!("{line}"));
    }
    Ok(())
}

/// Somebody who listens to a team until it ends, or until they are stopped.
struct Watch {
    listener: Listener,
    team: Team,
    /// Where a bundle tells what allocations are worth.
    judge: Option<Judge>,
    stop: Stop,
    is_over: bool,
}

impl Watch {
    fn enter(domain: &str, bundle: Option<&Path>, stop: Stop) -> Result<Self, Failure> {
        let domain = Domain::new(domain)?;
        let listener = Listener::enter(&domain, "top")?;
        let team = Team::new(domain.id(), listener.facts(), MonotonicClock.now_ns())?;
        let judge = bundle.map(|folder| Judge::open(folder, listener.facts())).transpose()?;
        Ok(Self { listener, team, judge, stop, is_over: false })
    }

    /// Listens for so long. Returns whether there is more to come.
    fn listen(&mut self, span: Duration) -> Result<bool, Failure> {
        let until_ns = MonotonicClock.now_ns().saturating_add(span.as_nanos() as u64);
        let (team, judge, is_over) = (&mut self.team, &mut self.judge, &mut self.is_over);
        loop {
            self.listener.look(&mut |heard, now_ns| {
                judge.iter_mut().for_each(|judge| judge.hear(heard, now_ns));
                *is_over |= team.hear(heard, now_ns);
            })?;
            let left_ns = until_ns.saturating_sub(MonotonicClock.now_ns());
            *is_over |= self.stop.is_set() || self.listener.is_alone();
            if *is_over || left_ns == 0 {
                return Ok(!*is_over);
            }
            self.listener.wait(REFRESH.min(Duration::from_nanos(left_ns)));
        }
    }

    fn overview(&self) -> Overview {
        let mut overview = self.team.overview(MonotonicClock.now_ns());
        let worth = self.judge.as_ref().and_then(Judge::worth);
        if let Some(allocation) = &mut overview.allocation {
            allocation.value = worth.map(|worth| rounded(worth.value));
            allocation.regret = worth.map(|worth| rounded(worth.regret));
        }
        overview
    }
}

fn show(watch: &mut Watch) -> Outcome {
    let keyboard = Keyboard::open(&watch.stop);
    let (mut screen, mut view) = (Screen::new(), View::default());
    let mut shown = watch.overview();
    while watch.listen(REFRESH)? {
        let is_held = keyboard.as_ref().map(Keyboard::is_paused);
        if is_held != Some(true) {
            shown = watch.overview();
        }
        view.scroll(keyboard.as_ref().map_or(0, Keyboard::take_scrolled));
        screen.show(|canvas| view.lines(&shown, canvas, is_held));
    }
    // The terminal is as it was before something else is told there.
    drop(keyboard);
    if !watch.stop.is_set() {
        tell!("the team has ended");
    }
    Ok(())
}

fn follow(watch: &mut Watch, span: Duration) -> Outcome {
    while watch.listen(span)? {
        print_json(&watch.overview());
        output::check()?;
    }
    Ok(())
}

fn serve(watch: &mut Watch, address: SocketAddr) -> Outcome {
    let shared = Arc::new(Mutex::new(watch.overview()));
    let bound = server::serve(address, Arc::clone(&shared))?;
    say!("http://{bound}/ and http://{bound}/metrics, until the team ends, or Ctrl-C");
    while watch.listen(REFRESH)? {
        *shared.lock().unwrap_or_else(PoisonError::into_inner) = watch.overview();
    }
    Ok(())
}
