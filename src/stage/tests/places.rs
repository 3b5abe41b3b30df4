//! Teams without subtasks: what is put elsewhere is there, and seen there.

use serde_json::{Value, json};

use super::{cast, stepped, told, with};
use crate::gridworld::Maze;
use crate::group_matching::Groups;
use crate::particle::Plane;
use crate::{Cast, Player, Show};

fn chosen(news: &Value) -> &Value {
    &news["state"]["chosen"]
}

/// Plays an episode to its end: what agents have decided is what they do.
fn plays_on<S: Show>(cast: &Cast, agents: usize) {
    with::<S, _>(cast, 0, |player, opening| {
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

fn is_refused<S: Show>(player: &mut Player<'_, S>, entity: usize, place: [f64; 2], why: &str) {
    let reason = player.place(entity, place).err().expect("nothing can be there");
    assert!(reason.contains(why), "{reason}");
}

#[test]
fn collectors_and_treasures_are_put_elsewhere() {
    let team = cast("treasure-8", "treasure-8", &["agent-collector", "agent-bank"]);
    plays_on::<Plane>(&team, 8);
    with::<Plane, _>(&team, 0, |player, opening| {
        (0..3).for_each(|_| drop(stepped(player)));
        let moved = told(player.place(0, [0.5, -1.25]));
        assert_eq!(moved["state"]["places"][0], json!([0.5, -1.25]));
        // What is put somewhere rests there.
        let place = |news: &Value| news["state"]["places"][0].as_array().expect("a place").clone();
        let next = place(&stepped(player));
        let way = next.iter().zip([0.5, -1.25]).map(|(to, from)| to.as_f64().unwrap() - from);
        assert!(way.map(f64::abs).sum::<f64>() < 0.2, "{next:?}");
        let treasure = opening["state"]["things"].as_array().expect("treasures").len() - 1;
        let moved = told(player.place(8 + treasure, [-0.5, 0.25]));
        assert_eq!(moved["state"]["things"][treasure], json!([-0.5, 0.25]));
        is_refused(player, 0, [0.0, 2.5], "too far");
        is_refused(player, 0, [f64::NAN, 0.0], "too far");
        is_refused(player, 99, [0.0, 0.0], "nowhere");
        assert_eq!(player.disturb(0).err().as_deref(), Some("nothing can happen to it"));
    });
}

#[test]
fn rovers_and_landmarks_are_put_elsewhere_and_towers_are_nowhere() {
    let team = cast("rover-tower-8", "rover-tower-8", &["agent-rover", "agent-tower"]);
    plays_on::<Plane>(&team, 8);
    with::<Plane, _>(&team, 0, |player, opening| {
        let goal = opening["agents"][0]["goal"].as_u64().expect("a goal") as usize;
        let tower = opening["agents"][0]["partner"].as_u64().expect("a tower") as usize;
        let mut said = Vec::new();
        for at in [[0.9, 0.9], [-0.9, 0.9], [-0.9, -0.9], [0.9, -0.9]] {
            let moved = told(player.place(8 + goal, at));
            assert_eq!(moved["state"]["things"][goal], json!(at));
            said.push(chosen(&moved)[tower].clone());
        }
        assert!(said.iter().any(|word| *word != said[0]), "its tower says where: {said:?}");
        is_refused(player, tower, [0.0, 0.0], "nowhere");
        let moved = told(player.place(0, [0.5, -0.5]));
        assert_eq!(moved["state"]["places"][0], json!([0.5, -0.5]));
    });
}

#[test]
fn agents_of_a_ring_are_put_into_other_cells() {
    let team = cast("group-matching", "8x6x2", &["agent"]);
    plays_on::<Groups>(&team, 8);
    with::<Groups, _>(&team, 0, |player, opening| {
        let cell = opening["state"]["places"][2].as_u64().expect("a cell");
        let other = (cell + 3) % 6;
        let moved = told(player.place(2, [other as f64, 0.0]));
        assert_eq!(moved["state"]["places"][2], other);
        assert_ne!(moved["state"]["thoughts"], opening["state"]["thoughts"]);
        is_refused(player, 2, [6.0, 0.0], "6 cells");
        is_refused(player, 8, [0.0, 0.0], "6 cells");
        // Everybody in one cell would end the episode.
        let gathers: Vec<Result<_, String>> =
            (0..8).map(|agent| player.place(agent, [1.0, 0.0]).map(drop)).collect();
        let refused = gathers.iter().position(Result::is_err).expect("the last one");
        assert!(gathers[refused].as_ref().unwrap_err().contains("by itself"));
        assert!(stepped(player)["step"]["reward"].is_number());
    });
}

#[test]
fn agents_of_a_maze_are_put_into_free_cells() {
    let team = cast("gridworld", "task1-2", &["agent"]);
    plays_on::<Maze>(&team, 2);
    with::<Maze, _>(&team, 0, |player, opening| {
        let map: Vec<Vec<u8>> = opening["map"]
            .as_array()
            .expect("rows")
            .iter()
            .map(|row| row.as_str().expect("a row").as_bytes().to_vec())
            .collect();
        let cells = map.iter().enumerate().flat_map(|(y, row)| {
            row.iter().enumerate().map(move |(x, sign)| ([x as f64, y as f64], *sign))
        });
        let find = |wanted: u8| cells.clone().find(|(_, sign)| *sign == wanted).expect("a cell").0;
        is_refused(player, 1, find(b'#'), "wall");
        is_refused(player, 1, [99.0, 1.0], "wall");
        let [x, y] = find(b'A');
        // Beside it is the way that leads there.
        let free = |[x, y]: [f64; 2]| map[y as usize][x as usize] != b'#';
        let ways = [[x + 1.0, y], [x - 1.0, y], [x, y + 1.0], [x, y - 1.0]];
        let beside = ways.into_iter().find(|way| free(*way)).expect("a way");
        let moved = told(player.place(1, beside));
        let cell = beside[1] * map[0].len() as f64 + beside[0];
        assert_eq!(moved["state"]["cells"][1].as_f64(), Some(cell));
        assert_eq!(moved["events"], json!([]), "nobody fell");
        assert_ne!(chosen(&moved), &Value::Null);
    });
}
