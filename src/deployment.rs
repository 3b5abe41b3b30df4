//! What a bundle means to a domain.

use std::path::Path;

use sortie_bundle::{Bundle, SubtaskConditioning};
use sortie_ipc::DomainContract;

use crate::arguments::AllocatorChoice;
use crate::failure::Failure;

/// Opens and checks a bundle.
pub(crate) fn open_bundle(folder: &Path) -> Result<Bundle, Failure> {
    Ok(Bundle::open(folder)?)
}

/// The contract of a domain that this bundle's policy acts in.
///
/// A process that allocates, or reports who does, names the `allocation`.
pub(crate) fn domain_contract(
    bundle: &Bundle,
    allocation: Option<AllocatorChoice>,
) -> DomainContract {
    let contract = bundle.contract();
    DomainContract {
        hash: contract.hash(),
        decision_interval: contract.decision_interval,
        subtasks: contract.subtask_conditioning == SubtaskConditioning::Mask,
        safe_action: contract.safe_action,
        model: model_id(bundle),
        allocation: allocation.map(|choice| choice.name().to_string()),
        mixes_teams: false,
        fields: toml::Table::try_from(contract).expect("a contract is a table of plain values"),
    }
}

/// The model's id in messages: the first 16 bytes of the bundle's.
pub(crate) fn model_id(bundle: &Bundle) -> [u8; 16] {
    let mut id = [0; 16];
    for (to, from) in id.iter_mut().zip(bundle.id()) {
        *to = *from;
    }
    id
}
