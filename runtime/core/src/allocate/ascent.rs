//! Coordinate ascent: moves one agent or exchanges two for as long as the total grows.
//!
//! For teams that are too large for [`exact`](super::exact). A sweep of moves asks for about A * T values,
//! one of exchanges for up to A * (A - 1).

use super::{TeamValue, Teams, comparable};
use crate::allocator::{AllocateError, UNASSIGNED};
use crate::limits::{AGENTS, TASKS};

/// Improves `allocation` `[A]` in place and returns its total.
///
/// The start is made feasible first: agents without an open subtask, and those beyond `team_max` (the
/// highest of a team), are placed one by one, in rising order, where the total is then largest. From
/// there on the total never falls. Every sweep offers each agent, in rising order, every open subtask
/// that has room, and moves it where the total is largest and larger than before; equal totals go to
/// the lowest subtask. Where a sweep moves nobody, every two agents of different subtasks, in rising
/// order, change places if the total grows by it: two firefighters in each other's place, or a lone one
/// that another fire needs more, are beyond single moves. The search ends where neither helps, or after
/// `sweeps` sweeps. Totals are summed in f64, subtasks in rising order.
///
/// # Errors
/// `TooLarge` for more agents than [`AGENTS`]; `BadLength` for an allocation of another length.
pub fn search(
    teams: Teams,
    values: &mut impl TeamValue,
    sweeps: usize,
    allocation: &mut [u8],
) -> Result<f64, AllocateError> {
    teams.check(AGENTS, allocation)?;
    let mut state = State::new(teams, values, allocation);
    for (agent, place) in allocation.iter_mut().enumerate() {
        if *place == UNASSIGNED {
            state.improve(agent, place, f64::NEG_INFINITY, values);
        }
    }
    for _ in 0..sweeps {
        let mut moved = false;
        for (agent, place) in allocation.iter_mut().enumerate() {
            if *place != UNASSIGNED {
                moved |= state.improve(agent, place, state.total(), values);
            }
        }
        if !moved && !state.exchange_all(allocation, values) {
            break;
        }
    }
    Ok(state.total())
}

/// The teams of an allocation and what they are worth.
struct State {
    teams: Teams,
    members: [u64; TASKS],
    /// 0 for closed subtasks.
    values: [f32; TASKS],
}

impl State {
    /// The feasible part of an allocation; all other agents become unassigned.
    fn new(teams: Teams, values: &mut impl TeamValue, allocation: &mut [u8]) -> Self {
        let mut state = Self { teams, members: [0; TASKS], values: [0.0; TASKS] };
        for (agent, place) in allocation.iter_mut().enumerate() {
            let task = usize::from(*place);
            match state.members.get_mut(task) {
                Some(team) if has_room(teams, task, *team) => *team |= 1 << agent,
                _ => *place = UNASSIGNED,
            }
        }
        for task in teams.tasks() {
            if let (Some(value), Some(team)) = (state.values.get_mut(task), state.members.get(task))
            {
                *value = comparable(values.value(task, *team));
            }
        }
        state
    }

    fn total(&self) -> f64 {
        self.values.iter().map(|value| f64::from(*value)).sum()
    }

    /// Moves an agent to the subtask where the total is largest, if it is more than `least` there.
    fn improve(
        &mut self,
        agent: usize,
        place: &mut u8,
        least: f64,
        values: &mut impl TeamValue,
    ) -> bool {
        let from = usize::from(*place);
        let asked = self.ask(agent, from, values);
        // What stays behind where the agent leaves comes first, if it leaves anything.
        let is_from = |question: &&Question| question.task == from;
        let left = asked.questions().first().filter(is_from).copied();
        let mut best: Option<Question> = None;
        let mut best_total = least;
        for joined in asked.questions().iter().filter(|question| question.task != from) {
            let total = self.total_with(left, *joined);
            if total > best_total {
                (best, best_total) = (Some(*joined), total);
            }
        }
        let Some(joined) = best else { return false };
        left.into_iter().for_each(|left| self.set(left));
        self.set(joined);
        *place = joined.task as u8;
        true
    }

    /// Offers every two agents each other's place; whether any took it.
    fn exchange_all(&mut self, allocation: &mut [u8], values: &mut impl TeamValue) -> bool {
        let mut exchanged = false;
        for second in 1..allocation.len() {
            let (firsts, rest) = allocation.split_at_mut_checked(second).unwrap_or_default();
            let Some(place) = rest.first_mut() else { continue };
            for (first, other) in firsts.iter_mut().enumerate() {
                if self.exchange((first, *other), (second, *place), values) {
                    core::mem::swap(place, other);
                    exchanged = true;
                }
            }
        }
        exchanged
    }

