//! Plans made of a fuzzer's bytes: the bytes themselves, or header and program with made-up weights and right checksums.

use sortie_core::plan::{AlignedBytes, Checksums, Header, checksums};

/// Weights and arenas beyond this only make the fuzzer slow.
pub const MOST_BYTES: usize = 1 << 16;

/// The plan of an input, whose first byte says which kind it is; and the other bytes.
pub fn plan(bytes: &[u8]) -> Option<(AlignedBytes, &[u8])> {
    let (kind, bytes) = bytes.split_first()?;
    let plan = if kind % 2 == 0 { forge(bytes)? } else { AlignedBytes::copy_of(bytes) };
    Some((plan, bytes))
}

/// Header and program with made-up weights and right checksums.
fn forge(bytes: &[u8]) -> Option<AlignedBytes> {
    let (mut header, _) = Header::read(bytes).ok()?;
    let (start, len) = (header.program_offset as usize, header.program_len as usize);
    let program = bytes.get(start..start.checked_add(len)?)?;
    header.weights_offset = start.saturating_add(len).next_multiple_of(64) as u32;
    let len = header.weights_len as usize;
    if len > MOST_BYTES || header.arena_bytes as usize > MOST_BYTES {
        return None;
    }
    let weight =
        |index: usize| (index.wrapping_mul(2_654_435_761) >> 8 & 0xFFFF) as f32 / 65_536.0 - 0.5;
    let weights: Vec<u8> = (0..len / 4).flat_map(|index| weight(index).to_le_bytes()).collect();
    let checksums: Checksums = checksums(&header, program, &weights);
    let mut plan = bytes.get(..start)?.to_vec();
    plan.get_mut(..128)?.copy_from_slice(&header.to_bytes(checksums));
    plan.extend(program);
    plan.resize(header.weights_offset as usize, 0);
    plan.extend(weights);
    Some(AlignedBytes::copy_of(&plan))
}
