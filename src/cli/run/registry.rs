//! The bundles that a process of a team may change to.

use std::path::Path;

use sortie_bundle::Bundle;
use sortie_core::wire::ControlStatus;
use sortie_ipc::{Loaded, LoadedModel, Registry, SwappedPolicy};

use crate::deployment::{beside, is_bundle_name, model_id};
use crate::failure::Failure;
use crate::output::tell;
use crate::owned;
use crate::policy::{Backend, DeployedPolicy};
use crate::trust::TrustArguments;

/// The policies of bundles beside that of a process.
pub(super) fn policies(
    folder: &Path,
    trust: &TrustArguments,
    backend: Backend,
) -> Result<Registry<SwappedPolicy>, Failure> {
    registry(folder, trust, move |bundle| {
        DeployedPolicy::open(bundle, backend).and_then(owned::policy)
    })
}

/// The bundles beside that of a process, which take the same signatures; `load` makes of one what it works with.
pub(super) fn registry<M: Send + 'static>(
    folder: &Path,
    trust: &TrustArguments,
    load: impl Fn(&Bundle) -> Result<M, Failure> + Send + 'static,
) -> Result<Registry<M>, Failure> {
    let (folder, trust) = (folder.to_path_buf(), trust.clone());
    let load = move |name: &str| -> Loaded<M> {
        let refused = |failure: Failure| {
            tell!("warning: `{name}` is not loaded: {}", failure.message);
            ControlStatus::BadArgument
        };
        if !is_bundle_name(name) {
            return Err(ControlStatus::BadArgument);
        }
        let bundle = trust.open_bundle(&beside(&folder, name)).map_err(refused)?;
        let model = load(&bundle).map_err(refused)?;
        let limits = &bundle.manifest().limits;
        Ok(LoadedModel {
            contract: bundle.contract().hash(),
            id: model_id(&bundle),
            entities_max: limits.n_max.into(),
            tasks_max: limits.t_max.into(),
            model,
        })
    };
    Ok(Registry::start(load)?)
}
