//! One step of the low level over chunks of transitions: targets first, then gradients.
//!
//! Dissertation section 7.3 and the public code. A term of the loss is a team in a state that a step of
//! the same episode follows. Its target bootstraps from the next state with the team as it was: the
//! target agents and the target mixer see the next entities with the allocation of the step before, while
//! the maximising actions are those of the online agents with the allocation of the next step.
//!
//! Only teams that enter the loss are computed, and of the rows only those that somebody looks at; all
//! others have a weight of zero, so that this is exact.

use std::time::Duration;

use super::coaching::{CoachLane, Guess, Held};
use super::hypernetwork::MixerInput;
use super::looking::{LookingPass, Recurrent};
use super::mixer::{MergedMixer, Mixer, MixerGradient, MixerPass};
use super::teams::{Marks, Teams, View, is_available, tasks_with_agents};
use crate::alma::agents::{Conditioning, TaskOrder, UtilityNetwork};
use crate::alma::records::config::ReturnsConfig;
use crate::alma::windows::Windows;
use crate::alma::windows::config::LowLevelConfig;
use crate::alma::windows::popart::PopArt;

/// A term of the loss: the value of a team in a state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Term {
    /// The state, as [`Windows`] counts them.
    pub state: usize,
    /// The subtask; 0 without subtasks.
    pub task: usize,
    /// What the value should be, in real units.
    pub target: f64,
}

/// What values are computed with.
pub(super) struct Side<'a> {
    pub(super) agents: Recurrent<'a>,
    /// What the agents have been told, if they have a coach.
    pub(super) told: Option<Held<'a>>,
    pub(super) mixer: &'a Mixer,
    pub(super) merged: &'a MergedMixer,
    pub(super) order: &'a TaskOrder,
}

/// What all lanes of a step read.
pub(super) struct Step<'a> {
    pub(super) config: &'a LowLevelConfig,
    pub(super) windows: &'a Windows,
    /// Marks of the mixer's input.
    pub(super) mixer_order: &'a TaskOrder,
}

/// What targets are computed with.
pub(super) struct Bootstrap<'a> {
    pub(super) online: Side<'a>,
    pub(super) target: Side<'a>,
    pub(super) popart: &'a PopArt,
}

/// What comes behind the rewards of a term.
#[derive(Clone, Copy, Debug)]
struct Bootstrapped {
    /// The last state whose reward counts: the value is that of the one behind it.
    state: usize,
    task: Option<usize>,
    term: usize,
    discount: f64,
}

/// What gradients are computed with.
pub(super) struct Descent<'a> {
    pub(super) online: Side<'a>,
    pub(super) popart: &'a PopArt,
    /// The head's weights and biases of the forward pass.
    pub(super) head: (&'a [f32], &'a [f32]),
    /// Terms of the whole loss.
    pub(super) terms: usize,
    /// What shapes strategies, if agents have a coach.
    pub(super) guess: Option<Guess<'a>>,
}

/// Sums over the terms of a lane.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sums {
    pub(super) squared_error: f64,
    pub(super) error: f64,
    pub(super) value: f64,
}

/// The part of a step that one lane does: its buffers and what it finds.
#[derive(Clone, Debug)]
pub(super) struct Lane {
    teams: Teams,
    agent_pass: LookingPass,
    mixer_input: MixerInput,
    mixer_pass: MixerPass,
    actions: Vec<u8>,
    utilities: Vec<f32>,
    slopes: Vec<f32>,
    bootstrapped: Vec<Bootstrapped>,
    pub(super) terms: Vec<Term>,
    /// Terms whose gradients have been computed.
    done: usize,
    pub(super) sums: Sums,
    pub(super) agents: Vec<f32>,
    pub(super) mixer: MixerGradient,
    pub(super) coach: CoachLane,
    pub(super) targets_time: Duration,
    pub(super) descent_time: Duration,
}

impl AsRef<CoachLane> for Lane {
    fn as_ref(&self) -> &CoachLane {
        &self.coach
    }
}

impl AsMut<CoachLane> for Lane {
    fn as_mut(&mut self) -> &mut CoachLane {
        &mut self.coach
    }
}

impl Lane {
    pub(super) fn new(agents: &UtilityNetwork, gru: &[f32], mixer: &Mixer) -> Self {
        Self {
            teams: Teams::default(),
            agent_pass: LookingPass::new(agents.shape()),
            mixer_input: MixerInput::default(),
            mixer_pass: MixerPass::default(),
            actions: Vec::new(),
            utilities: Vec::new(),
            slopes: Vec::new(),
            bootstrapped: Vec::new(),
            terms: Vec::new(),
            done: 0,
            sums: Sums::default(),
            agents: vec![0.0; agents.parameters().len() + gru.len()],
            mixer: MixerGradient::new(mixer.shape()),
            coach: CoachLane::default(),
            targets_time: Duration::ZERO,
            descent_time: Duration::ZERO,
        }
    }

