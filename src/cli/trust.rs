//! `--trust`: what is run was signed by somebody whose key is trusted.

use std::path::{Path, PathBuf};

use clap::Args;
use sortie_bundle::Bundle;
use sortie_plans::is_plan;
use sortie_sign::{NamedKey, Trust};

use crate::deployment::open_bundle;
use crate::failure::{Exit, Failure, Outcome};

/// Whose signatures are asked for; nobody's where nothing is said.
#[derive(Clone, Debug, Default, Args)]
pub struct TrustArguments {
    /// Refuse what was not signed with a key of this folder, or with this public key (`.pub`)
    #[arg(long, value_name = "KEYS")]
    trust: Option<PathBuf>,
}

impl TrustArguments {
    /// What was said, for processes that are started.
    pub(crate) fn keys(&self) -> Option<&Path> {
        self.trust.as_deref()
    }

    /// Opens a bundle, and refuses one that nobody has signed who is trusted.
    ///
    /// What was checked is what is in memory. Keys are read each time: one that was revoked meanwhile does not count.
    pub fn open_bundle(&self, folder: &Path) -> Result<Bundle, Failure> {
        let bundle = open_bundle(folder)?;
        self.signer(&bundle)?;
        Ok(bundle)
    }

    /// Who has signed a bundle; nobody where nobody is asked for.
    pub fn signer(&self, bundle: &Bundle) -> Result<Option<NamedKey>, Failure> {
        let Some(keys) = &self.trust else { return Ok(None) };
        Ok(Some(Trust::read(keys)?.check_bundle(bundle)?.clone()))
    }

    /// Refuses the bytes of a policy's file that nobody has signed who is trusted.
    pub(crate) fn check_plan(&self, path: &Path, bytes: &[u8]) -> Outcome {
        let Some(keys) = &self.trust else { return Ok(()) };
        if !is_plan(bytes) {
            return Err(only_plans(path));
        }
        Trust::read(keys)?.check_plan(path, bytes)?;
        Ok(())
    }

    /// Refuses a file where only bundles are signed.
    pub fn wants_bundle(&self, subject: &Path) -> Outcome {
        match self.trust.is_some() && subject.is_file() {
            true => Err(only_plans(subject)),
            false => Ok(()),
        }
    }
}

/// What an ONNX file comes to depends on what is said beside it.
pub(crate) fn only_plans(path: &Path) -> Failure {
    let message = "signatures are of bundles and of plans: compile the file, and have its plan signed and served";
    Failure::new(Exit::Usage, message).within(path.display())
}
