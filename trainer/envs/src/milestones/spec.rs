//! What a game says of itself.

use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;
use core::marker::PhantomData;

use super::VERSION;
use super::game::Game;
use super::rules::Rules;
use super::states::state_bytes;
use super::window::{RADIUS, WINDOW, channels, columns};
use crate::spec::{Metric, Shape, Sign, Spec, View};

/// How many numbers of episodes a game can have: one, and one for each milestone.
const MOST: usize = 17;

struct Metrics<G>(PhantomData<G>);

impl<G: Game> Metrics<G> {
    const ALL: &[Metric; MOST] = &metrics::<G>();
}

/// What episodes are measured by: how many milestones they reached, and of each whether they did.
const fn metrics<G: Game>() -> [Metric; MOST] {
    let reached = Metric {
        name: "milestones",
        unit: "milestones",
        about: "different milestones reached",
        is_reported: true,
    };
    let mut metrics = [reached; MOST];
    let mut place = 0;
    while place < G::MILESTONES.len() {
        let name = G::MILESTONES[place];
        metrics[1 + place] = Metric { name, unit: "share", about: name, is_reported: true };
        place += 1;
    }
    metrics
}

/// No milestone can be had any more.
pub(super) const IMPOSSIBLE: &str = "impossible";
/// The time ran out.
pub(super) const TIME: &str = "time";

/// What a game with these rules says of itself.
pub(super) fn spec<G: Game>(rules: &Rules) -> Spec {
    let features = columns::<G>();
    let names = |names: &[&str]| names.iter().map(|name| (*name).to_string()).collect::<Vec<_>>();
    let units = |column| if column < features - G::ITEMS.len() { "0 or 1" } else { "items" };
    let cells = WINDOW * WINDOW;
    Spec {
        name: G::NAME,
        version: VERSION,
        shape: Shape { agents: 1, entities: 1, tasks: 0, actions: G::ACTIONS.len(), features },
        view: View::Pictures([channels::<G>(), WINDOW, WINDOW]),
        features: feature_names::<G>(),
        units: (0..features).map(units).collect(),
        actions: names(G::ACTIONS),
        safe_action: Some(0),
        metrics: Metrics::<G>::ALL.split_at(1 + G::MILESTONES.len()).0,
        causes: &[IMPOSSIBLE, TIME],
        milestones: names(&rules.milestones.names::<G>()),
        signs: signs::<G>(rules),
        turns: 2,
        row_entries: cells * (1 + usize::from(!G::STATES.is_empty())) + G::ITEMS.len(),
        state_bytes: state_bytes::<G>(),
        episode_limit: rules.limit.max(rules.training_limit).into(),
        ..Spec::default()
    }
}

/// How the milestones in use show in what is carried.
fn signs<G: Game>(rules: &Rules) -> Vec<Sign> {
    let first = columns::<G>() - G::ITEMS.len();
    let used = rules.milestones.bits();
    let signs = G::SIGNS.iter().enumerate().filter(|(milestone, _)| used >> milestone & 1 == 1);
    signs
        .map(|(_, (item, change))| Sign { feature: first + usize::from(*item), change: *change })
        .collect()
}

/// Such as `ahead2.left1.tree`, and `items.log`.
fn feature_names<G: Game>() -> Vec<String> {
    let kinds = || G::OBJECTS[2..].iter().chain(G::STATES);
    let side = |place: usize, [before, behind]: [&str; 2]| match place.checked_sub(RADIUS) {
        None => format!("{before}{}", RADIUS - place),
        Some(0) => format!("{before}0"),
        Some(distance) => format!("{behind}{distance}"),
    };
    let cells = (0..WINDOW * WINDOW).flat_map(|cell| {
        let ahead = side(cell / WINDOW, ["ahead", "behind"]);
        let across = side(cell % WINDOW, ["left", "right"]);
        kinds().map(move |kind| format!("{ahead}.{across}.{kind}"))
    });
    cells.chain(G::ITEMS.iter().map(|item| format!("items.{item}"))).collect()
}
