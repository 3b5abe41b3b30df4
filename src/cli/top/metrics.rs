//! The same numbers in the text format of Prometheus.

use std::fmt::{Display, Write};

use super::overview::{Agent, Allocated, Overview, Process, Standing};

/// What it is sent as.
pub(super) const MEDIA_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";

/// A text that grows by families, each with its samples.
#[derive(Default)]
struct Text(String);

/// What a sample is of.
type Labels<'a> = &'a [(&'a str, &'a dyn Display)];

impl Text {
    /// Begins the samples of a name. What only grows is called a total, and is a counter; all else are gauges.
    fn family(&mut self, name: &str, help: &str) {
        let kind = if name.ends_with("_total") { "counter" } else { "gauge" };
        self.0 += &format!("# HELP sortie_{name} {help}\n# TYPE sortie_{name} {kind}\n");
    }

    fn sample(&mut self, name: &str, labels: Labels<'_>, value: f64) {
        let labels = labels.iter().map(|(name, value)| format!("{name}=\"{}\"", escaped(value)));
        let labels = labels.collect::<Vec<_>>().join(",");
        let labels = if labels.is_empty() { labels } else { format!("{{{labels}}}") };
        // A string takes whatever is written.
        let _ = writeln!(self.0, "sortie_{name}{labels} {value}");
    }

    /// A family of one sample.
    fn single(&mut self, name: &str, help: &str, value: f64) {
        self.family(name, help);
        self.sample(name, &[], value);
    }

    /// One of a sample for each agent of which there is something to tell.
    fn by_agent(
        &mut self,
        agents: &[Agent],
        name: &str,
        help: &str,
        value: impl Fn(&Agent) -> Option<f64>,
    ) {
        self.family(name, help);
        for it in agents {
            if let Some(value) = value(it) {
                self.sample(name, &[("agent", &it.agent)], value);
            }
        }
    }
}

