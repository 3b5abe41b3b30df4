//! Keys, lists and signatures: read or refused, never a panic; what was read is written so that it is read again.
//!
//! Each text is tried as it is, and with the checksum that a forger would put below it.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use sortie_core::signature::{trusted_plan, PublicKey};
use sortie_sign::{with_checksum, BundleSignature, NamedKey, Revoked, SecretKey};

/// That of the first test of RFC 8032.
const KEY: &str = "d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a";

fn read(text: &str) {
    let path = Path::new("file");
    if let Ok(key) = NamedKey::from_text(path, text) {
        assert_eq!(NamedKey::from_text(path, &key.to_text()).unwrap(), key);
    }
    if let Ok(list) = Revoked::from_text(path, text) {
        assert_eq!(Revoked::from_text(path, &Revoked::to_text(&list)).unwrap(), list);
    }
    if let Ok(signature) = BundleSignature::from_text(path, text) {
        assert_eq!(BundleSignature::from_text(path, &signature.to_text()).unwrap(), signature);
        // Nobody here holds a key.
        assert!(signature.check(path, &[7; 32]).is_err());
    }
    if let Ok(secret) = SecretKey::from_text(path, text) {
        assert!(!secret.public().to_string().is_empty());
    }
}

fuzz_target!(|bytes: &[u8]| {
    let text = String::from_utf8_lossy(bytes);
    read(&text);
    read(&with_checksum(&text));
    let key = PublicKey::from_hex(KEY).unwrap();
    assert!(trusted_plan(b"a plan", bytes, &[key]).is_err());
});
