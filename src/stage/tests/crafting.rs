//! An agent that runs options: what it remembers is its own process's.

use serde_json::Value;

use super::{json, place_of, stepped, told};
use crate::{Cast, Player, golden_hash};

const PLANS: [&str; 3] = ["agent-controller", "agent-meta", "agent-affordance"];

fn cast() -> Cast {
    super::cast("crafting-iron", "iron", &PLANS)
}

fn with<T>(play: impl FnOnce(&mut Player<'_>, Value) -> T) -> T {
    super::with(&cast(), 0, play)
}

fn option(news: &Value) -> &Value {
    &news["state"]["thoughts"][0]["option"]
}

#[test]
fn options_go_on_from_step_to_step_however_often_the_agent_looks() {
    let alone: Vec<Value> = with(|player, opening| {
        let mut seen = vec![opening];
        seen.extend((0..80).map(|_| stepped(player)));
        seen
    });
    let steps = alone.iter().map(|news| option(news)["step"].as_u64().expect("a step"));
    let steps: Vec<u64> = steps.collect();
    assert_eq!(steps[..2], [1, 2], "looking twice at the first state is one step of the option");
    let is_next = |pair: &[u64]| pair[1] == pair[0] + 1 || pair[1] == 1;
    assert!(steps.windows(2).all(is_next), "{steps:?}");
    assert!(steps[1..].contains(&1), "an option ends");
    // Whoever looks again and again at what has not changed sees the same.
    with(|player, opening| {
        assert_eq!(opening["state"], alone[0]["state"]);
        for wanted in &alone[1..40] {
            assert_eq!(stepped(player)["state"], wanted["state"]);
            let place = place_of(wanted, "agents", 0);
            let place = [0, 1].map(|axis| place[axis].as_f64().expect("a number"));
            let again = told(player.place(0, place));
            assert_eq!(again["state"], wanted["state"]);
            assert_eq!(player.repeat_decision(0), Ok(true));
        }
    });
}

#[test]
fn a_process_that_comes_back_remembers_nothing() {
    with(|player, _| {
        (0..5).for_each(|_| drop(stepped(player)));
        let dead = told(player.kill_or_revive(0));
        assert_eq!(dead["state"]["thoughts"], json(&[Value::Null]));
        assert_eq!(player.repeat_decision(0), Ok(false));
        let action = |news: &Value| news["step"]["actions"][0].clone();
        let repeated = action(&stepped(player));
        assert_eq!(action(&stepped(player)), repeated, "the world repeats its last action");
        let back = told(player.kill_or_revive(0));
        assert_eq!(option(&back)["step"], 1, "its option begins anew");
        let steps = (0..9).map(|_| option(&stepped(player))["step"].as_u64().expect("a step"));
        let steps: Vec<u64> = [1].into_iter().chain(steps).collect();
        let goes_on = |pair: &[u64]| pair[1] == pair[0] + 1;
        assert!(steps.windows(2).all(|pair| goes_on(pair) || pair[1] == 1), "{steps:?}");
        assert!(steps.windows(2).any(goes_on), "it remembers again: {steps:?}");
    });
}

#[test]
fn utilities_are_those_of_the_controller() {
    let cast = cast();
    let golden = golden_hash(&cast).expect("plans that fit");
    let hash = |most| {
        super::with(&cast, 0, |player, _| {
            while player.rehearse(most).expect("it plays") < most {}
            player.rehearsed()
        })
    };
    assert_eq!(hash(600), hash(600));
    assert_ne!(hash(600), hash(599));
    // Other plans in their place are refused, or have other bits.
    let swapped = Cast { plans: vec![cast.plans[1].clone(); 3], ..cast.clone() };
    assert_ne!(golden_hash(&swapped), Ok(golden));
    assert!(golden_hash(&Cast { plans: Vec::new(), ..cast }).is_err());
}
