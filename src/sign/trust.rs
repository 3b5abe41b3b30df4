//! Whom somebody trusts: a folder of public keys, less those that are revoked.

use std::path::{Path, PathBuf};
use std::{fs, io};

use serde::{Deserialize, Serialize};
use sortie_bundle::files::{Durability, replace_file};
use sortie_bundle::{Bundle, hex};
use sortie_core::signature::{PlanSignature, PublicKey, Signed};

use crate::error::SignError;
use crate::key::NamedKey;
use crate::seal::{read_text, sealed, unsealed};
use crate::signatures::{
    BundleSignature, bundle_signature_files, plan_signatures_of, signature_file,
};

/// The list of revoked keys, beside those that are trusted.
pub const REVOKED: &str = "revoked.toml";
const COMMENT: &str =
    "Keys whose signatures do not count any more, whatever lies beside this file.";

/// Keys that are trusted, and keys that are not trusted any more.
#[derive(Clone, Debug)]
pub struct Trust {
    path: PathBuf,
    keys: Vec<NamedKey>,
    revoked: Vec<Revoked>,
}

/// A key that is not trusted any more.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Revoked {
    /// The key.
    pub key: NamedKey,
    /// Why, in the words of whoever revoked it.
    pub reason: String,
}

/// The content of the list's file.
#[derive(Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ListFields {
    #[serde(default)]
    revoked: Vec<RevokedFields>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RevokedFields {
    name: String,
    key: String,
    reason: String,
}

impl Trust {
    /// Reads a folder of public keys, or one file `.pub`, and the list of revoked keys there.
    ///
    /// # Errors
    /// A file is missing or damaged, or there is no key.
    pub fn read(path: &Path) -> Result<Self, SignError> {
        let failed = |error| SignError::io(path, error);
        let is_folder = fs::metadata(path).map_err(failed)?.is_dir();
        let (files, list) = match is_folder {
            true => (public_keys(path).map_err(failed)?, path.join(REVOKED)),
            false => (vec![path.to_owned()], path.with_file_name(REVOKED)),
        };
        let keys: Result<Vec<NamedKey>, _> =
            files.iter().map(|file| NamedKey::read(file)).collect();
        let (keys, revoked) = (keys?, revoked_in(&list)?);
        if keys.is_empty() {
            return Err(SignError::NoKeys { path: path.to_owned() });
        }
        Ok(Self { path: path.to_owned(), keys, revoked })
    }

    /// Who has signed a bundle that was read: its id is that of the bytes in memory, whatever becomes of the folder.
    ///
    /// # Errors
    /// Nobody who is trusted.
    pub fn check_bundle(&self, bundle: &Bundle) -> Result<&NamedKey, SignError> {
        let what = bundle.folder();
        let files = bundle_signature_files(what)?;
        let judged = files.iter().map(|path| {
            let signature = BundleSignature::read(path)?;
            let holder = self.holder(what, &signature.key)?;
            signature.check(path, bundle.id()).map(|()| holder)
        });
        self.first(what, judged)
    }

    /// Who has signed the bytes of a plan, by the file beside it.
    ///
    /// # Errors
    /// Nobody who is trusted.
    pub fn check_plan(&self, path: &Path, plan: &[u8]) -> Result<&NamedKey, SignError> {
        let signatures = plan_signatures_of(path)?;
        let judged = signatures.iter().map(|PlanSignature { key, signature, .. }| {
            let holder = self.holder(path, key)?;
            let checked = Signed::Plan(plan).check(key, signature);
            checked.map(|()| holder).map_err(|_| SignError::forged(&signature_file(path), key))
        });
        self.first(path, judged)
    }

    /// One signature that counts is enough; without one, the reason that tells most.
    fn first<'a>(
        &self,
        what: &Path,
        judged: impl Iterator<Item = Result<&'a NamedKey, SignError>>,
    ) -> Result<&'a NamedKey, SignError> {
        let mut refused = self.unknown(what);
        for signature in judged {
            match signature {
                Ok(holder) => return Ok(holder),
                Err(error) if matches!(refused, SignError::Unknown { .. }) => refused = error,
                Err(_) => {}
            }
        }
        Err(refused)
    }

    fn holder(&self, what: &Path, key: &PublicKey) -> Result<&NamedKey, SignError> {
        if let Some(found) = self.revoked.iter().find(|revoked| revoked.key.key == *key) {
            let (name, reason) = (found.key.name.clone(), found.reason.clone());
            return Err(SignError::Revoked { what: what.to_owned(), name, reason });
        }
        self.keys.iter().find(|known| known.key == *key).ok_or_else(|| self.unknown(what))
    }

    fn unknown(&self, what: &Path) -> SignError {
        SignError::Unknown { what: what.to_owned(), trust: self.path.clone() }
    }
}

impl Revoked {
    /// The keys on a list, by the content of its file.
    ///
    /// # Errors
    /// It is damaged.
    pub fn from_text(path: &Path, text: &str) -> Result<Vec<Self>, SignError> {
        let ListFields { revoked } = unsealed(path, text)?;
        let checked = |RevokedFields { name, key, reason }: RevokedFields| {
            let key = NamedKey::from_fields(path, name, &key)?;
            Ok(Self { key, reason })
        };
        revoked.into_iter().map(checked).collect()
    }

    /// A list as its file has it.
    pub fn to_text(list: &[Self]) -> String {
        let fields = list.iter().map(|Self { key: NamedKey { name, key }, reason }| {
            RevokedFields { name: name.clone(), key: hex(&key.0), reason: reason.clone() }
        });
        sealed(COMMENT, &ListFields { revoked: fields.collect() })
    }
}

/// Puts a public key on the list of its folder, and returns the list's file.
///
/// # Errors
/// The key or the list is damaged, or the list cannot be written.
pub fn revoke(public: &Path, reason: &str) -> Result<PathBuf, SignError> {
    let key = NamedKey::read(public)?;
    let path = public.with_file_name(REVOKED);
    let mut revoked = revoked_in(&path)?;
    revoked.retain(|other| other.key.key != key.key);
    revoked.push(Revoked { key, reason: reason.to_owned() });
    let text = Revoked::to_text(&revoked);
    let failed = |source| SignError::Io { path: path.clone(), source };
    replace_file(&path, text.as_bytes(), Durability::Forced).map_err(failed)?;
    Ok(path)
}

fn revoked_in(path: &Path) -> Result<Vec<Revoked>, SignError> {
    match read_text(path) {
        Ok(text) => Revoked::from_text(path, &text),
        Err(SignError::Missing { .. }) => Ok(Vec::new()),
        Err(error) => Err(error),
    }
}

fn public_keys(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let entries = fs::read_dir(folder)?.map(|entry| entry.map(|entry| entry.path()));
    let mut paths: Vec<PathBuf> = entries.collect::<Result<_, _>>()?;
    paths.retain(|path| path.extension().is_some_and(|end| end == "pub"));
    paths.sort();
    Ok(paths)
}
