//! Mixers: the value of a team from the utilities of its agents' chosen actions. Used in training only.
//!
//! Each mixes two things: the agents' utilities, and for imagination their 2 A imagined ones. Weights of
//! imagined utilities come from what the hypernetwork sees within and across; all else that a mixer needs
//! comes from everything (dissertation section 5.4.1).

use std::ops::Range;

use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Parameters, Pass, Var};

use super::BLOCKS;
use super::attention::{EntityAttention, LookShape};
use super::batch::{Teams, View};

crate::words! {
    /// How the utilities of a team become its value.
    MixerKind {
        /// Their sum (VDN).
        Sum = "sum",
        /// A weighted sum, and a value of the state.
        Linear = "linear",
        /// Two layers with non-negative weights (QMIX).
        Qmix = "qmix",
    }
}

crate::words! {
    /// Who makes the numbers that a mixer mixes with.
    #[derive(Default)]
    Hypernetworks {
        /// One network makes all of them.
        #[default]
        Shared = "shared",
        /// A network for each kind: weights, biases, the value of the state (the dissertation's).
        Separate = "separate",
    }
}

crate::words! {
    /// What the weights of a linear mixer add up to.
    #[derive(Default)]
    WeightsSum {
        /// One: a team's value is about as large as an agent's utility (the dissertation's).
        #[default]
        One = "one",
        /// The number of agents: about as large as the sum of their utilities.
        Agents = "agents",
    }
}

/// Sizes of a mixer and of the hypernetworks that feed it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MixerShape {
    /// How it mixes.
    pub kind: MixerKind,
    /// Who makes its numbers.
    pub hypernetworks: Hypernetworks,
    /// What a linear mixer's weights add up to.
    pub weights_sum: WeightsSum,
    /// Of the hypernetworks' embedding and attention.
    pub looking: LookShape,
    /// Width between the two layers of QMIX.
    pub mixing: usize,
}

/// A mixer's layers.
#[derive(Clone, Debug)]
pub struct Mixer {
    shape: MixerShape,
    /// A network that makes all numbers, or one each kind; a sum has none.
    hypernetworks: Vec<Hypernetwork>,
    /// Numbers of each kind.
    kinds: Vec<usize>,
}

/// A network that attends to all entities and makes numbers for each agent. No activation stands between the attention's
/// output and the layer behind it, so that both are one matrix.
#[derive(Clone, Copy, Debug)]
struct Hypernetwork {
    looking: EntityAttention,
    project: Linear,
    /// Whether imagined agents have numbers of their own.
    imagines: bool,
}

/// The values of teams.
#[derive(Clone, Copy, Debug)]
pub struct Mixed {
    /// `[teams, 1]`
    pub real: Var,
    /// `[teams, 1]`: of the imagined utilities, where there are any.
    pub imagined: Option<Var>,
}

/// Most kinds of numbers.
const KINDS: usize = 4;

impl Mixer {
    /// Adds tensors under `mixer`, drawn as PyTorch does.
    pub fn new(parameters: &mut Parameters, shape: MixerShape, random: &mut Generator) -> Self {
        let MixerShape { mixing, looking: look, .. } = shape;
        let kinds = match shape.kind {
            MixerKind::Sum => vec![],
            MixerKind::Linear => vec![("weights", 1), ("value", 1)],
            MixerKind::Qmix => {
                vec![("first", mixing), ("bias", mixing), ("second", mixing), ("value", 1)]
            }
        };
        let mut hypernetwork = |name: &str, outputs: usize, imagines: bool| {
            let looking = EntityAttention::new(parameters, name, look, random);
            let name = format!("{name}.project");
            let project = parameters.linear(&name, look.width, outputs, random);
            Hypernetwork { looking, project, imagines }
        };
        let outputs = kinds.iter().map(|(_, numbers)| numbers).sum();
        let hypernetworks = match shape.hypernetworks {
            Hypernetworks::Shared if kinds.is_empty() => vec![],
            Hypernetworks::Shared => vec![hypernetwork("mixer", outputs, true)],
            // What is imagined is weighted by what imagined agents see; nothing else depends on it.
            Hypernetworks::Separate => {
                let kinds = kinds.iter().enumerate();
                let each = kinds.map(|(at, (name, numbers))| {
                    hypernetwork(&format!("mixer.{name}"), *numbers, at == 0)
                });
                each.collect()
            }
        };
        let kinds = kinds.into_iter().map(|(_, numbers)| numbers).collect();
        Self { shape, hypernetworks, kinds }
    }

