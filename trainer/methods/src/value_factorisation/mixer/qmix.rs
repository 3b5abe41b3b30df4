//! The mixer of QMIX (dissertation section 5.3.2): `Q = w2 . elu(sum of W1[a] q_a + b1) + V`.
//!
//! The hypernetwork gives each agent M numbers for its row of `W1`, M for `b1`, M for `w2` and one for
//! `V`; the last three are means over the team. Rows of `W1`, and `w2`, go through a softmax, so that no
//! weight is negative; `b1` and `V` are unrestricted.

use sortie_nn::layers::softmax;

use super::Team;

/// Numbers for each agent, at a mixing width M.
pub(super) fn kinds(mixing: usize) -> [(&'static str, usize); 4] {
    [("first", mixing), ("bias", mixing), ("second", mixing), ("value", 1)]
}

fn outputs(mixing: usize) -> usize {
    3 * mixing + 1
}

/// The layers of one team.
#[derive(Clone, Debug, Default)]
pub(super) struct Scratch {
    /// Rows of `W1`, one behind the other.
    first: Vec<f32>,
    hidden: Vec<f32>,
    second: Vec<f32>,
    d_hidden: Vec<f32>,
    d_second: Vec<f32>,
    d_first: Vec<f32>,
}

impl Scratch {
    pub(super) fn value(
        &mut self,
        mixing: usize,
        team: Team,
        numbers: &[f32],
        utilities: &[f32],
        imagined: bool,
    ) -> f32 {
        let outputs = outputs(mixing);
        self.first.clear();
        self.hidden.clear();
        self.hidden.resize(mixing, 0.0);
        self.second.clear();
        self.second.resize(mixing, 0.0);
        for row in team.inputs(imagined) {
            let start = self.first.len();
            self.first.extend_from_slice(&numbers[row * outputs..][..mixing]);
            softmax::forward(&mut self.first[start..]);
            add_scaled(&mut self.hidden, utilities[row], &self.first[start..]);
        }
        let share = 1.0 / team.size.max(1) as f32;
        let mut state = 0.0;
        for row in team.rows(0) {
            let numbers = &numbers[row * outputs..][..outputs];
            add_scaled(&mut self.hidden, share, &numbers[mixing..2 * mixing]);
            add_scaled(&mut self.second, share, &numbers[2 * mixing..3 * mixing]);
            state += share * numbers[3 * mixing];
        }
        self.hidden.iter_mut().for_each(|x| *x = if *x > 0.0 { *x } else { x.exp_m1() });
        softmax::forward(&mut self.second);
        self.second.iter().zip(&self.hidden).map(|(w, x)| w * x).sum::<f32>() + state
    }

    pub(super) fn descend(
        &mut self,
        mixing: usize,
        (team, imagined, slope): (Team, bool, f32),
        (numbers, utilities): (&[f32], &[f32]),
        (d_numbers, d_utilities): (&mut [f32], &mut [f32]),
    ) {
        self.value(mixing, team, numbers, utilities, imagined);
        let outputs = outputs(mixing);
        self.d_second.clear();
        self.d_second.extend(self.hidden.iter().map(|x| slope * x));
        softmax::backward(&self.second, &mut self.d_second);
        self.d_hidden.clear();
        let layers = self.second.iter().zip(&self.hidden);
        self.d_hidden.extend(layers.map(|(w, x)| slope * w * if *x > 0.0 { 1.0 } else { x + 1.0 }));
        for (row, first) in team.inputs(imagined).zip(self.first.chunks_exact(mixing)) {
            d_utilities[row] = first.iter().zip(&self.d_hidden).map(|(w, d)| w * d).sum();
            self.d_first.clear();
            self.d_first.extend(self.d_hidden.iter().map(|d| utilities[row] * d));
            softmax::backward(first, &mut self.d_first);
            add_scaled(&mut d_numbers[row * outputs..][..mixing], 1.0, &self.d_first);
        }
        let share = 1.0 / team.size.max(1) as f32;
        for row in team.rows(0) {
            let d_numbers = &mut d_numbers[row * outputs..][..outputs];
            add_scaled(&mut d_numbers[mixing..2 * mixing], share, &self.d_hidden);
            add_scaled(&mut d_numbers[2 * mixing..3 * mixing], share, &self.d_second);
            d_numbers[3 * mixing] += share * slope;
        }
    }
}

fn add_scaled(out: &mut [f32], factor: f32, values: &[f32]) {
    for (out, value) in out.iter_mut().zip(values) {
        *out += factor * value;
    }
}
