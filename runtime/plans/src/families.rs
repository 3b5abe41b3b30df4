//! Inputs of all kinds that an engine may meet: random ones, and those that tend to break engines.

use rand_core::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sortie_bundle::OwnedObservation;
use sortie_core::EntityMask;

use crate::comparison::Comparison;
use crate::observations::{
    OwnedTeamQuery, random_observations, random_observations_of, random_team_queries,
    random_team_queries_of,
};

/// Every adversarial family has this share of the random inputs.
const SHARE: usize = 4;
/// Fewest inputs of a family.
const FEWEST: usize = 8;

const NAN: &str = "NaN";
const INFINITIES: &str = "infinities";
const HUGE: &str = "values of 1e30";

/// What a plan owes for the inputs of a family.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standard {
    /// What the graph gives: the same answer, or none where its numbers are not finite.
    Same,
    /// A refusal: there is a feature that is not a finite number. Some engines swallow it: a ReLU that
    /// takes a maximum turns NaN into 0.
    Refusal,
    /// Nothing: products leave the range of f32 in any engine, and where depends on the order of sums.
    Nothing,
}

/// Which rows a graph gets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rows {
    /// All of them: the graph does the masking.
    All,
    /// The visible ones and the own one, as in deployment.
    Visible,
}

/// Inputs of one kind.
#[derive(Clone, Debug)]
pub struct Family<T> {
    /// What they have in common.
    pub name: &'static str,
    /// The inputs.
    pub inputs: Vec<T>,
    /// What is owed for them.
    pub standard: Standard,
    /// Which rows a graph gets: all, unless it is known that the graph's own masking cannot hide a value.
    pub rows: Rows,
}

impl<T> Family<T> {
    /// Inputs for which a network owes what its graph gives.
    pub fn of(name: &'static str, inputs: Vec<T>) -> Self {
        Self { name, inputs, standard: Standard::Same, rows: Rows::All }
    }

    /// The same inputs in another form.
    pub fn map<U>(self, form: impl Fn(T) -> U) -> Family<U> {
        let Self { name, inputs, standard, rows } = self;
        Family { name, inputs: inputs.into_iter().map(form).collect(), standard, rows }
    }

    /// Nothing compared yet.
    pub fn comparison(&self) -> Comparison {
        let judged = self.standard != Standard::Nothing;
        Comparison { judged, ..Comparison::new(self.name) }
    }
}

/// Sizes of an agent's network and of its world.
#[derive(Clone, Copy, Debug)]
pub struct ObservationSizes {
    /// Most entities.
    pub n_max: usize,
    /// Features d.
    pub features: usize,
    /// Actions U.
    pub actions: usize,
}

/// Random observations, and a share of each adversarial family, by seed.
///
/// Features that are no numbers stand in rows that the network looks at, but for `NaN behind the mask`: there
/// they stand in all others, which must not matter.
pub fn observation_families(
    count: usize,
    sizes: ObservationSizes,
    seed: u64,
) -> Vec<Family<OwnedObservation>> {
    let ObservationSizes { n_max, features, actions } = sizes;
    let few = (count / SHARE).max(FEWEST);
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut base =
        |n_max: usize| random_observations(few, n_max, features, actions, random.next_u64());
    let masked = |mask: fn(&OwnedObservation) -> EntityMask| {
        move |_: usize, seen: &mut OwnedObservation| seen.visible = mask(seen)
    };
    let scaled =
        |factor: f32| move |_: usize, seen: &mut OwnedObservation| scale(&mut seen.rows, factor);
    let with = |values: &'static [f32]| {
        move |index: usize, seen: &mut OwnedObservation| {
            let rows = looked_at(seen);
            place(&mut seen.rows, features, &rows, index, values);
        }
    };
    let mut families = vec![
        plain("random", random_observations(count, n_max, features, actions, seed)),
        changed("nothing visible", base(n_max), &masked(|_| EntityMask::EMPTY)),
        changed("everything visible", base(n_max), &masked(|o| EntityMask::first(o.entities()))),
        changed("only oneself visible", base(n_max), &masked(only_oneself)),
        plain("one entity", base(1)),
        plain("n_max entities", random_observations_of(few, n_max, features, actions, seed)),
        changed("no available action", base(n_max), &|_, seen| seen.available.fill(0)),
        changed("denormals", base(n_max), &scaled(1.0e-40)),
        changed("values of 1e6", base(n_max), &scaled(1.0e6)),
        changed(HUGE, base(n_max), &scaled(1.0e30)),
        changed(INFINITIES, base(n_max), &with(&[f32::INFINITY, f32::NEG_INFINITY])),
        changed(NAN, base(n_max), &with(&[f32::NAN])),
    ];
    let mut hidden = changed("NaN behind the mask", base(n_max), &|_, seen| {
        let rows = looked_at(seen);
        hide(&mut seen.rows, features, &rows);
    });
    hidden.rows = Rows::Visible;
    families.push(hidden);
    families
}

