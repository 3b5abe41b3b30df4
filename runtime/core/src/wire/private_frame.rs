//! What one agent gets of a frame.

use super::{FrameError, FrameHeader, FrameKind, FrameLayout, FrameMut, FrameView};
use crate::policy::NO_ACTION;

impl FrameView<'_> {
    /// Writes the private frame of `layout`'s owner into `payload`, and returns its header. Of what this agent does
    /// not see, no byte is written.
    ///
    /// # Errors
    /// [`FrameError::Length`]: `payload` is not the layout's, or not aligned to 64 bytes; [`FrameError::Layout`]:
    /// the layout is no private one, or of another domain.
    pub fn write_private(
        &self,
        layout: &FrameLayout,
        payload: &mut [u8],
    ) -> Result<FrameHeader, FrameError> {
        let owner = layout.owner().filter(|&owner| self.owner().is_none() && owner < self.agents());
        let owner = owner.filter(|_| self.stride() == layout.stride()).ok_or(FrameError::Layout)?;
        let mut frame = FrameMut::new(payload, *layout)?;
        frame.set_open_tasks(self.open_tasks());
        frame.set_progress(self.step(), self.decision_tick(), self.absent());
        if self.present().contains(owner) {
            self.show(owner, &mut frame);
        }
        let header = *self.header();
        let is_warm_up = header.kind == FrameKind::WarmUp as u16;
        let kind = if is_warm_up { FrameKind::WarmUp } else { FrameKind::Private };
        // The limit of a frame fits the field.
        Ok(FrameHeader { kind: kind as u16, len: layout.payload_bytes() as u32, ..header })
    }

    fn show(&self, owner: usize, frame: &mut FrameMut<'_>) {
        let seen = self.observable(owner).and(&self.present());
        let mut shown = seen;
        shown.insert(owner);
        frame.set_present(&shown);
        frame.set_observable(0, &seen);
        copy(self.available(owner), frame.available_mut(0));
        for (row, entity) in core::iter::once(owner).chain(seen.iter()).enumerate() {
            let tasks = self.entity_task().get(entity).copied().unwrap_or(0);
            frame.set_entity_task(row, tasks);
            let last_action = self.last_actions().get(entity).copied().unwrap_or(NO_ACTION);
            frame.set_last_action(row, last_action);
            let first = entity.saturating_mul(self.stride());
            copy(self.rows().get(first..).unwrap_or_default(), frame.row_mut(row));
        }
    }
}

fn copy<T: Copy>(from: &[T], to: &mut [T]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from;
    }
}
