//! A bundle in the place of the one that decided: what would it have done in the states of a record?

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Serialize;
use sortie_bundle::Bundle;
use sortie_core::choose::masked_argmax;
use sortie_core::wire::{ActionMsg, AllocMsg};
use sortie_core::{NO_ACTION, Policy};
use sortie_ipc::{Heard, ProcessInfo};
use sortie_learn::draft::DecoratedPolicy;

use super::Deployed;
use super::comparison::tasks;
use super::contents::{Contents, Shown, Told};
use super::roles::{Judge, Made, Roles, Team};
use crate::allocator::ProposalArguments;
use crate::failure::Failure;
use crate::listener::Listener;
use crate::output::{Common, Table, plural, print_json, say};

/// The longest sleep between two looks at a running team.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// How often a bundle would have done what a recorded team did.
#[derive(Serialize)]
pub(crate) struct Shadowed {
    record: PathBuf,
    frames: u64,
    #[serde(flatten)]
    made: Made,
    /// Of actions.
    agreement: Agreement,
    by_agent: BTreeMap<u16, Agreement>,
    by_subtask: BTreeMap<u8, Agreement>,
    /// The same for the half of all decisions in which it sets its best action furthest apart from its second.
    where_it_counts: Agreement,
    /// By how much it prefers its own action to the recorded one, in its own utilities, where they differ.
    preference: Option<Preference>,
    /// The actions that it takes instead, the most frequent first.
    instead: Vec<Instead>,
    /// Agents of allocations that would have been given the same subtask.
    allocations: Agreement,
}

/// How many of how many.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
struct Agreement {
    same: u64,
    of: u64,
}

impl Agreement {
    fn add(&mut self, is_same: bool) {
        self.same += u64::from(is_same);
        self.of += 1;
    }

    fn of<'a>(decisions: impl IntoIterator<Item = &'a Decided>) -> Self {
        let mut agreement = Self::default();
        decisions.into_iter().for_each(|decided| agreement.add(decided.is_same()));
        agreement
    }

    fn cells(self) -> [String; 2] {
        let share = 100.0 * self.same as f64 / self.of.max(1) as f64;
        [self.of.to_string(), format!("{share:.1} %")]
    }
}

#[derive(Debug, PartialEq, Serialize)]
struct Preference {
    mean: f32,
    p95: f32,
}

#[derive(Debug, PartialEq, Serialize)]
struct Instead {
    recorded: String,
    taken: String,
    times: u64,
}

/// A decision of the bundle beside the recorded one.
#[derive(Clone, Copy, Debug)]
struct Decided {
    agent: u16,
    task: u8,
    recorded: u16,
    taken: u16,
    /// From its best action to the next that was available.
    margin: f32,
    /// From the recorded action to its best.
    preferred: f32,
}

impl Decided {
    fn is_same(&self) -> bool {
        self.recorded == self.taken
    }
}

/// What a network made of an observation.
struct Opinion {
    agent: usize,
    utilities: Vec<f32>,
    available: Vec<bool>,
}

/// Notes what the bundle does beside what was done.
struct Shadow<'a> {
    /// Those of the decisions that are judged next.
    opinions: &'a RefCell<Vec<Opinion>>,
    /// How many actions were the same so far, and of how many.
    counts: &'a RefCell<(u64, u64)>,
    decided: Vec<Decided>,
    allocations: Agreement,
}

impl Judge for Shadow<'_> {
    fn action(&mut self, recorded: &ActionMsg, made: Option<&ActionMsg>, _: &Shown) {
        let mut opinions = self.opinions.borrow_mut();
        let place = opinions.iter().position(|it| it.agent == usize::from(recorded.agent));
        let opinion = place.map(|place| opinions.swap_remove(place));
        // Where one of both does nothing there is nothing to compare.
        let (Some(opinion), Some(made)) = (opinion, made) else { return };
        if recorded.action == NO_ACTION || made.action == NO_ACTION {
            return;
        }
        let utility = |action: u16| opinion.utilities.get(usize::from(action)).copied();
        let best = utility(made.action).unwrap_or_default();
        let others = opinion.utilities.iter().zip(&opinion.available).enumerate();
        let others =
            others.filter(|(at, (_, is_open))| **is_open && *at != usize::from(made.action));
        let second = others.map(|(_, (utility, _))| *utility).reduce(f32::max);
        let mut counts = self.counts.borrow_mut();
        counts.0 += u64::from(recorded.action == made.action);
        counts.1 += 1;
        self.decided.push(Decided {
            agent: recorded.agent,
            task: recorded.task,
            recorded: recorded.action,
            taken: made.action,
            margin: second.map_or(0.0, |second| best - second),
            preferred: utility(recorded.action).map_or(0.0, |theirs| best - theirs),
        });
    }

    fn allocation(&mut self, recorded: &AllocMsg, made: Result<&AllocMsg, String>, _: &Shown) {
        let Ok(made) = made else { return };
        for (theirs, own) in tasks(recorded).zip(tasks(made)) {
            if theirs.is_some() || own.is_some() {
                self.allocations.add(theirs == own);
            }
        }
    }
}

