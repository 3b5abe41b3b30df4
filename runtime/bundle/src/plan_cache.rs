//! Plans that were compiled before, kept beside the bundle.
//!
//! A cache only saves time: a plan that is missing, damaged or of another network is compiled again, and a
//! plan that cannot be kept is compiled at the next start.

use std::fs;
use std::path::{Path, PathBuf};

use sortie_core::plan::{AlignedBytes, Plan};

use crate::digest::{hex, sha256};

/// All that a compiled plan depends on.
#[derive(Clone, Copy, Debug)]
pub struct PlanKey<'a> {
    /// The network.
    pub onnx: &'a [u8],
    /// The arithmetic profile's name.
    pub profile: &'a str,
    /// The compiler's version.
    pub compiler: &'a str,
    /// Hash of the contract.
    pub contract: u64,
    /// Most visible entities.
    pub n_max: usize,
}

impl PlanKey<'_> {
    /// The file name of the plan: the same for the same plan, different for any other.
    fn file_name(&self) -> String {
        let source = hex(&sha256(self.onnx));
        let rest = (self.profile, self.compiler, self.contract, self.n_max);
        hex(&sha256(format!("{source} {rest:?}").as_bytes())).split_at(32).0.to_owned() + ".plan"
    }
}

/// The plan of `key`: from the first place that holds it, else from `compile`, and then kept in the first
/// place that can be written to.
pub fn cached_plan<E>(
    places: &[PathBuf],
    key: &PlanKey<'_>,
    compile: impl FnOnce() -> Result<Vec<u8>, E>,
) -> Result<AlignedBytes, E> {
    let name = key.file_name();
    let source = sha256(key.onnx);
    let kept = places.iter().filter_map(|place| fs::read(place.join(&name)).ok());
    let valid = |bytes: &AlignedBytes| {
        Plan::load(bytes.as_slice()).is_ok_and(|plan| plan.header().source == source)
    };
    if let Some(plan) = kept.map(|bytes| AlignedBytes::copy_of(&bytes)).find(valid) {
        return Ok(plan);
    }
    let plan = compile()?;
    // Nowhere is fine too: the next start compiles again.
    let _ = places.iter().any(|place| keep(&place.join(&name), &plan).is_ok());
    Ok(AlignedBytes::copy_of(&plan))
}

/// Where plans of a bundle are kept: beside it, or in the user's cache where it cannot be written to.
pub fn plan_places(folder: &Path) -> Vec<PathBuf> {
    let home = || std::env::home_dir().map(|home| home.join(".cache"));
    let cache = std::env::var_os("XDG_CACHE_HOME").map(PathBuf::from).or_else(home);
    [Some(folder.join("plans")), cache.map(|cache| cache.join("sortie"))]
        .into_iter()
        .flatten()
        .collect()
}

/// Writes beside the target and renames, so that no one ever reads half a plan.
fn keep(path: &Path, plan: &[u8]) -> std::io::Result<()> {
    if let Some(parent) = path.parent() {
        fs::create_dir_all(parent)?;
    }
    let draft = path.with_extension(format!("{}", std::process::id()));
    let written = fs::write(&draft, plan).and_then(|()| fs::rename(&draft, path));
    if written.is_err() {
        let _ = fs::remove_file(&draft);
    }
    written
}
