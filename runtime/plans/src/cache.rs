//! Plans that were compiled here before, in a folder of the user's own.
//!
//! A cache only saves time: a plan that is missing, damaged or of another network is compiled again, and a
//! plan that cannot be kept is compiled at the next start. A folder that others may write to is not used: whoever
//! changes a plan changes what a team does.

use std::fs::{self, DirBuilder, Metadata};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};

use rustix::process::geteuid;
use sortie_bundle::files::{Durability, replace_file};
use sortie_bundle::{hex, sha256};
use sortie_core::plan::{AlignedBytes, Plan};

/// All that a compiled plan depends on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlanKey<'a> {
    pub(crate) onnx: &'a [u8],
    /// The arithmetic profile's name.
    pub(crate) profile: &'a str,
    /// The compiler's version.
    pub(crate) compiler: &'a str,
    pub(crate) contract: u64,
    /// Most visible entities.
    pub(crate) n_max: usize,
    /// Most subtasks.
    pub(crate) t_max: u16,
    /// What is said of the network's inputs and outputs.
    pub(crate) roles: &'a [u8],
    /// The golden observations, where weights were rounded for them.
    pub(crate) golden: &'a [u8],
}

impl PlanKey<'_> {
    /// The file name of the plan: the same for the same plan, different for any other.
    fn file_name(&self) -> String {
        let [source, golden] = [self.onnx, self.golden].map(|file| hex(&sha256(file)));
        let rest = (self.profile, self.compiler, self.contract, self.n_max, self.t_max, self.roles);
        hex(&sha256(format!("{source} {golden} {rest:?}").as_bytes())).split_at(32).0.to_owned()
            + ".plan"
    }
}

/// The user's own folder of plans: `sortie/plans` in `XDG_CACHE_HOME`, else in `.cache` of the home folder.
pub fn user_cache() -> Option<PathBuf> {
    let named = std::env::var_os("XDG_CACHE_HOME").map(PathBuf::from);
    let named = named.filter(|folder| folder.is_absolute());
    let cache = named.or_else(|| std::env::home_dir().map(|home| home.join(".cache")));
    cache.map(|cache| cache.join("sortie").join("plans"))
}

/// The plan of `key`, if the folder holds one that can be loaded.
pub(crate) fn kept(folder: &Path, key: &PlanKey<'_>) -> Option<AlignedBytes> {
    check(folder).ok()?;
    let plan = AlignedBytes::copy_of(&fs::read(folder.join(key.file_name())).ok()?);
    let source = sha256(key.onnx);
    let valid = Plan::load(plan.as_slice()).is_ok_and(|plan| plan.header().source == source);
    valid.then_some(plan)
}

pub(crate) fn keep(folder: &Path, key: &PlanKey<'_>, plan: &[u8]) -> io::Result<()> {
    DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
    check(folder)?;
    replace_file(&folder.join(key.file_name()), plan, Durability::Cached)
}

/// Whether only the user can change what lies in the folder.
fn check(folder: &Path) -> io::Result<()> {
    const OTHERS_WRITE: u32 = 0o022;
    let own = |found: &Metadata| {
        found.is_dir() && found.uid() == geteuid().as_raw() && found.mode() & OTHERS_WRITE == 0
    };
    match fs::symlink_metadata(folder) {
        Ok(found) if own(&found) => Ok(()),
        Ok(_) => Err(io::Error::other("others may write to this folder, or it is not a folder")),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    const KEY: PlanKey<'_> = PlanKey {
        onnx: b"network",
        profile: "exact",
        compiler: "1",
        contract: 1,
        n_max: 8,
        t_max: 3,
        roles: b"",
        golden: b"",
    };

    #[test]
    fn threads_that_keep_the_same_plan_leave_one_whole_file() {
        let home = tempfile::tempdir().unwrap();
        let folder = home.path().join("plans");
        let plan = vec![7; 1 << 16];
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| keep(&folder, &KEY, &plan).unwrap());
            }
        });
        let files: Vec<_> =
            fs::read_dir(&folder).unwrap().map(|file| file.unwrap().path()).collect();
        assert_eq!(files.len(), 1, "{files:?}");
        assert_eq!(fs::read(&files[0]).unwrap(), plan);
    }

    #[test]
    fn a_folder_that_others_can_write_to_is_not_used() {
        let home = tempfile::tempdir().unwrap();
        let folder = home.path().join("plans");
        keep(&folder, &KEY, b"plan").unwrap();
        assert_eq!(fs::metadata(&folder).unwrap().permissions().mode() & 0o777, 0o700);
        fs::set_permissions(&folder, fs::Permissions::from_mode(0o777)).unwrap();
        assert!(keep(&folder, &KEY, b"plan").is_err());
        assert!(check(&folder).is_err());
        let link = home.path().join("link");
        std::os::unix::fs::symlink(home.path(), &link).unwrap();
        assert!(check(&link).is_err());
    }

    #[test]
    fn a_file_name_depends_on_everything() {
        let changed = [
            PlanKey { onnx: b"other", ..KEY },
            PlanKey { profile: "fused", ..KEY },
            PlanKey { compiler: "2", ..KEY },
            PlanKey { contract: 2, ..KEY },
            PlanKey { n_max: 9, ..KEY },
            PlanKey { t_max: 4, ..KEY },
            PlanKey { roles: b"output = 'q'", ..KEY },
            PlanKey { golden: b"cases", ..KEY },
        ];
        for other in changed {
            assert_ne!(other.file_name(), KEY.file_name(), "{other:?}");
        }
    }
}
