//! What the rules of a game leave open, and an episode under them, in memory and as bytes.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use super::world::{CELLS, Game, HOMES, ITEMS, World};
use crate::bytes::{LAYOUT, Reader};
use crate::environment::StateError;
use crate::random::{below, generator};

/// What the rules leave open.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rules {
    /// The milestones in use, the task last.
    pub milestones: MilestoneSet,
    /// Whether the first of each milestone is paid for, instead of the task alone.
    pub dense: bool,
    /// Chance of each step that an item gets lost.
    pub loss: f64,
    /// Steps after which an episode that is measured is over.
    pub limit: u16,
    /// Steps after which one to learn from is over.
    pub training_limit: u16,
}

impl Rules {
    /// The usual rules of a game for a set of milestones.
    pub fn usual<G: Game>(milestones: MilestoneSet) -> Self {
        let limit = (30 * G::SIZE * G::SIZE) as u16;
        Self { milestones, dense: false, loss: 0.0, limit, training_limit: 1_500 }
    }
}

/// Milestones of a game in their order; the last is the task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MilestoneSet {
    /// As bits, by the numbers that the game gives them.
    used: u16,
}

impl MilestoneSet {
    /// All milestones up to a task.
    pub fn up_to<G: Game>(task: &str) -> Option<Self> {
        let last = number::<G>(task)?;
        Some(Self { used: (1 << (last + 1)) - 1 })
    }

    /// These milestones, the last of which in the order of the game is the task.
    ///
    /// # Errors
    /// The name that no milestone has; empty where there are no names.
    pub fn named<'a, G: Game>(names: impl Iterator<Item = &'a str>) -> Result<Self, &'a str> {
        let mut used = 0;
        for name in names {
            used |= 1 << number::<G>(name).ok_or(name)?;
        }
        if used == 0 { Err("") } else { Ok(Self { used }) }
    }

    /// The task and others of these milestones, so many in all, by a seed.
    ///
    /// # Errors
    /// There are fewer.
    pub fn drawn(self, count: usize, seed: u64) -> Result<Self, String> {
        let all = self.used.count_ones() as usize;
        if !(1..=all).contains(&count) {
            return Err(format!("{count} milestones, there are 1 to {all} for this task"));
        }
        let (mut random, mut drawn) = (generator(seed), self);
        while drawn.len() > count {
            let chosen = drawn.members().nth(below(&mut random, drawn.len() - 1));
            drawn.used &= !chosen.map_or(0, |milestone| 1 << milestone);
        }
        Ok(drawn)
    }

    /// As bits, by the numbers that the game gives them.
    pub fn bits(self) -> u16 {
        self.used
    }

    /// How many there are.
    #[expect(clippy::len_without_is_empty, reason = "a task is always there")]
    pub fn len(self) -> usize {
        self.used.count_ones() as usize
    }

    /// The number of the task.
    pub fn task(self) -> u8 {
        (15 - self.used.leading_zeros()) as u8
    }

    /// The place of a milestone among those in use.
    pub fn place(self, milestone: u8) -> Option<u8> {
        let below = self.used & ((1 << milestone) - 1);
        (self.used >> milestone & 1 == 1).then_some(below.count_ones() as u8)
    }

    /// Milestones as bits, by their places among those in use.
    pub fn places(self, milestones: u16) -> u32 {
        let members = self.members().enumerate();
        members.fold(0, |set, (place, milestone)| {
            set | u32::from(milestones >> milestone & 1) << place
        })
    }

    fn members(self) -> impl Iterator<Item = u8> {
        (0..16).filter(move |milestone| self.used >> milestone & 1 == 1)
    }

    /// Their names.
    pub fn names<G: Game>(self) -> Vec<&'static str> {
        self.members().map(|milestone| G::MILESTONES[usize::from(milestone)]).collect()
    }
}

fn number<G: Game>(name: &str) -> Option<u8> {
    G::MILESTONES.iter().position(|milestone| *milestone == name).map(|number| number as u8)
}

/// How an episode stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Standing {
    Running,
    Solved,
    /// No milestone can be had any more.
    Impossible,
}

/// What an instance has once.
#[derive(Clone, Copy, Debug)]
pub(super) struct Episode {
    pub(super) world: World,
    pub(super) steps: u16,
    pub(super) limit: u16,
    pub(super) standing: Standing,
    pub(super) episode_return: f64,
    /// The milestones that were reached, as bits by the game's numbers.
    pub(super) reached: u16,
    /// The milestone in use that the last step reached, by its place.
    pub(super) milestone: Option<u8>,
}

