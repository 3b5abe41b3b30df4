//! One step of the low level over windows: targets first, then gradients.
//!
//! Dissertation section 7.3 and the public code. A term of the loss is a team in a state that a step of
//! the same episode follows. Its target bootstraps from the next state with the team as it was: the
//! target agents and the target mixer see the next entities with the allocation of the step before, while
//! the maximising actions are those of the online agents with the allocation of the next step.
//!
//! Only teams that enter the loss are computed, and of the rows only those that somebody looks at; all
//! others have a weight of zero, so that this is exact.

use sortie_learn::networks::best;
use sortie_nn::tape::{Pass, Tape, Var};

use super::agents::AgentLayers;
use super::coaching::CoachingLayers;
use super::mixer::{Mixer, MixerInput};
use super::teams::{Look, Teams, View, tasks_with_agents};
use crate::alma::agents::TaskOrder;
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

/// All layers of a learner in one vector: agents, memory, mixer, coach and recognition, then the merged layers of the
/// mixer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layers {
    pub(super) agents: AgentLayers,
    pub(super) mixer: Mixer,
    pub(super) coaching: Option<CoachingLayers>,
    /// Where the merged layers begin.
    pub(super) merged: usize,
}

/// What values are computed with.
pub(super) struct Side {
    /// As [`Layers`] has them.
    pub(super) parameters: Vec<f32>,
    /// Marks of the agents' input.
    pub(super) order: TaskOrder,
    pub(super) coach_order: TaskOrder,
    /// What strategies are drawn with.
    pub(super) seed: u64,
}

/// What all lanes of a step read.
pub(super) struct Step<'a> {
    pub(super) config: LowLevelConfig,
    pub(super) windows: &'a Windows,
    pub(super) layers: Layers,
    /// The networks that learn.
    pub(super) online: Side,
    /// Those that value what comes next.
    pub(super) target: Side,
    pub(super) mixer_order: TaskOrder,
    pub(super) recognition_order: TaskOrder,
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

/// What values are compared with their targets by.
pub(super) struct Comparison<'a> {
    pub(super) popart: &'a PopArt,
    /// The head's weights, then its biases, by which they are compared; gradients go through those that learn.
    pub(super) head: &'a [f32],
    pub(super) terms: usize,
}

/// The part of a step that one lane does: its buffers and what it finds.
#[derive(Clone, Debug, Default)]
pub(super) struct Lane {
    pub(super) tape: Tape,
    teams: Teams,
    input: MixerInput,
    pub(super) terms: Vec<Term>,
    /// Terms whose gradients have been computed.
    done: usize,
    /// Sum over its terms.
    pub(super) squared_error: f64,
    /// What a coach adds to the loss.
    pub(super) coach_loss: f64,
    pub(super) gradient: Vec<f32>,
    pub(super) operations: u64,
}

impl Lane {
    /// Forgets the step before; there are so many parameters.
    pub(super) fn begin(&mut self, parameters: usize) {
        self.terms.clear();
        (self.done, self.squared_error, self.coach_loss) = (0, 0.0, 0.0);
        self.gradient.clear();
        self.gradient.resize(parameters, 0.0);
    }
}

impl<'a> Step<'a> {
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
    fn tasks(&self, state: usize) -> impl Iterator<Item = Option<usize>> + use<'a> {
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

