//! Agents that an allocator assigns to buildings.

use serde_json::{Value, to_value};
use sortie_attention::{AttentionLayers, Layer, Matrix};

use super::{place_of, stepped, told};
use crate::{Cast, Player, golden_hash, memory};

const ALLOCATORS: [&str; 4] = ["learned", "coordinated", "heuristic", "random"];

/// The shipped team; one head looks at everybody alike.
fn cast() -> Cast {
    let matrix = Matrix { inputs: 70, outputs: 1, values: vec![0.0; 70] };
    let layer = Layer { matrix, bias: vec![1.0], relu: false };
    let one = Matrix { inputs: 1, outputs: 1, values: vec![0.0] };
    let query = Layer { matrix: one.clone(), bias: vec![0.0], relu: false };
    let attention = AttentionLayers { embed: layer, heads: 1, query, key: one };
    let team = super::cast("save-the-city", "2-5a_2-5b", &["agent"]);
    let cast = Cast { attention: Some(attention), ..team };
    let bytes = cast.to_bytes().expect("there is room");
    assert!(Cast::from_bytes(&bytes[..100]).is_err());
    cast
}

fn with<T>(episode: usize, play: impl FnOnce(&mut Player<'_>, Value) -> T) -> T {
    super::with(&cast(), episode, play)
}

#[test]
fn an_episode_is_played_to_its_end_and_no_further() {
    with(7, |player, opening| {
        assert_eq!(opening["allocators"], to_value(ALLOCATORS).unwrap());
        assert_eq!((&opening["at"], &opening["limit"]), (&0.into(), &150.into()));
        assert_eq!(opening["state"]["decided"], true);
        let agents = opening["agents"].as_array().expect("agents").len();
        let (mut before, mut decided) = (opening, 1);
        loop {
            let news = stepped(player);
            // Everybody does what it had decided to do.
            assert_eq!(news["step"]["actions"], before["state"]["chosen"]);
            decided += i32::from(news["state"]["decided"] == true);
            if news["result"].is_string() {
                assert!(news["state"].get("thoughts").is_none(), "nobody thinks in the last state");
                break;
            }
            assert_eq!(news["state"]["thoughts"].as_array().expect("thoughts").len(), agents);
            before = news;
        }
        assert!(decided > 5, "{decided} allocations");
        assert!(player.step().expect("the end").is_none());
        assert_eq!(player.disturb(0).err().as_deref(), Some("the episode is over"));
        assert_eq!(player.kill_or_revive(0).err().as_deref(), Some("the episode is over"));
        assert_eq!(player.choose_allocator(1).err().as_deref(), Some("the episode is over"));
    });
}

#[test]
fn attention_is_told_of_those_who_exist() {
    // Four agents in a set of up to five: frames have a row between them and the buildings.
    with(0, |player, opening| {
        let [agents, buildings] =
            ["agents", "things"].map(|kind| opening["state"][kind].as_array().unwrap().len());
        assert_eq!(agents, 4);
        let news = stepped(player);
        for (agent, thought) in news["state"]["thoughts"].as_array().unwrap().iter().enumerate() {
            let building = agents + news["state"]["allocation"][agent].as_u64().unwrap() as usize;
            let attention = thought["attention"].as_array().unwrap();
            let seen: Vec<usize> =
                attention.iter().map(|seen| seen["entity"].as_u64().unwrap() as usize).collect();
            assert!(seen.contains(&agent) && seen.contains(&building), "{seen:?}");
            assert!(seen.iter().all(|entity| *entity < agents + buildings));
            let sum: f64 = attention.iter().map(|seen| seen["weights"][0].as_f64().unwrap()).sum();
            assert!((sum - 1.0).abs() < 1e-3, "{sum}");
        }
    });
}

#[test]
fn the_world_goes_on_without_the_dead_and_with_whoever_comes_back() {
    with(7, |player, _| {
        let before = stepped(player);
        let dead = told(player.kill_or_revive(1));
        assert_eq!((&dead["at"], &dead["state"]["dead"]), (&before["at"], &to_value([1]).unwrap()));
        assert_eq!(
            (&dead["state"]["chosen"][1], &dead["state"]["thoughts"][1]),
            (&Value::Null, &Value::Null)
        );
        assert!(dead["state"]["chosen"][0].is_u64());
        assert_eq!(player.repeat_decision(1), Ok(false));
        assert_eq!(player.repeat_decision(0), Ok(true));
        // It repeats its last action while that is available, else it stays; after three steps it is absent.
        let at = before["at"].as_u64().expect("a number");
        for steps in 1..=8 {
            let news = stepped(player);
            let state = &news["state"];
            let absent = if steps < 3 { vec![] } else { vec![(1, at + 3)] };
            assert_eq!(state["absent"], to_value(absent).unwrap(), "after {steps} steps");
            assert!(steps < 3 || state["allocation"][1].is_null(), "others are given its work");
            let action = news["step"]["actions"][1].as_u64().expect("an action");
            assert!(
                action == 0 || action == before["step"]["actions"][1].as_u64().unwrap(),
                "{action}"
            );
        }
        let back = told(player.kill_or_revive(1));
        assert_eq!(back["state"]["dead"], to_value([0; 0]).unwrap());
        assert_eq!(back["state"]["absent"], back["state"]["dead"]);
        assert!(back["state"]["chosen"][1].is_u64(), "it decides at once");
        let chosen = &back["state"]["chosen"];
        assert_eq!(stepped(player)["step"]["actions"], *chosen);
        // The last one alive, and nobody.
        for agent in 0..5 {
            told(player.kill_or_revive(agent));
        }
        assert_eq!(stepped(player)["state"]["thoughts"], to_value(vec![Value::Null; 5]).unwrap());
    });
}

#[test]
fn what_is_changed_is_seen_at_once() {
    with(7, |player, opening| {
        let chosen = &opening["state"]["chosen"];
        let moved = told(player.place(0, [0.0, 0.0]));
        assert_eq!(place_of(&moved, "agents", 0), to_value([0.0, 0.0]).unwrap());
        assert_eq!(moved["state"]["decided"], true, "the allocator looks as well");
        assert_ne!(moved["state"]["chosen"], *chosen);
        assert!(player.place(1, [-1.0, 0.0]).is_err());
        assert!(
            player.place(1, [0.0, 0.0]).err().is_some_and(|why| why.contains("shares its cell"))
        );
        let buildings = opening["state"]["things"].as_array().unwrap().len();
        let fire =
            |news: &Value, at: usize| news["state"]["things"][at]["bars"][1]["share"].clone();
        let cold = (0..buildings).find(|at| fire(&opening, *at) == 0.0).expect("one without fire");
        let burning = told(player.disturb(cold));
        assert_eq!(fire(&burning, cold), 1.0);
        assert_eq!(burning["state"]["things"][cold]["status"], "burning");
        assert!(player.disturb(99).is_err());
        // Who allocates shows in who is sent where.
        let sent: Vec<Value> = (0..3)
            .map(|choice| told(player.choose_allocator(choice))["state"]["allocation"].clone())
            .collect();
        assert_ne!(sent[0], sent[2]);
        assert_eq!(told(player.choose_allocator(0))["state"]["allocation"], sent[0]);
        // What nobody at a building is worth does not depend on who allocates.
        told(player.choose_allocator(2));
        let nobody = |news: &Value| -> Vec<Value> {
            let values = news["state"]["values"].as_array().unwrap();
            values.iter().map(|value| value["nobody"].clone()).collect()
        };
        let by_rule = told(player.place(0, [15.0, 15.0]));
        assert_eq!(nobody(&by_rule), nobody(&told(player.choose_allocator(0))));
        // The values of the teams that are there, and of others.
        let values = burning["state"]["values"].as_array().unwrap();
        let known = values
            .iter()
            .filter(|value| value["others"].as_array().is_some_and(|others| others.len() == 3));
        assert_eq!(known.count(), buildings);
    });
}

#[test]
fn utilities_are_counted_in_the_order_of_the_episodes() {
    let cast = cast();
    let hash = |seed, most| {
        let mut memory = memory(&cast).expect("plans that fit");
        let mut player = Player::new(&mut memory, &cast, seed, 0).expect("the team fits");
        while player.rehearse(most).expect("it plays") < most {}
        assert_eq!(player.rehearse(most), Ok(most));
        player.rehearsed()
    };
    // Over the end of an episode; whatever follows does not count.
    assert_eq!(hash(1, 700), hash(1, 700));
    assert_ne!(hash(1, 700), hash(1, 699));
    assert_ne!(hash(1, 700), hash(2, 700));
    assert_eq!(hash(1, 10_000), 0x5f73_da80_2486_6414, "the page of the playground has it");
    assert_eq!(golden_hash(&cast), Ok(0xf78b_a41c_f816_8696));
}
