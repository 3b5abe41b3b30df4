//! Group Matching as an [`Environment`]: many rings at once, what there is to see of them, a row per agent, all of it
//! zeros and ones, and what a ring says of itself.

use alloc::boxed::Box;
use alloc::string::{String, ToString};
use alloc::vec::Vec;
use alloc::{format, vec};
use core::f64::consts::PI;

use super::VERSION;
use super::parameters::{Parameters, ParametersError, SET_NAMES};
use super::ring::{
    ACTION_NAMES, ACTIONS, Ring, STAY, State, all_agents, draw_cells, draw_groups, has_both,
    member_bytes, moved, reward, same_group, slipped, state_bytes, walk,
};
use crate::bytes::known;
use crate::entry::{Choice, EnvironmentError};
use crate::environment::{Environment, Split, StateError, Step, StepError, checked_actions};
use crate::observation::{EntitySet, Observation, members};
use crate::picture::{Cell, Disc, Field, Outline, Picture, lettered};
use crate::random::Random;
use crate::spec::{Metric, Shape, Spec, View};

/// The names of the columns of a row: cells, groups, agents.
pub fn feature_names(parameters: &Parameters) -> Vec<String> {
    let Parameters { agents, cells, groups, .. } = *parameters;
    let column = |what: &'static str| move |index: usize| format!("{what} {index}");
    (0..cells)
        .map(column("cell"))
        .chain((0..groups).map(column("group")))
        .chain((0..agents).map(column("agent")))
        .collect()
}

/// The columns of an agent's row that hold a one, in rising order: its cell, its groups, itself.
pub fn columns(
    parameters: &Parameters,
    ring: Ring<'_>,
    agent: usize,
) -> impl Iterator<Item = usize> {
    let Parameters { cells, groups, .. } = *parameters;
    let own = ring.groups().enumerate().filter(move |(_, members)| members >> agent & 1 == 1);
    core::iter::once(usize::from(ring.cells[agent]))
        .chain(own.map(move |(group, _)| cells + group))
        .chain(core::iter::once(cells + groups + agent))
}

/// Writes an agent's row.
pub fn write_row(parameters: &Parameters, ring: Ring<'_>, agent: usize, row: &mut [f32]) {
    row.fill(0.0);
    columns(parameters, ring, agent).for_each(|column| row[column] = 1.0);
}

/// Its name, as `--env` takes it.
pub(super) const NAME: &str = "group-matching";

const METRICS: &[Metric] = &[Metric::reported("matches", "groups", "groups gathered")];

/// Entries of a row beside the groups: its cell, itself.
const OWN_ENTRIES: usize = 2;

/// What a ring with these parameters says of itself.
pub(super) fn spec(parameters: &Parameters) -> Spec {
    let Parameters { agents, groups, episode_limit, .. } = *parameters;
    let features = parameters.features();
    Spec {
        name: NAME.into(),
        version: VERSION,
        shape: Shape { agents, entities: agents, tasks: 0, actions: ACTIONS, features },
        view: View::Entities,
        features: feature_names(parameters),
        actions: ACTION_NAMES.map(String::from).to_vec(),
        safe_action: Some(STAY),
        metrics: METRICS.to_vec(),
        row_entries: OWN_ENTRIES + groups,
        state_bytes: state_bytes(parameters),
        episode_limit,
        ..Spec::default()
    }
}

/// The sizes of a ring by what it says of itself, with its most steps; all else is as usual.
pub fn sizes(spec: &Spec) -> Parameters {
    let Shape { agents, features, .. } = spec.shape;
    let groups = spec.row_entries - OWN_ENTRIES;
    let cells = features - groups - agents;
    Parameters { agents, cells, groups, episode_limit: spec.episode_limit, ..Parameters::default() }
}

/// The middle of a cell: the first one is at the top, the others follow clockwise.
fn middle(cell: usize, cells: usize, radius: f64) -> [f64; 2] {
    let turn = 2.0 * PI * cell as f64 / cells as f64;
    [radius * libm::sin(turn), radius * libm::cos(turn)]
}

