//! Files of signatures: of a bundle one for each key, in a folder of its own inside; of a plan one beside it.

use std::ffi::OsString;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sortie_bundle::files::{Durability, read_file, replace_file};
use sortie_bundle::{Bundle, hex};
use sortie_core::signature::{
    MAGIC, PlanSignature, PublicKey, SignatureError, Signed, from_hex, plan_signatures,
};
use zerocopy::IntoBytes;

use crate::error::SignError;
use crate::key::SecretKey;
use crate::seal::{read_text, sealed, unsealed};

/// Where a bundle keeps its signatures: no part of it, so that signing changes neither its id nor what it is.
pub const FOLDER: &str = "signatures";
/// The most signatures that are read.
const MOST: usize = 64;
const COMMENT: &str = "Signature of sortie (Ed25519) over \"sortie bundle 1\\n\" and the 32 bytes of the bundle's id.";

/// A signature over a bundle.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BundleSignature {
    /// The id of the bundle that was signed.
    pub bundle: [u8; 32],
    /// The key that is said to have signed.
    pub key: PublicKey,
    signature: [u8; 64],
}

/// The content of its file: digits.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Fields {
    bundle: String,
    key: String,
    signature: String,
}

impl BundleSignature {
    /// What a key makes of a bundle's id.
    pub fn new(secret: &SecretKey, id: &[u8; 32]) -> Self {
        let signature = secret.sign(Signed::Bundle(id));
        Self { bundle: *id, key: secret.public().key, signature }
    }

    /// As its file has it.
    pub fn to_text(&self) -> String {
        let [bundle, key] = [self.bundle, self.key.0].map(|bytes| hex(&bytes));
        sealed(COMMENT, &Fields { bundle, key, signature: hex(&self.signature) })
    }

    /// Reads a file of a bundle's signatures.
    ///
    /// # Errors
    /// It cannot be read, or is damaged.
    pub fn read(path: &Path) -> Result<Self, SignError> {
        let text = read_text(path)?;
        Self::from_text(path, &text)
    }

    /// Of the content of such a file.
    ///
    /// # Errors
    /// It is damaged.
    pub fn from_text(path: &Path, text: &str) -> Result<Self, SignError> {
        let Fields { bundle, key, signature } = unsealed(path, text)?;
        let fields = (from_hex(&bundle), PublicKey::from_hex(&key), from_hex(&signature));
        let (Some(bundle), Some(key), Some(signature)) = fields else {
            return Err(SignError::damaged(path, "it is no signature"));
        };
        Ok(Self { bundle, key, signature })
    }

    /// Checks that its key has signed the bundle of this id.
    ///
    /// # Errors
    /// It has signed another, or has not signed.
    pub fn check(&self, path: &Path, id: &[u8; 32]) -> Result<(), SignError> {
        if self.bundle != *id {
            let [signed, got] = [&self.bundle, id].map(|id| hex(id));
            return Err(SignError::OtherBundle { path: path.to_owned(), signed, got });
        }
        let checked = Signed::Bundle(id).check(&self.key, &self.signature);
        checked.map_err(|_| SignError::forged(path, &self.key))
    }
}

/// Signs a bundle that was read and checked, and returns the file of the signature.
///
/// # Errors
/// It cannot be written.
pub fn sign_bundle(secret: &SecretKey, bundle: &Bundle) -> Result<PathBuf, SignError> {
    let signature = BundleSignature::new(secret, bundle.id());
    let folder = bundle.folder().join(FOLDER);
    fs::create_dir_all(&folder).map_err(|error| SignError::io(&folder, error))?;
    // The key's digits, not its name: two people may have chosen the same one.
    let path = folder.join(format!("{:.16}.toml", hex(&signature.key.0)));
    write(&path, signature.to_text().as_bytes())?;
    Ok(path)
}

/// The files of the signatures in a bundle's folder.
///
/// # Errors
/// There is none, there are too many, or the folder cannot be read.
pub fn bundle_signature_files(bundle: &Path) -> Result<Vec<PathBuf>, SignError> {
    let folder = bundle.join(FOLDER);
    let entries = match fs::read_dir(&folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Err(unsigned(bundle)),
        Err(source) => return Err(SignError::Io { path: folder, source }),
    };
    let files = entries.flatten().map(|entry| entry.path());
    let mut files: Vec<PathBuf> =
        files.filter(|path| path.extension().is_some_and(|end| end == "toml")).collect();
    files.sort();
    match files.len() {
        0 => Err(unsigned(bundle)),
        1..=MOST => Ok(files),
        found => Err(SignError::damaged(
            &folder,
            format!("it has {found} files, at most {MOST} are read"),
        )),
    }
}

/// The file of a plan's signatures.
pub fn signature_file(plan: &Path) -> PathBuf {
    let mut name = OsString::from(plan);
    name.push(".sig");
    name.into()
}

/// Signs the bytes of a plan, beside what others have signed of it, and returns the file of the signatures.
///
/// # Errors
/// What is there already is damaged, or it cannot be written.
pub fn sign_plan(secret: &SecretKey, path: &Path, plan: &[u8]) -> Result<PathBuf, SignError> {
    let (key, signature) = (secret.public().key, secret.sign(Signed::Plan(plan)));
    let mut signatures = match plan_signatures_of(path) {
        Ok(signatures) => signatures,
        Err(SignError::Unsigned { .. }) => Vec::new(),
        Err(error) => return Err(error),
    };
    // Those over what the plan was before would only be in the way.
    signatures.retain(|other| {
        other.key != key && Signed::Plan(plan).check(&other.key, &other.signature).is_ok()
    });
    signatures.push(PlanSignature { magic: MAGIC, key, signature });
    let file = signature_file(path);
    write(&file, signatures.as_bytes())?;
    Ok(file)
}

/// The signatures in the file beside a plan.
///
/// # Errors
/// There is none, or it is damaged.
pub fn plan_signatures_of(plan: &Path) -> Result<Vec<PlanSignature>, SignError> {
    let file = signature_file(plan);
    let most = (MOST * size_of::<PlanSignature>()) as u64;
    let bytes = read_file(&file, most).map_err(|source| match source.kind() {
        io::ErrorKind::NotFound => unsigned(plan),
        _ => SignError::Io { path: file.clone(), source },
    })?;
    let damaged = |error: SignatureError| SignError::damaged(&file, error.to_string());
    plan_signatures(&bytes).map(<[_]>::to_vec).map_err(damaged)
}

fn unsigned(what: &Path) -> SignError {
    SignError::Unsigned { what: what.to_owned() }
}

fn write(path: &Path, content: &[u8]) -> Result<(), SignError> {
    let failed = |source| SignError::Io { path: path.to_owned(), source };
    replace_file(path, content, Durability::Cached).map_err(failed)
}
