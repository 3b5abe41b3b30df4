//! Pairs of keys: a secret one that signs, a public one that others trust.

use std::fmt;
use std::fs::{self, OpenOptions};
use std::io::Write;
use std::os::unix::fs::{OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

use ed25519_compact::{KeyPair, Seed};
use serde::{Deserialize, Serialize};
use sortie_bundle::hex;
use sortie_core::signature::{PublicKey, Signed, from_hex};

use crate::error::SignError;
use crate::seal::{read_text, sealed, unsealed};

/// Most letters of a name.
const NAME_LETTERS: usize = 32;
const PUBLIC: &str = "Public key of sortie. Whoever trusts it takes what its holder has signed.";
const SECRET: &str = "Secret key of sortie: whoever reads this signs in its holder's name. Keep it off robots and out of git.";

/// A public key with the name that people know it by.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NamedKey {
    /// For messages alone: keys are told apart by themselves.
    pub name: String,
    /// The key itself.
    pub key: PublicKey,
}

/// The content of its file.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PublicFields {
    name: String,
    /// 64 hexadecimal digits.
    key: String,
}

/// A secret key, which no message shows.
pub struct SecretKey {
    name: String,
    pair: KeyPair,
}

/// The content of its file.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SecretFields {
    name: String,
    /// Of the pair as well, so that a damaged secret is noticed before anything is signed with it.
    public: String,
    secret: String,
}

/// Whether a text can be the name of a key.
pub fn is_name(text: &str) -> bool {
    let is_letter = |byte: u8| byte.is_ascii_alphanumeric() || b"._-".contains(&byte);
    (1..=NAME_LETTERS).contains(&text.len())
        && !text.starts_with('.')
        && text.bytes().all(is_letter)
}

/// The secret and the public file of a pair `keys/me`, which may be named by either of them.
pub fn key_files(pair: &Path) -> [PathBuf; 2] {
    let text = pair.as_os_str().to_string_lossy();
    let stem = [".key", ".pub"].iter().find_map(|end| text.strip_suffix(end)).unwrap_or(&text);
    [".key", ".pub"].map(|end| PathBuf::from(format!("{stem}{end}")))
}

impl NamedKey {
    /// Reads a file `.pub`, and refuses a key with which anybody could sign.
    ///
    /// # Errors
    /// It is missing or damaged.
    pub fn read(path: &Path) -> Result<Self, SignError> {
        let text = read_text(path)?;
        Self::from_text(path, &text)
    }

    /// The same of the content of a file.
    ///
    /// # Errors
    /// It is damaged.
    pub fn from_text(path: &Path, text: &str) -> Result<Self, SignError> {
        let PublicFields { name, key } = unsealed(path, text)?;
        Self::from_fields(path, name, &key)
    }

    /// As its file has it.
    pub fn to_text(&self) -> String {
        sealed(PUBLIC, &PublicFields { name: self.name.clone(), key: hex(&self.key.0) })
    }

    pub(crate) fn from_fields(path: &Path, name: String, key: &str) -> Result<Self, SignError> {
        let key = PublicKey::from_hex(key).filter(|key| key.validate().is_ok());
        match key.filter(|_| is_name(&name)) {
            Some(key) => Ok(Self { name, key }),
            None => Err(SignError::damaged(path, "its name or its key is none")),
        }
    }
}

impl fmt::Display for NamedKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "`{}` (key {:.16})", self.name, hex(&self.key.0))
    }
}

impl SecretKey {
    /// A key of the system's randomness.
    ///
    /// # Errors
    /// The name is none, or the system gives no random numbers.
    pub fn new(name: &str) -> Result<Self, SignError> {
        let mut seed = [0; 32];
        getrandom::fill(&mut seed).map_err(SignError::Random)?;
        Self::from_seed(name, seed)
    }

    /// A key of 32 secret bytes.
    ///
    /// # Errors
    /// The name is none.
    pub fn from_seed(name: &str, seed: [u8; 32]) -> Result<Self, SignError> {
        if !is_name(name) {
            return Err(SignError::Name { name: name.to_owned() });
        }
        Ok(Self { name: name.to_owned(), pair: KeyPair::from_seed(Seed::new(seed)) })
    }

    /// Makes the pair of files `keys/me`, named by its last part.
    ///
    /// # Errors
    /// Either file exists, or cannot be written.
    pub fn create(pair: &Path) -> Result<NamedKey, SignError> {
        let [secret_file, public_file] = key_files(pair);
        let secret = Self::new(&secret_file.file_stem().unwrap_or_default().to_string_lossy())?;
        if let Some(there) = [&secret_file, &public_file].into_iter().find(|file| file.exists()) {
            return Err(SignError::Exists { path: there.clone() });
        }
        if let Some(folder) = secret_file.parent() {
            fs::create_dir_all(folder).map_err(|error| SignError::io(folder, error))?;
        }
        write_new(&secret_file, &secret.to_text(), 0o600)?;
        write_new(&public_file, &secret.public().to_text(), 0o644)?;
        Ok(secret.public())
    }

    /// Reads the secret file of a pair.
    ///
    /// # Errors
    /// It is missing or damaged, or others can read it.
    pub fn read(pair: &Path) -> Result<Self, SignError> {
        const OTHERS: u32 = 0o077;
        let [path, _] = key_files(pair);
        let found = fs::metadata(&path).map_err(|error| SignError::io(&path, error))?;
        let mode = found.permissions().mode() & 0o777;
        if mode & OTHERS != 0 {
            return Err(SignError::Open { path, mode });
        }
        let text = read_text(&path)?;
        Self::from_text(&path, &text)
    }

    /// The same of the content of a file.
    ///
    /// # Errors
    /// It is damaged.
    pub fn from_text(path: &Path, text: &str) -> Result<Self, SignError> {
        let SecretFields { name, public, secret } = unsealed(path, text)?;
        let seed = from_hex(&secret).ok_or_else(|| SignError::damaged(path, "it holds no key"))?;
        let key = Self::from_seed(&name, seed)?;
        if PublicKey::from_hex(&public) != Some(key.public().key) {
            return Err(SignError::damaged(path, "its two keys are no pair"));
        }
        Ok(key)
    }

    /// What others trust.
    pub fn public(&self) -> NamedKey {
        NamedKey { name: self.name.clone(), key: PublicKey(*self.pair.pk) }
    }

    /// Signs. The same thing gets the same signature again.
    pub fn sign(&self, signed: Signed<'_>) -> [u8; 64] {
        *self.pair.sk.sign(signed.message().concat(), None)
    }

    fn to_text(&self) -> String {
        let secret = hex(&self.pair.sk.seed()[..]);
        let public = hex(&self.public().key.0);
        sealed(SECRET, &SecretFields { name: self.name.clone(), public, secret })
    }
}

fn write_new(path: &Path, text: &str, mode: u32) -> Result<(), SignError> {
    let file = OpenOptions::new().write(true).create_new(true).mode(mode).open(path);
    let written = file.and_then(|mut file| file.write_all(text.as_bytes()));
    written.map_err(|error| SignError::io(path, error))
}
