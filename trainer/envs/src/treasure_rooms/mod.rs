//! A treasure behind locked rooms, a game of [`milestones`](crate::milestones): keys open doors, one thing fits the hand.

use crate::milestones::{EMPTY, Effect, Game, ITEMS, WALL, World, world};
use crate::random::{Random, below, shuffle};

/// How `--env` finds it.
pub const ENTRY: crate::Entry = crate::milestones::entry::<TreasureRooms>();

/// Objects by their numbers.
mod object {
    pub(super) const RED_DOOR: u8 = 3;
    pub(super) const YELLOW_DOOR: u8 = 4;
    pub(super) const BLUE_DOOR: u8 = 5;
    pub(super) const GREEN_DOOR: u8 = 6;
    pub(super) const RED_KEY: u8 = 7;
    pub(super) const YELLOW_KEY: u8 = 8;
    pub(super) const PURPLE_KEY: u8 = 9;
    pub(super) const GREEN_WEIGHT: u8 = 10;
    pub(super) const GREEN_BUTTON: u8 = 11;
    pub(super) const BLUE_KEY: u8 = 12;
    pub(super) const PURPLE_CHEST: u8 = 13;
}

/// Items by their numbers.
mod item {
    pub(super) const RED_KEY: u8 = 0;
    pub(super) const YELLOW_KEY: u8 = 1;
    pub(super) const GREEN_WEIGHT: u8 = 2;
    pub(super) const PRESSED: u8 = 3;
    pub(super) const BLUE_KEY: u8 = 4;
    pub(super) const PURPLE_KEY: u8 = 5;
    pub(super) const TREASURE: u8 = 6;
}

/// Milestones by their numbers.
mod milestone {
    pub(super) const RED_KEY: u8 = 0;
    pub(super) const YELLOW_KEY: u8 = 1;
    pub(super) const RED_DOOR: u8 = 2;
    pub(super) const YELLOW_DOOR: u8 = 3;
    pub(super) const GREEN_WEIGHT: u8 = 4;
    pub(super) const BLUE_KEY: u8 = 5;
    pub(super) const BLUE_DOOR: u8 = 6;
    pub(super) const GREEN_DOOR: u8 = 7;
    pub(super) const PURPLE_KEY: u8 = 8;
    pub(super) const TREASURE: u8 = 9;
}

/// Which key lies in the middle at the start, where only one does.
mod case {
    pub(super) const RED: u8 = 1;
    pub(super) const YELLOW: u8 = 2;
}

/// Whether an object is a door.
fn is_door(object: u8) -> bool {
    (object::RED_DOOR..=object::GREEN_DOOR).contains(&object)
}

/// The game of keys and doors.
#[derive(Clone, Copy, Debug, Default)]
pub struct TreasureRooms;

/// What can be taken: object, item, milestone and home.
const THINGS: [(u8, u8, u8, usize); 5] = [
    (object::RED_KEY, item::RED_KEY, milestone::RED_KEY, 0),
    (object::YELLOW_KEY, item::YELLOW_KEY, milestone::YELLOW_KEY, 1),
    (object::GREEN_WEIGHT, item::GREEN_WEIGHT, milestone::GREEN_WEIGHT, 2),
    (object::BLUE_KEY, item::BLUE_KEY, milestone::BLUE_KEY, 3),
    (object::PURPLE_KEY, item::PURPLE_KEY, milestone::PURPLE_KEY, 4),
];

/// Doors that keys open: object, item and milestone.
const DOORS: [(u8, u8, u8); 3] = [
    (object::RED_DOOR, item::RED_KEY, milestone::RED_DOOR),
    (object::YELLOW_DOOR, item::YELLOW_KEY, milestone::YELLOW_DOOR),
    (object::BLUE_DOOR, item::BLUE_KEY, milestone::BLUE_DOOR),
];

/// Column and row of a cell.
type Place = (usize, usize);

