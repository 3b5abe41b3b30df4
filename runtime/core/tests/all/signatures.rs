//! Plans that are taken of those who are trusted alone.

use sortie_core::include_plan;
use sortie_core::signature::{
    MAGIC, PlanSignature, PublicKey, SignatureError, Signed, from_hex, trusted_plan,
};
use zerocopy::IntoBytes;

const PLAN: &[u8] = include_plan!("../../../../examples/embed_c/cart.plan");
// Signed with the key of the first test of RFC 8032, by another implementation.
const SIGNATURES: &[u8] = include_bytes!("../../../../examples/embed_c/cart.plan.sig");
const SIGNER: PublicKey = key("d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a");
/// That of the second test.
const OTHER: PublicKey = key("3d4017c3e843895a92b70aa74d1b7ebc9c982ccf2ec4968cc0cd55f12af4660c");

const fn key(digits: &str) -> PublicKey {
    PublicKey::from_hex(digits).expect("digits of a key")
}

fn refused(plan: &[u8], signatures: &[u8], trusted: &[PublicKey]) -> Option<SignatureError> {
    trusted_plan(plan, signatures, trusted).err()
}

#[test]
fn a_signed_plan_is_given_back_to_who_trusts_its_signer() {
    assert_eq!(trusted_plan(PLAN, SIGNATURES, &[SIGNER]), Ok(PLAN));
    // While keys are replaced two are trusted, and two may have signed.
    assert_eq!(trusted_plan(PLAN, SIGNATURES, &[OTHER, SIGNER]), Ok(PLAN));
    let others = PlanSignature { magic: MAGIC, key: OTHER, signature: [7; 64] };
    let both = [others.as_bytes(), SIGNATURES].concat();
    assert_eq!(trusted_plan(PLAN, &both, &[SIGNER]), Ok(PLAN));
    assert_eq!(trusted_plan(PLAN, &both, &[SIGNER, OTHER]), Ok(PLAN));
    assert_eq!(refused(PLAN, &both, &[OTHER]), Some(SignatureError::Refused));
    assert_eq!(refused(PLAN, SIGNATURES, &[OTHER]), Some(SignatureError::UnknownKey));
    assert_eq!(refused(PLAN, SIGNATURES, &[]), Some(SignatureError::UnknownKey));
}

#[test]
fn every_changed_byte_is_refused_by_name() {
    for byte in (0..PLAN.len()).step_by(53) {
        let mut plan = PLAN.to_vec();
        plan[byte] ^= 1;
        let error = refused(&plan, SIGNATURES, &[SIGNER]);
        assert_eq!(error, Some(SignatureError::Refused), "byte {byte} of the plan");
    }
    for byte in 0..SIGNATURES.len() {
        let mut signatures = SIGNATURES.to_vec();
        signatures[byte] ^= 1;
        let want = match byte {
            0..8 => SignatureError::BadMagic,
            8..40 => SignatureError::UnknownKey,
            _ => SignatureError::Refused,
        };
        assert_eq!(refused(PLAN, &signatures, &[SIGNER]), Some(want), "byte {byte}");
    }
    let cut = &SIGNATURES[..SIGNATURES.len() - 1];
    for signatures in [&[], cut, &SIGNATURES[..1]] {
        assert_eq!(refused(PLAN, signatures, &[SIGNER]), Some(SignatureError::Length));
    }
    let shorter = &PLAN[..PLAN.len() - 1];
    assert_eq!(refused(shorter, SIGNATURES, &[SIGNER]), Some(SignatureError::Refused));
}

#[test]
fn keys_with_which_anybody_could_sign_are_none() {
    let one = "0100000000000000000000000000000000000000000000000000000000000000";
    let zero = "0000000000000000000000000000000000000000000000000000000000000000";
    let no_point = "0200000000000000000000000000000000000000000000000000000000000000";
    let beyond = "eeffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f";
    for weak in [one, zero, no_point, beyond].map(key) {
        assert_eq!(weak.validate(), Err(SignatureError::BadKey), "{weak:?}");
        // The neutral element as R, and 0 as s, satisfy the equation of a neutral key for whatever is signed.
        let mut signature = [0; 64];
        signature[0] = 1;
        let record = PlanSignature { magic: MAGIC, key: weak, signature };
        let error = refused(PLAN, record.as_bytes(), &[weak]);
        assert_eq!(error, Some(SignatureError::BadKey), "{weak:?}");
    }
    assert_eq!(SIGNER.validate(), Ok(()));
}

#[test]
fn a_signature_over_one_kind_of_thing_is_none_over_another() {
    let id: [u8; 32] = std::array::from_fn(|byte| byte as u8);
    // By another implementation as well.
    let signature = from_hex(
        "e2f7eeeb47c202a03aac7fbd847126e1a5a5256fa7de5e7d75340ac46bad75554f90041a78e5e440782022ce83e87f9727dcccd5411afb71fe6b9f6a3b066d04",
    );
    let signature = signature.expect("digits of a signature");
    assert_eq!(Signed::Bundle(&id).check(&SIGNER, &signature), Ok(()));
    let as_plan = Signed::Plan(&id).check(&SIGNER, &signature);
    assert_eq!(as_plan, Err(SignatureError::Refused));
    let other = [1; 32];
    assert_eq!(Signed::Bundle(&other).check(&SIGNER, &signature), Err(SignatureError::Refused));
}

#[test]
fn digits_are_read_whole_or_not_at_all() {
    assert_eq!(from_hex("00ff1a"), Some([0, 255, 26]));
    for wrong in ["", "00ff1", "00ff1a0", "00ff1a00", "00fF1a", "00fg1a", "00 f1a"] {
        assert_eq!(from_hex::<3>(wrong), None, "{wrong}");
    }
}