    /// Exchanges two agents, each with its subtask, if the total grows by it.
    fn exchange(
        &mut self,
        (first, here): (usize, u8),
        (second, there): (usize, u8),
        values: &mut impl TeamValue,
    ) -> bool {
        let (here, there) = (usize::from(here), usize::from(there));
        let (Some(at_first), Some(at_second)) = (self.members.get(here), self.members.get(there))
        else {
            return false;
        };
        if here == there {
            return false;
        }
        let both = 1_u64 << first | 1 << second;
        let mut asked = Asked::default();
        asked.push(here, at_first ^ both);
        asked.push(there, at_second ^ both);
        asked.answer(values);
        let [left, joined] = asked.questions() else { return false };
        let grows = self.total_with(Some(*left), *joined) > self.total();
        if grows {
            self.set(*left);
            self.set(*joined);
        }
        grows
    }

    /// The values of the team that an agent would leave and of all teams that it could join.
    fn ask(&self, agent: usize, from: usize, values: &mut impl TeamValue) -> Asked {
        let mut asked = Asked::default();
        if let Some(team) = self.members.get(from) {
            asked.push(from, team & !(1 << agent));
        }
        for task in self.teams.tasks().filter(|task| *task != from) {
            let team = self.members.get(task).filter(|team| has_room(self.teams, task, **team));
            if let Some(team) = team {
                asked.push(task, team | 1 << agent);
            }
        }
        asked.answer(values);
        asked
    }

    /// The total after a move; added in the order of [`Self::total`].
    fn total_with(&self, left: Option<Question>, joined: Question) -> f64 {
        let changed = |(task, value): (usize, &f32)| match left {
            _ if task == joined.task => f64::from(joined.value),
            Some(left) if task == left.task => f64::from(left.value),
            _ => f64::from(*value),
        };
        self.values.iter().enumerate().map(changed).sum()
    }

    fn set(&mut self, question: Question) {
        let Question { task, team, value } = question;
        let places = (self.members.get_mut(task), self.values.get_mut(task));
        if let (Some(members), Some(place)) = places {
            (*members, *place) = (team, value);
        }
    }
}

/// A team at a subtask and, once answered, its value.
#[derive(Clone, Copy)]
struct Question {
    task: usize,
    team: u64,
    value: f32,
}

/// Questions that are asked together: at most one per subtask.
#[derive(Default)]
struct Asked(heapless::Vec<Question, TASKS>);

impl Asked {
    fn push(&mut self, task: usize, team: u64) {
        // There are as many places as subtasks, so that none is refused.
        let _ = self.0.push(Question { task, team, value: 0.0 });
    }

    fn answer(&mut self, values: &mut impl TeamValue) {
        let mut pairs = [(0, 0); TASKS];
        let mut answers = [0.0; TASKS];
        for (pair, question) in pairs.iter_mut().zip(&self.0) {
            *pair = (question.task, question.team);
        }
        let (Some(pairs), Some(answers)) =
            (pairs.get(..self.0.len()), answers.get_mut(..self.0.len()))
        else {
            return;
        };
        values.values(pairs, answers);
        for (question, answer) in self.0.iter_mut().zip(answers) {
            question.value = comparable(*answer);
        }
    }

    fn questions(&self) -> &[Question] {
        &self.0
    }
}

/// Whether a team of an open subtask can take one agent more.
fn has_room(teams: Teams, task: usize, team: u64) -> bool {
    teams.open_tasks >> task & 1 == 1 && (team.count_ones() as usize) < teams.team_max
}

#[cfg(test)]
mod tests {
    use super::super::exact;
    use super::*;
    use std::vec;
    use std::vec::Vec;

    /// A value that only depends on subtask, team and seed.
    fn noise(seed: u64, task: usize, team: u64) -> u64 {
        let mut word = (seed << 40) ^ (team << 6) ^ task as u64;
        for _ in 0..3 {
            word = (word ^ word >> 29).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        }
        word >> 40
    }

    fn total(teams: Teams, values: &mut impl TeamValue, allocation: &[u8]) -> f64 {
        let team = |task: usize| {
            let members = allocation.iter().enumerate().filter(|(_, t)| usize::from(**t) == task);
            members.map(|(agent, _)| 1 << agent).sum()
        };
        teams.tasks().map(|task| f64::from(comparable(values.value(task, team(task))))).sum()
    }

    fn assert_feasible(teams: Teams, allocation: &[u8]) {
        let assigned: Vec<_> = allocation.iter().filter(|task| **task != UNASSIGNED).collect();
        assert_eq!(assigned.len(), teams.places(), "{teams:?} {allocation:?}");
        for task in assigned {
            assert!(teams.open_tasks.checked_shr((*task).into()).unwrap_or(0) & 1 == 1);
            let team = allocation.iter().filter(|other| *other == task).count();
            assert!(team <= teams.team_max, "{teams:?} {allocation:?}");
        }
    }

