//! What says how good a team is.

use sortie_envs::{Spec, Split};

/// What says how good a team is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Score {
    /// The share of solved episodes.
    #[default]
    Success,
    /// The mean return, where no episode can be solved.
    Return,
}

impl Score {
    /// What counts in an environment.
    pub fn of(spec: &Spec) -> Self {
        if spec.has_success { Self::Success } else { Self::Return }
    }

    /// What counts in the environment of this name; success where nobody knows it.
    pub fn of_environment(name: &str) -> Self {
        let opened = sortie_envs::open(name, Split::Test, 0, &Default::default());
        opened.map_or(Self::Success, |environment| Self::of(environment.spec()))
    }

    /// What tables call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::Return => "return",
        }
    }

    /// What files call it.
    pub fn key(self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::Return => "return_mean",
        }
    }

    /// What an axis says of it.
    pub fn about(self) -> &'static str {
        match self {
            Self::Success => "share of solved episodes",
            Self::Return => "mean return",
        }
    }

    /// Which of the two numbers it is.
    pub fn pick(self, success: f64, return_mean: f64) -> f64 {
        match self {
            Self::Success => success,
            Self::Return => return_mean,
        }
    }

    /// A value as text, to as many places as say something.
    pub fn text(self, value: f64) -> String {
        match self {
            Self::Success => format!("{value:.3}"),
            Self::Return => format!("{value:.2}"),
        }
    }

    /// The ends of an axis that shows these values.
    pub fn range(self, values: impl IntoIterator<Item = f64>) -> [f64; 2] {
        if self == Self::Success {
            return [0.0, 1.0];
        }
        let numbers = values.into_iter().filter(|value| value.is_finite());
        let ends = numbers.fold(None, |ends: Option<[f64; 2]>, value| {
            let [low, high] = ends.unwrap_or([value; 2]);
            Some([low.min(value), high.max(value)])
        });
        let [low, high] = ends.unwrap_or_default();
        [low.floor(), high.ceil().max(low.floor() + 1.0)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn returns_count_where_nothing_can_be_solved() {
        for (name, want) in [
            ("save-the-city", Score::Success),
            ("particle/treasure-8", Score::Return),
            ("particle/rover-tower-8", Score::Return),
            ("nowhere/at-all", Score::Success),
        ] {
            assert_eq!(Score::of_environment(name), want, "{name}");
        }
        assert_eq!(Score::Success.pick(0.25, 3.0), 0.25);
        assert_eq!(Score::Return.pick(0.25, 3.0), 3.0);
        assert_eq!(
            (Score::Success.text(0.25), Score::Return.text(-3.0)),
            ("0.250".into(), "-3.00".into())
        );
    }

    #[test]
    fn axes_end_at_whole_numbers() {
        assert_eq!(Score::Success.range([0.3, 7.0]), [0.0, 1.0]);
        assert_eq!(Score::Return.range([-7.5, f64::NAN, 128.2]), [-8.0, 129.0]);
        assert_eq!(Score::Return.range([5.0]), [5.0, 6.0]);
        assert_eq!(Score::Return.range([]), [0.0, 1.0]);
    }
}
