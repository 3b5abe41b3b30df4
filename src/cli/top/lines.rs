//! A team as lines of text, for a terminal and for those who have none.

use sortie_pages::Canvas;

use super::overview::{Agent, Overview, Process, Standing};
use crate::output::{Table, plural};

/// What a terminal has at least, and what it takes to show all columns.
const LEAST: (usize, usize) = (80, 24);
const WIDE: usize = 110;
/// From when on a process is called silent, which tells of itself ten times a second.
const SILENT_MS: u64 = 1000;
/// Letters of a model's id, and of an action's name.
const MODEL: usize = 8;
const ACTION: usize = 10;

/// What is seen of a team where there is not room for all of it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct View {
    /// Lines below the first that can be seen of processes and agents.
    scrolled: usize,
}

impl View {
    pub(super) fn scroll(&mut self, lines: isize) {
        self.scrolled = self.scrolled.saturating_add_signed(lines);
    }

    /// All that a terminal shows, and what keys do: none where none are heard, else whether the screen is held.
    pub(super) fn lines(
        &mut self,
        team: &Overview,
        canvas: Canvas,
        is_held: Option<bool>,
    ) -> Vec<String> {
        // A canvas is what can be written on: a column and a line of the terminal stay free.
        let (columns, rows) = (canvas.width + 1, canvas.lines + 1);
        if columns < LEAST.0 || rows < LEAST.1 {
            let (width, height) = LEAST;
            return vec![format!("{width} by {height} are needed, here are {columns} by {rows}")];
        }
        let mut lines = head(team);
        let body = body(team, columns >= WIDE);
        let room = canvas.lines - lines.len() - 1;
        let most = body.len().saturating_sub(room);
        self.scrolled = self.scrolled.min(most);
        let below = most - self.scrolled;
        lines.extend(body.into_iter().skip(self.scrolled).take(room));
        lines.push(hint(is_held, self.scrolled, below));
        lines
    }
}

/// All of it, however long.
pub(super) fn all(team: &Overview) -> Vec<String> {
    [head(team), body(team, false)].concat()
}

fn hint(is_held: Option<bool>, above: usize, below: usize) -> String {
    let keys = match is_held {
        None => "Ctrl-C ends it",
        Some(true) => "HELD: space goes on, q quits, arrows scroll",
        Some(false) => "space holds, q quits, arrows scroll",
    };
    match above + below {
        0 => keys.to_owned(),
        _ => format!("{keys}: {above} lines above, {below} below"),
    }
}

fn head(team: &Overview) -> Vec<String> {
    let mut place = format!("domain {}", team.domain);
    if let Some(environment) = &team.environment {
        place += &format!(", {environment}");
    }
    let frame = team.frame.map_or("no frames for all".to_owned(), |frame| {
        format!("tick {}, episode {}, step {}", frame.tick, frame.episode, frame.step)
    });
    let mut lines = vec![format!("{place}: {frame}"), leader(team), rate(team)];
    lines.extend(worth(team));
    lines.push(String::new());
    lines
}

/// Who allocates, and how old what agents act on is.
fn leader(team: &Overview) -> String {
    let leads = |it: &&Process| it.role == "allocator" && it.leads_in_term.is_some();
    let leader = match team.processes.iter().find(leads) {
        Some(it) => format!("allocator {} leads", on_host(it.pid, it.host)),
        None => "no allocator leads".to_owned(),
    };
    let Some(newest) = team.allocation else { return leader };
    format!(
        "{leader}, term {}: {:.1} a second, newest {} old, took {:.0} us",
        newest.term,
        newest.per_s,
        plural(newest.age_ticks as usize, "tick"),
        newest.decide_us
    )
}

/// A process by its id, and where it is not the world's host, by that host's number.
fn on_host(pid: u32, host: u16) -> String {
    if host == 0 { pid.to_string() } else { format!("{pid}@{host}") }
}

/// How far a recent allocation is from the best.
fn worth(team: &Overview) -> Option<String> {
    let allocation = team.allocation?;
    let (value, regret) = allocation.value.zip(allocation.regret)?;
    Some(format!(
        "allocated to {value:.3}; regret, beside the best that the search finds: {regret:.3}"
    ))
}

