//! What there is to draw.

use sortie_envs::gridworld::{Cell, SIDE, picture_of};
use sortie_envs::random::generator;

use super::{opened, saved};

#[test]
fn a_picture_is_what_the_state_says() {
    let mut world = opened("task1-2", &[]);
    world.reset(0, &mut generator(1));
    let spec = world.spec().clone();
    let cells: Vec<Cell> = Cell::all(&spec).collect();
    assert_eq!(cells.len(), SIDE * SIDE);
    assert_eq!(cells[0], Cell::Wall);
    let mut state = saved(&*world);
    let picture = picture_of(&spec, &state).expect("a state");
    assert_eq!((picture.tiers, &picture.found[..]), (0, &[0, 0][..]));
    assert!(picture.cells.iter().all(|cell| cells[usize::from(*cell)] == Cell::Free));
    assert_eq!(picture.pits.len(), cells.iter().filter(|cell| **cell == Cell::Pit).count());
    state[18] = 2;
    state[20..28].copy_from_slice(&0.25_f64.to_le_bytes());
    let picture = picture_of(&spec, &state).expect("a state");
    assert_eq!((picture.found[0], picture.pits[0].probability), (2, 0.25));
    assert!(picture_of(&spec, &state[1..]).is_err());
}

#[test]
fn doors_and_treasures_are_where_the_map_has_them() {
    let spec = opened("flip-2", &[]).spec().clone();
    let count = |wanted: fn(&Cell) -> bool| Cell::all(&spec).filter(wanted).count();
    // Eight paths in four tiers of two; those behind the first have doors.
    assert_eq!(count(|cell| matches!(cell, Cell::Treasure(0..8))), 8);
    for tier in 1..4 {
        assert_eq!(Cell::all(&spec).filter(|cell| *cell == Cell::Door(tier)).count(), 2);
    }
    assert_eq!(count(|cell| matches!(cell, Cell::Door(_))), 6);
    let maze = opened("task1-2", &[]).spec().clone();
    let treasures = Cell::all(&maze).filter(|cell| matches!(cell, Cell::Treasure(_)));
    assert_eq!(treasures.collect::<Vec<_>>(), [Cell::Treasure(0), Cell::Treasure(1)]);
}
