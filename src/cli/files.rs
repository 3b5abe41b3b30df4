//! The files that verbs write: tried before the work, written whole, and never over something else.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use sortie_bundle::files::{Durability, check_writable, replace_file};

use crate::failure::{Exit, Failure, Outcome};

/// What a file holds, by its first bytes. A file that is there already is replaced by one of its own kind only.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Plan,
    Page,
    Observations,
    Episode,
}

impl Kind {
    fn beginning(self) -> &'static [u8] {
        match self {
            Self::Plan => b"SORTIEPL",
            Self::Page => b"<!doctype html>",
            Self::Observations => b"SORTIEOB",
            Self::Episode => b"{",
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Plan => "a plan",
            Self::Page => "a page",
            Self::Observations => "a file of observations",
            Self::Episode => "a recorded episode",
        }
    }
}

/// Refuses what cannot be written later: places out of reach, and files of another kind.
pub fn try_output(path: &Path, kind: Kind) -> Outcome {
    let file = |error: std::io::Error| Failure::file(path, &error);
    // Devices and pipes are no files to replace.
    if path.is_file() {
        let mut start = Vec::new();
        let length = kind.beginning().len() as u64;
        File::open(path)
            .and_then(|file| file.take(length).read_to_end(&mut start))
            .map_err(file)?;
        if !start.is_empty() && !start.eq_ignore_ascii_case(kind.beginning()) {
            let (path, kind) = (path.display(), kind.name());
            let reason = format!(
                "{path} is there already and is not {kind}: remove it, or choose another name"
            );
            return Err(Failure::new(Exit::Usage, reason));
        }
    }
    check_writable(path).map_err(file)
}

/// Writes a file as a whole, or leaves what is there.
pub fn write_output(path: &Path, content: &[u8]) -> Outcome {
    replace_file(path, content, Durability::Cached).map_err(|error| Failure::file(path, &error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_replaced_by_their_own_kind_only() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        for (content, exit) in [
            ("", None),
            ("SORTIEPL and more", None),
            ("<!doctype html>", Some(Exit::Usage)),
            ("S", Some(Exit::Usage)),
        ] {
            std::fs::write(&path, content).unwrap();
            let tried = try_output(&path, Kind::Plan).map_err(|failure| failure.exit);
            assert_eq!(tried.err(), exit, "{content}");
        }
        assert!(try_output(&folder.path().join("new"), Kind::Plan).is_ok());
        let nowhere = try_output(&folder.path().join("no/file"), Kind::Plan).unwrap_err();
        assert_eq!(nowhere.exit, Exit::Missing);
        assert!(try_output(Path::new("/dev/null"), Kind::Page).is_ok());
    }
}
