//! The reasons of one decision, for people and for scripts.

use serde::Serialize;
use sortie_bundle::ContractV1;
use sortie_core::wire::{ActionMsg, AllocMsg, FrameView};
use sortie_core::{AllocateError, AllocationState, DecideError, NO_ACTION, UNASSIGNED};
use sortie_stage::{Attention, Thought, rounded};

use crate::output::{Table, say};
use crate::views::probes::{OfState, team_on};

/// Whom a person is told of, of all that an agent attends to.
const TOLD: usize = 8;

/// Why an agent did what it did.
#[derive(Debug, Serialize)]
pub(super) struct Reasons {
    agent: u16,
    tick: u32,
    world_term: u32,
    episode: u32,
    step: u32,
    action: Option<String>,
    utility: Option<f32>,
    /// The subtask that it acted for.
    task: Option<u8>,
    /// Its policy refused.
    fallback: bool,
    /// Why it did, or its guard.
    refused_for: Option<String>,
    /// It was sent after the deadline.
    late: bool,
    /// From the frame to the answer.
    answered_us: f64,
    /// How many of the entities are agents: the first ones.
    agents: usize,
    /// What it could do, the best first.
    actions: Vec<Choice>,
    /// Whom it attended to, weights of all heads, the highest first.
    attention: Vec<Attention>,
    /// What it saw of itself, without zeros.
    features: Vec<(String, f32)>,
    allocation: Option<Allocated>,
}

/// An action that was available.
#[derive(Debug, Serialize)]
struct Choice {
    action: String,
    utility: f64,
}

/// The allocation that the agent acted on.
#[derive(Debug, Serialize)]
pub(super) struct Allocated {
    tick: u32,
    term: u32,
    epoch: u32,
    /// A fallback rule made it.
    heuristic: bool,
    /// What the network expects of all teams together; none where no network values teams.
    value: Option<f64>,
    /// By how much more it expects of the best allocation that the search finds by it.
    regret: Option<f64>,
    /// Open subtasks.
    tasks: Vec<Place>,
}

/// An open subtask, and what the network expects of it.
#[derive(Debug, Serialize)]
struct Place {
    task: usize,
    team: Vec<usize>,
    /// Of this team; none where no network values teams.
    value: Option<f64>,
    /// By how much all values together would be more were the agent here instead; none where it is, or finds no room.
    instead: Option<f64>,
}

