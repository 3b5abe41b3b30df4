//! Plans and teams in Python: what `sortie/__init__.py` shows.
#![deny(unsafe_code)]

mod arrays;
mod bundle;
mod bundle_allocator;
mod compiler;
mod errors;
mod interface;
mod owned_plan;
mod plan;
mod plan_batch;
mod policy_client;

use pyo3::pymodule;

#[pymodule]
mod _sortie {
    #[pymodule_export]
    use crate::bundle::Bundle;
    #[pymodule_export]
    use crate::compiler::compile;
    #[pymodule_export]
    use crate::plan::Plan;
    #[pymodule_export]
    use crate::policy_client::{Action, PolicyClient};
}