fn rate(team: &Overview) -> String {
    let wanted = team.rate_hz.map_or(String::new(), |wanted| format!(" of {wanted}"));
    let missed = plural(team.missed_total as usize, "message");
    let mut line = format!(
        "{:.1}{wanted} ticks a second in the last {:.0} s, {missed} missed",
        team.ticks_per_s, team.window_s
    );
    let is_paused = team.frame.is_some_and(|frame| frame.paused);
    for (word, is_so) in [(", PAUSED", is_paused), (", DEGRADED", team.degraded)] {
        line += if is_so { word } else { "" };
    }
    line
}

fn body(team: &Overview, is_wide: bool) -> Vec<String> {
    [processes(team, is_wide), vec![String::new()], agents(team, is_wide)].concat()
}

fn processes(team: &Overview, is_wide: bool) -> Vec<String> {
    let more = if is_wide { &["runs", "up s"][..] } else { &[] };
    let header = [&["process", "pid", "agents", "leads", "state", "model"], more].concat();
    let mut table = Table::of_text(&header);
    for it in &team.processes {
        let leads = it.leads_in_term.map_or("-".to_owned(), |term| format!("term {term}"));
        let model = it.model.chars().take(MODEL).collect::<String>();
        let mut row = vec![
            format!("{:9}", it.role),
            format!("{:>7}", on_host(it.pid, it.host)),
            format!("{:9}", listed(&it.agents)),
            format!("{leads:7}"),
            format!("{:13}", state(it)),
            if model.is_empty() { "-".to_owned() } else { model },
        ];
        if is_wide {
            let network = if it.model.is_empty() { "-" } else { "plan" };
            row.push(if it.graph { "graph" } else { network }.to_owned());
            row.push(it.up_s.to_string());
        }
        table.row(row);
    }
    table.lines()
}

fn state(it: &Process) -> String {
    match it.silent_ms {
        ..SILENT_MS => "there".to_owned(),
        silent_ms => format!("silent {:.1} s", silent_ms as f64 / 1e3),
    }
}

/// Numbers, those in a row as their first and last.
fn listed(agents: &[usize]) -> String {
    let runs = agents.chunk_by(|one, next| one + 1 == *next);
    let run = |run: &[usize]| match run {
        [first, .., last] => format!("{first}-{last}"),
        _ => run.iter().map(usize::to_string).collect(),
    };
    let listed = runs.map(run).collect::<Vec<_>>().join(" ");
    if listed.is_empty() { "-".to_owned() } else { listed }
}

fn agents(team: &Overview, is_wide: bool) -> Vec<String> {
    let figures = ["subtask", "utility", "fallback", "late", "p50 us", "p99 us", "pid"];
    let more = if is_wide { &["asked", "fell back", "was late"][..] } else { &[] };
    let header = [&["agent", "action"], &figures[..], more].concat();
    let mut table = Table::new(&header).with_texts(2);
    for it in &team.agents {
        let decide = it.decide_us;
        let mut row = vec![
            it.agent.to_string(),
            format!("{:ACTION$}", action(it)),
            told(it.subtask),
            format!("{:>7}", told(it.utility.map(|utility| format!("{utility:.2}")))),
            percent(it.fallback_share),
            format!("{:>6}", percent(it.late_share)),
            format!("{:>6}", told(decide.map(|decide| format!("{:.0}", decide.p50)))),
            format!("{:>6}", told(decide.map(|decide| format!("{:.0}", decide.p99)))),
            format!("{:>7}", told(it.process.zip(it.host).map(|(pid, host)| on_host(pid, host)))),
        ];
        if is_wide {
            let totals = [it.asked_total, it.fallbacks_total, it.late_total];
            row.extend(totals.map(|total| format!("{total:>8}")));
        }
        table.row(row);
    }
    table.lines()
}

/// What it does, by its name or its number, or why it does nothing.
fn action(it: &Agent) -> String {
    match (it.standing, &it.action_name) {
        (Standing::Absent, _) => "ABSENT".to_owned(),
        (Standing::Missing, _) => "none".to_owned(),
        (Standing::Plays, Some(name)) => console::truncate_str(name, ACTION, "+").into_owned(),
        (Standing::Plays, None) => told(it.action),
    }
}

fn told(value: Option<impl ToString>) -> String {
    value.map_or("-".to_owned(), |value| value.to_string())
}

fn percent(share: Option<f64>) -> String {
    told(share.map(|share| format!("{:.1} %", 100.0 * share)))
}