    /// Mixes the utilities `[blocks * agents, 1]` of the chosen actions of all agents, and with three blocks the imagined ones.
    pub fn mix(&self, pass: &mut Pass<'_>, all: Teams<'_>, utilities: Var) -> Mixed {
        let agents = all.known.queries();
        let imagines = pass.size(utilities)[0] > agents;
        let numbers = self.numbers(pass, all.known, imagines, utilities);
        let mut mix = |rows: Range<usize>| {
            let utilities = pass.rows(utilities, rows.clone());
            let mixed = Mixing { all, teams: &all.numbers[..rows.len()], rows, utilities };
            match self.shape.kind {
                MixerKind::Sum => pass.scatter(utilities, mixed.teams, all.sizes.len()),
                MixerKind::Linear => self.linear(pass, mixed, numbers),
                MixerKind::Qmix => qmix(pass, mixed, numbers),
            }
        };
        let real = mix(0..agents);
        Mixed { real, imagined: imagines.then(|| mix(agents..BLOCKS * agents)) }
    }

    /// The numbers of each kind, `[blocks * agents, numbers]`, or of the first block alone; no more of them than there are
    /// kinds.
    fn numbers(
        &self,
        pass: &mut Pass<'_>,
        view: View<'_>,
        imagines: bool,
        none: Var,
    ) -> [Var; KINDS] {
        let mut numbers = [none; KINDS];
        for (at, Hypernetwork { looking, project, imagines: own }) in
            self.hypernetworks.iter().enumerate()
        {
            let view = if imagines && *own { view } else { view.whole() };
            let attended = looking.attend(pass, view);
            numbers[at] = pass.linear(attended.output, *project);
        }
        if self.hypernetworks.len() == 1 && self.kinds.len() > 1 {
            let (all, mut column) = (numbers[0], 0);
            for (kind, width) in self.kinds.iter().enumerate() {
                numbers[kind] = pass.columns(all, column..column + width);
                column += width;
            }
        }
        numbers
    }

    /// `Q = sum of w_a q_a + V`: `w` is a softmax, over all that is mixed, of the first number, and `V` the mean of the second
    /// over the team.
    fn linear(
        &self,
        pass: &mut Pass<'_>,
        Mixing { all, teams, rows, utilities }: Mixing<'_>,
        [scores, value, ..]: [Var; KINDS],
    ) -> Var {
        let count = all.sizes.len();
        let scores = pass.rows(scores, rows);
        let weights = pass.softmax_by(scores, teams, count);
        let weighted = pass.multiply(weights, utilities);
        let mut mixed = pass.scatter(weighted, teams, count);
        if self.shape.weights_sum == WeightsSum::Agents {
            let sizes = pass.input(1, all.sizes);
            mixed = pass.multiply(mixed, sizes);
        }
        let value = all.mean(pass, value);
        pass.add(mixed, value)
    }
}

/// QMIX (dissertation section 5.3.2), with its layers of one team: `Q = w2 . elu(sum of W1[a] q_a + b1) + V`.
///
/// Each agent has M numbers for its row of `W1`, M for `b1`, M for `w2` and one for `V`; the last three are means over the
/// team. Rows of `W1`, and `w2`, go through a softmax, so that no weight is negative; `b1` and `V` are unrestricted.
fn qmix(
    pass: &mut Pass<'_>,
    Mixing { all, teams, rows, utilities }: Mixing<'_>,
    [first, bias, second, value]: [Var; KINDS],
) -> Var {
    let first = pass.rows(first, rows);
    let first = pass.softmax(first);
    let first = pass.scale_rows(first, utilities);
    let hidden = pass.scatter(first, teams, all.sizes.len());
    let bias = all.mean(pass, bias);
    let hidden = pass.add(hidden, bias);
    let hidden = pass.elu(hidden);
    let second = all.mean(pass, second);
    let second = pass.softmax(second);
    let mixed = pass.multiply(hidden, second);
    let mixed = pass.sum_columns(mixed);
    let value = all.mean(pass, value);
    pass.add(mixed, value)
}

/// What is mixed: utilities, their rows, and the team of each.
struct Mixing<'a> {
    all: Teams<'a>,
    teams: &'a [u32],
    rows: Range<usize>,
    utilities: Var,
}

impl Teams<'_> {
    /// The mean over each team of its agents' numbers, of those in the first block.
    fn mean(self, pass: &mut Pass<'_>, numbers: Var) -> Var {
        let agents = self.known.queries();
        let first = pass.rows(numbers, 0..agents);
        pass.mean_by(first, &self.numbers[..agents], self.sizes.len())
    }
}