/// Has `bundle` decide in every state of a record, with what the recorded team was allocated.
pub(crate) fn shadow(
    record: &Path,
    bundle: &Bundle,
    draws: (u64, ProposalArguments),
) -> Result<Shadowed, Failure> {
    let mut contents = Contents::read(record)?;
    // Whatever decided then, this bundle's plan decides now.
    contents.engines.clear();
    let frames = contents.frames;
    decide_beside(&contents, bundle, draws, |take, _| contents.replay(take).map(|()| frames))
}

/// Has `bundle` decide beside a running team, in every state that it sees and with what its agents are allocated, for as long
/// as `goes_on` says: it is told how many actions were the same, and of how many.
pub(crate) fn shadow_team(
    listener: &mut Listener,
    processes: &[ProcessInfo],
    bundle: &Bundle,
    draws: (u64, ProposalArguments),
    goes_on: &mut dyn FnMut(u64, u64) -> bool,
) -> Result<Shadowed, Failure> {
    let contents = Contents::of_team(listener.facts(), processes)?;
    decide_beside(&contents, bundle, draws, |take, counts| {
        let mut frames = 0;
        loop {
            listener.look(&mut |heard, _| {
                frames += u64::from(matches!(heard, Heard::Frame(..)));
                Told::of(heard).into_iter().for_each(&mut *take);
            })?;
            let (same, of) = *counts.borrow();
            if !goes_on(same, of) || listener.is_alone() {
                return Ok(frames);
            }
            listener.wait(LOOK_EVERY);
        }
    })
}

/// Has `bundle` decide what `tell` shows, and returns how many frames there were.
fn decide_beside(
    contents: &Contents,
    bundle: &Bundle,
    draws: (u64, ProposalArguments),
    tell: impl FnOnce(&mut dyn FnMut(Told), &RefCell<(u64, u64)>) -> Result<u64, Failure>,
) -> Result<Shadowed, Failure> {
    let mut deployed = Deployed::open(contents, bundle, draws)?;
    let counts = RefCell::new((0, 0));
    let opinions = RefCell::new(Vec::new());
    // Whoever decided then.
    let mut team = Team { model: None, ..deployed.team()? };
    team.policies = team.policies.into_iter().map(|policy| aloud(policy, &opinions)).collect();
    let (decided, allocations) = (Vec::new(), Agreement::default());
    let mut shadow = Shadow { opinions: &opinions, counts: &counts, decided, allocations };
    let mut roles = Roles::new(contents, bundle, vec![team], &mut shadow)?;
    let frames = tell(&mut |message| roles.hear(message), &counts)?;
    let made = roles.end();
    let Shadow { decided, allocations, .. } = shadow;
    let of = contents.path().to_owned();
    Ok(Shadowed::new((of, frames, made), &decided, allocations, bundle))
}

/// A policy whose utilities are noted.
fn aloud<'a>(
    policy: Box<dyn Policy + 'a>,
    opinions: &'a RefCell<Vec<Opinion>>,
) -> Box<dyn Policy + 'a> {
    Box::new(DecoratedPolicy::new(policy, move |policy, observation, _| {
        let mut utilities = vec![0.0; policy.actions()];
        policy.utilities(observation, &mut utilities)?;
        let decision = masked_argmax(&utilities, observation.available);
        let available = observation.available.iter().map(|code| *code != 0).collect();
        let opinion = Opinion { agent: observation.self_index, utilities, available };
        opinions.borrow_mut().push(opinion);
        decision
    }))
}

impl Shadowed {
    fn new(
        (record, frames, made): (PathBuf, u64, Made),
        decided: &[Decided],
        allocations: Agreement,
        bundle: &Bundle,
    ) -> Self {
        let (mut by_agent, mut by_subtask) = (BTreeMap::new(), BTreeMap::new());
        for it in decided {
            let of_agent: &mut Agreement = by_agent.entry(it.agent).or_default();
            of_agent.add(it.is_same());
            let of_subtask: &mut Agreement = by_subtask.entry(it.task).or_default();
            of_subtask.add(it.is_same());
        }
        // Agents without a subtask are no subtask's.
        by_subtask.remove(&sortie_core::UNASSIGNED);
        let mut sorted: Vec<&Decided> = decided.iter().collect();
        sorted.sort_by(|one, other| other.margin.total_cmp(&one.margin));
        let names = &bundle.contract().action_names;
        Self {
            record,
            frames,
            made,
            agreement: Agreement::of(decided),
            by_agent,
            by_subtask,
            where_it_counts: Agreement::of(sorted.iter().take(sorted.len().div_ceil(2)).copied()),
            preference: preference(decided),
            instead: instead(decided, names),
            allocations,
        }
    }

