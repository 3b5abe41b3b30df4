//! The teams of some states, and what agents and mixer see of them.

use std::ops::Range;

use sortie_envs::EntitySet;
use sortie_learn::networks::Targets;
use sortie_nn::layers::SparseRows;

use super::mixer::MixerInput;
use crate::alma::agents::{Conditioning, TaskOrder, UtilityInput};
use crate::alma::windows::{NO_ACTION, NO_TASK, Windows};

/// One state, seen with the subtasks that hold at a state: usually the same, or the one before.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scene<'a> {
    pub(super) windows: &'a Windows,
    /// Whose entities there are.
    pub(super) state: usize,
    /// Whose subtasks and allocation hold.
    tasks_of: usize,
}

impl Scene<'_> {
    pub(super) fn present(self, entity: usize) -> bool {
        self.windows.present[self.state * self.windows.shape.entities + entity]
    }

    /// The subtask of an entity, or [`NO_TASK`].
    pub(super) fn task(self, entity: usize) -> u8 {
        self.windows.entity_task[self.tasks_of * self.windows.shape.entities + entity]
    }

    /// Whether two entities work on a subtask together.
    fn share_task(self, a: usize, b: usize) -> bool {
        self.task(a) != NO_TASK && self.task(a) == self.task(b)
    }

    fn observes(self, agent: usize, entity: usize) -> bool {
        let shape = self.windows.shape;
        let row = self.state * shape.agents + agent;
        self.windows.observable[row * shape.entities + entity] && self.present(entity)
    }

    /// The features of an entity.
    fn features(self, entity: usize) -> impl Iterator<Item = (usize, f32)> {
        self.windows.features.row(self.state * self.windows.shape.entities + entity)
    }
}

const NOWHERE: u32 = u32::MAX;

/// How states are looked at, from the state that a team belongs to.
#[derive(Clone, Copy, Debug)]
pub(super) struct View {
    /// Steps ahead of it whose entities there are.
    ahead: usize,
    /// Steps ahead of it whose subtasks hold.
    tasks_ahead: usize,
}

impl View {
    /// The state itself.
    pub(super) const NOW: Self = Self { ahead: 0, tasks_ahead: 0 };
    /// The state behind it.
    pub(super) const NEXT: Self = Self { ahead: 1, tasks_ahead: 1 };
    /// The state behind it, with the allocation as it was: whose team it is does not change on the way.
    pub(super) const NEXT_AS_BEFORE: Self = Self { ahead: 1, tasks_ahead: 0 };

    /// How agents with a memory look at all states of a window, one after the other, so that they look
    /// like this at one: with the allocation of each state, memories begin at a window's first.
    pub(super) fn sequence(self) -> Self {
        if self.ahead == self.tasks_ahead { Self::NOW } else { self }
    }

    /// Steps ahead of a state whose entities there are.
    pub(super) fn ahead(self) -> usize {
        self.ahead
    }

    /// What there is to see of a state.
    pub(super) fn of(self, windows: &Windows, state: usize) -> Scene<'_> {
        Scene { windows, state: state + self.ahead, tasks_of: state + self.tasks_ahead }
    }
}

/// States in a view, and how subtasks are seen there.
#[derive(Clone, Copy, Debug)]
pub(super) struct Look<'a> {
    pub(super) windows: &'a Windows,
    pub(super) view: View,
    conditioning: Conditioning,
    /// The columns that mark an entity's subtask: the one of subtask t stands at place t, counted from the
    /// first behind features and last action.
    marks: Option<&'a [u16]>,
    /// What heads point at.
    targets: Targets,
}

impl<'a> Look<'a> {
    /// With the marks of this order, where entities are marked, for heads that point at these.
    pub(super) fn new(
        (windows, view): (&'a Windows, View),
        (conditioning, order): (Conditioning, &'a TaskOrder),
        targets: Targets,
    ) -> Self {
        let marks = (conditioning == Conditioning::Input).then_some(&*order.0);
        Self { windows, view, conditioning, marks, targets }
    }

    /// Adds the row of an entity: its features, its last action's one-hot, its subtask's mark.
    ///
    /// How an agent stands to what it may aim at is left out: it would tell of what the agent does not see.
    fn write(self, scene: Scene<'_>, entity: usize, rows: &mut SparseRows) {
        let shape = scene.windows.shape;
        let pairs = if entity < shape.agents { self.targets.pairs() } else { 0..0 };
        let own = scene.features(entity).filter(|(column, _)| !pairs.contains(column));
        own.for_each(|(column, value)| rows.push(column, value));
        if entity < shape.agents {
            let last = scene.windows.last_actions[scene.state * shape.agents + entity];
            if last != NO_ACTION {
                rows.push(shape.features + usize::from(last), 1.0);
            }
        }
        let mark = self.marks.and_then(|marks| marks.get(usize::from(scene.task(entity))));
        if let Some(column) = mark {
            rows.push(shape.features + shape.actions + usize::from(*column), 1.0);
        }
        rows.end_row();
    }

    /// The row of an entity, which is added where it has none.
    fn row(
        self,
        scene: Scene<'_>,
        entity: usize,
        places: &mut [u32],
        rows: &mut SparseRows,
    ) -> usize {
        if places[entity] == NOWHERE {
            places[entity] = rows.len() as u32;
            self.write(scene, entity, rows);
        }
        places[entity] as usize
    }
}

/// The agents that work on a subtask in a state; without subtasks, all of a state.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Team {
    pub(super) state: usize,
    /// Their subtask; 0 without subtasks.
    pub(super) task: usize,
    /// Their place among the agents of all teams.
    agents: Range<usize>,
}

/// Teams one behind the other, those of a state together.
#[derive(Clone, Debug, Default)]
pub(super) struct Teams {
    teams: Vec<Team>,
    agents: Vec<u8>,
    /// `[N]`: the row of every entity of the current state, or [`NOWHERE`] until it is asked for.
    places: Vec<u32>,
}

impl Teams {
    pub(super) fn clear(&mut self) {
        self.teams.clear();
        self.agents.clear();
    }

