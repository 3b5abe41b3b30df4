//! For tests: a street with agents and sites at numbered doors, whose states are laid out by hand.

use sortie_envs::{
    AgentSet, EntitySet, Environment, Episode, Observation, Random, Rewards, Rule, Shape,
    SparseRows, Spec, Split, StateError, Step, StepError, UNASSIGNED, members,
};

/// Slots of agents.
pub(in crate::alma::records) const AGENTS: usize = 8;
const SITES: usize = 4;
const DOORS: u8 = 16;

/// A state: the doors of the agents, then for each site its door and whether it is open.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::alma::records) struct Street {
    pub(in crate::alma::records) agents: Vec<u8>,
    pub(in crate::alma::records) sites: Vec<(u8, bool)>,
}

impl Street {
    /// So many agents at their own numbers, and open sites at these doors.
    pub(in crate::alma::records) fn new(agents: u8, doors: &[u8]) -> Self {
        let sites = doors.iter().map(|door| (*door, true)).collect();
        Self { agents: (0..agents).collect(), sites }
    }

    pub(in crate::alma::records) fn bytes(&self) -> Vec<u8> {
        let mut bytes = vec![self.agents.len() as u8];
        bytes.extend(&self.agents);
        self.sites.iter().for_each(|(door, is_open)| bytes.extend([*door, u8::from(*is_open)]));
        bytes
    }

    fn read(bytes: &[u8]) -> Self {
        let (agents, sites) = bytes[1..].split_at(bytes[0].into());
        let sites = sites.chunks_exact(2).map(|site| (site[0], site[1] == 1));
        Self { agents: agents.to_vec(), sites: sites.collect() }
    }

    /// All that there is to see.
    pub(in crate::alma::records) fn seen(&self) -> Observation {
        let mut seen = Observation::default();
        toy().observe(&self.bytes(), 0, EntitySet::MAX, &mut seen);
        seen
    }

    fn distance(&self, agent: usize, site: usize) -> u8 {
        self.agents[agent].abs_diff(self.sites[site].0)
    }
}

/// The environment of such states; nobody plays in it.
pub(in crate::alma::records) struct Toy {
    spec: Spec,
    /// The sites that belong to the subtask of the one before them.
    pub(in crate::alma::records) joined: u32,
}

pub(in crate::alma::records) fn toy() -> Toy {
    let shape =
        Shape { agents: AGENTS, entities: AGENTS + SITES, tasks: SITES, actions: 3, features: 3 };
    let spec = Spec {
        name: "street".into(),
        shape,
        rewards: Rewards { tasks: true, agents: false },
        turns: 2,
        // Everybody to the last site, to the nearest, or to the first.
        rules: ["coordinated", "heuristic", "random"].map(|name| Rule::new(name, "")).to_vec(),
        relations: DOORS.into(),
        row_entries: 3,
        state_bytes: 1 + AGENTS + 2 * SITES,
        ..Spec::default()
    };
    Toy { spec, joined: 0 }
}

impl Environment for Toy {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn instances(&self) -> usize {
        1
    }

    fn open(&self, _: usize, _: Split) -> Box<dyn Environment> {
        Box::new(toy())
    }

    fn reset(&mut self, _: usize, _: &mut Random) {}

    fn step(&mut self, _: usize, _: &[u16], _: &mut Random) -> Result<Step, StepError> {
        Err(StepError::EpisodeOver)
    }

    fn save(&self, _: usize, state: &mut Vec<u8>) {
        state.extend(Street::new(1, &[3]).bytes());
    }

    fn load(&mut self, _: usize, _: &[u8]) -> Result<(), StateError> {
        Ok(())
    }

    /// Features: 1 for a site, the door, whether it is open.
    fn observe(&self, state: &[u8], turn: usize, wanted: EntitySet, seen: &mut Observation) {
        let street = Street::read(state);
        *seen = Observation::new(&self.spec.shape);
        let (agents, sites) = (street.agents.len(), street.sites.len());
        seen.present = ((1 << sites) - 1) << AGENTS | ((1 << agents) - 1);
        seen.entities = wanted & seen.present;
        seen.observable[..agents].fill(seen.present);
        seen.available[..agents].fill(0b111);
        let turned = |door: u8| f32::from(if turn == 0 { door } else { DOORS - 1 - door });
        for entity in members(seen.entities) {
            match entity.checked_sub(AGENTS) {
                None => seen.rows.push_dense(&[0.0, turned(street.agents[entity]), 0.0]),
                Some(site) => {
                    let (door, is_open) = street.sites[site];
                    seen.rows.push_dense(&[1.0, turned(door), f32::from(u8::from(is_open))]);
                }
            }
        }
        for (site, (_, is_open)) in street.sites.iter().enumerate() {
            let task = site - (self.joined >> site & 1) as usize;
            seen.entity_task[AGENTS + site] = 1 << task;
            seen.open_tasks |= u128::from(*is_open) << task;
        }
    }

    fn episode(&self, _: usize) -> Episode {
        Episode::default()
    }

    fn turned_action(&self, turn: usize, action: u16) -> u16 {
        [action, [0, 2, 1][usize::from(action)]][turn]
    }

    fn allocate(&self, rule: usize, state: &[u8], _: &mut Random, allocation: &mut [u8]) {
        let street = Street::read(state);
        let open: Vec<usize> = (0..street.sites.len()).filter(|s| street.sites[*s].1).collect();
        allocation.fill(UNASSIGNED);
        for (agent, task) in allocation.iter_mut().take(street.agents.len()).enumerate() {
            let nearest = open.iter().copied().min_by_key(|site| street.distance(agent, *site));
            let site = [open.last().copied(), nearest, open.first().copied()][rule];
            *task = site.map_or(UNASSIGNED, |site| site as u8);
        }
    }

    /// The distance to the site, or without one to the nearest that is open.
    fn potential(&self, state: &[u8], scale: f32, team: AgentSet, task: Option<usize>) -> f32 {
        let street = Street::read(state);
        let open = || (0..street.sites.len()).filter(|site| street.sites[*site].1);
        let distance = |agent: usize| match task {
            Some(task) => Some(street.distance(agent, task)),
            None => open().map(|site| street.distance(agent, site)).min(),
        };
        members(team.into()).map(|agent| -scale * f32::from(distance(agent).unwrap_or(0))).sum()
    }

    /// The distance as one-hot.
    fn relate(
        &self,
        state: &[u8],
        _: usize,
        task: usize,
        wanted: EntitySet,
        rows: &mut SparseRows,
    ) {
        let street = Street::read(state);
        let door = street.sites[task].0;
        for entity in members(wanted & street.seen().present) {
            let other = match entity.checked_sub(AGENTS) {
                None => Some(street.agents[entity]),
                Some(site) if site != task && street.sites[site].1 => Some(street.sites[site].0),
                Some(_) => None,
            };
            other.iter().for_each(|other| rows.push(other.abs_diff(door).into(), 1.0));
            rows.end_row();
        }
    }
}