impl Allocated {
    /// By what is asked of the team's network, if it has one that values teams, and by what the allocation and the best one are
    /// worth by it.
    pub(super) fn new(
        allocation: &AllocMsg,
        state: &AllocationState<'_>,
        (agent, team_max): (u16, usize),
        (mut values, worth): (Option<&mut OfState<'_>>, Option<[f64; 2]>),
    ) -> Result<Self, AllocateError> {
        let team_of = |task: usize| team_on(task, &allocation.task, state);
        let own = allocation.task.get(usize::from(agent)).copied().unwrap_or(UNASSIGNED);
        let itself = 1_u64 << agent;
        let mut ask = |task: usize, team: u64| match &mut values {
            Some(values) => Ok(values(task, &[team])?.first().copied().map(f64::from)),
            None => Ok(None),
        };
        // What its own subtask loses where it goes elsewhere.
        let left = usize::from(own);
        let loss = match own {
            UNASSIGNED => Some(0.0),
            _ => {
                let (with, without) =
                    (ask(left, team_of(left))?, ask(left, team_of(left) & !itself)?);
                with.zip(without).map(|(with, without)| with - without)
            }
        };
        let mut tasks = Vec::new();
        for task in (0..state.tasks).filter(|task| state.open_tasks >> task & 1 == 1) {
            let team = team_of(task);
            let value = ask(task, team)?;
            let has_room = task != left && (team.count_ones() as usize) < team_max;
            let joined = if has_room { ask(task, team | itself)? } else { None };
            let gain = joined.zip(value).map(|(joined, value)| joined - value);
            let instead = gain.zip(loss).map(|(gain, loss)| rounded(gain - loss));
            let team = (0..state.agents).filter(|member| team >> member & 1 == 1).collect();
            tasks.push(Place { task, team, value: value.map(rounded), instead });
        }
        Ok(Self {
            tick: allocation.tick as u32,
            term: allocation.term,
            epoch: allocation.epoch,
            heuristic: allocation.flags & AllocMsg::HEURISTIC != 0,
            value: worth.map(|[value, _]| rounded(value)),
            regret: worth.map(|[value, best]| rounded(best - value)),
            tasks,
        })
    }

    fn print(&self) {
        let Self { tick, term, epoch, heuristic, value, regret, tasks } = self;
        let by = if *heuristic { ", by a fallback rule" } else { "" };
        say!();
        say!("allocation {epoch} of term {term}, of tick {tick}{by}");
        let mut table = Table::new(&["subtask", "team", "value", "with it instead"]);
        for Place { task, team, value, instead } in tasks {
            let team: Vec<String> = team.iter().map(ToString::to_string).collect();
            let figure = |value: Option<f64>, sign: &str| match value {
                Some(value) if sign.is_empty() => format!("{value:.3}"),
                Some(value) => format!("{value:+.3}"),
                None => "-".to_owned(),
            };
            let cells =
                [task.to_string(), team.join(" "), figure(*value, ""), figure(*instead, "+")];
            table.row(cells);
        }
        table.print();
        if let (Some(value), Some(regret)) = (value, regret) {
            say!(
                "all subtasks: {value:.3}; regret, beside the best that the search finds: {regret:.3}"
            );
        }
    }
}

impl Reasons {
    pub(super) fn new(
        contract: &ContractV1,
        (answer, view): (&ActionMsg, &FrameView<'_>),
        heard: Option<Result<Thought, DecideError>>,
        allocation: Option<Allocated>,
    ) -> Self {
        let header = view.header();
        let agent = usize::from(answer.agent);
        let name = |action: usize| match contract.action_names.get(action) {
            Some(name) => name.clone(),
            None => format!("action {action}"),
        };
        let heard = heard.unwrap_or_else(|| Ok(nothing()));
        let refusal = heard.as_ref().err().copied();
        let Thought { utilities, mut attention, .. } = heard.unwrap_or_else(|_| nothing());
        let available = view.available(agent).iter().zip(utilities).enumerate();
        let available = available.filter(|(_, (code, _))| **code != 0);
        let choice = |(action, (_, utility))| Choice { action: name(action), utility };
        let mut actions: Vec<Choice> = available.map(choice).collect();
        actions.sort_by(|one, other| other.utility.total_cmp(&one.utility));
        attention.sort_by(|one, other| mean(other).total_cmp(&mean(one)));
        let row = view.rows().get(agent * view.stride()..).unwrap_or_default();
        let features = contract.feature_names.iter().zip(row).filter(|(_, value)| **value != 0.0);
        Self {
            agent: answer.agent,
            tick: answer.tick as u32,
            world_term: header.world_term,
            episode: header.episode,
            step: view.step(),
            action: (answer.action != NO_ACTION).then(|| name(answer.action.into())),
            utility: Some(answer.q).filter(|utility| utility.is_finite()),
            task: Some(answer.task).filter(|task| *task != UNASSIGNED),
            fallback: answer.has(ActionMsg::FALLBACK),
            refused_for: refusal.map(|error| in_words(error, contract, view)),
            late: answer.has(ActionMsg::LATE),
            answered_us: answer.t_ns.saturating_sub(header.t_ns) as f64 / 1e3,
            agents: view.agents(),
            actions,
            attention,
            features: features.map(|(name, value)| (name.clone(), *value)).collect(),
            allocation,
        }
    }

    pub(super) fn print(&self) {
        let Self { agent, tick, episode, step, .. } = self;
        say!("agent {agent} in tick {tick} (episode {episode}, step {step})");
        let action = self.action.as_deref().unwrap_or("nothing, for nothing was available");
        let task = self.task.map_or(String::new(), |task| format!(", for subtask {task}"));
        say!("did: {action}{task}, {:.0} us after its frame", self.answered_us);
        if self.fallback {
            let why = self.refused_for.as_ref().map_or(String::new(), |why| format!(" ({why})"));
            say!("its policy refused{why}: this is what its fallback does");
        }
        if self.late {
            say!("that was after the deadline");
        }
        let choices = self.actions.iter();
        let choices = choices.map(|Choice { action, utility }| format!("{action} {utility:.3}"));
        list("utilities", choices.collect());
        let attended = self.attention.iter().take(TOLD);
        let attended = attended.map(|it| {
            let what = if it.entity < self.agents { "agent" } else { "entity" };
            format!("{what} {} {:.2}", it.entity, mean(it))
        });
        list("attended to", attended.collect());
        let features = self.features.iter().map(|(name, value)| format!("{name} {value}"));
        list("saw of itself", features.collect());
        if let Some(allocation) = &self.allocation {
            allocation.print();
        }
    }
}

/// A refusal, with the feature by its name where it is about one.
fn in_words(error: DecideError, contract: &ContractV1, view: &FrameView<'_>) -> String {
    let DecideError::BeyondGuards { entity, feature } = error else { return error.to_string() };
    let value = view.rows().get(entity * view.stride() + feature);
    let (Some(name), Some(value)) = (contract.feature_names.get(feature), value) else {
        return error.to_string();
    };
    format!("`{name}` of entity {entity} is {value}, outside of its guarded range")
}

/// Where the policy was not asked, or has no utilities to tell.
fn nothing() -> Thought {
    Thought::new(&[], Vec::new())
}

/// Of all heads.
fn mean(attention: &Attention) -> f64 {
    attention.weights.iter().sum::<f64>() / attention.weights.len().max(1) as f64
}

fn list(what: &str, items: Vec<String>) {
    if !items.is_empty() {
        say!("{what}: {}", items.join(", "));
    }
}

#[cfg(test)]
mod tests {
    use sortie_core::EntityMask;
    use zerocopy::FromZeros;