impl Episode {
    pub(super) fn begins(world: World, limit: u16) -> Self {
        let (standing, milestone) = (Standing::Running, None);
        Self { world, steps: 0, limit, standing, episode_return: 0.0, reached: 0, milestone }
    }

    pub(super) fn is_done(&self) -> bool {
        self.standing != Standing::Running || self.steps >= self.limit
    }
}

/// Bytes beside the cells and the items.
const OTHERS: usize = 1 + 2 + 2 + 1 + 8 + 2 + 2 + 4 + HOMES;

/// Bytes of every state: the ring of walls is not among them.
pub(super) fn state_bytes<G: Game>() -> usize {
    OTHERS + 2 * ITEMS + (G::SIZE - 2) * (G::SIZE - 2)
}

/// Adds the bytes of a state.
pub(super) fn write_episode(episode: &Episode, bytes: &mut Vec<u8>) {
    let Episode { world, steps, limit, standing, episode_return, reached, .. } = episode;
    let mut buffer = [0; OTHERS + 2 * ITEMS + CELLS];
    let mut count = 0;
    let mut add = |part: &[u8]| {
        buffer[count..][..part.len()].copy_from_slice(part);
        count += part.len();
    };
    add(&[LAYOUT]);
    add(&steps.to_le_bytes());
    add(&limit.to_le_bytes());
    add(&[*standing as u8]);
    add(&episode_return.to_le_bytes());
    add(&reached.to_le_bytes());
    add(&world.open.to_le_bytes());
    add(&[world.position, world.direction, world.carried, world.case]);
    add(&world.homes);
    world.inventory.iter().for_each(|carried| add(&carried.to_le_bytes()));
    let size = usize::from(world.size);
    for row in world.cells[size..size * (size - 1)].chunks_exact(size) {
        add(&row[1..size - 1]);
    }
    bytes.extend_from_slice(&buffer[..count]);
}

/// Reads what [`write_episode`] wrote; nothing is checked but the length.
#[inline]
pub(super) fn read_episode<G: Game>(bytes: &[u8]) -> Result<Episode, StateError> {
    let mut reader = Reader::new(bytes, state_bytes::<G>())?;
    let (steps, limit) = (reader.u16(), reader.u16());
    let standing = match reader.u8() {
        0 => Standing::Running,
        1 => Standing::Solved,
        _ => Standing::Impossible,
    };
    let (episode_return, reached) = (reader.f64(), reader.u16());
    let mut world = World { open: reader.u16(), ..World::new(G::SIZE) };
    (world.position, world.direction) = (reader.u8(), reader.u8());
    (world.carried, world.case) = (reader.u8(), reader.u8());
    world.homes.copy_from_slice(reader.slice(HOMES));
    world.inventory.fill_with(|| reader.u16());
    let inner = G::SIZE - 2;
    for y in 1..=inner {
        world.cells[y * G::SIZE + 1..][..inner].copy_from_slice(reader.slice(inner));
    }
    Ok(Episode { world, steps, limit, standing, episode_return, reached, milestone: None })
}

/// Reads what an episode can be in.
pub(super) fn read_sound<G: Game>(bytes: &[u8], longest: u16) -> Result<Episode, StateError> {
    let episode = read_episode::<G>(bytes)?;
    flaw::<G>(&episode, longest).map_or(Ok(episode), |flaw| Err(StateError::Impossible(flaw)))
}

fn flaw<G: Game>(episode: &Episode, longest: u16) -> Option<String> {
    let Episode { world, steps, limit, .. } = episode;
    let objects = G::OBJECTS.len();
    let inside = 1..G::SIZE - 1;
    let place = usize::from(world.position);
    let flaws = [
        (steps > limit || *limit > longest, format!("it is {steps} of {limit} steps long")),
        (!episode.episode_return.is_finite(), "its return is no number".into()),
        (
            !inside.contains(&(place % G::SIZE)) || !inside.contains(&(place / G::SIZE)),
            format!("the agent is in cell {place}"),
        ),
        (world.direction > 3, format!("the agent looks in direction {}", world.direction)),
        (usize::from(world.carried) >= objects, format!("it carries object {}", world.carried)),
        (
            world.homes.iter().any(|home| usize::from(*home) >= G::SIZE * G::SIZE),
            "things go back to no cell".into(),
        ),
    ];
    let unknown = world.cells.iter().find(|object| usize::from(**object) >= objects);
    let mut flaws = flaws.into_iter();
    flaws
        .find_map(|(is_wrong, flaw)| is_wrong.then_some(flaw))
        .or_else(|| unknown.map(|object| format!("a cell holds object {object}")))
}
