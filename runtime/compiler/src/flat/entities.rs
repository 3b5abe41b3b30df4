//! Which inputs hold the entities that an agent sees, which of them it may attend to, and which of them it is.

use sortie_plans::{CompileError, InputRole, PolicyOptions};

use super::values::{Value, listed};

/// What says that an agent's own row comes before all others.
const FIRST: &str = "first";

/// The inputs of a network over entities, or of one that is told who it is.
pub(super) struct EntityRoles {
    rows: Option<Rows>,
    /// The input with the number of the own row; none where that comes first.
    own: Option<String>,
}

/// The entities, and which of them an agent may attend to.
struct Rows {
    entities: String,
    mask: String,
    /// Whether the mask is 1 for what must not be attended to.
    blocks: bool,
}

impl EntityRoles {
    /// Those that are said; nothing is found by itself.
    pub(super) fn of(
        inputs: &[Value],
        options: &PolicyOptions,
    ) -> Result<Option<Self>, CompileError> {
        let PolicyOptions { entities, mask, own, .. } = options;
        let Some(entities) = entities else {
            return match own.as_deref() {
                None if mask.is_none() => Ok(None),
                Some(name) if mask.is_none() && name != FIRST => {
                    let own = Some(index(inputs, name)?);
                    Ok(Some(Self { rows: None, own }))
                }
                _ => Err(no_entities(inputs)),
            };
        };
        let rows = named(inputs, "input of entities", entities)?;
        let count = rows.is_float().then(|| count(rows)).flatten();
        let count = count.ok_or_else(|| no_entities(inputs))?;
        let is_mask = |value: &&Value| numbers(value) == Some(count) && value.name != *entities;
        let (mask, blocks) = mask
            .as_deref()
            .and_then(polarity)
            .ok_or_else(|| no_mask(inputs.iter().filter(is_mask)))?;
        let mask = named(inputs, "mask of entities", mask)?;
        if !is_mask(&mask) {
            return Err(no_mask(inputs.iter().filter(is_mask)));
        }
        let own = match own.as_deref() {
            Some(FIRST) => None,
            Some(name) => Some(index(inputs, name)?),
            None => return Err(no_own(inputs)),
        };
        let rows = Rows { entities: entities.clone(), mask: mask.name.clone(), blocks };
        Ok(Some(Self { rows: Some(rows), own }))
    }

    /// What an input is for, where it is one of these.
    pub(super) fn role(&self, name: &str) -> Option<InputRole> {
        let own_first = self.own.is_none();
        match &self.rows {
            _ if self.own.as_deref() == Some(name) => Some(InputRole::OwnIndex),
            Some(rows) if name == rows.entities => Some(InputRole::Entities { own_first }),
            Some(rows) if name == rows.mask => {
                Some(InputRole::Mask { blocks: rows.blocks, own_first })
            }
            _ => None,
        }
    }
}

/// The name of a mask, and whether it is 1 for what must not be attended to.
fn polarity(said: &str) -> Option<(&str, bool)> {
    let visible = said.strip_suffix(":visible").map(|name| (name, false));
    visible.or_else(|| said.strip_suffix(":blocked").map(|name| (name, true)))
}

/// How many entities there are in `[.., N, D]`.
fn count(value: &Value) -> Option<usize> {
    let shape = value.shape.as_ref()?;
    let (count, rows) = (shape.iter().rev().nth(1)?, shape.iter().rev().skip(2));
    rows.copied().all(|size| size == 1).then_some(*count)
}

/// The input with the number of the own row.
fn index(inputs: &[Value], name: &str) -> Result<String, CompileError> {
    let own = named(inputs, "number of the own row", name)?;
    if is_index(&own) { Ok(own.name.clone()) } else { Err(no_own(inputs)) }
}

fn is_index(value: &&Value) -> bool {
    value.is_whole() && numbers(value) == Some(1)
}

fn numbers(value: &Value) -> Option<usize> {
    value.shape.as_ref().map(|shape| shape.iter().product())
}

fn named<'v>(
    inputs: &'v [Value],
    what: &'static str,
    name: &str,
) -> Result<&'v Value, CompileError> {
    let found = inputs.iter().find(|input| input.name == name);
    found.ok_or_else(|| CompileError::NotInFile {
        what: what.into(),
        name: name.to_owned(),
        found: listed(inputs.iter().map(ToString::to_string)),
    })
}

fn no_entities(inputs: &[Value]) -> CompileError {
    let candidates = inputs.iter().filter(|input| input.is_float() && count(input).is_some());
    CompileError::Unclear {
        what: "which input holds the entities [1, N, D]".into(),
        candidates: listed(candidates.map(ToString::to_string)),
        flag: "`--entities NAME`".into(),
    }
}

fn no_mask<'v>(candidates: impl Iterator<Item = &'v Value>) -> CompileError {
    CompileError::Unclear {
        what: "which entities an agent may attend to".into(),
        candidates: listed(candidates.map(ToString::to_string)),
        flag: "`--mask NAME:visible` where 1 is what it may attend to, `--mask NAME:blocked` where 0 is".into(),
    }
}

fn no_own(inputs: &[Value]) -> CompileError {
    let candidates = inputs.iter().filter(is_index);
    CompileError::Unclear {
        what: "which entity the agent itself is".into(),
        candidates: listed(candidates.map(ToString::to_string)),
        flag: "`--self first` where its own row comes first, or `--self NAME` of the input with its number".into(),
    }
}
