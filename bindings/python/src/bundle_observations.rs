//! What a team's agents see, read from arrays.

use numpy::PyUntypedArrayMethods;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use sortie_bundle::ContractV1;
use sortie_core::{EntityMask, NO_ACTION, Observation, limits};

use crate::arrays::{mask, numbers, slice, whole};

/// Copies of what the agents of one frame see, so that others may write to the arrays meanwhile.
pub(crate) struct Observations {
    rows: Vec<f32>,
    features: usize,
    last_actions: Vec<u16>,
    visible: Vec<EntityMask>,
    /// Availability `[A, U]`.
    available: Vec<u16>,
    actions: usize,
}

impl Observations {
    pub(crate) fn read(
        contract: &ContractV1,
        entities: &Bound<'_, PyAny>,
        visible: &Bound<'_, PyAny>,
        available: &Bound<'_, PyAny>,
        last_actions: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let (features, actions) = (contract.features.into(), contract.actions.into());
        let (rows, count) = rows(entities, features)?;
        let agents = visible.len()?;
        if agents > limits::AGENTS.min(count) {
            return Err(PyValueError::new_err(format!(
                "`visible` has {agents} agents; they are the first of {count} entities, at most {}",
                limits::AGENTS
            )));
        }
        let seen = mask("visible", visible, &[agents, count])?;
        let visible = if count == 0 { Vec::new() } else { seen.chunks(count).map(set).collect() };
        let available = mask("available", available, &[agents, actions])?;
        let last_actions = match last_actions {
            Some(last) => last_of(last, agents, actions)?,
            None => vec![NO_ACTION; agents],
        };
        Ok(Self { rows, features, last_actions, visible, available, actions })
    }

    /// As policies take them, in the agents' order.
    pub(crate) fn views(&self) -> Vec<Observation<'_>> {
        let available = self.available.chunks(self.actions.max(1));
        let each = self.visible.iter().zip(available).enumerate();
        let views = each.map(|(self_index, (visible, available))| Observation {
            rows: &self.rows,
            stride: self.features,
            last_actions: &self.last_actions,
            visible: *visible,
            self_index,
            available,
        });
        views.collect()
    }
}

/// Rows of features `[N, d]`, and how many.
pub(crate) fn rows(entities: &Bound<'_, PyAny>, features: usize) -> PyResult<(Vec<f32>, usize)> {
    let entities = numbers("entities", entities)?;
    let [count, columns] = *entities.shape() else {
        return Err(PyValueError::new_err(format!(
            "`entities` has the shape {:?}, needed is a row of {features} features for each",
            entities.shape()
        )));
    };
    if columns != features || count > limits::ENTITIES {
        return Err(PyValueError::new_err(format!(
            "`entities` has the shape [{count}, {columns}], needed are at most {} rows of {features} features",
            limits::ENTITIES
        )));
    }
    Ok((slice(&entities)?.to_vec(), count))
}

/// The entities whose flag is set.
pub(crate) fn set(flags: &[u16]) -> EntityMask {
    let mut set = EntityMask::EMPTY;
    for (entity, _) in flags.iter().enumerate().filter(|(_, flag)| **flag != 0) {
        set.insert(entity);
    }
    set
}

/// Last actions, -1 where there was none.
fn last_of(given: &Bound<'_, PyAny>, agents: usize, actions: usize) -> PyResult<Vec<u16>> {
    let last = |action: i64| match u16::try_from(action) {
        Ok(action) if usize::from(action) < actions => Ok(action),
        _ if action == -1 => Ok(NO_ACTION),
        _ => Err(PyValueError::new_err(format!(
            "`last_actions` holds {action}: an action is one of {actions} from 0, or -1 for none"
        ))),
    };
    let given = whole("last_actions", given)?;
    if given.len() != agents {
        let got = given.len();
        return Err(PyTypeError::new_err(format!("`last_actions` has {got} of {agents} agents")));
    }
    given.into_iter().map(last).collect()
}
