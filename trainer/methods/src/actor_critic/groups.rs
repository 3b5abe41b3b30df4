//! Who shares networks and where an agent's rows stand; how rows are normalised, and how actions are drawn by their scores.

use std::ops::Range;

use sortie_envs::random::unit;
use sortie_envs::{Random, Spec};
use sortie_learn::networks::drawn;
use sortie_learn::{LearnError, State};
use sortie_nn::layers::normalise::Moments;
use sortie_nn::layers::{VisibleLists, softmax};
use sortie_nn::tape::{Linear, Pass, Var};

/// Agents that share a policy and a critic's own layers: those of a role, or one alone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Group {
    /// Its agents.
    pub agents: Range<usize>,
    /// Numbers that an agent observes.
    pub observed: usize,
    /// Whether the agent's index within the group follows them, as a row of zeros and a one.
    pub identity: bool,
    /// Actions of an agent.
    pub actions: usize,
}

impl Group {
    /// Columns of the networks' input.
    pub fn inputs(&self) -> usize {
        self.observed + if self.identity { self.agents.len() } else { 0 }
    }

    /// Of numbers with so many columns for each of its rows those of some records.
    pub(crate) fn rows<'a>(
        &self,
        numbers: &'a [f32],
        columns: usize,
        records: &Range<usize>,
    ) -> &'a [f32] {
        let rows = self.range(records);
        &numbers[rows.start * columns..rows.end * columns]
    }

    /// What its agents see in some records, of what they see in all.
    pub(crate) fn input(&self, pass: &mut Pass<'_>, seen: &[f32], records: &Range<usize>) -> Var {
        pass.input(self.inputs(), self.rows(seen, self.inputs(), records))
    }

    /// Its rows of some records.
    pub(crate) fn range(&self, records: &Range<usize>) -> Range<usize> {
        records.start * self.agents.len()..records.end * self.agents.len()
    }

    /// Record and agent of each of its rows.
    pub(crate) fn order(
        &self,
        records: Range<usize>,
    ) -> impl Iterator<Item = (usize, usize)> + use<> {
        let agents = self.agents.clone();
        records.flat_map(move |record| agents.clone().map(move |agent| (record, agent)))
    }

    /// Where its rows stand among those of all groups, of so many records.
    pub(crate) fn places(&self, records: usize) -> Range<usize> {
        self.agents.start * records..self.agents.end * records
    }

    /// `[rows, actions]`: a one for each of these actions, among zeros.
    pub(crate) fn one_hot(&self, actions: &[u32]) -> Vec<f32> {
        let mut taken = vec![0.0; actions.len() * self.actions];
        for (taken, action) in taken.chunks_exact_mut(self.actions).zip(actions) {
            taken[*action as usize] = 1.0;
        }
        taken
    }

    /// Mean and variance of the columns of all these ones.
    pub(crate) fn moments(&self, actions: &[u32]) -> Moments {
        let (mut means, share) = (vec![0.0; self.actions], 1.0 / actions.len() as f64);
        actions.iter().for_each(|action| means[*action as usize] += share);
        let variances = means.iter().map(|mean| mean * (1.0 - mean)).collect();
        Moments { means, variances }
    }
}

/// Numbers by groups, a row for each agent of each record.
pub type Rows = Vec<Vec<f32>>;

/// Makes lists empty, so many of them, and keeps their memory.
pub(crate) fn emptied<T>(lists: &mut Vec<Vec<T>>, count: usize) {
    lists.resize_with(count, Vec::new);
    lists.iter_mut().for_each(Vec::clear);
}

/// All agents, in their order.
///
/// Of a batch of records the rows of a group stand behind each other, record by record, and the groups behind each other.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Groups(pub Vec<Group>);

impl Groups {
    /// One group for each role, or for each agent alone.
    pub fn new(spec: &Spec, shares: bool, identity: bool) -> Self {
        let all = 0..spec.shape.agents;
        let roles: Vec<_> = match &spec.roles[..] {
            [] => vec![(all, spec.shape.features, spec.shape.actions)],
            roles => roles
                .iter()
                .map(|role| (role.agents.clone(), role.features.len(), role.actions.len()))
                .collect(),
        };
        let groups = roles.into_iter().flat_map(|(agents, observed, actions)| {
            let size = if shares { agents.len() } else { 1 };
            agents.step_by(size.max(1)).map(move |first| Group {
                agents: first..first + size,
                observed,
                identity: identity && size > 1,
                actions,
            })
        });
        Self(groups.collect())
    }

    /// How many agents there are.
    pub fn agents(&self) -> usize {
        self.0.last().map_or(0, |group| group.agents.end)
    }

