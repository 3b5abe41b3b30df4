//! The layers of agents on a tape: entities embedded and looked at, which coach and recognition begin with too, and the
//! utility network behind them.

use sortie_learn::export::{AttentionNetwork, Layer, Layout, Matrix};
use sortie_learn::networks::{Aims, View};
use sortie_nn::layers::attention::AttentionShape;
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

    /// The same as mixers look at it.
    pub(super) fn view(&self) -> View<'_> {
        View { rows: &self.rows, own: &[], lists: &self.visible, imagines: false }
    }

    /// Whether queries absorb their keys, because that takes fewer multiplications than keys and values.
    ///
    /// The products of whole matrices that keys and values allow are faster than the sums over pairs, so
    /// pairs count twice.
    fn absorbs(&self, shape: AttentionShape) -> bool {
        let matrix = 2 * shape.width * shape.width;
        let pair = 2 * shape.heads * shape.width;
        let (rows, queries) = (self.rows.len(), self.visible.queries());
        queries * matrix + 4 * self.visible.pairs() * pair < rows * matrix
    }
}

/// What embeds entities and lets agents look at them (dissertation section 2.3).
#[derive(Clone, Copy, Debug)]
pub(crate) struct TrunkLayers {
    /// `[input, E]`
    pub(crate) fc1: Linear,
    pub(crate) queries: Linear,
    /// `[2 E, E]`
    pub(crate) keys_values: Linear,
    pub(crate) shape: AttentionShape,
}

impl TrunkLayers {
    /// A trunk over entities of so many input columns.
    fn of(input: usize, shape: AttentionShape, places: &mut Places) -> Self {
        let width = shape.width;
        Self {
            fc1: places.linear(input, width),
            queries: places.projection(width, width),
            keys_values: places.projection(width, 2 * width),
            shape,
        }
    }

    /// What each acting agent attends to, and its own embedding, `[agents, E]` each; and the embeddings of all rows.
    pub(crate) fn attend(self, t: &mut Pass<'_>, input: &UtilityInput) -> [Var; 3] {
        let (visible, heads) = (&input.visible, self.shape.heads);
        let entities = t.sparse_linear_rectified(&input.rows, self.fc1);
        let own = t.rows(entities, 0..visible.queries());
        let queries = t.linear(own, self.queries);
        let attended = if input.absorbs(self.shape) {
            t.absorbed_attention(queries, entities, self.keys_values, visible, heads)
        } else {
            let keys_values = t.linear(entities, self.keys_values);
            t.attention(queries, keys_values, visible, heads)
        };
        [attended, own, entities]
    }
}

/// The layers of a utility network, in the order of its tensors.
#[derive(Clone, Copy, Debug)]
pub struct UtilityLayers {
    trunk: TrunkLayers,
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
    /// What each agent attends to, `[agents, E]`.
    pub(super) attended: Var,
    /// The embeddings of all rows, `[rows, E]`.
    entities: Var,
    /// What stands before the head, `[agents, R]`: there memories and strategies come in.
    pub base: Var,
}

impl UtilityLayers {
    /// Those of a network of this shape.
    pub fn of(shape: UtilityShape) -> Self {
        let places = &mut Places::default();
        let UtilityShape { input, width, base, actions, skip, targets, .. } = shape;
        Self {
            trunk: TrunkLayers::of(input, shape.attention(), places),
            out: places.linear(width, width),
            fc2: places.linear(width, base),
            head: places.linear(base, actions - targets.count),
            skip: skip.then(|| places.projection(width, width)),
            pointing: (targets.count > 0).then(|| places.linear(base, targets.reach(width))),
        }
    }

    /// Everything before the head.
    pub fn look(self, t: &mut Pass<'_>, input: &UtilityInput) -> Looked {
        let [attended, own, entities] = self.trunk.attend(t, input);
        let looked = match self.skip {
            Some(skip) => t.linear_sum_rectified([attended, own], [self.out, skip]),
            None => t.linear_rectified(attended, self.out),
        };
        Looked { attended, entities, base: t.linear_rectified(looked, self.fc2) }
    }

    /// The utilities `[agents, U]` of what stands before the head.
    pub fn head(self, t: &mut Pass<'_>, looked: Looked, input: &UtilityInput) -> Var {
        let untargeted = t.linear(looked.base, self.head);
        let Some(pointing) = self.pointing else { return untargeted };
        let vectors = t.linear(looked.base, pointing);
        let aimed = input.aims.all().point(t, [vectors, looked.entities]);
        t.concat(&[untargeted, aimed])
    }

    /// The utilities `[agents, U]` of agents without memories and strategies.
    pub fn utilities(self, t: &mut Pass<'_>, input: &UtilityInput) -> Var {
        let looked = self.look(t, input);
        self.head(t, looked, input)
    }
}

impl<'a> UtilityView<'a> {
    /// The layers, for export.
    pub fn layers(self) -> AttentionNetwork<'a> {
        let (shape, values) = (self.shape, self.parameters);
        let UtilityShape { input, width, heads, base, actions, targets, .. } = shape;
        let UtilityLayers { trunk, out, fc2, head, skip, pointing } = UtilityLayers::of(shape);
        let whole = |layer: Linear| Layer::of(layer, values, Layout::OutputsFirst);
        let attention_in = trunk.queries.weight..trunk.keys_values.weight_range().end;
        AttentionNetwork {
            inputs: input,
            width,
            heads,
            base,
            outputs: actions,
            fc1: Layer::of(trunk.fc1, values, Layout::InputsFirst),
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
