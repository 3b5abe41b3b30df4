//! Crafting: from logs to iron and diamond, a game of [`milestones`](crate::milestones).

use crate::milestones::world::Board;
use crate::milestones::{EMPTY, Effect, Game, ITEMS, World, world};
use crate::random::{Random, below, unit};

/// How `--env` finds it.
pub const ENTRY: crate::Entry = crate::milestones::entry::<Crafting>();

/// Objects by their numbers.
mod object {
    pub(super) const DIRT: u8 = 3;
    pub(super) const TREE: u8 = 4;
    pub(super) const STONE: u8 = 5;
    pub(super) const COAL: u8 = 6;
    pub(super) const IRON_ORE: u8 = 7;
    pub(super) const DIAMOND: u8 = 8;
    pub(super) const BENCH: u8 = 9;
    pub(super) const FURNACE: u8 = 10;
}

/// Items by their numbers.
mod item {
    pub(super) const LOG: u8 = 0;
    pub(super) const DIRT: u8 = 1;
    pub(super) const WOOD: u8 = 2;
    pub(super) const STICK: u8 = 3;
    pub(super) const STONE: u8 = 4;
    pub(super) const WOOD_PICKAXE: u8 = 5;
    pub(super) const STONE_PICKAXE: u8 = 6;
    pub(super) const IRON_PICKAXE: u8 = 7;
    pub(super) const IRON_ORE: u8 = 8;
    pub(super) const IRON: u8 = 9;
    pub(super) const COAL: u8 = 10;
    pub(super) const DIAMOND: u8 = 11;
}

/// Milestones by their numbers.
mod milestone {
    pub(super) const LOG: u8 = 0;
    pub(super) const WOOD: u8 = 1;
    pub(super) const STICK: u8 = 2;
    pub(super) const BENCH: u8 = 3;
    pub(super) const WOOD_PICKAXE: u8 = 4;
    pub(super) const STONE: u8 = 5;
    pub(super) const FURNACE: u8 = 6;
    pub(super) const STONE_PICKAXE: u8 = 7;
    pub(super) const IRON_ORE: u8 = 8;
    pub(super) const COAL: u8 = 9;
    pub(super) const IRON: u8 = 10;
    pub(super) const IRON_PICKAXE: u8 = 11;
    pub(super) const DIAMOND: u8 = 12;
}

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
        let question = Question { world, used };
        let can_be_next = |milestone: &u8| question.affords(*milestone, 1, 0);
        question.milestones().filter(can_be_next).fold(0, |set, milestone| set | 1 << milestone)
    }

    /// What follows from the inventory or the trees alone is asked first.
    fn affords_any(world: &World, used: u16) -> bool {
        let question = Question { world, used };
        question.milestones().any(|milestone| question.affords(milestone, 1, 0))
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

/// A state, and the milestones in use.
struct Question<'a> {
    world: &'a World,
    used: u16,
}

/// The item that a milestone is about.
const fn item_of(milestone: u8) -> u8 {
    match milestone {
        milestone::LOG => item::LOG,
        milestone::WOOD => item::WOOD,
        milestone::STICK => item::STICK,
        milestone::STONE => item::STONE,
        milestone::IRON_ORE => item::IRON_ORE,
        milestone::COAL => item::COAL,
        milestone::IRON => item::IRON,
        milestone::WOOD_PICKAXE => item::WOOD_PICKAXE,
        milestone::STONE_PICKAXE => item::STONE_PICKAXE,
        milestone::IRON_PICKAXE => item::IRON_PICKAXE,
        _ => item::DIAMOND,
    }
}

