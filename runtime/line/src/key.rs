//! The secret that both ends of a line have, and what it makes of a datagram.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::{OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

/// Bytes of a checksum.
pub(crate) const TAG: usize = 16;
/// Bytes of a key, and fewest of its file.
const BYTES: usize = 32;
/// Bytes that SHA-256 takes at once.
const BLOCK: usize = 64;

/// The secret of a line. HMAC-SHA256 (RFC 2104), of which a datagram carries half; written down here, since the package that has
/// it would bring three more.
#[derive(Clone)]
pub struct Key {
    /// What has taken in the key, from which every checksum goes on.
    inner: Sha256,
    outer: Sha256,
}

impl std::fmt::Debug for Key {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Key")
    }
}

/// Why there is no key.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// The file cannot be used.
    #[error("{}: {source}", path.display())]
    File {
        /// The key's file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// Others can read it.
    #[error("{}: others can read it: chmod 600 {}", path.display(), path.display())]
    Readable {
        /// The key's file.
        path: PathBuf,
    },
    /// It is too short to be a secret.
    #[error("{}: a key has {BYTES} bytes at least, this has {bytes}", path.display())]
    Short {
        /// The key's file.
        path: PathBuf,
        /// How many it has.
        bytes: usize,
    },
}

impl Key {
    /// The key that is no secret: with it a checksum finds what was damaged, and keeps nobody out.
    pub fn plain() -> Self {
        Self::new(&[0; BYTES])
    }

    /// That of a file.
    ///
    /// # Errors
    /// It cannot be read, others can read it, or it is too short.
    pub fn read(path: &Path) -> Result<Self, KeyError> {
        let failed = |source| KeyError::File { path: path.to_owned(), source };
        let mode = fs::metadata(path).map_err(failed)?.permissions().mode();
        if mode & 0o077 != 0 {
            return Err(KeyError::Readable { path: path.to_owned() });
        }
        let secret = fs::read(path).map_err(failed)?;
        if secret.len() < BYTES {
            return Err(KeyError::Short { path: path.to_owned(), bytes: secret.len() });
        }
        Ok(Self::new(&secret))
    }

    /// Makes a file of a new secret, which nobody but its owner can read.
    ///
    /// # Errors
    /// There is such a file already, or it cannot be written.
    pub fn create(path: &Path) -> Result<(), KeyError> {
        let failed = |source| KeyError::File { path: path.to_owned(), source };
        let mut secret = [0; BYTES];
        getrandom::fill(&mut secret).map_err(|error| failed(io::Error::other(error)))?;
        let mut file = OpenOptions::new();
        let mut file = file.write(true).create_new(true).mode(0o600).open(path).map_err(failed)?;
        file.write_all(&secret).map_err(failed)
    }

    fn new(secret: &[u8]) -> Self {
        let mut block = [0; BLOCK];
        let digest = Sha256::digest(secret);
        let short: &[u8] = if secret.len() > BLOCK { &digest } else { secret };
        block.iter_mut().zip(short).for_each(|(to, from)| *to = *from);
        let padded = |with: u8| Sha256::new_with_prefix(block.map(|byte| byte ^ with));
        Self { inner: padded(0x36), outer: padded(0x5c) }
    }

    /// The checksum of what is said.
    pub(crate) fn tag(&self, said: &[u8]) -> [u8; TAG] {
        let inner = self.inner.clone().chain_update(said).finalize();
        let whole: [u8; 32] = self.outer.clone().chain_update(inner).finalize().into();
        let mut tag = [0; TAG];
        tag.iter_mut().zip(whole).for_each(|(to, from)| *to = from);
        tag
    }

    /// Whether this is the checksum, in a time that does not tell where it differs.
    pub(crate) fn fits(&self, said: &[u8], tag: &[u8; TAG]) -> bool {
        let own = self.tag(said);
        own.iter().zip(tag).fold(0, |other, (own, theirs)| other | (own ^ theirs)) == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksums_are_those_of_rfc_4231() {
        // Test cases 1, 2 and 6: a short key, a shorter one, and one that is longer than a block.
        for (key, said, tag) in [
            (vec![0x0b; 20], &b"Hi There"[..], "b0344c61d8db38535ca8afceaf0bf12b"),
            (b"Jefe".to_vec(), b"what do ya want for nothing?", "5bdcc146bf60754e6a042426089575c7"),
            (
                vec![0xaa; 131],
                b"Test Using Larger Than Block-Size Key - Hash Key First",
                "60e431591ee0b67f0d8a26aacbf5b77f",
            ),
        ] {
            let own = Key::new(&key).tag(said);
            let own: String = own.iter().map(|byte| format!("{byte:02x}")).collect();
            assert_eq!(own, tag);
        }
    }

    #[test]
    fn a_key_that_is_no_secret_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("line.key");
        assert!(matches!(Key::read(&path), Err(KeyError::File { .. })));
        Key::create(&path).unwrap();
        let key = Key::read(&path).unwrap();
        assert!(!key.fits(b"hello", &Key::plain().tag(b"hello")));
        assert!(key.fits(b"hello", &key.tag(b"hello")) && !key.fits(b"hallo", &key.tag(b"hello")));
        for bit in 0..8 * TAG {
            let mut tag = key.tag(b"hello");
            tag[bit / 8] ^= 1 << (bit % 8);
            assert!(!key.fits(b"hello", &tag), "bit {bit}");
        }
        // A secret that is there is not replaced.
        assert!(matches!(Key::create(&path), Err(KeyError::File { .. })));
        fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).unwrap();
        assert!(matches!(Key::read(&path), Err(KeyError::Readable { .. })));
        fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
        fs::write(&path, "short").unwrap();
        assert!(matches!(Key::read(&path), Err(KeyError::Short { bytes: 5, .. })));
    }
}
