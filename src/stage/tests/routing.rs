//! Vehicles whose allocator points at customers.

use serde_json::{Value, json};

use super::{cast, stepped, told, with};

/// The customers and the depot that somebody is sent to, by their numbers.
fn sent(news: &Value) -> Vec<u64> {
    let allocation = news["state"]["allocation"].as_array().expect("an allocation");
    allocation.iter().filter_map(Value::as_u64).collect()
}

#[test]
fn vehicles_are_sent_to_customers_and_do_as_they_are_told() {
    let team = cast("routing", "5-15", &["agent"]);
    with(&team, 3, |player, opening| {
        assert_eq!(opening["allocators"], json!(["learned", "nearest", "greedy", "hungarian"]));
        let depot = opening["state"]["things"].as_array().expect("places").len() as u64 - 1;
        let (mut before, mut rounds) = (opening, 0);
        while before.get("result").is_none() {
            assert_eq!(before["state"]["decided"], true, "every round asks anew");
            let mut customers: Vec<u64> =
                sent(&before).into_iter().filter(|to| *to < depot).collect();
            assert!(!customers.is_empty() || rounds > 0, "somebody leaves");
            let all = customers.len();
            customers.sort_unstable();
            customers.dedup();
            assert_eq!(customers.len(), all, "nobody is sent where another one goes");
            assert!(
                before["state"]["values"].as_array().expect("values").iter().all(Value::is_null)
            );
            let news = stepped(player);
            assert_eq!(news["step"]["actions"], before["state"]["chosen"]);
            (before, rounds) = (news, rounds + 1);
        }
        assert!((2..=30).contains(&rounds), "{rounds}");
    });
}

#[test]
fn rules_allocate_in_its_place_and_one_sends_a_single_vehicle() {
    let team = cast("routing", "5-15", &["agent"]);
    with(&team, 3, |player, opening| {
        assert!(sent(&opening).len() > 1, "{opening}");
        assert_eq!(sent(&told(player.choose_allocator(1))).len(), 1, "the nearest, by one vehicle");
        assert_eq!(
            sent(&told(player.choose_allocator(3))).len(),
            4,
            "all of them, by Hungarian method"
        );
        assert_eq!(sent(&told(player.choose_allocator(0))), sent(&opening));
    });
}
