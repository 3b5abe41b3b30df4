//! Crafting: from logs to iron and diamond.

use super::affordances;
use super::numbers::{item, milestone, object};
use crate::milestones::{EMPTY, Effect, Game, ITEMS, World};
use crate::random::{Random, below, unit};

/// The game of wood, stone and iron.
#[derive(Clone, Copy, Debug, Default)]
pub struct Crafting;

/// Cells of the play area, to each side.
const INNER: usize = 10;
/// The first row of rock.
const ROCK: usize = 6;

impl Game for Crafting {
    const NAME: &'static str = "crafting";
    const ABOUT: &'static str =
        "An agent makes tools of wood, stone and iron (dissertation chapter 6)";
    const SIZE: usize = INNER + 2;
    const OBJECTS: &'static [&'static str] = &[
        "empty",
        "agent",
        "wall",
        "dirt",
        "tree",
        "stone",
        "coal",
        "iron_ore",
        "diamond",
        "crafting_bench",
        "furnace",
    ];
    const STATES: &'static [&'static str] = &[];
    const ITEMS: &'static [&'static str] = &[
        "log",
        "dirt",
        "wood",
        "stick",
        "stone",
        "wood_pickaxe",
        "stone_pickaxe",
        "iron_pickaxe",
        "iron_ore",
        "iron",
        "coal",
        "diamond",
    ];
    const ACTIONS: &'static [&'static str] = &[
        "turn_left",
        "turn_right",
        "forward",
        "backward",
        "mine",
        "craft_wood",
        "craft_stick",
        "craft_pickaxe",
        "smelt_iron",
        "place_crafting_bench",
        "place_furnace",
    ];
    const MILESTONES: &'static [&'static str] = &[
        "log",
        "wood",
        "stick",
        "crafting_bench",
        "wood_pickaxe",
        "stone",
        "furnace",
        "stone_pickaxe",
        "iron_ore",
        "coal",
        "iron",
        "iron_pickaxe",
        "diamond",
    ];
    const SIGNS: &'static [(u8, i16)] = &[
        (item::LOG, 1),
        (item::WOOD, 4),
        (item::STICK, 4),
        (item::WOOD, -4),
        (item::WOOD_PICKAXE, 1),
        (item::STONE, 1),
        (item::STONE, -4),
        (item::STONE_PICKAXE, 1),
        (item::IRON_ORE, 1),
        (item::COAL, 1),
        (item::IRON, 1),
        (item::IRON_PICKAXE, 1),
        (item::DIAMOND, 1),
    ];
    const PAID: u16 = (1 << 13) - 1;
    const TASKS: &'static [&'static str] = &["iron", "diamond"];
    const LOSSES: Option<[u32; ITEMS]> = Some([20, 0, 20, 20, 10, 10, 8, 2, 5, 5, 5, 1]);
    const ENDS_IF_IMPOSSIBLE: bool = true;

    fn draw(random: &mut Random) -> World {
        loop {
            let mut world = World::new(Self::SIZE);
            let mut counts = [0_u8; 16];
            for cell in cells() {
                let object = if cell / Self::SIZE < ROCK { forest(random) } else { rock(random) };
                counts[usize::from(object)] += 1;
                world.cells[cell] = object;
            }
            let least = [(object::TREE, 5), (object::IRON_ORE, 4), (object::COAL, 4)];
            if least.iter().any(|(object, least)| counts[usize::from(*object)] < *least) {
                continue;
            }
            let column = 1 + below(random, INNER);
            world.cells[world.at(column, INNER)] = object::DIAMOND;
            world.stand_somewhere(cells(), random);
            return world;
        }
    }

    fn act(world: &mut World, action: usize) -> Effect {
        let places = world.front_and_back();
        match action {
            4 => mine(world, places[0]),
            5 => make(world, &[(item::LOG, 1)], (item::WOOD, 4), milestone::WOOD),
            6 => make(world, &[(item::WOOD, 2)], (item::STICK, 4), milestone::STICK),
            7 => make_pickaxe(world),
            8 if is_near(world, object::FURNACE) => {
                let parts = [(item::COAL, 1), (item::IRON_ORE, 1)];
                make(world, &parts, (item::IRON, 1), milestone::IRON)
            }
            9 => place(world, places[0], (item::WOOD, object::BENCH), milestone::BENCH),
            10 => place(world, places[0], (item::STONE, object::FURNACE), milestone::FURNACE),
            0..=3 => {
                world.go(action, places, |_| false);
                None
            }
            _ => None,
        }
    }

    fn state(_: &World, _: u8) -> u8 {
        0
    }

    fn affordances(world: &World, used: u16) -> u16 {
        affordances::all(world, used)
    }

    fn affords_any(world: &World, used: u16) -> bool {
        affordances::any(world, used)
    }
}