/// Sizes of an allocator's network and of its world.
#[derive(Clone, Copy, Debug)]
pub struct TeamQuerySizes {
    /// Most entities.
    pub n_max: usize,
    /// Features d.
    pub features: usize,
    /// Columns F of the relation.
    pub relations: usize,
}

/// The same for the teams that an allocator asks about.
pub fn team_query_families(
    count: usize,
    sizes: TeamQuerySizes,
    seed: u64,
) -> Vec<Family<OwnedTeamQuery>> {
    let TeamQuerySizes { n_max, features, relations } = sizes;
    let few = (count / SHARE).max(FEWEST);
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut base =
        |n_max: usize| random_team_queries(few, n_max, features, relations, random.next_u64());
    let scaled = |factor: f32| {
        move |_: usize, query: &mut OwnedTeamQuery| {
            scale(&mut query.state.rows, factor);
            scale(&mut query.relation, factor);
        }
    };
    let with = |values: &'static [f32]| {
        move |index: usize, query: &mut OwnedTeamQuery| {
            let rows = asked_about(query);
            place(&mut query.state.rows, features, &rows, index, values);
        }
    };
    let mut families = vec![
        plain("random", random_team_queries(count, n_max, features, relations, seed)),
        changed("nothing present", base(n_max), &|_, query| {
            query.state.present = EntityMask::EMPTY
        }),
        changed("everything present", base(n_max), &|_, query| {
            query.state.present = EntityMask::first(query.state.entities());
        }),
        changed("nobody in the team", base(n_max), &|_, query| query.team = 0),
        changed("everybody in the team", base(n_max), &|_, query| {
            query.team =
                EntityMask::first(query.state.agents).words().first().copied().unwrap_or(0);
        }),
        plain("one entity", base(1)),
        plain("n_max entities", random_team_queries_of(few, n_max, features, relations, seed)),
        changed("denormals", base(n_max), &scaled(1.0e-40)),
        changed("values of 1e6", base(n_max), &scaled(1.0e6)),
        changed(HUGE, base(n_max), &scaled(1.0e30)),
        changed(INFINITIES, base(n_max), &with(&[f32::INFINITY, f32::NEG_INFINITY])),
        changed(NAN, base(n_max), &with(&[f32::NAN])),
    ];
    let mut hidden = changed("NaN behind the mask", base(n_max), &|_, query| {
        let rows = asked_about(query);
        hide(&mut query.state.rows, features, &rows);
        hide(&mut query.relation, relations, &rows);
    });
    hidden.rows = Rows::Visible;
    families.push(hidden);
    families
}

fn plain<T>(name: &'static str, inputs: Vec<T>) -> Family<T> {
    let standard = match name {
        NAN | INFINITIES => Standard::Refusal,
        HUGE => Standard::Nothing,
        _ => Standard::Same,
    };
    Family { name, inputs, standard, rows: Rows::All }
}

/// The inputs after an edit that knows their number.
fn changed<T>(name: &'static str, mut inputs: Vec<T>, edit: &dyn Fn(usize, &mut T)) -> Family<T> {
    inputs.iter_mut().enumerate().for_each(|(index, input)| edit(index, input));
    plain(name, inputs)
}