    #[test]
    fn never_ends_below_a_feasible_start() {
        let mut gained = 0;
        for seed in 0..200 {
            let teams = Teams { agents: 24, open_tasks: 0x01B5_A3F1, team_max: 4 };
            let mut values = |task, team| noise(seed, task, team) as f32;
            let mut allocation = vec![UNASSIGNED; 24];
            let start = search(teams, &mut values, 0, &mut allocation).unwrap();
            assert_feasible(teams, &allocation);
            assert_eq!(start, total(teams, &mut values, &allocation));
            let mut last = start;
            for sweeps in [1, 1, 1, 100] {
                let end = search(teams, &mut values, sweeps, &mut allocation).unwrap();
                assert_feasible(teams, &allocation);
                assert!(end >= last, "seed {seed}: {last} became {end}");
                assert_eq!(end, total(teams, &mut values, &allocation));
                last = end;
            }
            gained += usize::from(last > start);
        }
        assert!(gained > 100, "only {gained} of 200 starts could be improved");
    }

    #[test]
    fn exchanges_where_no_single_move_has_room() {
        let teams = Teams { agents: 2, open_tasks: 0b11, team_max: 1 };
        let mut values = |task: usize, team| if team == 1 << task { 1.0 } else { 2.0 };
        let mut allocation = vec![0, 1];
        let end = search(teams, &mut values, 8, &mut allocation).unwrap();
        assert_eq!((end, allocation), (4.0, vec![1, 0]));
    }

    #[test]
    fn no_move_and_no_exchange_improves_the_end() {
        let teams = Teams { agents: 6, open_tasks: 0b11_0110, team_max: 3 };
        let mut values = |task, team| noise(4, task, team) as f32;
        let mut allocation = vec![UNASSIGNED; 6];
        let end = search(teams, &mut values, 100, &mut allocation).unwrap();
        for (first, second) in
            (0..6).flat_map(|second| (0..second).map(move |first| (first, second)))
        {
            let mut exchanged = allocation.clone();
            exchanged.swap(first, second);
            assert!(total(teams, &mut values, &exchanged) <= end);
        }
        for agent in 0..6 {
            for task in teams.tasks() {
                let mut moved = allocation.clone();
                moved[agent] = task as u8;
                if moved.iter().filter(|other| **other == task as u8).count() <= 3 {
                    assert!(total(teams, &mut values, &moved) <= end);
                }
            }
        }
    }

    #[test]
    fn agrees_with_the_exact_search_where_agents_do_not_interact() {
        let teams = Teams { agents: 6, open_tasks: 0b1_1101, team_max: 6 };
        let worth = |task, agent: usize| noise(5, task, 1 << agent) as f32;
        let mut values = |task: usize, team: u64| {
            (0..6).filter(|agent| team >> agent & 1 == 1).map(|agent| worth(task, agent)).sum()
        };
        let table: Vec<f32> = teams
            .tasks()
            .flat_map(|task| (0..64).map(move |team| (task, team)))
            .map(|(task, team)| values(task, team))
            .collect();
        let mut arena = vec![exact::Cell::default(); exact::cells(6, 4)];
        let (mut best, mut found) = (vec![0; 6], vec![0; 6]);
        exact::search(teams, &table, &mut arena, &mut best).unwrap();
        search(teams, &mut values, 100, &mut found).unwrap();
        assert_eq!(found, best);
    }

    #[test]
    fn any_values_and_any_start_give_a_feasible_allocation() {
        let strange = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN, 0.0, 1.0];
        for seed in 0..300 {
            let pick = |salt, below| noise(seed, salt, 7) % below;
            let agents = pick(0, 13) as usize;
            let open_tasks = pick(1, 1 << 20) as u32 & pick(2, 1 << 20) as u32;
            let teams = Teams { agents, open_tasks, team_max: pick(3, 5) as usize };
            let mut values = |task, team| strange[noise(seed, task, team) as usize % strange.len()];
            let mut allocation: Vec<u8> =
                (0..agents).map(|agent| noise(seed, agent, 9) as u8).collect();
            let end = search(teams, &mut values, 20, &mut allocation).unwrap();
            assert!(end.is_finite());
            assert_feasible(teams, &allocation);
            assert_eq!(end, total(teams, &mut values, &allocation));
        }
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let teams = Teams { agents: 2, open_tasks: 1, team_max: 2 };
        let mut values = |_, _| 0.0;
        let refusal = search(teams, &mut values, 1, &mut [0]);
        assert_eq!(refusal, Err(AllocateError::BadLength));
        let many = Teams { agents: AGENTS + 1, ..teams };
        let refusal = search(many, &mut values, 1, &mut [0; AGENTS + 1]);
        assert_eq!(refusal, Err(AllocateError::TooLarge));
    }
}
