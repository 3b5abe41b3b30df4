//! Episodes as bytes.

use alloc::format;
use alloc::vec::Vec;

use super::episode::{Episode, Standing};
use super::game::Game;
use super::world::{CELLS, HOMES, ITEMS, World};
use crate::environment::StateError;

/// The version of the layout.
const LAYOUT: u8 = 1;
/// Bytes beside the cells and the items.
const OTHERS: usize = 1 + 2 + 2 + 1 + 8 + 2 + 2 + 4 + HOMES;

/// Bytes of every state: the ring of walls is not among them.
pub(super) fn state_bytes<G: Game>() -> usize {
    OTHERS + 2 * ITEMS + (G::SIZE - 2) * (G::SIZE - 2)
}

/// Adds the bytes of a state.
pub(super) fn write(episode: &Episode, bytes: &mut Vec<u8>) {
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

/// The grid of a state of a known length.
#[inline]
pub(super) fn read_world<G: Game>(bytes: &[u8]) -> World {
    read_episode::<G>(bytes).world
}

#[inline]
fn read_episode<G: Game>(bytes: &[u8]) -> Episode {
    let mut rest = &bytes[1..];
    let mut take = |count: usize| {
        let (taken, others) = rest.split_at(count);
        rest = others;
        taken
    };
    let number = |bytes: &[u8]| u16::from_le_bytes([bytes[0], bytes[1]]);
    let (steps, limit) = (number(take(2)), number(take(2)));
    let standing = match take(1)[0] {
        0 => Standing::Running,
        1 => Standing::Solved,
        _ => Standing::Impossible,
    };
    let episode_return = f64::from_le_bytes(take(8).try_into().expect("eight bytes"));
    let reached = number(take(2));
    let mut world = World::new(G::SIZE);
    world.open = number(take(2));
    let small = take(4);
    (world.position, world.direction, world.carried, world.case) =
        (small[0], small[1], small[2], small[3]);
    world.homes.copy_from_slice(take(HOMES));
    let items = take(2 * ITEMS).chunks_exact(2);
    world.inventory.iter_mut().zip(items).for_each(|(count, bytes)| *count = number(bytes));
    let inner = G::SIZE - 2;
    for (y, row) in rest.chunks_exact(inner).take(inner).enumerate() {
        world.cells[(y + 1) * G::SIZE + 1..][..inner].copy_from_slice(row);
    }
    Episode { world, steps, limit, standing, episode_return, reached, milestone: None }
}

/// Reads what [`write`] wrote.
pub(super) fn read<G: Game>(bytes: &[u8], longest: u16) -> Result<Episode, StateError> {
    let wanted = state_bytes::<G>();
    match bytes.first() {
        Some(&found) if found != LAYOUT => {
            return Err(StateError::Version { found, wanted: LAYOUT });
        }
        Some(_) if bytes.len() == wanted => {}
        _ => return Err(StateError::Length { found: bytes.len(), wanted }),
    }
    let episode = read_episode::<G>(bytes);
    flaw::<G>(&episode, longest).map_or(Ok(episode), |flaw| Err(StateError::Impossible(flaw)))
}

fn flaw<G: Game>(episode: &Episode, longest: u16) -> Option<alloc::string::String> {
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
