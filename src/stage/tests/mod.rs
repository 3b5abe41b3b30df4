//! Shipped teams play, are watched, and are interfered with.

mod crafting;
mod places;
mod routing;
mod save_the_city;

use std::path::Path;

use serde::Serialize;
use serde_json::{Value, to_value};
use sortie_bundle::Bundle;

use crate::{AllocatorCast, Cast, GoldenObservation, Memory, News, OptionSettings, Player, memory};

/// A shipped team as a page brings it along, with the plans that lie beside its bundle.
fn cast(model: &str, set: &str, plans: &[&str]) -> Cast {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models").join(model);
    let bundle = Bundle::open(&folder).expect("the shipped bundle");
    let (contract, limits) = (bundle.contract(), bundle.manifest().limits);
    let plan = |name: &str| std::fs::read(folder.join(format!("{name}.plan")));
    let rules = bundle.options().map(|options| options.rules(contract.actions.into()));
    let pointing = bundle.pointing_graphs().map(|(_, rules)| AllocatorCast::Pointing {
        plans: ["encoder", "decoder"].map(|part| plan(&format!("allocator_{part}")).expect(part)),
        exclusive: rules.exclusive,
        first_action: rules.first_action,
    });
    let values = plan("allocator").ok().map(|plan| AllocatorCast::TeamValue {
        plan,
        entities: limits.n_max,
        tasks: limits.t_max,
        team_max: limits.team_max,
    });
    let environment = &bundle.manifest().contract.environment.name;
    let (environment, _) = environment.split_once('/').expect("environment and set");
    let cases = bundle.golden().cases.iter();
    let features = contract.features.into();
    let golden = cases.map(|case| GoldenObservation::new(&case.observation.view(), features));
    Cast {
        environment: environment.to_owned(),
        set: set.to_owned(),
        contract: contract.hash(),
        decision_interval: contract.decision_interval,
        safe_action: contract.safe_action,
        plans: plans.iter().map(|name| plan(name).expect("a plan")).collect(),
        plan_of: bundle.manifest().network.graph_of.clone(),
        options: rules.map(|rules| OptionSettings::from(&rules.expect("rules"))),
        allocator: pointing.or(values),
        attention: None,
        golden: golden.collect(),
    }
}

/// Plays an episode of seed 1 as far as `play` says.
fn with<T>(cast: &Cast, episode: usize, play: impl FnOnce(&mut Player<'_>, Value) -> T) -> T {
    let bytes = cast.to_bytes().expect("there is room");
    assert_eq!(Cast::from_bytes(&bytes).as_ref(), Ok(cast));
    let mut memory: Memory = memory(cast).expect("plans that fit");
    let mut player = Player::new(&mut memory, cast, 1, episode).expect("the team fits");
    let opening = json(&player.open().expect("it begins"));
    play(&mut player, opening)
}

fn json(told: &impl Serialize) -> Value {
    to_value(told).expect("JSON")
}

fn told(news: Result<News, String>) -> Value {
    json(&news.expect("it is done"))
}

fn stepped(player: &mut Player<'_>) -> Value {
    json(&player.step().expect("the team plays").expect("there is a step"))
}

/// Where an agent or a thing is.
fn place_of(news: &Value, of: &str, number: usize) -> Value {
    news["state"][of][number]["place"].clone()
}