    use super::*;
    use crate::views::probes;

    /// What a team is worth: no two teams of a subtask are worth the same.
    fn worth(task: usize, team: u64) -> f64 {
        (1.0 + task as f64) * (team.count_ones() as f64).sqrt() + team as f64 / 64.0
    }

    /// The value of an allocation of all agents, for the open subtasks alone.
    fn total(tasks: &[u8], open: u32) -> f64 {
        let team = |task: usize| {
            let members = tasks.iter().enumerate().filter(|(_, of)| usize::from(**of) == task);
            members.fold(0, |team, (member, _)| team | 1 << member)
        };
        let open = (0..3).filter(|task| open >> task & 1 == 1);
        open.map(|task| worth(task, team(task))).sum()
    }

    #[test]
    fn another_subtask_is_judged_by_what_all_of_them_would_be_worth() {
        let given = [0, 0, 1, UNASSIGNED];
        let best = [2, 2, 1, 1];
        let mut allocation = AllocMsg::new_zeroed();
        allocation.task = [UNASSIGNED; _];
        allocation.task[..4].copy_from_slice(&given);
        let state = AllocationState {
            agents: 4,
            tasks: 3,
            rows: &[],
            stride: 0,
            present: EntityMask::from_words(&[0b1111]),
            entity_task: &[0; 4],
            open_tasks: 0b111,
            available: &[],
        };
        let mut values = |task: usize, teams: &[u64]| {
            Ok(teams.iter().map(|team| worth(task, *team) as f32).collect())
        };
        for agent in 0..4 {
            let worth = [given, best]
                .map(|tasks| probes::total(&mut values, &state, &tasks).expect("nobody refuses"));
            let judged = (Some(&mut values as &mut OfState<'_>), Some(worth));
            let made = Allocated::new(&allocation, &state, (agent, 2), judged);
            let made = made.expect("nobody refuses");
            assert_eq!(made.tasks.len(), 3);
            let is = |told: Option<f64>, expected: f64| {
                told.is_some_and(|told| (told - expected).abs() < 2e-3)
            };
            let [of_given, of_best] = [given, best].map(|tasks| total(&tasks, 0b111));
            assert!(is(made.value, of_given) && is(made.regret, of_best - of_given), "{made:?}");
            for place in made.tasks {
                let mut moved = given;
                moved[usize::from(agent)] = place.task as u8;
                let is_full =
                    moved.iter().filter(|task| usize::from(**task) == place.task).count() > 2;
                let gain = total(&moved, 0b111) - total(&given, 0b111);
                match place.instead {
                    None => assert!(moved == given || is_full, "agent {agent}: {place:?}"),
                    Some(told) => {
                        assert!(!is_full && (told - gain).abs() < 1e-3, "{place:?}: {gain}")
                    }
                }
            }
        }
    }
}
