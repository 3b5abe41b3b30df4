//! What stands behind the weights of a plan: sections, each a name, a length, a checksum and its bytes.

use super::Header;
use super::error::PlanError;

/// One of them, read where it stands.
#[derive(Clone, Copy)]
pub(super) struct Section<'p> {
    pub(super) magic: [u8; 8],
    /// The length as it stands in the plan.
    pub(super) length: [u8; 4],
    pub(super) checksum: u32,
    pub(super) body: &'p [u8],
}

/// Those of a plan, in order, up to the first bytes that are none.
pub(super) struct Sections<'p> {
    rest: &'p [u8],
}

impl<'p> Sections<'p> {
    pub(super) fn of_plan(plan: &'p [u8]) -> Result<Self, PlanError> {
        let (header, _) = Header::read(plan)?;
        let end = (header.weights_offset as usize).saturating_add(header.weights_len as usize);
        let rest = plan.get(end..);
        Ok(Self { rest: rest.ok_or(PlanError::Truncated { need: end, got: plan.len() })? })
    }

    /// Whether nothing stands behind the last one.
    pub(super) fn is_over(&self) -> bool {
        self.rest.is_empty()
    }
}

impl<'p> Iterator for Sections<'p> {
    type Item = Section<'p>;

    fn next(&mut self) -> Option<Section<'p>> {
        let (magic, rest) = self.rest.split_first_chunk::<8>()?;
        let (length, rest) = rest.split_first_chunk()?;
        let (checksum, rest) = rest.split_first_chunk()?;
        let (body, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
        self.rest = rest;
        let checksum = u32::from_le_bytes(*checksum);
        Some(Section { magic: *magic, length: *length, checksum, body })
    }
}
