//! What a bundle means to a domain.

use std::path::{Path, PathBuf};

use sortie_bundle::{Bundle, BundleError, Environment, MANIFEST, SubtaskConditioning};
use sortie_ipc::DomainContract;

use crate::allocation::AllocatorChoice;
use crate::environment::check_known;
use crate::failure::{Exit, Failure};

/// Opens a bundle and checks that its environment is one that this program knows.
pub fn open_bundle(folder: &Path) -> Result<Bundle, Failure> {
    let bundle = Bundle::open(folder).map_err(|error| match error {
        BundleError::NotABundle { .. } => no_bundle(folder).unwrap_or_else(|| error.into()),
        error => error.into(),
    })?;
    check_known(&bundle.manifest().contract.environment)
        .map_err(|reason| Failure::new(Exit::BadData, format!("{}: {reason}", folder.display())))?;
    Ok(bundle)
}

/// Why a folder is no bundle, where more can be said than that.
fn no_bundle(folder: &Path) -> Option<Failure> {
    let name = folder.display();
    if !folder.exists() {
        let message = format!(
            "`{name}` does not exist; a bundle is a folder with a `bundle.toml`: those that are shipped lie in \
             `models/`, `sortie export RUN` makes one"
        );
        return Some(Failure::new(Exit::Missing, message));
    }
    let entries = folder.read_dir().into_iter().flatten().flatten();
    let bundles = entries.map(|entry| entry.path()).filter(|path| path.join(MANIFEST).exists());
    let mut bundles: Vec<String> = bundles.map(|path| path.display().to_string()).collect();
    bundles.sort();
    (!bundles.is_empty()).then(|| {
        let bundles = bundles.join(", ");
        let message = format!("`{name}` is not a bundle, but holds some; name one of: {bundles}");
        Failure::new(Exit::Missing, message)
    })
}

/// The contract of a domain that this bundle's policy acts in.
///
/// A process that allocates, or reports who does, names the `allocation`.
pub fn domain_contract(bundle: &Bundle, allocation: Option<AllocatorChoice>) -> DomainContract {
    let contract = bundle.contract();
    let mut fields =
        toml::Table::try_from(contract).expect("a contract is a table of plain values");
    // Outside the hash, which says what a network takes: names of features may be those of another environment.
    let Environment { name, version, .. } = &bundle.manifest().contract.environment;
    let name = name.split('/').next().unwrap_or_default();
    fields.insert("environment".to_owned(), name.into());
    fields.insert("environment_version".to_owned(), version.as_str().into());
    DomainContract {
        hash: contract.hash(),
        decision_interval: contract.decision_interval,
        subtasks: contract.subtask_conditioning == SubtaskConditioning::Mask,
        safe_action: contract.safe_action,
        model: model_id(bundle),
        bundle: bundle_name(bundle.folder()),
        allocation: allocation.map(|choice| choice.name().to_string()),
        draws: None,
        mixes_teams: false,
        fields,
    }
}

/// Most bytes of a bundle's name on the wire.
const NAME_BYTES: usize = 32;

/// Whether a text names a bundle beside another: a folder, never a path.
pub(crate) fn is_bundle_name(text: &str) -> bool {
    let is_letter = |byte: u8| byte.is_ascii_alphanumeric() || b"._-".contains(&byte);
    (1..=NAME_BYTES).contains(&text.len()) && !text.starts_with('.') && text.bytes().all(is_letter)
}

/// The name by which processes know a bundle, where its folder has one that may travel.
pub(crate) fn bundle_name(folder: &Path) -> Option<String> {
    let folder = folder.canonicalize().ok()?;
    let name = folder.file_name()?.to_str()?;
    is_bundle_name(name).then(|| name.to_string())
}

/// The bundle of this name beside another.
pub(crate) fn beside(folder: &Path, name: &str) -> PathBuf {
    let parent = folder.parent().filter(|parent| !parent.as_os_str().is_empty());
    parent.unwrap_or(Path::new(".")).join(name)
}

/// The model's id in messages: the first 16 bytes of the bundle's.
pub fn model_id(bundle: &Bundle) -> [u8; 16] {
    let mut id = [0; 16];
    for (to, from) in id.iter_mut().zip(bundle.id()) {
        *to = *from;
    }
    id
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bundle_is_named_by_its_folder_and_never_by_a_path() {
        for name in ["a-team", "v1.2_b", &"x".repeat(32)] {
            assert!(is_bundle_name(name), "{name}");
        }
        for path in ["", ".", "..", "a/b", "/a", "..\\a", "a b", &"x".repeat(33)] {
            assert!(!is_bundle_name(path), "{path}");
        }
        assert_eq!(beside(Path::new("models/a"), "b"), Path::new("models/b"));
        assert_eq!(beside(Path::new("a"), "b"), Path::new("./b"));
    }
}
