//! Buffers that grow to the largest batch seen, so that a steady stream of batches allocates nothing.

/// The first `length` numbers of a buffer; their content is whatever stood there.
pub(super) fn sized(buffer: &mut Vec<f32>, length: usize) -> &mut [f32] {
    if buffer.len() < length {
        buffer.resize(length, 0.0);
    }
    &mut buffer[..length]
}
