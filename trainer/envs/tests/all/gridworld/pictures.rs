//! What a maze looks like.

use sortie_envs::Picture;
use sortie_envs::gridworld::SIDE;
use sortie_envs::random::generator;

use super::{opened, saved};

/// How many cells are of a kind.
fn count(picture: &Picture, kind: &str) -> usize {
    picture.cells.iter().filter(|cell| cell.kind == kind).count()
}

#[test]
fn a_picture_is_what_the_state_says() {
    let mut world = opened("task1-2", &[]);
    world.reset(0, &mut generator(1));
    let mut state = saved(&*world);
    let picture = world.picture(&state);
    assert_eq!(picture.field.expect("a grid").to, [SIDE as f64 - 0.5; 2]);
    assert!(picture.cells[0].is_solid && picture.cells[0].kind == "wall");
    let places: Vec<_> = picture.agents.iter().map(|agent| agent.place.expect("a place")).collect();
    assert!(
        !picture.cells.iter().any(|cell| places.contains(&cell.place)),
        "they stand in free cells"
    );
    assert!(picture.agents.iter().all(|agent| agent.status == "found nothing"));
    let pits = count(&picture, "pit");
    assert_eq!(count(&picture, "treasure"), 2);
    // What the first agent found, and the first pit.
    state[18] = 2;
    state[20..28].copy_from_slice(&0.25_f64.to_le_bytes());
    state[32] = 1;
    let picture = world.picture(&state);
    assert_eq!(picture.agents[0].status, "found B");
    assert_eq!((count(&picture, "pit"), count(&picture, "open pit")), (pits - 1, 1));
    assert_eq!((count(&picture, "treasure"), count(&picture, "treasure, found")), (1, 1));
    state[32] = 0;
    let picture = world.picture(&state);
    let first = picture.cells.iter().find(|cell| cell.kind == "pit").expect("a pit");
    assert_eq!(first.label, "25");
}

#[test]
fn doors_open_behind_tiers() {
    let mut world = opened("flip-2", &[]);
    world.reset(0, &mut generator(1));
    let mut state = saved(&*world);
    // Eight paths in four tiers of two; those behind the first have doors.
    let picture = world.picture(&state);
    let found = |picture: &Picture| (count(picture, "door"), count(picture, "open door"));
    assert_eq!((found(&picture), count(&picture, "treasure")), ((6, 0), 8));
    state[13] = 1;
    assert_eq!(found(&world.picture(&state)), (4, 2));
    assert_eq!(world.picture(&state).cells.len(), picture.cells.len());
}