    /// The share of actions that were otherwise.
    pub(crate) fn disagreement(&self) -> f64 {
        let Agreement { same, of } = self.agreement;
        (of - same) as f64 / of.max(1) as f64
    }

    pub(crate) fn print(&self, common: Common) {
        if common.json {
            return print_json(self);
        }
        self.print_table();
    }

    /// For people.
    pub(crate) fn print_table(&self) {
        let mut table = Table::new(&["", "decisions", "the same"]);
        let mut row = |what: String, agreement: Agreement| {
            table.row([what].into_iter().chain(agreement.cells()));
        };
        row("all".to_owned(), self.agreement);
        row("where it counts".to_owned(), self.where_it_counts);
        self.by_agent.iter().for_each(|(agent, it)| row(format!("agent {agent}"), *it));
        self.by_subtask.iter().for_each(|(task, it)| row(format!("subtask {task}"), *it));
        if self.allocations.of > 0 {
            row("agents' subtasks".to_owned(), self.allocations);
        }
        table.print();
        if let Some(Preference { mean, p95 }) = &self.preference {
            say!(
                "where they differ it prefers its own action by {mean:.3} in the mean, {p95:.3} at the 95th percentile"
            );
        }
        for Instead { recorded, taken, times } in &self.instead {
            say!("{taken} instead of {recorded}: {}", plural(*times as usize, "time"));
        }
    }
}

/// Of the decisions that differ, if any do.
fn preference(decided: &[Decided]) -> Option<Preference> {
    let different = decided.iter().filter(|it| !it.is_same());
    let mut preferred: Vec<f32> = different.map(|it| it.preferred).collect();
    preferred.sort_by(f32::total_cmp);
    let p95 = *preferred.get((preferred.len() * 95).div_ceil(100).saturating_sub(1))?;
    Some(Preference { mean: preferred.iter().sum::<f32>() / preferred.len() as f32, p95 })
}

/// The most frequent pairs of actions that differ.
fn instead(decided: &[Decided], names: &[String]) -> Vec<Instead> {
    const TOLD: usize = 5;
    let mut pairs: BTreeMap<(u16, u16), u64> = BTreeMap::new();
    for it in decided.iter().filter(|it| !it.is_same()) {
        *pairs.entry((it.recorded, it.taken)).or_default() += 1;
    }
    let mut pairs: Vec<_> = pairs.into_iter().collect();
    pairs.sort_by_key(|(_, times)| std::cmp::Reverse(*times));
    let name = |action: u16| match names.get(usize::from(action)) {
        Some(name) => name.clone(),
        None => format!("action {action}"),
    };
    let told = pairs.into_iter().take(TOLD).map(|((recorded, taken), times)| Instead {
        recorded: name(recorded),
        taken: name(taken),
        times,
    });
    told.collect()
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::deployment::open_bundle;

    #[test]
    fn what_counts_is_the_half_that_is_set_furthest_apart() {
        // Four decisions; the two that are set furthest apart, by 3 and by 2, are the same.
        let decided = |taken: u16, margin: f32, preferred: f32| Decided {
            agent: taken,
            task: if taken == 1 { sortie_core::UNASSIGNED } else { 0 },
            recorded: 1,
            taken,
            margin,
            preferred,
        };
        let decided = [
            decided(1, 2.0, 0.0),
            decided(0, 0.5, 0.25),
            decided(1, 3.0, 0.0),
            decided(2, 1.0, 0.75),
        ];
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/save-the-city");
        let bundle = open_bundle(&folder).expect("the shipped bundle");
        let all = (PathBuf::from("run.mcap"), 4, Made::default());
        let told = Shadowed::new(all, &decided, Agreement::default(), &bundle);
        assert_eq!(told.agreement, Agreement { same: 2, of: 4 });
        assert_eq!(told.where_it_counts, Agreement { same: 2, of: 2 });
        assert_eq!(told.by_agent[&2], Agreement { same: 0, of: 1 });
        // Those without a subtask are nobody's.
        assert_eq!(told.by_subtask, BTreeMap::from([(0, Agreement { same: 0, of: 2 })]));
        assert_eq!(told.preference, Some(Preference { mean: 0.5, p95: 0.75 }));
        let names = &bundle.contract().action_names;
        let instead = |taken: usize| (names[1].clone(), names[taken].clone(), 1);
        let told = told.instead.into_iter().map(|it| (it.recorded, it.taken, it.times));
        assert_eq!(told.collect::<Vec<_>>(), [instead(0), instead(2)]);
    }
}
