//! Signatures: a board starts only plans that were signed by somebody whom it trusts.
//!
//! That is one step at start-up, before the plan is loaded. `sortie sign --new keys/me` makes a pair of keys, `sortie sign
//! keys/me walking.plan` writes `walking.plan.sig` beside the plan, and the digits of the public key stand in `keys/me.pub`:
//!
//! ```
//! use sortie_core::include_plan;
//! use sortie_core::plan::Plan;
//! use sortie_core::signature::{PublicKey, SignatureError, trusted_plan};
//!
//! const PLAN: &[u8] = include_plan!("../../../examples/embed_c/cart.plan");
//! const SIGNATURES: &[u8] = include_bytes!("../../../examples/embed_c/cart.plan.sig");
//! // Of whom plans are taken; while a key is replaced, the old one and the new one.
//! const TRUSTED: [PublicKey; 1] =
//!     [PublicKey::from_hex("d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a").unwrap()];
//!
//! let plan = Plan::load(trusted_plan(PLAN, SIGNATURES, &TRUSTED)?)?;
//! # assert_eq!(plan.outputs().count(), 1);
//!
//! // One byte of a weight is another: nothing is loaded.
//! let mut other = PLAN.to_vec();
//! *other.last_mut().unwrap() ^= 1;
//! assert_eq!(trusted_plan(&other, SIGNATURES, &TRUSTED), Err(SignatureError::Refused));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Signatures are Ed25519 (RFC 8032) over what kind of thing it is and the thing itself. Nothing is allocated, and the plan is
//! read once, from its first byte to its last. Keys of small order, with which anybody could sign, are refused.
//!
//! That nothing here panics is tested, not proved by linking as it is of all else in this crate: arrays of the crate below are
//! indexed by digits whose range its arithmetic keeps, which the optimiser does not see.

use ed25519_compact as ed25519;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout, Unaligned};

/// The first bytes of a file of signatures.
pub const MAGIC: [u8; 8] = *b"SORTIES1";

/// A public key: who is trusted.
#[derive(
    Clone,
    Copy,
    Debug,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    FromBytes,
    Immutable,
    IntoBytes,
    KnownLayout,
    Unaligned,
)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(transparent)]
pub struct PublicKey(pub [u8; 32]);

/// What is signed, each kind of its own: a signature over one is none over another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Signed<'a> {
    /// The bytes of a plan.
    Plan(&'a [u8]),
    /// The id of a bundle.
    Bundle(&'a [u8; 32]),
}

/// A signature over a plan, as it stands in files: one behind the other where several have signed.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, FromBytes, Immutable, IntoBytes, KnownLayout, Unaligned,
)]
#[repr(C)]
pub struct PlanSignature {
    /// [`MAGIC`].
    pub magic: [u8; 8],
    /// The key that it was made with.
    pub key: PublicKey,
    /// The signature itself.
    pub signature: [u8; 64],
}

/// Why something is not taken for signed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum SignatureError {
    /// There are no signatures, or bytes of one are missing.
    Length,
    /// The bytes are no signatures, or of another version.
    BadMagic,
    /// It is signed, but with no key that is trusted.
    UnknownKey,
    /// The trusted key is none: no point on the curve, or one with which anybody could sign.
    BadKey,
    /// The key has not signed this: it was changed, or the signature was.
    Refused,
}

impl PublicKey {
    /// A key by its 64 hexadecimal digits, in lower case as they stand in a file `.pub`.
    pub const fn from_hex(digits: &str) -> Option<Self> {
        match from_hex(digits) {
            Some(bytes) => Some(Self(bytes)),
            None => None,
        }
    }

    /// Whether it can be trusted at all.
    ///
    /// # Errors
    /// [`SignatureError::BadKey`].
    pub fn validate(&self) -> Result<(), SignatureError> {
        ed25519::PublicKey::new(self.0).validate().map_err(|_| SignatureError::BadKey)
    }
}

impl<'a> Signed<'a> {
    /// The signed message: these parts one behind the other.
    pub fn message(self) -> [&'a [u8]; 2] {
        match self {
            Self::Plan(bytes) => [b"sortie plan 1\n", bytes],
            Self::Bundle(id) => [b"sortie bundle 1\n", id],
        }
    }

    /// Checks that the holder of a key has signed this.
    ///
    /// # Errors
    /// [`SignatureError::BadKey`] and [`SignatureError::Refused`].
    pub fn check(self, key: &PublicKey, signature: &[u8; 64]) -> Result<(), SignatureError> {
        let refused = |error| match error {
            ed25519::Error::InvalidPublicKey | ed25519::Error::WeakPublicKey => {
                SignatureError::BadKey
            }
            _ => SignatureError::Refused,
        };
        let signature = ed25519::Signature::new(*signature);
        let key = ed25519::PublicKey::new(key.0);
        let mut state = key.verify_incremental(&signature).map_err(refused)?;
        self.message().iter().for_each(|part| state.absorb(part));
        state.verify().map_err(refused)
    }
}

/// The plan itself, where one of the trusted keys has signed it.
///
/// `signatures` is the content of its file `.sig`.
///
/// # Errors
/// Nobody who is trusted has.
pub fn trusted_plan<'a>(
    plan: &'a [u8],
    signatures: &[u8],
    trusted: &[PublicKey],
) -> Result<&'a [u8], SignatureError> {
    let mut reason = SignatureError::UnknownKey;
    for PlanSignature { key, signature, .. } in plan_signatures(signatures)? {
        if trusted.contains(key) {
            match Signed::Plan(plan).check(key, signature) {
                Ok(()) => return Ok(plan),
                Err(error) => reason = error,
            }
        }
    }
    Err(reason)
}

/// The signatures in a file `.sig`, at least one.
///
/// # Errors
/// [`SignatureError::Length`] and [`SignatureError::BadMagic`].
pub fn plan_signatures(bytes: &[u8]) -> Result<&[PlanSignature], SignatureError> {
    match <[PlanSignature]>::ref_from_bytes(bytes) {
        Err(_) | Ok([]) => Err(SignatureError::Length),
        Ok(signatures) if signatures.iter().any(|signature| signature.magic != MAGIC) => {
            Err(SignatureError::BadMagic)
        }
        Ok(signatures) => Ok(signatures),
    }
}

/// Bytes by their hexadecimal digits in lower case, as many as there are.
pub const fn from_hex<const BYTES: usize>(digits: &str) -> Option<[u8; BYTES]> {
    let mut bytes = [0; BYTES];
    let mut places = bytes.as_mut_slice();
    let mut left = digits.as_bytes();
    while let Some((place, others)) = places.split_first_mut() {
        let Some(([high, low], rest)) = left.split_first_chunk() else { return None };
        let (Some(high), Some(low)) = (digit(*high), digit(*low)) else { return None };
        *place = high << 4 | low;
        (places, left) = (others, rest);
    }
    if left.is_empty() { Some(bytes) } else { None }
}

const fn digit(letter: u8) -> Option<u8> {
    match letter {
        b'0'..=b'9' => Some(letter - b'0'),
        b'a'..=b'f' => Some(letter - b'a' + 10),
        _ => None,
    }
}

impl core::fmt::Display for SignatureError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Length => "signatures are missing, or cut off",
            Self::BadMagic => "these are no signatures, or of another version",
            Self::UnknownKey => "signed, but with no key that is trusted",
            Self::BadKey => "the trusted key is none that can be trusted",
            Self::Refused => "the key has not signed this: it was changed, or its signature was",
        })
    }
}

impl core::error::Error for SignatureError {}
