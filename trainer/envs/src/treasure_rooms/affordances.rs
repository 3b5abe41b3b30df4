//! Which milestones of the treasure's rooms can be next.

use super::numbers::{case, is_door, item, milestone, object};
use crate::milestones::{WALL, World, board};

/// A state, and the milestones in use.
struct Question<'a> {
    world: &'a World,
    used: u16,
}

/// Of the milestones in use those that can be next.
pub(super) fn all(world: &World, used: u16) -> u16 {
    let question = Question { world, used };
    let members = (0..10).filter(|milestone| used >> milestone & 1 == 1);
    members.filter(|milestone| question.affords(*milestone, 0)).fold(0, |set, it| set | 1 << it)
}

/// The milestone that an object is about.
fn milestone_of(object: u8) -> Option<u8> {
    Some(match object {
        object::RED_DOOR => milestone::RED_DOOR,
        object::YELLOW_DOOR => milestone::YELLOW_DOOR,
        object::BLUE_DOOR => milestone::BLUE_DOOR,
        object::GREEN_DOOR => milestone::GREEN_DOOR,
        object::RED_KEY => milestone::RED_KEY,
        object::YELLOW_KEY => milestone::YELLOW_KEY,
        object::PURPLE_KEY => milestone::PURPLE_KEY,
        object::GREEN_WEIGHT => milestone::GREEN_WEIGHT,
        object::BLUE_KEY => milestone::BLUE_KEY,
        _ => return None,
    })
}

impl Question<'_> {
    /// Whether a milestone can be had without passing through another one in use; `asked` holds, as bits, what this
    /// answer is needed for, which cannot be part of it.
    fn affords(&self, milestone: u8, asked: u16) -> bool {
        if asked >> milestone & 1 == 1 {
            return false;
        }
        let asked = asked | 1 << milestone;
        let (world, none) = (self.world, |item| self.world.count(item) == 0);
        let without = |milestone| self.without_a_milestone(milestone, asked);
        let opens =
            |door, key: u8, milestone| !world.is_open(door) && (!none(key) || without(milestone));
        match milestone {
            milestone::RED_KEY => {
                none(item::RED_KEY)
                    && (self.meets(object::RED_KEY)
                        // The public code asks for the red door, though the key is behind the yellow one.
                        || world.case == case::YELLOW && without(milestone::RED_DOOR))
            }
            milestone::YELLOW_KEY => {
                none(item::YELLOW_KEY)
                    && (self.meets(object::YELLOW_KEY)
                        || world.case == case::RED && without(milestone::RED_DOOR))
            }
            milestone::RED_DOOR => opens(object::RED_DOOR, item::RED_KEY, milestone::RED_KEY),
            milestone::YELLOW_DOOR => {
                opens(object::YELLOW_DOOR, item::YELLOW_KEY, milestone::YELLOW_KEY)
            }
            milestone::BLUE_DOOR => opens(object::BLUE_DOOR, item::BLUE_KEY, milestone::BLUE_KEY),
            milestone::GREEN_WEIGHT => {
                self.meets(object::GREEN_WEIGHT)
                    || none(item::GREEN_WEIGHT)
                        && !world.is_open(object::GREEN_BUTTON)
                        && without(milestone::RED_DOOR)
            }
            milestone::BLUE_KEY => {
                self.meets(object::BLUE_KEY)
                    || none(item::BLUE_KEY) && without(milestone::YELLOW_DOOR)
            }
            milestone::GREEN_DOOR => {
                opens(object::GREEN_DOOR, item::GREEN_WEIGHT, milestone::GREEN_WEIGHT)
                    && (world.is_open(object::BLUE_DOOR) || without(milestone::BLUE_DOOR))
            }
            milestone::PURPLE_KEY => {
                self.meets(object::PURPLE_KEY)
                    || none(item::PURPLE_KEY) && without(milestone::GREEN_DOOR)
            }
            _ => {
                (world.is_open(object::RED_DOOR) || without(milestone::RED_DOOR))
                    && (!none(item::PURPLE_KEY) || without(milestone::PURPLE_KEY))
            }
        }
    }

    /// Whether something is no milestone in use, and can be had.
    fn without_a_milestone(&self, milestone: u8, asked: u16) -> bool {
        self.used >> milestone & 1 == 0 && self.affords(milestone, asked)
    }

    /// Whether a walk meets this object. It goes through open doors and whatever is no milestone in use.
    fn meets(&self, object: u8) -> bool {
        let met = board::met(self.world, |object| {
            let unused =
                milestone_of(object).is_none_or(|milestone| self.used >> milestone & 1 == 0);
            object > WALL && unused || is_door(object) && self.world.is_open(object)
        });
        let wanted = board::cells(self.world, |other| other == object);
        board::both(&met, &wanted) != [0; 12]
    }
}
