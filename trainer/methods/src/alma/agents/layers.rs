//! The utility network on a tape, and what it looks at.

use sortie_learn::export::{AttentionNetwork, Layer, Layout, Matrix};
use sortie_learn::networks::{AimView, Aims, Attended, EntityAttention, View};
use sortie_nn::layers::linear::LinearShape;
use sortie_nn::layers::{SparseRows, VisibleLists};
use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Parameters, Pass, Places, Var};

use super::utility::{UtilityShape, UtilityView};

/// What the network looks at: the entities of any number of independent samples.
///
/// Query i belongs to row i: the rows of all acting agents come first, then the other entities.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UtilityInput {
    /// Features `[rows, D]` of every entity, last actions included.
    pub rows: SparseRows,
    /// For each acting agent the rows that it sees, its own among them where it is visible.
    pub visible: VisibleLists,
    /// What the actions of acting agents aim at.
    pub aims: Aims,
}

impl UtilityInput {
    /// Forgets all samples, keeps the memory.
    pub fn clear(&mut self) {
        self.rows.clear();
        self.visible.clear();
        self.aims.clear();
    }

    /// The same without what is aimed at.
    pub fn view(&self) -> View<'_> {
        View { rows: &self.rows, own: &[], lists: &self.visible, imagines: false }
    }
}

/// The layers of a utility network, in the order of its tensors.
#[derive(Clone, Copy, Debug)]
pub struct UtilityLayers {
    looking: EntityAttention,
    out: Linear,
    fc2: Linear,
    head: Linear,
    skip: Option<Linear>,
    /// Makes the vector that points.
    pointing: Option<Linear>,
}

/// What a utility network has made of its input before the head.
#[derive(Clone, Copy, Debug)]
pub struct Looked {
    /// The embeddings of all rows `[rows, E]`, and what each agent attends to, `[agents, E]`.
    pub(super) attended: Attended,
    /// What stands before the head, `[agents, R]`: there memories and strategies come in.
    pub base: Var,
}

impl UtilityLayers {
    /// Those of a network of this shape.
    pub fn of(shape: UtilityShape) -> Self {
        let places = &mut Places::default();
        let UtilityShape { input, width, heads, base, actions, skip, targets } = shape;
        Self {
            looking: EntityAttention {
                embed: places.linear(input, width),
                queries: places.projection(width, width),
                keys_values: places.projection(width, 2 * width),
                heads,
                absorbs: true,
            },
            out: places.linear(width, width),
            fc2: places.linear(width, base),
            head: places.linear(base, actions - targets.count),
            skip: skip.then(|| places.projection(width, width)),
            pointing: (targets.count > 0).then(|| places.linear(base, targets.reach(width))),
        }
    }

    /// Everything before the head.
    pub fn look(self, t: &mut Pass<'_>, view: View<'_>) -> Looked {
        let attended = self.looking.attend(t, view);
        let looked = match self.skip {
            Some(skip) => {
                let own = attended.own(t, view);
                t.linear_sum_rectified([attended.output, own], [self.out, skip])
            }
            None => t.linear_rectified(attended.output, self.out),
        };
        Looked { attended, base: t.linear_rectified(looked, self.fc2) }
    }

    /// The utilities `[agents, U]` of what stands before the head.
    pub fn head(self, t: &mut Pass<'_>, looked: Looked, aims: AimView<'_>) -> Var {
        let untargeted = t.linear(looked.base, self.head);
        let Some(pointing) = self.pointing else { return untargeted };
        let vectors = t.linear(looked.base, pointing);
        let aimed = aims.point(t, [vectors, looked.attended.embeddings]);
        t.concat(&[untargeted, aimed])
    }

    /// The utilities `[agents, U]` of agents without memories and strategies.
    pub fn utilities(self, t: &mut Pass<'_>, input: &UtilityInput) -> Var {
        let looked = self.look(t, input.view());
        self.head(t, looked, input.aims.all())
    }
}

impl<'a> UtilityView<'a> {
    /// The layers, for export.
    pub fn layers(self) -> AttentionNetwork<'a> {
        let (shape, values) = (self.shape, self.parameters);
        let UtilityShape { input, width, heads, base, actions, targets, .. } = shape;
        let UtilityLayers { looking, out, fc2, head, skip, pointing } = UtilityLayers::of(shape);
        let whole = |layer: Linear| Layer::of(layer, values, Layout::OutputsFirst);
        let attention_in = looking.queries.weight..looking.keys_values.weight_range().end;
        AttentionNetwork {
            inputs: input,
            width,
            heads,
            base,
            outputs: actions,
            fc1: Layer::of(looking.embed, values, Layout::InputsFirst),
            attention_in: Matrix { values: &values[attention_in], layout: Layout::OutputsFirst },
            attention_out: whole(out),
            fc2: Some(whole(fc2)),
            head: whole(head),
            skip: skip.map(|skip| whole(skip).weight),
            pointing: pointing.map(|pointing| targets.deployed(pointing, values)),
        }
    }
}

/// Adds projections that stand behind each other as one tensor, each with so many times as many outputs as inputs.
pub(crate) fn stacked<const COUNT: usize>(
    p: &mut Parameters,
    name: &str,
    (width, times): (usize, [usize; COUNT]),
    random: &mut Generator,
) -> [Linear; COUNT] {
    let mut whole = p.projection(name, width, times.iter().sum::<usize>() * width, random);
    times.map(|times| {
        let own = Linear { shape: LinearShape { input: width, output: times * width }, ..whole };
        whole.weight = own.weight_range().end;
        own
    })
}
