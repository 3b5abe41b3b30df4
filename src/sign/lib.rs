//! Keys and signatures of bundles and plans, by file.
//!
//! A [`SecretKey`] signs, a [`PublicKey`](sortie_core::signature::PublicKey) in a file tells whom somebody trusts, and [`Trust`] is
//! a folder of such files, less the keys that its list of revoked ones names. What is signed of a bundle is its id, which vouches
//! for every file of it; of a plan its bytes, so that a board can check it alone (`sortie_core::signature`).
//!
//! All files are texts that this crate writes and nobody edits: each ends with a checksum over what stands before it, so that a
//! damaged file is told from one that somebody forged. Signatures protect, the checksum does not.

#![forbid(unsafe_code)]

mod error;
mod key;
mod seal;
mod signatures;
#[cfg(test)]
mod tests;
mod trust;

pub use error::SignError;
pub use key::{NamedKey, SecretKey, is_name, key_files};
#[doc(hidden)]
pub use seal::with_checksum;
pub use signatures::{
    BundleSignature, FOLDER, bundle_signature_files, plan_signatures_of, sign_bundle, sign_plan,
    signature_file,
};
pub use trust::{REVOKED, Revoked, Trust, revoke};
