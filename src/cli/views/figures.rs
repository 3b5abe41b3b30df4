//! What reports say of an environment's own numbers.

use serde_json::{Map, Value};
use sortie_envs::group_matching::sizes;
use sortie_envs::{Episode, Metric, Spec, group_matching, save_the_city};

use crate::worlds::tally::Tally;

/// What a report says of an environment's own numbers.
pub(crate) struct Figures {
    /// For people, without line ends.
    pub(crate) text: String,
    /// For scripts, by their names and in this order.
    pub(crate) fields: Vec<(&'static str, Value)>,
}

/// Numbers of which an episode reaches so many of all that there are.
struct Reached {
    what: &'static str,
    /// Names of both numbers for scripts.
    fields: [&'static str; 2],
    reached: &'static str,
    all: All,
}

/// How many there are in an episode.
enum All {
    Metric(&'static str),
    Always(usize),
}

/// What is told so, and not by means.
fn reached_in(spec: &Spec) -> Option<Reached> {
    if spec.name == save_the_city::ENTRY.name {
        let (fields, reached) = (["buildings_saved", "buildings"], "buildings_completed");
        let all = All::Metric("buildings");
        return Some(Reached { what: "buildings saved", fields, reached, all });
    }
    (spec.name == group_matching::ENTRY.name).then(|| Reached {
        what: "groups gathered",
        fields: ["groups_gathered", "groups"],
        reached: "matches",
        all: All::Always(sizes(spec).groups),
    })
}

/// What an episode came to, in a few words.
pub(crate) fn outcome(spec: &Spec, episode: &Episode) -> String {
    let values = spec.metrics.iter().zip(&episode.metrics);
    if let Some(Reached { what, reached, all, .. }) = reached_in(spec) {
        let value = |name| values.clone().find(|(metric, _)| metric.name == name);
        let value = |name| value(name).and_then(|(_, value)| *value).unwrap_or(0.0);
        let all = match all {
            All::Metric(name) => value(name),
            All::Always(count) => count as f64,
        };
        return format!("{what} {} of {all} in {} steps", value(reached), episode.steps);
    }
    let told = values.filter(|(metric, _)| metric.is_reported);
    let told = told.filter_map(|(metric, value)| {
        // Two decimals, as far as there are any.
        let shown = (100.0 * (*value)?).round() / 100.0;
        Some(format!("{} {shown}", metric.name))
    });
    told.collect::<Vec<_>>().join(", ")
}

/// What episodes came to, beside what is counted everywhere.
pub(crate) fn figures(spec: &Spec, tally: &Tally) -> Figures {
    if let Some(Reached { what, fields, reached, all }) = reached_in(spec) {
        let sum = |name| tally.metric(spec, name).sum as usize;
        let all = match all {
            All::Metric(name) => sum(name),
            All::Always(count) => count * tally.episodes,
        };
        let [first, second] = fields;
        let fields = vec![(first, sum(reached).into()), (second, all.into())];
        return Figures { text: format!("{what} {} of {all}", sum(reached)), fields };
    }
    let means = spec.metrics.iter().filter_map(|metric| {
        let sum = tally.metric(spec, &metric.name);
        (sum.episodes > 0).then(|| (metric, sum.sum / sum.episodes as f64))
    });
    let text = means.clone().filter(|(metric, _)| metric.is_reported);
    let text = text.map(|(Metric { name, unit, .. }, mean)| {
        let unit = if name == unit { String::new() } else { format!(" {unit}") };
        format!("{name} {mean:.2}{unit}")
    });
    let fields: Map<String, Value> =
        means.map(|(metric, mean)| (metric.name.to_string(), mean.into())).collect();
    Figures { text: text.collect::<Vec<_>>().join(", "), fields: vec![("metrics", fields.into())] }
}

#[cfg(test)]
mod tests {
    use sortie_envs::{ENVIRONMENTS, Split, open};

    use super::*;

    /// An episode of an environment that came to these values.
    fn episode(name: &str, values: &[(&str, f64)]) -> (Spec, Episode) {
        let world = open(name, Split::Test, 1, &Default::default()).expect("it opens");
        let spec = world.spec().clone();
        let value = |name| values.iter().find(|(known, _)| *known == name).map(|(_, it)| *it);
        let metrics = spec.metrics.iter().map(|metric| value(&metric.name)).collect();
        (spec, Episode { steps: 7, metrics, ..Episode::default() })
    }

    #[test]
    fn what_is_reached_is_told_of_all_that_there_is() {
        let values = [("buildings_completed", 2.0), ("buildings", 3.0)];
        let (spec, played) = episode(ENVIRONMENTS[0].name, &values);
        assert_eq!(outcome(&spec, &played), "buildings saved 2 of 3 in 7 steps");
        let mut tally = Tally::default();
        tally.add(played.clone());
        tally.add(played);
        let figures = figures(&spec, &tally);
        assert_eq!(figures.text, "buildings saved 4 of 6");
        assert_eq!(figures.fields, [("buildings_saved", 4.into()), ("buildings", 6.into())]);
    }

    #[test]
    fn all_else_is_told_by_means() {
        let (spec, played) = episode("gridworld", &[("treasures", 2.0), ("tiers", 1.0)]);
        assert_eq!(outcome(&spec, &played), "treasures 2, tiers 1");
        let mut tally = Tally::default();
        tally.add(played);
        tally.add(episode("gridworld", &[("treasures", 1.0), ("tiers", 1.0)]).1);
        let figures = figures(&spec, &tally);
        assert_eq!(figures.text, "treasures 1.50, tiers 1.00");
        assert_eq!(figures.fields[0].1["treasures"], 1.5);
    }
}