    /// For every row of so many records the rows of the other agents of its record, by their index.
    pub fn others(&self, records: usize) -> VisibleLists {
        let mut others = VisibleLists::default();
        for (record, agent) in self.0.iter().flat_map(|group| group.order(0..records)) {
            let rows = (0..self.agents()).filter(|other| *other != agent);
            rows.for_each(|other| others.push(self.row(records, record, other)));
            others.end_list();
        }
        others
    }

    /// For every row of so many records its record.
    pub fn records(&self, records: usize) -> Vec<u32> {
        let rows = self.0.iter().flat_map(|group| group.order(0..records));
        rows.map(|(record, _)| record as u32).collect()
    }

    fn row(&self, records: usize, record: usize, agent: usize) -> usize {
        let group = self.0.iter().find(|group| group.agents.contains(&agent));
        let agents = group.map_or(0..0, |group| group.agents.clone());
        agents.start * records + record * agents.len() + agent - agents.start
    }
}

/// Slope of leaky ReLU below zero.
pub(crate) const SLOPE: f32 = 0.01;

/// A layer with leaky ReLU behind it.
pub(crate) fn leaky(pass: &mut Pass<'_>, x: Var, layer: Linear) -> Var {
    bent(pass, x, layer, SLOPE)
}

/// A layer behind which numbers below zero count so many times as much.
pub(crate) fn bent(pass: &mut Pass<'_>, x: Var, layer: Linear, slope: f32) -> Var {
    if slope == 0.0 {
        return pass.linear_rectified(x, layer);
    }
    let y = pass.linear(x, layer);
    pass.leaky_relu(y, slope)
}

/// Where drawn actions come from.
pub trait Draw {
    /// Draws an action for every row of every group, by the scores of actions `[rows, actions]`.
    fn draw(&mut self, groups: &Groups, scores: &Rows) -> Vec<Vec<u32>>;

    /// Adds Gumbel's noise to scores, whose largest is then drawn by their softmax; none unless there is chance in it.
    fn shake(&mut self, scores: &mut [f32]) {
        let _ = scores;
    }
}

impl Draw for Random {
    fn draw(&mut self, groups: &Groups, scores: &Rows) -> Vec<Vec<u32>> {
        let mut chances = Vec::new();
        let mut of_group = |(group, scores): (&Group, &Vec<f32>)| {
            let rows = scores.chunks_exact(group.actions);
            rows.map(|scores| {
                chances.clear();
                chances.extend_from_slice(scores);
                softmax::forward(&mut chances);
                drawn(&chances, unit(self) as f32) as u32
            })
            .collect()
        };
        groups.0.iter().zip(scores).map(&mut of_group).collect()
    }

    fn shake(&mut self, scores: &mut [f32]) {
        for score in scores {
            let number = unit(self).max(f64::MIN_POSITIVE);
            *score -= (-number.ln()).ln() as f32;
        }
    }
}

/// The best action of every row of every group.
pub(crate) fn best_of_all(groups: &Groups, scores: &Rows) -> Vec<Vec<u32>> {
    let all = groups.0.iter().zip(scores);
    all.map(|(of, scores)| scores.chunks_exact(of.actions).map(best).collect()).collect()
}

/// The first of the largest.
pub(crate) fn best(scores: &[f32]) -> u32 {
    let largest = scores.iter().enumerate().reduce(|a, b| if b.1 > a.1 { b } else { a });
    largest.map_or(0, |(action, _)| action as u32)
}

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

#[cfg(test)]
mod tests {
    use super::*;

    fn group(agents: Range<usize>) -> Group {
        Group { agents, observed: 3, identity: true, actions: 2 }
    }

    #[test]
    fn every_row_sees_the_others_of_its_record() {
        let groups = Groups(vec![group(0..2), group(2..3)]);
        let (others, records) = (groups.others(2), groups.records(2));
        // Agents 0 and 1 of record 0, of record 1; agent 2 of both.
        let lists: Vec<Vec<usize>> = (0..6).map(|row| others.list(row).collect()).collect();
        assert_eq!(lists, [[1, 4], [0, 4], [3, 5], [2, 5], [0, 1], [2, 3]]);
        assert_eq!(records, [0, 0, 1, 1, 0, 1]);
    }

    #[test]
    fn the_largest_of_shaken_scores_is_drawn_by_their_softmax() {
        let mut random = sortie_envs::random::generator(1);
        let chances = [0.1_f32, 0.6, 0.3];
        let mut drawn = [0; 3];
        for _ in 0..20_000 {
            let mut scores = chances.map(f32::ln);
            random.shake(&mut scores);
            drawn[best(&scores) as usize] += 1;
        }
        for (count, chance) in drawn.into_iter().zip(chances) {
            assert!((count as f32 / 20_000.0 - chance).abs() < 0.015, "{drawn:?}");
        }
    }
}
