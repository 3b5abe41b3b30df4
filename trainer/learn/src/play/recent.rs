//! What the last episodes came to that were played to learn from.

use std::collections::{BTreeMap, VecDeque};

use serde::{Deserialize, Serialize};
use sortie_envs::Spec;

/// Episodes that means are taken of: as many as dissertations and papers take for curves of training.
const LAST: usize = 100;

/// The environment's metrics of the last episodes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Recent {
    episodes: VecDeque<Vec<Option<f64>>>,
}

impl Recent {
    /// An episode ended.
    pub(super) fn add(&mut self, metrics: Vec<Option<f64>>) {
        self.episodes.truncate(LAST - 1);
        self.episodes.push_front(metrics);
    }

    /// Means of the metrics that evaluations tell, by their names; none before so many episodes ended.
    pub(super) fn means(&self, spec: &Spec) -> BTreeMap<String, f64> {
        let reported = spec.metrics.iter().enumerate().filter(|(_, metric)| metric.is_reported);
        let is_full = self.episodes.len() == LAST;
        let mean = |(place, metric): (usize, &sortie_envs::Metric)| {
            let values = self.episodes.iter().filter_map(|it| it.get(place).copied().flatten());
            let (count, sum) =
                values.fold((0, 0.0), |(count, sum), value| (count + 1, sum + value));
            (count > 0).then(|| (metric.name.to_owned(), sum / f64::from(count)))
        };
        reported.filter(|_| is_full).filter_map(mean).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const METRICS: &[sortie_envs::Metric] = &[
        sortie_envs::Metric { name: "hidden", unit: "", about: "", is_reported: false },
        sortie_envs::Metric { name: "found", unit: "", about: "", is_reported: true },
    ];

    #[test]
    fn means_are_those_of_the_last_hundred() {
        let spec = Spec { metrics: METRICS, ..Spec::default() };
        let mut recent = Recent::default();
        for episode in 0..LAST {
            assert!(recent.means(&spec).is_empty(), "after {episode}");
            recent.add(vec![Some(5.0), Some(episode as f64)]);
        }
        assert_eq!(recent.means(&spec), [("found".to_owned(), 49.5)].into());
        recent.add(vec![Some(5.0), Some(100.0)]);
        assert_eq!(recent.means(&spec)["found"], 50.5, "the first does not count any more");
        // Episodes that have no such number do not count.
        (0..LAST - 1).for_each(|_| recent.add(vec![None, None]));
        assert_eq!(recent.means(&spec)["found"], 100.0);
    }
}