fn only_oneself(seen: &OwnedObservation) -> EntityMask {
    let mut mask = EntityMask::EMPTY;
    mask.insert(seen.self_index);
    mask
}

/// The rows that an agent's network looks at.
fn looked_at(seen: &OwnedObservation) -> Vec<usize> {
    let mut mask = seen.visible;
    mask.insert(seen.self_index);
    mask.iter().collect()
}

/// The rows that an allocator's network looks at.
fn asked_about(query: &OwnedTeamQuery) -> Vec<usize> {
    let state = query.state.view();
    let view = query.view(&state);
    let mut mask = view.visible();
    view.own_row().into_iter().for_each(|row| mask.insert(row));
    mask.iter().collect()
}

fn scale(values: &mut [f32], factor: f32) {
    values.iter_mut().for_each(|value| *value *= factor);
}

/// Puts one of `values` into a feature of one of `rows`; which, the input's number says.
fn place(matrix: &mut [f32], columns: usize, rows: &[usize], index: usize, values: &[f32]) {
    let chosen = |list: usize| index.checked_rem(list).unwrap_or(0);
    let (row, value) = (rows.get(chosen(rows.len())), values.get(chosen(values.len())));
    if let (Some(row), Some(value)) = (row, value)
        && let Some(to) = matrix.get_mut(row * columns + chosen(columns))
    {
        *to = *value;
    }
}

/// Fills all rows but these with NaN.
fn hide(matrix: &mut [f32], columns: usize, shown: &[usize]) {
    for (row, values) in matrix.chunks_mut(columns.max(1)).enumerate() {
        if !shown.contains(&row) {
            values.fill(f32::NAN);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named<'a, T>(families: &'a [Family<T>], name: &str) -> &'a [T] {
        &families.iter().find(|family| family.name == name).expect("the family exists").inputs
    }

    #[test]
    fn families_are_what_their_names_say() {
        let sizes = ObservationSizes { n_max: 9, features: 5, actions: 3 };
        let families = observation_families(64, sizes, 7);
        assert_eq!(named(&families, "random").len(), 64);
        assert!(families.iter().skip(1).all(|family| family.inputs.len() == 16));
        assert!(named(&families, "nothing visible").iter().all(|o| o.visible.is_empty()));
        assert!(named(&families, "one entity").iter().all(|o| o.entities() == 1));
        assert!(named(&families, "n_max entities").iter().all(|o| o.entities() == 9));
        let seen = |o: &OwnedObservation, holds: &dyn Fn(f32) -> bool| {
            looked_at(o).iter().any(|row| o.rows[row * 5..][..5].iter().any(|v| holds(*v)))
        };
        assert!(named(&families, "NaN").iter().all(|o| seen(o, &|value| value.is_nan())));
        assert!(named(&families, "infinities").iter().all(|o| seen(o, &|v| v.is_infinite())));
        let hidden = named(&families, "NaN behind the mask");
        assert!(hidden.iter().all(|o| !seen(o, &|value| value.is_nan())));
        assert!(hidden.iter().any(|o| o.rows.iter().any(|value| value.is_nan())));
        let denormal = named(&families, "denormals").iter().flat_map(|o| &o.rows);
        assert!(denormal.clone().all(|v| !v.is_normal()) && denormal.clone().any(|v| *v != 0.0));
    }

    #[test]
    fn families_of_team_queries_are_what_their_names_say() {
        let sizes = TeamQuerySizes { n_max: 9, features: 5, relations: 2 };
        let families = team_query_families(64, sizes, 7);
        assert!(named(&families, "nobody in the team").iter().all(|query| query.team == 0));
        assert!(named(&families, "n_max entities").iter().all(|q| q.state.entities() == 9));
        let nan = |q: &OwnedTeamQuery| {
            asked_about(q).iter().any(|row| q.state.rows[row * 5..][..5].iter().any(|v| v.is_nan()))
        };
        assert!(named(&families, "NaN").iter().all(nan));
        assert!(!named(&families, "NaN behind the mask").iter().any(nan));
    }
}
