//! The bundles that a running process can change to: those beside its own.

use std::path::{Path, PathBuf};

use sortie_bundle::Bundle;
use sortie_core::wire::ControlStatus;
use sortie_ipc::{LoadedModel, Registry};

use crate::deployment::{model_id, open_bundle};
use crate::failure::Failure;
use crate::output::tell;

/// Most bytes of a key on the wire.
const KEY_BYTES: usize = 32;

/// Whether a text names a bundle of a registry: a folder, never a path.
pub(crate) fn is_key(text: &str) -> bool {
    let is_letter = |byte: u8| byte.is_ascii_alphanumeric() || b"._-".contains(&byte);
    (1..=KEY_BYTES).contains(&text.len()) && !text.starts_with('.') && text.bytes().all(is_letter)
}

/// The folder of bundles, and what one of them was loaded to.
pub(super) struct Bundles<M, L> {
    folder: PathBuf,
    load: L,
    loaded: Option<M>,
}

impl<M, L: FnMut(&Bundle) -> Result<M, Failure>> Bundles<M, L> {
    /// The bundles beside `bundle`; `load` makes of one what its process works with.
    pub(super) fn beside(bundle: &Path, load: L) -> Self {
        let parent = bundle.parent().filter(|parent| !parent.as_os_str().is_empty());
        Self { folder: parent.unwrap_or(Path::new(".")).to_path_buf(), load, loaded: None }
    }

    /// What was loaded last, once.
    pub(super) fn take(&mut self) -> Option<M> {
        self.loaded.take()
    }
}

impl<M, L: FnMut(&Bundle) -> Result<M, Failure>> Registry for Bundles<M, L> {
    fn load(&mut self, key: &str) -> Result<LoadedModel, ControlStatus> {
        let refused = |failure: Failure| {
            tell!("warning: `{key}` is not loaded: {}", failure.message);
            ControlStatus::BadArgument
        };
        if !is_key(key) {
            return Err(ControlStatus::BadArgument);
        }
        let bundle = open_bundle(&self.folder.join(key)).map_err(refused)?;
        self.loaded = Some((self.load)(&bundle).map_err(refused)?);
        let limits = &bundle.manifest().limits;
        Ok(LoadedModel {
            contract: bundle.contract().hash(),
            id: model_id(&bundle),
            entities_max: limits.n_max.into(),
            tasks_max: limits.t_max.into(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_a_name_and_no_path() {
        for key in ["a-team", "v1.2_b", &"x".repeat(32)] {
            assert!(is_key(key), "{key}");
        }
        for path in ["", ".", "..", "a/b", "/a", "..\\a", "a b", &"x".repeat(33)] {
            assert!(!is_key(path), "{path}");
        }
    }
}