/// The doorways of the rooms north, east, south and west, and the lines that things lie on.
const ROOMS: [(Place, [Place; 3]); 4] = [
    ((5, 3), [(4, 1), (5, 1), (6, 1)]),
    ((7, 5), [(9, 4), (9, 5), (9, 6)]),
    ((5, 7), [(4, 9), (5, 9), (6, 9)]),
    ((3, 5), [(1, 4), (1, 5), (1, 6)]),
];

impl Game for TreasureRooms {
    const NAME: &'static str = "treasure-rooms";
    const ABOUT: &'static str =
        "An agent opens locked rooms on the way to a treasure (dissertation chapter 6)";
    const SIZE: usize = 11;
    const OBJECTS: &'static [&'static str] = &[
        "empty",
        "agent",
        "wall",
        "red_door",
        "yellow_door",
        "blue_door",
        "green_door",
        "red_key",
        "yellow_key",
        "purple_key",
        "green_weight",
        "green_button",
        "blue_key",
        "purple_chest",
    ];
    const STATES: &'static [&'static str] = &["open", "closed", "locked", "pressed"];
    const ITEMS: &'static [&'static str] = &[
        "red_key",
        "yellow_key",
        "green_weight",
        "hurt_back",
        "blue_key",
        "purple_key",
        "treasure",
    ];
    const ACTIONS: &'static [&'static str] =
        &["turn_left", "turn_right", "forward", "backward", "interact"];
    const MILESTONES: &'static [&'static str] = &[
        "red_key",
        "yellow_key",
        "red_door",
        "yellow_door",
        "green_weight",
        "blue_key",
        "blue_door",
        "green_door",
        "purple_key",
        "treasure",
    ];
    const SIGNS: &'static [(u8, i16)] = &[
        (item::RED_KEY, 1),
        (item::YELLOW_KEY, 1),
        (item::RED_KEY, -1),
        (item::YELLOW_KEY, -1),
        (item::GREEN_WEIGHT, 1),
        (item::BLUE_KEY, 1),
        (item::BLUE_KEY, -1),
        (item::PRESSED, 1),
        (item::PURPLE_KEY, 1),
        (item::TREASURE, 1),
    ];
    const PAID: u16 = 1 << milestone::RED_KEY
        | 1 << milestone::YELLOW_KEY
        | 1 << milestone::GREEN_WEIGHT
        | 1 << milestone::BLUE_KEY
        | 1 << milestone::PURPLE_KEY
        | 1 << milestone::TREASURE;
    const TASKS: &'static [&'static str] = &["treasure"];
    const LOSSES: Option<[u32; ITEMS]> = None;
    const ENDS_IF_IMPOSSIBLE: bool = false;

    fn draw(random: &mut Random) -> World {
        let mut world = World::new(Self::SIZE);
        for cell in 0..Self::SIZE * Self::SIZE {
            if is_wall(cell % Self::SIZE, cell / Self::SIZE) {
                world.cells[cell] = WALL;
            }
        }
        let mut corners = [(4, 4), (4, 6), (6, 4), (6, 6)];
        shuffle(random, &mut corners);
        world.case = below(random, 3) as u8;
        if world.case != case::RED {
            put(&mut world, object::YELLOW_KEY, corners[0]);
        }
        if world.case != case::YELLOW {
            put(&mut world, object::RED_KEY, corners[1]);
        }
        let mut doors =
            [object::YELLOW_DOOR, object::RED_DOOR, object::GREEN_DOOR, object::BLUE_DOOR];
        shuffle(random, &mut doors);
        for (door, (doorway, mut line)) in doors.into_iter().zip(ROOMS) {
            put(&mut world, door, doorway);
            shuffle(random, &mut line);
            for (thing, place) in behind(door, world.case).into_iter().flatten().zip(line) {
                put(&mut world, thing, place);
            }
        }
        let centre = (4..=6).flat_map(|y| (4..=6).map(move |x| y * Self::SIZE + x));
        world.stand_somewhere(centre, random);
        world
    }

    fn act(world: &mut World, action: usize) -> Effect {
        let places = world.front_and_back();
        if action < 4 {
            world.go(action, places, is_door);
            return None;
        }
        interact(world, places[0])
    }

    fn state(world: &World, object: u8) -> u8 {
        match (object, world.is_open(object)) {
            (object::GREEN_BUTTON, true) => 3,
            (object, false) if is_door(object) => 2,
            _ => 0,
        }
    }

    fn affordances(world: &World, used: u16) -> u16 {
        let question = Question { world, used };
        let can_be_next = |milestone: &u8| question.affords(*milestone, 0);
        question.milestones().filter(can_be_next).fold(0, |set, milestone| set | 1 << milestone)
    }
}