/// The cells of the play area, row by row.
fn cells() -> impl Iterator<Item = usize> + Clone {
    (1..=INNER).flat_map(|y| (1..=INNER).map(move |x| y * Crafting::SIZE + x))
}

fn forest(random: &mut Random) -> u8 {
    match (50.0 * unit(random)) as u8 {
        0..36 => EMPTY,
        36..46 => object::TREE,
        _ => object::DIRT,
    }
}

fn rock(random: &mut Random) -> u8 {
    match (50.0 * unit(random)) as u8 {
        0..29 => object::STONE,
        29..37 => object::COAL,
        37..45 => object::IRON_ORE,
        _ => object::DIRT,
    }
}

fn mine(world: &mut World, front: usize) -> Effect {
    let has = |item| world.count(item) > 0;
    let iron = has(item::IRON_PICKAXE);
    let stone = iron || has(item::STONE_PICKAXE);
    let any = stone || has(item::WOOD_PICKAXE);
    let (item, effect) = match world.object(front) {
        object::DIRT => (item::DIRT, None),
        object::TREE => (item::LOG, Some(milestone::LOG)),
        object::STONE if any => (item::STONE, Some(milestone::STONE)),
        object::COAL if stone => (item::COAL, Some(milestone::COAL)),
        object::IRON_ORE if stone => (item::IRON_ORE, Some(milestone::IRON_ORE)),
        object::DIAMOND if iron => (item::DIAMOND, Some(milestone::DIAMOND)),
        _ => return None,
    };
    world.cells[front] = EMPTY;
    world.gain(item, 1);
    effect
}

/// Makes something of parts, where there are enough of each.
fn make(world: &mut World, parts: &[(u8, u16)], made: (u8, u16), milestone: u8) -> Effect {
    if parts.iter().any(|(item, count)| world.count(*item) < *count) {
        return None;
    }
    parts.iter().for_each(|(item, count)| world.lose(*item, *count));
    world.gain(made.0, made.1);
    Some(milestone)
}

/// Makes a pickaxe of the best material that there is enough of.
fn make_pickaxe(world: &mut World) -> Effect {
    if !is_near(world, object::BENCH) {
        return None;
    }
    let kinds = [
        (item::IRON, item::IRON_PICKAXE, milestone::IRON_PICKAXE),
        (item::STONE, item::STONE_PICKAXE, milestone::STONE_PICKAXE),
        (item::WOOD, item::WOOD_PICKAXE, milestone::WOOD_PICKAXE),
    ];
    kinds.into_iter().find_map(|(material, pickaxe, milestone)| {
        make(world, &[(material, 3), (item::STICK, 2)], (pickaxe, 1), milestone)
    })
}

/// Makes an object of four of an item, and puts it down.
fn place(world: &mut World, front: usize, (item, object): (u8, u8), milestone: u8) -> Effect {
    if world.object(front) != EMPTY || world.count(item) < 4 {
        return None;
    }
    world.lose(item, 4);
    world.cells[front] = object;
    Some(milestone)
}

/// Whether such an object is at most two cells away, across corners too.
fn is_near(world: &World, object: u8) -> bool {
    let size = Crafting::SIZE;
    let (x, y) = (usize::from(world.position) % size, usize::from(world.position) / size);
    let columns = x.saturating_sub(2)..(x + 3).min(size);
    let mut rows = world.cells.chunks_exact(size).take(y + 3).skip(y.saturating_sub(2));
    rows.any(|row| row[columns.clone()].contains(&object))
}
