//! What the world of a supervised team has played, kept in its domain: the next world goes on where one died.

use std::fs;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use sortie_ipc::Domain;

use crate::failure::Failure;
use crate::worlds::tally::Tally;

/// The file's name. It goes with the domain.
const FILE: &str = "played.json";

/// The played episodes of a domain.
pub(super) struct Ledger {
    path: PathBuf,
    playing: String,
}

#[derive(Serialize, Deserialize)]
struct Page<T> {
    /// What was played: episodes of anything else do not count.
    playing: String,
    tally: T,
}

impl Ledger {
    /// That of `domain` for what is to be played.
    pub(super) fn new(domain: &Domain, playing: String) -> Self {
        Self { path: domain.base().join(FILE), playing }
    }

    /// What a world of a team that is still there had played when it died.
    pub(super) fn read(&self, domain: &Domain) -> Result<Tally, Failure> {
        // Where nobody is left, the file is of a team that is dead as well.
        if !domain.is_alive()? {
            return Ok(Tally::default());
        }
        let text = fs::read(&self.path).unwrap_or_default();
        let page: Option<Page<Tally>> = serde_json::from_slice(&text).ok();
        let page = page.filter(|page| page.playing == self.playing);
        Ok(page.map(|page| page.tally).unwrap_or_default())
    }

    /// Writes what is played. Where that fails, the next world counts from an earlier episode.
    pub(super) fn write(&self, tally: &Tally) {
        let page = Page { playing: self.playing.clone(), tally };
        let unfinished = self.path.with_extension("new");
        let text = serde_json::to_vec(&page).unwrap_or_default();
        let _ = fs::write(&unfinished, text).and_then(|()| fs::rename(&unfinished, &self.path));
    }

    /// Forgets it all, once it is reported.
    pub(super) fn close(self) {
        // It may be gone with its domain.
        let _ = fs::remove_file(self.path);
    }
}
