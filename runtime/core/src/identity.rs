//! What a domain is, as hashes: processes that do not fit each other must not talk.

const FNV_OFFSET: u64 = 0xcbf2_9ce4_8422_2325;
const FNV_PRIME: u64 = 0x0000_0100_0000_01b3;

/// The 64-bit FNV-1a hash of `bytes`.
pub fn fnv1a(bytes: &[u8]) -> u64 {
    bytes.iter().fold(FNV_OFFSET, |hash, &byte| (hash ^ u64::from(byte)).wrapping_mul(FNV_PRIME))
}

/// The schema of a running domain: its contract and its sizes A, N and T.
///
/// FNV-1a over the contract hash and the three sizes as `u64`, `u16`, `u16`, `u16`, little-endian.
/// Stands as an attribute on every service and in every message.
pub fn schema_hash(contract: u64, agents: u16, entities: u16, tasks: u16) -> u64 {
    let [a0, a1] = agents.to_le_bytes();
    let [n0, n1] = entities.to_le_bytes();
    let [t0, t1] = tasks.to_le_bytes();
    let [c0, c1, c2, c3, c4, c5, c6, c7] = contract.to_le_bytes();
    fnv1a(&[c0, c1, c2, c3, c4, c5, c6, c7, a0, a1, n0, n1, t0, t1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matches_the_published_vectors_of_fnv1a() {
        assert_eq!(fnv1a(b""), 0xcbf2_9ce4_8422_2325);
        assert_eq!(fnv1a(b"a"), 0xaf63_dc4c_8601_ec8c);
        assert_eq!(fnv1a(b"foobar"), 0x8594_4171_f739_67e8);
    }

    #[test]
    fn every_size_changes_the_schema() {
        let base = schema_hash(7, 5, 11, 6);
        for other in [schema_hash(8, 5, 11, 6), schema_hash(7, 6, 11, 6)] {
            assert_ne!(base, other);
        }
        assert_ne!(base, schema_hash(7, 5, 12, 6));
        assert_ne!(base, schema_hash(7, 5, 11, 7));
    }
}