    fn look<'o>(&self, view: View, order: &'o TaskOrder) -> Look<'o>
    where
        'a: 'o,
    {
        let targets = self.config.targets(self.windows.shape);
        Look::new((self.windows, view), (self.config.conditioning, order), targets)
    }

    /// Adds the terms of some states of a window to a lane, with their targets.
    pub(super) fn value(&self, popart: &PopArt, states: &[usize], lane: &mut Lane) {
        let (windows, actions) = (self.windows, self.windows.shape.actions);
        let bootstrapped = self.list_terms(states, &mut lane.terms);
        let Lane { tape, teams, input, .. } = lane;
        teams.clear();
        for Bootstrapped { state, task, .. } in &bootstrapped {
            teams.push(View::NEXT_AS_BEFORE.of(windows, *state), *state, *task);
        }
        let Some(window) = bootstrapped.first().map(|first| first.state / windows.shape.steps)
        else {
            return;
        };
        let told = |t: &mut Pass<'_>, side: &Side, teams: &Teams| {
            let agents = teams.agents().map(|(state, agent)| (state + 1, agent));
            let drawn = (&side.coach_order, side.seed);
            self.layers.coaching.map(|it| it.tell(t, (windows, window), drawn, agents).strategies)
        };

        let mut t = tape.begin_forward(&self.online.parameters);
        let strategies = told(&mut t, &self.online, teams);
        let look = self.look(View::NEXT, &self.online.order);
        let utilities = self.layers.agents.utilities(&mut t, look, teams, strategies);
        let rows = t.values(utilities).chunks_exact(actions).zip(teams.agents());
        let best = rows.map(|(row, (state, agent))| {
            let available = windows.available[(state + 1) * windows.shape.agents + agent];
            best(row, available) as u32
        });
        let best: Vec<u32> = best.collect();
        lane.operations += t.operations(false);

        let mut t = tape.begin_forward(&self.target.parameters);
        let strategies = told(&mut t, &self.target, teams);
        let look = self.look(View::NEXT_AS_BEFORE, &self.target.order);
        let values = self.mixed(&mut t, (look, strategies), (teams, input), &best);
        let outputs = bootstrapped.iter().map(|it| self.output(it.task.unwrap_or(0)));
        let values = self.layers.mixer.head(&mut t, values, &outputs.collect::<Vec<_>>());
        for (value, Bootstrapped { term, discount, .. }) in
            t.values(values).iter().zip(&bootstrapped)
        {
            lane.terms[*term].target += discount * popart.denormalise(f64::from(*value));
        }
        lane.operations += t.operations(false);
    }

    /// The values of teams before the head, from the utilities of these actions.
    fn mixed(
        &self,
        t: &mut Pass<'_>,
        (look, told): (Look<'_>, Option<Var>),
        (teams, input): (&mut Teams, &mut MixerInput),
        actions: &[u32],
    ) -> Var {
        let utilities = self.layers.agents.utilities(t, look, teams, told);
        let chosen = t.pick(utilities, actions);
        teams.write_mixer(self.look(look.view, &self.mixer_order), input);
        self.layers.mixer.mix(t, self.layers.merged, input, chosen)
    }

    /// The output of the head that values a subtask.
    fn output(&self, task: usize) -> u32 {
        (task % self.layers.mixer.shape.outputs) as u32
    }

    /// Adds the terms of some states with their rewards; lists those that bootstrap, teams of a state together.
    fn list_terms(&self, states: &[usize], terms: &mut Vec<Term>) -> Vec<Bootstrapped> {
        let mut bootstrapped = Vec::new();
        for state in states {
            for task in self.tasks(*state) {
                let (target, last) = self.returns(*state, task);
                let term = terms.len();
                let follows =
                    last.map(|(state, discount)| Bootstrapped { state, task, term, discount });
                bootstrapped.extend(follows);
                terms.push(Term { state: *state, task: task.unwrap_or(0), target });
            }
        }
        bootstrapped.sort_by_key(|bootstrapped| bootstrapped.state);
        bootstrapped
    }

    /// Adds to a lane the gradients of its next terms, which are those of some states of a window.
    pub(super) fn descend(&self, comparison: &Comparison<'_>, states: &[usize], lane: &mut Lane) {
        let (windows, shape) = (self.windows, self.windows.shape);
        let Lane { tape, teams, input, squared_error, coach_loss, .. } = lane;
        teams.clear();
        for state in states {
            for task in self.tasks(*state) {
                teams.push(View::NOW.of(windows, *state), *state, task);
            }
        }
        let terms = &lane.terms[lane.done..][..teams.each().count()];
        lane.done += terms.len();

        let mut t = tape.begin(&self.online.parameters);
        let told = self.layers.coaching.map(|coaching| {
            let drawn = (&self.online.coach_order, self.online.seed);
            let window = states[0] / shape.steps;
            (coaching, coaching.tell(&mut t, (windows, window), drawn, teams.agents()))
        });
        let look = self.look(View::NOW, &self.online.order);
        let strategies = told.map(|(_, told)| told.strategies);
        let taken = teams.agents().map(|(state, agent)| state * shape.agents + agent);
        let taken: Vec<u32> = taken.map(|place| windows.actions[place].into()).collect();
        let raw = self.mixed(&mut t, (look, strategies), (teams, input), &taken);
        let outputs: Vec<u32> = terms.iter().map(|term| self.output(term.task)).collect();
        let compared = t.values(raw).iter().zip(&outputs).zip(terms);
        let slopes = comparison.slopes(compared, squared_error);
        let values = self.layers.mixer.head(&mut t, raw, &outputs);
        let mut loss = t.weighted_sum(values, &slopes);
        if let Some((coaching, told)) = told {
            let order = (windows, &self.recognition_order);
            let own = coaching.loss(&mut t, order, (states, comparison.terms), told);
            *coach_loss += f64::from(t.values(own)[0]);
            loss = t.add(loss, own);
        }
        t.backward(loss, &mut lane.gradient);
        lane.operations += t.operations(true);
    }
}

impl Comparison<'_> {
    /// The slopes of the loss by the values of some terms, which come with their values before the head and its outputs.
    fn slopes<'t>(
        &self,
        compared: impl Iterator<Item = ((&'t f32, &'t u32), &'t Term)>,
        squared_error: &mut f64,
    ) -> Vec<f32> {
        let (weights, biases) = self.head.split_at(self.head.len() / 2);
        let slope = |((raw, output), term): ((&f32, &u32), &Term)| {
            let value = weights[*output as usize] * raw + biases[*output as usize];
            let error = f64::from(value) - self.popart.normalise(term.target);
            *squared_error += error * error;
            (2.0 * error / self.terms as f64) as f32
        };
        compared.map(slope).collect()
    }
}