/// The cell nearest to a place.
fn cell_at(parameters: &Parameters, place: [f64; 2]) -> Option<u8> {
    let away = |cell: &u8| {
        let [x, y] = middle((*cell).into(), parameters.cells, 1.0);
        libm::hypot(place[0] - x, place[1] - y)
    };
    let nearest =
        (0..parameters.cells as u8).min_by(|one, other| away(one).total_cmp(&away(other)));
    nearest.filter(|cell| away(cell).is_finite())
}

/// What a ring looks like. Agents in one cell stand one behind the other, towards the middle.
fn picture(parameters: &Parameters, ring: Ring<'_>) -> Picture {
    let (cells, groups) = (parameters.cells, ring.groups().collect::<Vec<_>>());
    let side = (0.9 * 2.0 * libm::sin(PI / cells as f64)).min(0.8);
    let gap = (0.9 / ring.cells.len() as f64).min(0.2);
    let agents = ring.cells.iter().enumerate().map(|(agent, cell)| {
        let before = ring.cells[..agent].iter().filter(|other| *other == cell).count();
        let own = groups.iter().enumerate().filter(|(_, members)| **members >> agent & 1 == 1);
        let own: Vec<usize> = own.map(|(group, _)| group).collect();
        let first = own.first().copied().unwrap_or(0);
        let names: Vec<String> = own.into_iter().map(lettered).collect();
        Disc {
            name: format!("{}{agent}", lettered(first)),
            kind: "agent",
            colour: Some(first as u8),
            place: Some(middle((*cell).into(), cells, 1.0 - gap * before as f64)),
            radius: Some(gap.min(side) * 0.45),
            about: format!("in cell {cell}, group {}", names.join(", ")),
            ..Disc::default()
        }
    });
    let things = groups.iter().enumerate().map(|(group, set)| {
        let agents = members(*set).map(|agent| agent.to_string()).collect::<Vec<_>>().join(", ");
        Disc {
            name: lettered(group),
            kind: "group",
            outline: Outline::Square,
            colour: Some(group as u8),
            status: if ring.is_matched(*set) { "together" } else { "apart" }.into(),
            about: if agents.is_empty() { "nobody".into() } else { format!("agents {agents}") },
            ..Disc::default()
        }
    });
    let label = |cell: usize| if cell < 100 { cell.to_string() } else { String::new() };
    let cell = |cell: usize| Cell {
        place: middle(cell, cells, 1.0),
        kind: "cell".into(),
        label: label(cell),
        ..Cell::default()
    };
    Picture {
        field: Some(Field::plane(1.05 + side / 2.0, side)),
        cells: (0..cells).map(cell).collect(),
        agents: agents.collect(),
        things: things.collect(),
        links: Vec::new(),
    }
}

/// Group Matching, many instances in one object. Nothing is allocated after construction.
#[derive(Clone, Debug)]
pub struct GroupMatching {
    parameters: Parameters,
    spec: Spec,
    split: Split,
    episodes: Vec<Episode>,
}

/// What an instance has once.
#[derive(Clone, Debug)]
struct Episode {
    cells: Vec<u8>,
    members: Vec<u8>,
    matches: usize,
    steps: u32,
    episode_return: f64,
}

impl Episode {
    /// Everybody in the first cell, and in the last group; the time is over.
    fn new(parameters: &Parameters) -> Self {
        let bytes = member_bytes(parameters.agents);
        let mut members = vec![0; parameters.groups * bytes];
        let all = all_agents(parameters.agents).to_le_bytes();
        let last = members.len() - bytes;
        members[last..].copy_from_slice(&all[..bytes]);
        Self {
            cells: vec![0; parameters.agents],
            members,
            matches: parameters.groups,
            steps: parameters.episode_limit,
            episode_return: 0.0,
        }
    }

    fn ring(&self) -> Ring<'_> {
        Ring { cells: &self.cells, members: &self.members }
    }

    /// Counts from here on.
    fn begin(&mut self, steps: u32, episode_return: f64) {
        self.matches = self.ring().matches();
        self.steps = steps;
        self.episode_return = episode_return;
    }
}