impl Question<'_> {
    /// The milestones in use.
    fn milestones(&self) -> impl Iterator<Item = u8> {
        (0..13).filter(|milestone| self.used >> milestone & 1 == 1)
    }

    /// Whether so many of a milestone can be had without passing through another one in use; `asked` holds, as bits,
    /// what this answer is needed for, which cannot be part of it.
    fn affords(&self, milestone: u8, count: u16, asked: u16) -> bool {
        if asked >> milestone & 1 == 1 {
            return false;
        }
        let asked = asked | 1 << milestone;
        let have = |milestone, count| self.have(milestone, count, asked);
        match milestone {
            milestone::LOG => self.has_free_sides_of_trees(count.into()),
            milestone::WOOD => have(milestone::LOG, count.div_ceil(4)),
            milestone::STICK => have(milestone::WOOD, 2 * count.div_ceil(4)),
            milestone::BENCH => have(milestone::WOOD, 4 * count),
            milestone::FURNACE => have(milestone::STONE, 4 * count),
            milestone::STONE => {
                let tools =
                    [milestone::WOOD_PICKAXE, milestone::STONE_PICKAXE, milestone::IRON_PICKAXE];
                tools.into_iter().any(|tool| have(tool, 1)) && self.meets(object::STONE, count)
            }
            milestone::COAL => self.mines(object::COAL, count, asked),
            milestone::IRON_ORE => self.mines(object::IRON_ORE, count, asked),
            milestone::DIAMOND => {
                have(milestone::IRON_PICKAXE, 1) && self.meets(object::DIAMOND, count)
            }
            milestone::IRON => {
                have(milestone::IRON_ORE, count)
                    && have(milestone::COAL, count)
                    && self.has_place(object::FURNACE, milestone::FURNACE, asked)
            }
            milestone::IRON_PICKAXE => self.makes(milestone::IRON, count, asked),
            milestone::STONE_PICKAXE => {
                !self.could_make(item::IRON, asked) && self.makes(milestone::STONE, count, asked)
            }
            _ => {
                !self.could_make(item::IRON, asked)
                    && !self.could_make(item::STONE, asked)
                    && self.makes(milestone::WOOD, count, asked)
            }
        }
    }

    /// Whether so many are there, or can be had without a milestone.
    fn have(&self, milestone: u8, count: u16, asked: u16) -> bool {
        self.world.count(item_of(milestone)) >= count
            || self.used >> milestone & 1 == 0 && self.affords(milestone, count, asked)
    }

    fn mines(&self, object: u8, count: u16, asked: u16) -> bool {
        let tools = [milestone::STONE_PICKAXE, milestone::IRON_PICKAXE];
        tools.into_iter().any(|tool| self.have(tool, 1, asked)) && self.meets(object, count)
    }

    /// Whether the parts of so many pickaxes of a material can be brought to a bench.
    fn makes(&self, material: u8, count: u16, asked: u16) -> bool {
        self.have(milestone::STICK, 2 * count, asked)
            && self.have(material, 3 * count, asked)
            && self.has_place(object::BENCH, milestone::BENCH, asked)
    }

    /// Whether a pickaxe of a material is what the inventory would become at a bench.
    fn could_make(&self, material: u8, asked: u16) -> bool {
        self.world.count(item::STICK) >= 2
            && self.world.count(material) >= 3
            && self.has_place(object::BENCH, milestone::BENCH, asked)
    }

    /// Whether such an object can be walked up to, or placed without a milestone.
    fn has_place(&self, object: u8, milestone: u8, asked: u16) -> bool {
        let places = world::cells(self.world, |other| other == object);
        places != Board::default()
            && world::count(&world::both(&places, &world::touchable(self.world))) > 0
            || self.used >> milestone & 1 == 0 && self.affords(milestone, 1, asked)
    }

    /// Whether trees can be felled from so many sides, each for itself: whether somebody gets there is not asked.
    fn has_free_sides_of_trees(&self, count: usize) -> bool {
        let (size, agent) = (usize::from(self.world.size), usize::from(self.world.position));
        let is_free = |cell: &usize| self.world.cells[*cell] == EMPTY || *cell == agent;
        let trees = self.world.cells.iter().enumerate().filter(|(_, it)| **it == object::TREE);
        let sides = trees.flat_map(|(cell, _)| [cell - 1, cell + 1, cell - size, cell + size]);
        sides.filter(is_free).take(count).count() == count
    }

    /// Whether a walk meets so many of these objects. It goes through what is mined without a milestone on the way.
    fn meets(&self, object: u8, count: u16) -> bool {
        let unused = |milestone: u8| self.used >> milestone & 1 == 0;
        let met = world::met(self.world, |object| match object {
            object::DIRT => true,
            object::STONE => unused(milestone::STONE),
            object::COAL => unused(milestone::COAL),
            object::IRON_ORE => unused(milestone::IRON_ORE),
            object::DIAMOND => unused(milestone::DIAMOND),
            _ => false,
        });
        let wanted = world::cells(self.world, |other| other == object);
        world::count(&world::both(&met, &wanted)) >= u32::from(count)
    }
}