/// A label's value as it stands between quotes.
fn escaped(value: &dyn Display) -> String {
    value.to_string().replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

/// What Prometheus reads.
pub(super) fn text(team: &Overview) -> String {
    let mut text = Text::default();
    of_team(&mut text, team);
    of_processes(&mut text, &team.processes);
    of_agents(&mut text, &team.agents);
    text.0
}

fn of_team(text: &mut Text, team: &Overview) {
    let [environment, allocator] =
        [&team.environment, &team.allocator].map(|it| it.as_deref().unwrap_or_default());
    let labels: Labels<'_> =
        &[("domain", &team.domain), ("environment", &environment), ("allocator", &allocator)];
    text.family("team_info", "What the domain runs.");
    text.sample("team_info", labels, 1.0);
    text.single("ticks_total", "Ticks since somebody listens.", team.ticks_total as f64);
    let missed = "Messages that came and went before they were read.";
    text.single("missed_messages_total", missed, team.missed_total as f64);
    text.single("window_seconds", "What rates, ratios and quantiles cover.", team.window_s);
    text.single("ticks_per_second", "Ticks a second in the window.", team.ticks_per_s);
    let degraded = "Whether agents have had no allocation for too long.";
    text.single("degraded", degraded, truth(team.degraded));
    if let Some(frame) = team.frame {
        text.single("episode", "Episode of the newest frame.", frame.episode.into());
        text.single("step", "Step of the episode.", frame.step.into());
        text.single("paused", "Whether the world stands still.", truth(frame.paused));
    }
    if let Some(allocation) = &team.allocation {
        of_allocation(text, allocation);
    }
}

fn of_allocation(text: &mut Text, it: &Allocated) {
    text.single("allocations_total", "Allocations since somebody listens.", it.total as f64);
    let rate = "Allocations a second in the window.";
    text.single("allocations_per_second", rate, it.per_s);
    let age = "Time since the newest allocation was made.";
    text.single("allocation_age_seconds", age, it.age_s);
    let age = "Ticks since the frame that the newest allocation was made for.";
    text.single("allocation_age_ticks", age, it.age_ticks as f64);
    let decide = "How long the newest allocation took.";
    text.single("allocation_decide_seconds", decide, it.decide_us / 1e6);
    if let (Some(value), Some(regret)) = (it.value, it.regret) {
        text.single("allocation_value", "What its network expects of a recent allocation.", value);
        let more = "By how much more it expects of the best allocation that its search finds.";
        text.single("allocation_regret", more, regret);
    }
}

fn of_processes(text: &mut Text, processes: &[Process]) {
    text.family("process_info", "Who is there.");
    for it in processes {
        let labels: Labels<'_> =
            &[("pid", &it.pid), ("host", &it.host), ("role", &it.role), ("model", &it.model)];
        text.sample("process_info", labels, 1.0);
    }
    text.family("process_silent_seconds", "Time since a process has told of itself.");
    for it in processes {
        let labels: Labels<'_> = &[("pid", &it.pid), ("host", &it.host), ("role", &it.role)];
        text.sample("process_silent_seconds", labels, it.silent_ms as f64 / 1e3);
    }
    text.family("leader_term", "Term of who leads its role.");
    for it in processes {
        if let Some(term) = it.leads_in_term {
            let labels: Labels<'_> = &[("pid", &it.pid), ("host", &it.host), ("role", &it.role)];
            text.sample("leader_term", labels, term.into());
        }
    }
}

fn of_agents(text: &mut Text, agents: &[Agent]) {
    let asked = "Ticks that asked the agent for an action.";
    text.by_agent(agents, "agent_asked_total", asked, |it| Some(it.asked_total as f64));
    let fallbacks = "Those in which it did not do what its policy decided.";
    text.by_agent(agents, "agent_fallbacks_total", fallbacks, |it| Some(it.fallbacks_total as f64));
    let guarded = "Those in which a guard refused what it observed.";
    text.by_agent(agents, "agent_guarded_total", guarded, |it| Some(it.guarded_total as f64));
    let late = "Those that were answered after the deadline.";
    text.by_agent(agents, "agent_late_total", late, |it| Some(it.late_total as f64));
    let fallbacks = "Share of fallbacks in the window.";
    text.by_agent(agents, "agent_fallback_ratio", fallbacks, |it| it.fallback_share);
    let late = "Share of late answers in the window.";
    text.by_agent(agents, "agent_late_ratio", late, |it| it.late_share);
    let absent = "Whether nobody acts for the agent.";
    text.by_agent(agents, "agent_absent", absent, |it| match it.standing {
        Standing::Missing => None,
        standing => Some(truth(standing == Standing::Absent)),
    });
    let subtask = "Number of the subtask that the agent acts for.";
    text.by_agent(agents, "agent_subtask", subtask, |it| it.subtask.map(f64::from));
    let utility = "Utility of its newest action.";
    text.by_agent(agents, "agent_utility", utility, |it| it.utility.map(f64::from));
    of_decisions(text, agents);
}

fn of_decisions(text: &mut Text, agents: &[Agent]) {
    text.family("agent_decide_seconds", "How long a decision takes, in the window.");
    for it in agents {
        let Some(decide) = it.decide_us else { continue };
        for (quantile, us) in [("0.5", decide.p50), ("0.99", decide.p99)] {
            let labels: Labels<'_> = &[("agent", &it.agent), ("quantile", &quantile)];
            text.sample("agent_decide_seconds", labels, us / 1e6);
        }
    }
}

fn truth(is_so: bool) -> f64 {
    f64::from(u8::from(is_so))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_escaped() {
        let mut text = Text::default();
        text.sample("it", &[("of", &"a\"b\\c\nd"), ("and", &7)], 0.5);
        assert_eq!(text.0, "sortie_it{of=\"a\\\"b\\\\c\\nd\",and=\"7\"} 0.5\n");
    }
}