impl GroupMatching {
    /// Sets up `instances` rings whose episodes are over.
    pub fn new(parameters: Parameters, instances: usize) -> Result<Self, ParametersError> {
        parameters.check()?;
        if parameters.holds_out() && !has_both(&parameters) {
            return Err(ParametersError::HeldOut);
        }
        let episodes = vec![Episode::new(&parameters); instances];
        Ok(Self { episodes, spec: spec(&parameters), split: Split::Train, parameters })
    }

    /// What the rules leave open.
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// The same rules with so many instances, whose episodes are over, and other starts.
    fn with_instances(&self, instances: usize, split: Split) -> Self {
        let episodes = vec![Episode::new(&self.parameters); instances];
        Self { episodes, spec: self.spec.clone(), split, parameters: self.parameters }
    }

    /// Who stands where, and who belongs together.
    pub fn ring(&self, instance: usize) -> Ring<'_> {
        self.episodes[instance].ring()
    }

    /// The values of the episode so far.
    pub fn metrics(&self, instance: usize) -> EpisodeMetrics {
        let episode = &self.episodes[instance];
        EpisodeMetrics {
            solved: self.is_solved(instance),
            episode_return: episode.episode_return,
            steps: episode.steps,
            matches: episode.matches,
            timed_out: episode.steps >= self.parameters.episode_limit,
        }
    }

    /// Whether the episode is over and the instance waits for a reset.
    pub fn is_done(&self, instance: usize) -> bool {
        self.is_solved(instance) || self.episodes[instance].steps >= self.parameters.episode_limit
    }

    /// A start may be solved already; only the first step decides.
    fn is_solved(&self, instance: usize) -> bool {
        let episode = &self.episodes[instance];
        episode.steps > 0 && episode.matches == self.parameters.groups
    }

    /// Steps with the actions that happened, for replays.
    pub fn step_executed(&mut self, instance: usize, executed: &[u16]) -> Result<Step, StepError> {
        self.step_with(instance, executed, |action| action)
    }

    fn step_with(
        &mut self,
        instance: usize,
        actions: &[u16],
        mut execute: impl FnMut(u16) -> u16,
    ) -> Result<Step, StepError> {
        let Parameters { agents, cells, groups, episode_limit, .. } = self.parameters;
        let actions = checked_actions(self.is_done(instance), agents, ACTIONS, actions)?;
        let episode = &mut self.episodes[instance];
        for (cell, action) in episode.cells.iter_mut().zip(actions) {
            *cell = moved(*cell, execute(*action), cells);
        }
        let before = episode.matches;
        episode.matches = episode.ring().matches();
        episode.steps += 1;
        let reward = reward(before, episode.matches);
        episode.episode_return += reward;
        // What ends at the limit counts as cut off there, solved or not.
        let (solved, timed_out) = (episode.matches == groups, episode.steps >= episode_limit);
        Ok(Step { reward, terminated: solved && !timed_out, timed_out, tasks_changed: false })
    }
}

/// The values of one episode so far, final once it is done.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EpisodeMetrics {
    /// Whether the last step left all groups gathered.
    pub solved: bool,
    /// Sum of the team's rewards.
    pub episode_return: f64,
    /// Steps so far.
    pub steps: u32,
    /// Groups that have gathered.
    pub matches: usize,
    /// Whether the time ran out, solved or not.
    pub timed_out: bool,
}

/// Makes one.
pub(super) fn open(choice: &Choice<'_>) -> Result<GroupMatching, EnvironmentError> {
    let settings: Parameters = choice.settings()?;
    let Parameters { agents, cells, groups, fixed_groups, .. } =
        Parameters::named(choice.set.unwrap_or(SET_NAMES[0]))
            .map_err(|error| EnvironmentError::Set(error.to_string()))?;
    let parameters = Parameters { agents, cells, groups, fixed_groups, ..settings };
    GroupMatching::new(parameters, choice.instances)
        .map(|ring| ring.with_instances(choice.instances, choice.split))
        .map_err(|error| EnvironmentError::Setting(error.to_string()))
}

