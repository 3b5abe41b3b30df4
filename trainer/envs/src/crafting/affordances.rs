//! Which milestones of crafting can be next.

use super::numbers::{item, milestone, object};
use crate::milestones::board::{self, Board};
use crate::milestones::{EMPTY, World};

/// A state, and the milestones in use.
struct Question<'a> {
    world: &'a World,
    used: u16,
}

/// Of the milestones in use those that can be next.
pub(super) fn all(world: &World, used: u16) -> u16 {
    let question = Question { world, used };
    let members = (0..13).filter(|milestone| used >> milestone & 1 == 1);
    members.filter(|milestone| question.affords(*milestone, 1, 0)).fold(0, |set, it| set | 1 << it)
}

/// Whether one of them can; what follows from the inventory or the trees alone is asked first.
pub(super) fn any(world: &World, used: u16) -> bool {
    let question = Question { world, used };
    (0..13).any(|milestone| used >> milestone & 1 == 1 && question.affords(milestone, 1, 0))
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
        let places = board::cells(self.world, |other| other == object);
        places != Board::default()
            && board::count(&board::both(&places, &board::touchable(self.world))) > 0
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
        let met = board::met(self.world, |object| match object {
            object::DIRT => true,
            object::STONE => unused(milestone::STONE),
            object::COAL => unused(milestone::COAL),
            object::IRON_ORE => unused(milestone::IRON_ORE),
            object::DIAMOND => unused(milestone::DIAMOND),
            _ => false,
        });
        let wanted = board::cells(self.world, |other| other == object);
        board::count(&board::both(&met, &wanted)) >= u32::from(count)
    }
}