    pub(super) fn operations(&self) -> u64 {
        self.agent_pass.operations() + self.mixer_pass.operations()
    }

    /// Forgets the step before.
    pub(super) fn begin(&mut self) {
        self.terms.clear();
        self.done = 0;
        self.sums = Sums::default();
        self.agents.fill(0.0);
        self.mixer.clear();
    }
}

impl Step<'_> {
    /// The states that can be learned from.
    pub(super) fn states(&self) -> Vec<usize> {
        let live = |state: &usize| self.leads_on(*state) && self.tasks(*state).next().is_some();
        (0..self.windows.shape.states()).filter(live).collect()
    }

    /// Whether behind a state there is another of the same episode in the same window.
    fn leads_on(&self, state: usize) -> bool {
        let steps = self.windows.shape.steps;
        self.windows.has_transition[state] && state % steps + 1 < steps
    }

    /// The subtasks of a state that can be learned from: unfinished, with agents; without subtasks,
    /// everybody.
    fn tasks(&self, state: usize) -> impl Iterator<Item = Option<usize>> {
        let windows = self.windows;
        let subtasks = self.config.conditioning.has_subtasks();
        let tasks = if subtasks { windows.shape.tasks } else { 0 };
        let with_agents = tasks_with_agents(View::NOW.of(windows, state));
        let unfinished = &windows.task_unfinished[state * windows.shape.tasks..];
        let live = (0..tasks).filter(move |task| with_agents >> task & 1 == 1 && unfinished[*task]);
        let everybody = (!subtasks).then_some(None);
        everybody.into_iter().chain(live.map(Some))
    }

    /// Reward of a term, and whether what comes next is worth nothing.
    fn outcome(&self, state: usize, task: Option<usize>) -> (f32, bool) {
        let windows = self.windows;
        match task.map(|task| state * windows.shape.tasks + task) {
            Some(at) => (windows.task_reward[at], windows.task_terminated[at]),
            None => (windows.reward[state], windows.terminated[state]),
        }
    }

    /// The discounted rewards of a team from a state on; and, unless what comes next is worth nothing,
    /// the last state that they come from and the discount of what follows it.
    fn returns(&self, state: usize, task: Option<usize>) -> (f64, Option<(usize, f64)>) {
        let ReturnsConfig { steps, discount, .. } = self.config.returns;
        let (mut rewards, mut weight) = (0.0, 1.0);
        for last in state.. {
            let (reward, ends) = self.outcome(last, task);
            rewards += weight * f64::from(reward);
            weight *= f64::from(discount);
            if ends {
                break;
            }
            if last + 1 == state + steps as usize || !self.goes_on(last, task) {
                return (rewards, Some((last, weight)));
            }
        }
        (rewards, None)
    }

    /// Whether behind a step there is another of the same team that can be learned from.
    fn goes_on(&self, state: usize, task: Option<usize>) -> bool {
        let windows = self.windows;
        let works = |allocated: &u8| task.is_none_or(|task| usize::from(*allocated) == task);
        let now = windows.allocation(state).iter().map(works);
        self.leads_on(state + 1) && now.eq(windows.allocation(state + 1).iter().map(works))
    }

    fn agent_marks<'o>(&self, order: &'o TaskOrder) -> (Conditioning, Marks<'o>) {
        let conditioning = self.config.conditioning;
        (conditioning, (conditioning == Conditioning::Input).then_some(&*order.0))
    }

    /// Adds the terms of some states to a lane, with their targets.
    pub(super) fn value(&self, networks: &Bootstrap<'_>, states: &[usize], lane: &mut Lane) {
        let windows = self.windows;
        lane.teams.clear();
        lane.bootstrapped.clear();
        for state in states {
            for task in self.tasks(*state) {
                let (target, last) = self.returns(*state, task);
                let term = lane.terms.len();
                lane.bootstrapped.extend(last.map(|(state, discount)| Bootstrapped {
                    state,
                    task,
                    term,
                    discount,
                }));
                lane.terms.push(Term { state: *state, task: task.unwrap_or(0), target });
            }
        }
        // Teams of a state stand together.
        lane.bootstrapped.sort_by_key(|bootstrapped| bootstrapped.state);
        for Bootstrapped { state, task, .. } in &lane.bootstrapped {
            lane.teams.push(View::NEXT_AS_BEFORE.of(windows, *state), *state, *task);
        }

        let Bootstrap { online, target, popart } = networks;
        let Lane { teams, agent_pass, mixer_input, .. } = lane;
        let (look, marks) = ((windows, View::NEXT), self.agent_marks(online.order));
        let players = (online.agents, online.told);
        let utilities = agent_pass.forward(players, look, marks, teams);
        let rows = utilities.chunks_exact(windows.shape.actions);
        lane.actions.clear();
        lane.actions.extend(rows.zip(teams.agents()).map(|(row, (state, agent))| {
            let codes = ((state + 1) * windows.shape.agents + agent) * windows.shape.actions;
            let codes = &windows.available[codes..][..windows.shape.actions];
            self.best_action(row, codes, agent, windows.allocation(state))
        }));

        let view = (windows, View::NEXT_AS_BEFORE);
        let marks = self.agent_marks(target.order);
        let players = (target.agents, target.told);
        let utilities = agent_pass.forward(players, view, marks, teams);
        pick(utilities, windows.shape.actions, lane.actions.iter(), &mut lane.utilities);
        teams.write_mixer(view, self.agent_marks(self.mixer_order), mixer_input);
        let (mixer, merged) = (target.mixer, target.merged);
        let values = lane.mixer_pass.forward(mixer, merged, mixer_input, &lane.utilities);
        for (raw, bootstrapped) in values.iter().zip(&lane.bootstrapped) {
            let term = &mut lane.terms[bootstrapped.term];
            let value = popart.denormalise(f64::from(head(mixer.head(), term.task, *raw)));
            term.target += bootstrapped.discount * value;
        }
    }

    /// The best available action, the first of equals.
    fn best_action(&self, row: &[f32], codes: &[u16], agent: usize, allocation: &[u8]) -> u8 {
        let by_task = self.config.task_availability;
        let open = |code: u16| {
            if by_task { is_available(code, agent, allocation) } else { code > 0 }
        };
        let mut best = (f32::NEG_INFINITY, 0);
        for ((action, utility), code) in (0..).zip(row).zip(codes) {
            if open(*code) && *utility > best.0 {
                best = (*utility, action);
            }
        }
        best.1
    }

    /// Adds to a lane the gradients of its next terms, which are those of some states.
    pub(super) fn descend(&self, networks: &Descent<'_>, states: &[usize], lane: &mut Lane) {
        let windows = self.windows;
        let actions = windows.shape.actions;
        let Descent { online, popart, .. } = networks;
        let Lane { teams, agent_pass, mixer_input, mixer_pass, slopes, .. } = lane;
        teams.clear();
        for state in states {
            for task in self.tasks(*state) {
                teams.push(View::NOW.of(windows, *state), *state, task);
            }
        }
        let terms = &lane.terms[lane.done..][..teams.each().count()];
        lane.done += terms.len();

        let view = (windows, View::NOW);
        let marks = self.agent_marks(online.order);
        let players = (online.agents, online.told);
        let utilities = agent_pass.forward(players, view, marks, teams);
        let taken = |(state, agent)| &windows.actions[state * windows.shape.agents + agent];
        pick(utilities, actions, teams.agents().map(taken), &mut lane.utilities);
        teams.write_mixer(view, self.agent_marks(self.mixer_order), mixer_input);
        let mixer = online.mixer;
        let values = mixer_pass.forward(mixer, online.merged, mixer_input, &lane.utilities);

        slopes.clear();
        let outputs = mixer.shape().outputs;
        for (raw, term) in values.iter().zip(terms) {
            let value = head(networks.head, term.task, *raw);
            let error = f64::from(value) - popart.normalise(term.target);
            lane.sums.squared_error += error * error;
            lane.sums.error += error.abs();
            lane.sums.value += f64::from(value);
            let slope = (2.0 * error / networks.terms as f64) as f32;
            let output = term.task % outputs;
            lane.mixer.head[output] += slope * raw;
            lane.mixer.head[outputs + output] += slope;
            slopes.push(slope * mixer.head().0[output]);
        }
        let tensors = (&*lane.utilities, &**slopes);
        let d_chosen =
            mixer_pass.backward(mixer, online.merged, mixer_input, tensors, &mut lane.mixer);
        slopes.clear();
        slopes.resize(d_chosen.len() * actions, 0.0);
        for ((row, slope), agent) in
            slopes.chunks_exact_mut(actions).zip(d_chosen).zip(teams.agents())
        {
            row[usize::from(*taken(agent))] = *slope;
        }
        let Some(guess) = networks.guess else {
            return agent_pass.backward(online.agents, slopes, &mut lane.agents);
        };
        let d_told = agent_pass.backward_told(online.agents, slopes, &mut lane.agents);
        guess.descend(windows, (states, networks.terms), d_told, &mut lane.coach);
    }
}

/// A value in normalised units: the head's output of a subtask.
fn head((weights, biases): (&[f32], &[f32]), task: usize, raw: f32) -> f32 {
    let output = task % weights.len();
    weights[output] * raw + biases[output]
}

/// Writes the utilities of chosen actions.
fn pick<'a>(
    utilities: &[f32],
    actions: usize,
    chosen: impl Iterator<Item = &'a u8>,
    picked: &mut Vec<f32>,
) {
    picked.clear();
    let rows = utilities.chunks_exact(actions).zip(chosen);
    picked.extend(rows.map(|(row, action)| row[usize::from(*action)]));
}
