//! Teams without subtasks: what is put elsewhere is there, and seen there.

use serde_json::{Value, json};

use super::{cast, place_of, stepped, told, with};
use crate::{Cast, Player};

fn chosen(news: &Value) -> &Value {
    &news["state"]["chosen"]
}

/// Plays an episode to its end: what agents have decided is what they do.
fn plays_on(cast: &Cast, agents: usize) {
    with(cast, 0, |player, opening| {
        assert_eq!(opening["agents"].as_array().expect("agents").len(), agents);
        assert_eq!(opening["allocators"], json!([]), "nobody is assigned");
        let mut before = opening;
        while before.get("result").is_none() {
            assert_eq!(before["state"]["thoughts"].as_array().expect("thoughts").len(), agents);
            let news = stepped(player);
            assert_eq!(news["step"]["actions"], *chosen(&before));
            before = news;
        }
        assert!(before["state"].get("thoughts").is_none(), "nobody thinks in the last state");
        assert_eq!(player.place(0, [1.0, 1.0]).err().as_deref(), Some("the episode is over"));
    });
}

fn is_refused(player: &mut Player<'_>, entity: usize, place: [f64; 2], why: &str) {
    let reason = player.place(entity, place).err().expect("nothing can be there");
    assert!(reason.contains(why), "{reason}");
}

#[test]
fn collectors_and_treasures_are_put_elsewhere() {
    let team = cast("treasure-8", "treasure-8", &["agent-collector", "agent-bank"]);
    plays_on(&team, 8);
    with(&team, 0, |player, opening| {
        (0..3).for_each(|_| drop(stepped(player)));
        let moved = told(player.place(0, [0.5, -1.25]));
        assert_eq!(place_of(&moved, "agents", 0), json!([0.5, -1.25]));
        // What is put somewhere rests there.
        let place = |news: &Value| place_of(news, "agents", 0).as_array().expect("a place").clone();
        let next = place(&stepped(player));
        let way = next.iter().zip([0.5, -1.25]).map(|(to, from)| to.as_f64().unwrap() - from);
        assert!(way.map(f64::abs).sum::<f64>() < 0.2, "{next:?}");
        let treasure = opening["state"]["things"].as_array().expect("treasures").len() - 1;
        let moved = told(player.place(8 + treasure, [-0.5, 0.25]));
        assert_eq!(place_of(&moved, "things", treasure), json!([-0.5, 0.25]));
        is_refused(player, 0, [0.0, 2.5], "too far");
        is_refused(player, 0, [f64::NAN, 0.0], "too far");
        is_refused(player, 99, [0.0, 0.0], "nowhere");
        assert_eq!(player.disturb(0).err().as_deref(), Some("nothing can happen to it"));
    });
}

#[test]
fn rovers_and_landmarks_are_put_elsewhere_and_towers_are_nowhere() {
    let team = cast("rover-tower-8", "rover-tower-8", &["agent-rover", "agent-tower"]);
    plays_on(&team, 8);
    with(&team, 0, |player, opening| {
        let links = opening["state"]["links"].as_array().expect("links");
        let linked = |name: &str| {
            let own = links.iter().find(|link| link["from"] == 0 && link["name"] == name);
            own.and_then(|link| link["to"].as_u64()).expect("a link") as usize
        };
        let (goal, tower) = (linked("goal") - 8, linked("pair"));
        let mut said = Vec::new();
        for at in [[0.9, 0.9], [-0.9, 0.9], [-0.9, -0.9], [0.9, -0.9]] {
            let moved = told(player.place(8 + goal, at));
            assert_eq!(place_of(&moved, "things", goal), json!(at));
            said.push(chosen(&moved)[tower].clone());
        }
        assert!(said.iter().any(|word| *word != said[0]), "its tower says where: {said:?}");
        is_refused(player, tower, [0.0, 0.0], "nowhere");
        let moved = told(player.place(0, [0.5, -0.5]));
        assert_eq!(place_of(&moved, "agents", 0), json!([0.5, -0.5]));
    });
}

#[test]
fn agents_of_a_ring_are_put_into_other_cells() {
    let team = cast("group-matching", "8x6x2", &["agent"]);
    plays_on(&team, 8);
    with(&team, 0, |player, opening| {
        let cells = opening["state"]["cells"].as_array().expect("cells").iter();
        let cells = cells.map(|cell| [0, 1].map(|axis| cell[1]["place"][axis].as_f64().unwrap()));
        let cells: Vec<[f64; 2]> = cells.collect();
        let about = |news: &Value| news["state"]["agents"][2]["about"].clone();
        let is_in =
            |cell: usize| about(&opening).as_str().unwrap().contains(&format!("cell {cell},"));
        let cell = (0..6).find(|cell| is_in(*cell)).expect("a cell");
        let other = (cell + 3) % 6;
        let moved = told(player.place(2, cells[other].map(|part| 0.9 * part)));
        assert!(about(&moved).as_str().unwrap().contains(&format!("cell {other},")), "{moved}");
        assert_ne!(moved["state"]["thoughts"], opening["state"]["thoughts"]);
        is_refused(player, 2, [f64::NAN, 0.0], "cells of the ring");
        is_refused(player, 8, [0.0, 0.0], "cells of the ring");
        // Everybody in one cell would end the episode.
        let gathers: Vec<Result<_, String>> =
            (0..8).map(|agent| player.place(agent, cells[1]).map(drop)).collect();
        let refused = gathers.iter().position(Result::is_err).expect("the last one");
        assert!(gathers[refused].as_ref().unwrap_err().contains("by itself"));
        assert!(stepped(player)["step"]["reward"].is_number());
    });
}

#[test]
fn agents_of_a_maze_are_put_into_free_cells() {
    let team = cast("gridworld", "task1-2", &["agent"]);
    plays_on(&team, 2);
    with(&team, 0, |player, opening| {
        let cells = opening["state"]["cells"].as_array().expect("cells");
        let place = |cell: &Value| [0, 1].map(|axis| cell[1]["place"][axis].as_f64().unwrap());
        let walls: Vec<_> =
            cells.iter().filter(|cell| cell[1]["kind"] == "wall").map(place).collect();
        let treasure = cells.iter().find(|cell| cell[1]["label"] == "A").map(place);
        is_refused(player, 1, walls[0], "wall");
        is_refused(player, 1, [99.0, 1.0], "wall");
        let [x, y] = treasure.expect("a treasure");
        // Beside it is the way that leads there.
        let ways = [[x + 1.0, y], [x - 1.0, y], [x, y + 1.0], [x, y - 1.0]];
        let beside = ways.into_iter().find(|way| !walls.contains(way)).expect("a way");
        let moved = told(player.place(1, beside));
        assert_eq!(place_of(&moved, "agents", 1), json!(beside));
        assert_ne!(chosen(&moved), &Value::Null);
    });
}
