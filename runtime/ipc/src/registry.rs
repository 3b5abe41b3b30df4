//! Models that a running process can change to.

use sortie_core::Shape;
use sortie_core::wire::ControlStatus;

/// Where a process finds other models, by name.
pub trait Registry {
    /// Loads the model of `key`, checked and ready to be bound, and keeps it for the caller of the process. The one in
    /// use stays as it is. The process stands still meanwhile.
    ///
    /// # Errors
    /// [`ControlStatus::BadArgument`]: there is none under this key, or it cannot be read. A model of another contract,
    /// or too small for the domain, is refused by the process as [`ControlStatus::Foreign`].
    fn load(&mut self, key: &str) -> Result<LoadedModel, ControlStatus>;
}

/// A model as far as its process has to know it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LoadedModel {
    /// Hash of the contract that it was trained for.
    pub contract: u64,
    /// First 16 bytes of its id.
    pub id: [u8; 16],
    /// Most entities that it takes.
    pub entities_max: usize,
    /// Most subtasks that it takes.
    pub tasks_max: usize,
}

impl LoadedModel {
    fn fits(&self, contract: u64, shape: Shape) -> bool {
        self.contract == contract
            && shape.entities <= self.entities_max
            && shape.tasks <= self.tasks_max
    }
}

/// What a process that works with a model ended with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// The world has ended.
    WithWorld,
    /// It is to go on with the model that its registry loaded last.
    ForNextModel,
}

/// What is needed to judge and to change models while a process runs.
pub(crate) struct Reloading<'a> {
    pub(crate) registry: Option<&'a mut dyn Registry>,
    pub(crate) contract: u64,
    pub(crate) shape: Shape,
    /// A model has been loaded that is to be bound.
    pub(crate) is_due: bool,
}

impl Reloading<'_> {
    /// Loads the model of `key`: its id, or what to answer.
    pub(crate) fn load(&mut self, key: &str) -> Result<[u8; 16], ControlStatus> {
        let registry = self.registry.as_mut().ok_or(ControlStatus::NotSupported)?;
        let model = registry.load(key)?;
        if !model.fits(self.contract, self.shape) {
            return Err(ControlStatus::Foreign);
        }
        self.is_due = true;
        Ok(model.id)
    }

    pub(crate) fn ended(&self) -> Ended {
        if self.is_due { Ended::ForNextModel } else { Ended::WithWorld }
    }
}
