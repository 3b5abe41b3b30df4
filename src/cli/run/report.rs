//! What a run ends with: success by team, and latency.

use std::collections::BTreeMap;

use serde::{Serialize, Serializer};
use serde_json::Value;
use sortie_envs::Spec;
use sortie_learn::evaluate::wilson_interval;

use super::figures::{Figures, Since};
use super::onlooker::Onlooker;
use crate::latency::{Latency, Percentiles};
use crate::output::{Table, plural, print_json, say};
use crate::views;
use crate::worlds::tally::{Tally, TeamTally};

/// The summary of a run; scripts rely on its names.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    episodes: usize,
    /// Those of worlds that died: of these the rest of the report knows no more than how they ended.
    episodes_of_dead_worlds: usize,
    success: f64,
    success_ci95: [f64; 2],
    return_mean: f64,
    /// The environment's own.
    #[serde(flatten, serialize_with = "in_order")]
    own: Vec<(&'static str, Value)>,
    #[serde(skip)]
    own_text: String,
    #[serde(skip)]
    has_success: bool,
    by_team: BTreeMap<String, TeamTally>,
    decisions: u64,
    /// Actions of agents for which nobody answered in time, or whose policy refused.
    fallbacks: u64,
    /// Those for which a guard refused what an agent observed.
    guarded: u64,
    /// Agents for which nobody acts at the end: left out of allocations.
    absent: Vec<Absent>,
    decide_us: Percentiles,
    act_us: Percentiles,
    tick_us: Percentiles,
    ticks: u64,
    /// From the first frame to the end of the last step.
    wall_s: f64,
    /// From one frame to the next, and the standard deviation of that.
    interval_us: Percentiles,
    jitter_us: f64,
    /// From the time at which a frame was due to its publishing; absent without a rate.
    delay_us: Option<Percentiles>,
    /// Periods in which no frame came, since the world was late by them.
    skipped_periods: u64,
    /// Ticks that were not over when the next frame was due.
    overrun_ticks: u64,
    /// Ticks a second that the run was held to; absent where it went as fast as the team acts.
    rate_hz: Option<f64>,
    allocation: String,
    backend: String,
    processes: usize,
}

/// How a report is given.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Manner {
    Json,
    Tables,
}

/// Reports what was played, however it ended; nothing where it ended badly before the first episode was over.
pub(super) fn report(
    tally: &Tally,
    spec: &Spec,
    onlooker: &Onlooker,
    setup: Setup,
    manner: Manner,
    has_ended_well: bool,
) {
    if !has_ended_well && tally.episodes == 0 {
        return;
    }
    let report = Report::new((tally, spec), onlooker.earlier, &onlooker.figures, setup);
    match manner {
        Manner::Json => print_json(&report),
        Manner::Tables => report.print(&onlooker.figures),
    }
}

/// What the report says of the run's set-up.
pub(super) struct Setup {
    pub(super) allocation: String,
    pub(super) backend: String,
    pub(super) rate_hz: Option<f64>,
}

impl Report {
    fn new(
        (tally, spec): (&Tally, &Spec),
        earlier: usize,
        figures: &Figures,
        setup: Setup,
    ) -> Self {
        let Tally { episodes, solved, returns, .. } = *tally;
        let own = views::figures(spec, tally);
        Self {
            episodes,
            episodes_of_dead_worlds: earlier,
            success: solved as f64 / episodes.max(1) as f64,
            success_ci95: wilson_interval(solved, episodes),
            return_mean: returns / episodes.max(1) as f64,
            own: own.fields,
            own_text: own.text,
            has_success: spec.has_success,
            by_team: tally.by_team.clone(),
            decisions: figures.decisions,
            fallbacks: figures.fallbacks,
            guarded: figures.guarded,
            absent: figures.absent.iter().map(|one| Absent::new(one, earlier)).collect(),
            decide_us: figures.decide.percentiles(),
            act_us: figures.act.percentiles(),
            tick_us: figures.tick.percentiles(),
            ticks: figures.tick.samples(),
            wall_s: figures.wall_seconds(),
            interval_us: figures.interval.percentiles(),
            jitter_us: figures.jitter.deviation() / 1000.0,
            delay_us: setup.rate_hz.map(|_| figures.delay.percentiles()),
            skipped_periods: figures.skipped,
            overrun_ticks: figures.overran,
            rate_hz: setup.rate_hz,
            allocation: setup.allocation,
            backend: setup.backend,
            processes: figures.processes.len(),
        }
    }