/// Ring, lines between the rooms, and corners.
fn is_wall(x: usize, y: usize) -> bool {
    let outside = |place: usize| !(4..=6).contains(&place);
    [x, y].iter().any(|place| [0, 3, 7, 10].contains(place)) || outside(x) && outside(y)
}

/// What lies behind a door.
fn behind(door: u8, start: u8) -> [Option<u8>; 3] {
    let other = |case, key| (start == case).then_some(key);
    match door {
        object::YELLOW_DOOR => [Some(object::BLUE_KEY), other(case::YELLOW, object::RED_KEY), None],
        object::RED_DOOR => {
            let key = other(case::RED, object::YELLOW_KEY);
            [Some(object::GREEN_WEIGHT), Some(object::PURPLE_CHEST), key]
        }
        object::GREEN_DOOR => [Some(object::PURPLE_KEY), None, None],
        _ => [Some(object::GREEN_BUTTON), None, None],
    }
}

/// Puts an object somewhere, which is where it goes back to.
fn put(world: &mut World, object: u8, (x, y): Place) {
    let cell = world.at(x, y);
    world.cells[cell] = object;
    if let Some((.., home)) = THINGS.iter().find(|thing| thing.0 == object) {
        world.homes[*home] = cell as u8;
    }
}

fn interact(world: &mut World, front: usize) -> Effect {
    let object = world.object(front);
    if let Some((_, item, milestone, _)) = THINGS.iter().find(|thing| thing.0 == object) {
        put_back(world);
        world.cells[front] = EMPTY;
        world.carried = object;
        world.gain(*item, 1);
        return Some(*milestone);
    }
    if let Some((_, key, milestone)) = DOORS.iter().find(|door| door.0 == object) {
        return (!world.is_open(object) && world.count(*key) > 0).then(|| {
            use_up(world, *key);
            world.open |= 1 << object;
            *milestone
        });
    }
    match object {
        object::GREEN_BUTTON if world.count(item::GREEN_WEIGHT) > 0 => {
            use_up(world, item::GREEN_WEIGHT);
            world.gain(item::PRESSED, 1);
            world.open |= 1 << object::GREEN_BUTTON | 1 << object::GREEN_DOOR;
            Some(milestone::GREEN_DOOR)
        }
        object::PURPLE_CHEST if world.count(item::PURPLE_KEY) > 0 => {
            world.gain(item::TREASURE, 1);
            Some(milestone::TREASURE)
        }
        _ => None,
    }
}

/// What was in the hand goes back where it was at the start, even if the agent stands there.
fn put_back(world: &mut World) {
    if let Some((object, item, _, home)) = THINGS.iter().find(|thing| thing.0 == world.carried) {
        world.cells[usize::from(world.homes[*home])] = *object;
        world.lose(*item, 1);
    }
}

fn use_up(world: &mut World, item: u8) {
    world.lose(item, 1);
    world.carried = EMPTY;
}

/// A state, and the milestones in use.
struct Question<'a> {
    world: &'a World,
    used: u16,
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
    /// The milestones in use.
    fn milestones(&self) -> impl Iterator<Item = u8> {
        (0..10).filter(|milestone| self.used >> milestone & 1 == 1)
    }

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
        let met = world::met(self.world, |object| {
            let unused =
                milestone_of(object).is_none_or(|milestone| self.used >> milestone & 1 == 0);
            object > WALL && unused || is_door(object) && self.world.is_open(object)
        });
        let wanted = world::cells(self.world, |other| other == object);
        world::both(&met, &wanted) != [0; 12]
    }
}