    /// Adds the team of a subtask, with the agents that exist and hold to it in a view of its state.
    ///
    /// With `None` the team is everybody.
    pub(super) fn push(&mut self, scene: Scene<'_>, state: usize, task: Option<usize>) {
        let start = self.agents.len();
        let member = |agent: &u8| {
            let agent = usize::from(*agent);
            scene.present(agent) && task.is_none_or(|task| usize::from(scene.task(agent)) == task)
        };
        self.agents.extend((0..scene.windows.shape.agents as u8).filter(member));
        let agents = start..self.agents.len();
        self.teams.push(Team { state, task: task.unwrap_or(0), agents });
    }

    pub(super) fn each(&self) -> impl Iterator<Item = &Team> + Clone {
        self.teams.iter()
    }

    /// State and number of every agent of every team.
    pub(super) fn agents(&self) -> impl Iterator<Item = (usize, usize)> + Clone + '_ {
        self.teams.iter().flat_map(|team| {
            self.agents[team.agents.clone()].iter().map(|agent| (team.state, usize::from(*agent)))
        })
    }

    /// Writes what the agents see: with the subtask mask only those of their subtask.
    pub(super) fn write_agents(&mut self, look: Look<'_>, input: &mut UtilityInput) {
        input.clear();
        input.aims.aim_at(look.targets.entities(), look.targets.pairs());
        for (state, agent) in self.agents() {
            look.write(look.view.of(look.windows, state), agent, &mut input.rows);
        }
        let Self { teams, agents, places } = self;
        let masked = look.conditioning == Conditioning::Mask;
        for scene_teams in teams.chunk_by(|a, b| a.state == b.state) {
            let (scene, own) = begin(look, scene_teams, agents, places);
            for agent in own.iter().copied().map(usize::from) {
                let mut seen: EntitySet = 0;
                for entity in 0..look.windows.shape.entities {
                    if scene.observes(agent, entity) && (!masked || scene.share_task(agent, entity))
                    {
                        let row = look.row(scene, entity, places, &mut input.rows);
                        input.visible.push(row);
                        seen |= 1 << entity;
                    }
                }
                let query = input.visible.queries() as u32;
                input.visible.end_list();
                let row = |entity: usize| places[entity] as usize;
                input.aims.push((query, scene.features(agent)), seen, row);
            }
        }
    }

    /// Writes what the mixer sees: everything that exists, with the subtask mask what belongs to a
    /// team's subtask.
    pub(super) fn write_mixer(&mut self, look: Look<'_>, input: &mut MixerInput) {
        input.rows.clear();
        input.teams.clear();
        for (state, agent) in self.agents() {
            look.write(look.view.of(look.windows, state), agent, &mut input.rows);
        }
        let Self { teams, agents, places } = self;
        let masked = look.conditioning == Conditioning::Mask;
        for scene_teams in teams.chunk_by(|a, b| a.state == b.state) {
            let (scene, _) = begin(look, scene_teams, agents, places);
            for team in scene_teams {
                for entity in 0..look.windows.shape.entities {
                    let belongs = !masked || usize::from(scene.task(entity)) == team.task;
                    if scene.present(entity) && belongs {
                        let row = look.row(scene, entity, places, &mut input.rows);
                        input.teams.push(row);
                    }
                }
                input.teams.end_team(team.agents.len());
            }
        }
    }
}

/// Begins the state of some teams, whose agents have rows already; returns what there is to see and their agents.
fn begin<'a, 'w>(
    look: Look<'w>,
    teams: &[Team],
    agents: &'a [u8],
    places: &mut Vec<u32>,
) -> (Scene<'w>, &'a [u8]) {
    let span = teams[0].agents.start..teams[teams.len() - 1].agents.end;
    let own = &agents[span.clone()];
    places.clear();
    places.resize(look.windows.shape.entities, NOWHERE);
    span.zip(own).for_each(|(row, agent)| places[usize::from(*agent)] = row as u32);
    (look.view.of(look.windows, teams[0].state), own)
}

/// The subtask of every agent at a state, of those that have one.
pub(super) fn tasks_with_agents(scene: Scene<'_>) -> u64 {
    (0..scene.windows.shape.agents)
        .filter(|agent| scene.present(*agent) && scene.task(*agent) != NO_TASK)
        .fold(0, |tasks, agent| tasks | 1 << scene.task(agent))
}
