//! Rules that the recordings meet rarely.

use sortie_envs::crafting::Crafting;
use sortie_envs::milestones::{Game, MilestoneSet, Milestones, Rules, World};
use sortie_envs::random::{below, generator};
use sortie_envs::{EntitySet, Environment, Observation, Split};

use super::open;

/// An empty forest with the agent in its middle, looking right.
fn clearing() -> World {
    World { position: 5 * 12 + 5, ..World::new(12) }
}

/// Steps once with so many of these items, and tells which milestone was reached.
fn after(mut world: World, items: &[(usize, u16)], action: usize) -> (Option<u8>, World) {
    items.iter().for_each(|(item, count)| world.inventory[*item] += count);
    let reached = Crafting::act(&mut world, action);
    (reached, world)
}

#[test]
fn the_best_material_becomes_the_pickaxe_within_two_cells_of_a_bench() {
    let bench = |cell: usize| {
        let mut world = clearing();
        world.cells[cell] = 9;
        world
    };
    let parts = [(3, 2), (2, 3), (4, 3), (9, 3)];
    for (items, milestone) in
        [(&parts[..2], Some(4)), (&parts[..3], Some(7)), (&parts[..], Some(11))]
    {
        assert_eq!(after(bench(3 * 12 + 7), items, 7).0, milestone);
    }
    assert_eq!(after(bench(3 * 12 + 8), &parts, 7).0, None);
    assert_eq!(after(bench(8 * 12 + 5), &parts, 7).0, None);
    assert_eq!(after(bench(7 * 12 + 3), &[(3, 1), (2, 3)], 7).0, None);
}

#[test]
fn stone_needs_a_pickaxe_ore_one_of_stone_and_diamond_one_of_iron() {
    let facing = |object: u8| {
        let mut world = clearing();
        world.cells[5 * 12 + 6] = object;
        world
    };
    for (object, milestone, least) in
        [(4, Some(0), 0), (5, Some(5), 1), (6, Some(9), 2), (7, Some(8), 2), (8, Some(12), 3)]
    {
        for pickaxe in 0..4 {
            let items = if pickaxe == 0 { vec![] } else { vec![(4 + pickaxe, 1)] };
            let (reached, world) = after(facing(object), &items, 4);
            let want = if pickaxe >= least { milestone } else { None };
            assert_eq!(reached, want, "{object} with {pickaxe}");
            assert_eq!(world.cells[5 * 12 + 6] == 0, want.is_some());
        }
    }
    assert_eq!(after(facing(9), &[(7, 1)], 4).1.cells[5 * 12 + 6], 9);
}

#[test]
fn an_episode_without_anything_to_reach_is_over() {
    let milestones = MilestoneSet::up_to::<Crafting>("iron").unwrap();
    let mut grids =
        Milestones::<Crafting>::new(Rules::usual::<Crafting>(milestones), 1, Split::Test);
    let mut world = clearing();
    world.cells[5 * 12 + 6] = 4;
    grids.start(0, world);
    assert!(!grids.step_losing(0, 4, |_| None).unwrap().done());
    let step = grids.step_losing(0, 2, |_| Some(0)).unwrap();
    assert!(step.terminated && !step.timed_out);
    assert_eq!(grids.episode(0).cause, Some("impossible"));
}

#[test]
fn items_get_lost_by_their_weights() {
    let milestones = MilestoneSet::up_to::<Crafting>("iron").unwrap();
    let rules = Rules { loss: 0.5, ..Rules::usual::<Crafting>(milestones) };
    let mut grids = Milestones::<Crafting>::new(rules, 1, Split::Test);
    let mut world = clearing();
    world.cells[5 * 12 + 8] = 4;
    (world.inventory[0], world.inventory[8], world.inventory[1]) = (1, 1, 1);
    let mut random = generator(1);
    let mut lost = [0; 12];
    for _ in 0..10_000 {
        grids.start(0, world);
        grids.step(0, &[0], &mut random).unwrap();
        for (item, lost) in lost.iter_mut().enumerate() {
            *lost += world.inventory[item] - grids.world(0).inventory[item];
        }
    }
    let near = |found: u16, want: u16| found.abs_diff(want) < 200;
    assert!(near(lost[0], 4_000) && near(lost[8], 1_000) && lost[1] == 0, "{lost:?}");
}

#[test]
fn in_the_mirror_left_is_right() {
    let mut plain = open("treasure-rooms", Split::Train, &[]).unwrap();
    let mut random = generator(5);
    plain.reset(0, &mut random);
    let (mut state, mut views) = (Vec::new(), [0, 1].map(|_| Observation::default()));
    plain.save(0, &mut state);
    for (turn, seen) in views.iter_mut().enumerate() {
        plain.observe(&state, turn, EntitySet::MAX, seen);
    }
    let mirrored = |column: usize| {
        let (channels, cell) = (16, column / 16);
        (cell / 11 * 11 + 10 - cell % 11) * channels + column % channels
    };
    let mut want: Vec<_> =
        views[0].rows.row(0).map(|(column, one)| (mirrored(column), one)).collect();
    want.sort_by_key(|entry| entry.0);
    assert!(views[1].rows.row(0).eq(want));
    assert_eq!([0, 1, 2, 3, 4].map(|action| plain.turned_action(1, action)), [1, 0, 2, 3, 4]);
}

#[test]
fn columns_have_the_names_of_what_they_show() {
    let world = open("crafting/iron", Split::Train, &[]).unwrap();
    let names = &world.spec().features;
    assert_eq!(names.len(), 121 * 9 + 12);
    let at = |name: &str| names.iter().position(|other| other == name).unwrap();
    assert_eq!(at("ahead5.left5.wall"), 0);
    assert_eq!(at("ahead1.left0.tree"), (4 * 11 + 5) * 9 + 2);
    assert_eq!(at("behind5.right5.furnace"), 121 * 9 - 1);
    assert_eq!(at("items.diamond"), 121 * 9 + 11);
}

#[test]
fn milestones_show_in_what_is_carried() {
    for (name, least) in [("crafting/diamond", 50), ("treasure-rooms", 50)] {
        let mut world = open(name, Split::Train, &[]).unwrap();
        let (signs, actions) = (world.spec().signs.clone(), world.spec().shape.actions);
        assert_eq!(signs.len(), world.spec().milestones.len());
        let row = |world: &dyn Environment| {
            let (mut state, mut seen) = (Vec::new(), Observation::default());
            world.save(0, &mut state);
            world.observe(&state, 0, EntitySet::MAX, &mut seen);
            let mut row = vec![0.0; world.spec().shape.features];
            seen.rows.write_dense(0, &mut row);
            row
        };
        let mut reached = 0;
        for seed in 0..8 {
            let mut random = generator(seed);
            world.reset(0, &mut random);
            let mut before = row(&*world);
            for _ in 0..3_000 {
                let action = below(&mut random, actions) as u16;
                let done = world.step(0, &[action], &mut random).unwrap().done();
                let now = row(&*world);
                let change = |feature: usize| now[feature] - before[feature];
                let shown = |rises: bool| {
                    signs.iter().position(|sign| {
                        let (found, wanted) = (change(sign.feature), f32::from(sign.change));
                        (wanted > 0.0) == rises
                            && if rises { found >= wanted } else { found <= wanted }
                    })
                };
                assert_eq!(shown(true).or_else(|| shown(false)), world.milestone(0), "{name}");
                reached += usize::from(world.milestone(0).is_some());
                before = now;
                if done {
                    break;
                }
            }
        }
        assert!(reached > least, "{name}: {reached}");
    }
}