    fn print(&self, figures: &Figures) {
        let over = format!("{}, {}", plural(self.episodes, "episode"), self.allocated());
        let returned = format!("mean return {:.1}", self.return_mean);
        let own = if self.own_text.is_empty() { "" } else { ", " };
        if self.has_success {
            let [low, high] = self.success_ci95;
            let interval = format!("95 % interval {low:.2} to {high:.2}");
            say!("\nsuccess {:.2} ({interval}) over {over}", self.success);
            say!("{}{own}{returned}\n", self.own_text);
            self.print_teams();
            say!();
        } else {
            say!("\n{returned} over {over}");
            say!("{}\n", self.own_text);
        }
        let guarded = match self.guarded {
            0 => String::new(),
            guarded => format!(" ({guarded} by guards)"),
        };
        say!(
            "{}, {}, {}{guarded}",
            plural(self.processes, "process"),
            plural(self.decisions as usize, "decision"),
            plural(self.fallbacks as usize, "fallback action"),
        );
        say!("{:.2} s, pace {}\n", self.wall_s, self.pace());
        if !self.absent.is_empty() {
            self.absent.iter().for_each(|absent| say!("{absent}"));
            say!();
        }
        if self.episodes_of_dead_worlds > 0 {
            say!(
                "a world died: of the first {} figures below know nothing\n",
                plural(self.episodes_of_dead_worlds, "episode")
            );
        }
        let mut latency = Table::new(&["latency, us", "p50", "p99", "p99.9", "max", "samples"]);
        latency.row(latency_row("one decision", self.decide_us, &figures.decide));
        latency.row(latency_row("observation to action", self.act_us, &figures.act));
        latency.row(latency_row("whole tick", self.tick_us, &figures.tick));
        if let Some(delay) = self.delay_us {
            latency.row(latency_row("frame after due", delay, &figures.delay));
        }
        latency.row(latency_row("frame to frame", self.interval_us, &figures.interval));
        latency.print();
    }

    fn print_teams(&self) {
        let mut teams = Table::new(&["team", "episodes", "solved"]);
        for (team, report) in &self.by_team {
            teams.row([team.clone(), report.episodes.to_string(), report.solved.to_string()]);
        }
        teams.print();
    }

    fn allocated(&self) -> String {
        match self.allocation.as_str() {
            "none" => "without allocation".to_string(),
            name => format!("{name} allocation"),
        }
    }

    fn pace(&self) -> String {
        match self.rate_hz {
            Some(rate) => format!(
                "{rate} ticks a second: {} skipped, {} over {} period, jitter {:.1} us",
                plural(self.skipped_periods as usize, "period"),
                plural(self.overrun_ticks as usize, "tick"),
                if self.overrun_ticks == 1 { "its" } else { "their" },
                self.jitter_us
            ),
            None => "as fast as the team acts".to_string(),
        }
    }
}

/// An agent for which nobody acts.
#[derive(Debug, Serialize)]
struct Absent {
    agent: usize,
    /// Since when: the episode, from 1, and its step, from 0.
    episode: usize,
    step: u32,
}

impl Absent {
    fn new((agent, since): (&usize, &Since), earlier: usize) -> Self {
        Self { agent: *agent, episode: earlier + since.episode as usize + 1, step: since.step }
    }
}

impl std::fmt::Display for Absent {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { agent, episode, step } = self;
        write!(
            f,
            "agent {agent} is absent since step {step} of episode {episode}: nobody acts for it"
        )
    }
}

/// As a map, which sorts nothing.
fn in_order<S: Serializer>(
    fields: &[(&'static str, Value)],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    serializer.collect_map(fields.iter().map(|(name, value)| (name, value)))
}

fn latency_row(name: &str, shown: Percentiles, latency: &Latency) -> [String; 6] {
    let figure = |us: f64| format!("{us:.1}");
    [
        name.to_string(),
        figure(shown.p50),
        figure(shown.p99),
        shown.p999.map_or("-".to_string(), figure),
        figure(shown.max),
        latency.samples().to_string(),
    ]
}