impl Environment for GroupMatching {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn instances(&self) -> usize {
        self.episodes.len()
    }

    fn open(&self, instances: usize, split: Split) -> Box<dyn Environment> {
        Box::new(self.with_instances(instances, split))
    }

    fn reset(&mut self, instance: usize, random: &mut Random) {
        let (parameters, episode) = (&self.parameters, &mut self.episodes[instance]);
        draw_groups(parameters, self.split, random, &mut episode.members);
        draw_cells(parameters, random, &mut episode.cells);
        episode.begin(0, 0.0);
    }

    /// Asks every agent for its action, which chance may replace.
    fn step(
        &mut self,
        instance: usize,
        actions: &[u16],
        random: &mut Random,
    ) -> Result<Step, StepError> {
        let parameters = self.parameters;
        self.step_with(instance, actions, |action| slipped(&parameters, action, random))
    }

    fn save(&self, instance: usize, state: &mut Vec<u8>) {
        let Episode { steps, episode_return, .. } = self.episodes[instance];
        State { steps, episode_return, ring: self.ring(instance) }.write(state);
    }

    fn load(&mut self, instance: usize, state: &[u8]) -> Result<(), StateError> {
        let state = State::read(&self.parameters, state)?.check(&self.parameters)?;
        let episode = &mut self.episodes[instance];
        episode.cells.copy_from_slice(state.ring.cells);
        episode.members.copy_from_slice(state.ring.members);
        episode.begin(state.steps, state.episode_return);
        Ok(())
    }

    /// A cell is a column of the only row; what the groups came to so far counts from there.
    fn picture(&self, state: &[u8]) -> Picture {
        picture(&self.parameters, known(State::read(&self.parameters, state)).ring)
    }

    /// The nearest cell counts.
    fn place(&mut self, instance: usize, agent: usize, place: [f64; 2]) -> Result<(), StateError> {
        let Parameters { agents, groups, .. } = self.parameters;
        let cell = cell_at(&self.parameters, place).filter(|_| agent < agents);
        let Some(cell) = cell else {
            return Err(StateError::Impossible("agents stand in cells of the ring".into()));
        };
        let episode = &mut self.episodes[instance];
        let before = core::mem::replace(&mut episode.cells[agent], cell);
        let matches = episode.ring().matches();
        if matches == groups {
            episode.cells[agent] = before;
            return Err(StateError::Impossible("the last group gathers by itself only".into()));
        }
        episode.matches = matches;
        Ok(())
    }

    fn observe(&self, state: &[u8], _: usize, wanted: EntitySet, seen: &mut Observation) {
        let parameters = &self.parameters;
        let ring = known(State::read(parameters, state)).ring;
        let all = all_agents(parameters.agents);
        seen.begin_agents(parameters.agents, ACTIONS, wanted, |_| all);
        for agent in members(seen.entities) {
            columns(parameters, ring, agent).for_each(|column| seen.rows.push(column, 1.0));
            seen.rows.end_row();
        }
    }

    fn episode(&self, instance: usize) -> crate::Episode {
        let counted = self.metrics(instance);
        let sizes = self.ring(instance).groups().map(|members| members.count_ones().to_string());
        crate::Episode {
            steps: counted.steps,
            done: self.is_done(instance),
            solved: counted.solved,
            timed_out: counted.timed_out,
            episode_return: counted.episode_return,
            group: sizes.reduce(|sizes, size| format!("{sizes}+{size}")).unwrap_or_default(),
            metrics: [Some(counted.matches as f64)].to_vec(),
            cause: None,
        }
    }

    fn scripted(&self, state: &[u8], _: &[u8], _: &mut Random, actions: &mut [u16]) -> bool {
        walk(&self.parameters, known(State::read(&self.parameters, state)).ring, actions);
        true
    }

    fn companions(&self, state: &[u8], companions: &mut [EntitySet]) -> bool {
        let state = known(State::read(&self.parameters, state));
        for (agent, companions) in companions.iter_mut().enumerate() {
            *companions = same_group(&self.parameters, state.ring, state.steps, agent);
        }
        true
    }
}
