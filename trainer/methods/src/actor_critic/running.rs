//! What policies were shown so far, by which they normalise what they are shown next.

use sortie_learn::{LearnError, State};
use sortie_nn::layers::normalise::Moments;

use super::groups::Groups;

/// Mean and variance of what each group's policy was shown, moved a tenth of the way with every batch.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Running {
    /// By groups, `[inputs]`.
    pub means: Vec<Vec<f64>>,
    /// By groups, `[inputs]`.
    pub variances: Vec<Vec<f64>>,
}

impl Running {
    const RATE: f64 = 0.1;

    /// Those of groups that saw nothing yet.
    pub fn new(groups: &Groups) -> Self {
        let all = |number: f64| groups.0.iter().map(|group| vec![number; group.inputs()]).collect();
        Self { means: all(0.0), variances: all(1.0) }
    }

    /// Moves towards the moments of a batch of so many rows.
    pub fn update(&mut self, group: usize, moments: &Moments, rows: usize) {
        let unbiased = rows as f64 / (rows as f64 - 1.0).max(1.0);
        let towards = |at: &mut f64, to: f64| *at += Self::RATE * (to - *at);
        for (mean, to) in self.means[group].iter_mut().zip(&moments.means) {
            towards(mean, *to);
        }
        for (variance, to) in self.variances[group].iter_mut().zip(&moments.variances) {
            towards(variance, unbiased * to);
        }
    }

    /// Visits them: rounded to f32 as part of the weights, and as they are for runs that go on.
    pub(crate) fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        let all = || self.means.iter().chain(&self.variances).flatten();
        let mut rounded: Vec<f32> = all().map(|moment| *moment as f32).collect();
        state.vector("inputs", &mut rounded)?;
        if state.is_reading() {
            let all = self.means.iter_mut().chain(&mut self.variances).flatten();
            all.zip(rounded).for_each(|(moment, rounded)| *moment = f64::from(rounded));
        }
        state.value("inputs", self)
    }

    /// Normalises what a group is shown outside of batches.
    pub fn normalise(&self, group: usize, rows: &mut [f32]) {
        let (means, variances) = (self.means[group].clone(), self.variances[group].clone());
        Moments { means, variances }.normalise(rows);
    }
}
