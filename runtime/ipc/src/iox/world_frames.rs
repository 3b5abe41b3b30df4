//! How a world's frames reach their readers: one for all, or one for each agent.

use iceoryx2::port::update_connections::UpdateConnections;
use sortie_core::link::{FrameBlock, LinkError};
use sortie_core::wire::{FrameFormat, FrameHeader, FrameLayout, FrameView};
use zerocopy::IntoBytes;

use super::LinkService;
use super::message::{FrameHeaderPayload, Message};
use super::opener::{FrameSender, Opener};
use crate::error::Error;

/// Writes a frame in place and returns its header.
type Fill<'a> = &'a mut dyn FnMut(&mut [u8]) -> Result<FrameHeader, LinkError>;

/// The frame topics of a world.
pub(super) struct WorldFrames<S: LinkService> {
    format: FrameFormat,
    /// All agents' observations: for all in a domain that shares its frames, else for the allocator, if there is one.
    whole: Option<FrameSender<S>>,
    /// One topic for each agent of a domain whose frames are private.
    private: Vec<(FrameLayout, FrameSender<S>)>,
    /// Where a frame is written that nobody gets as a whole.
    unsent: Vec<FrameBlock>,
}

impl<S: LinkService> WorldFrames<S> {
    pub(super) fn shared(opener: &Opener<'_, S>) -> Result<Self, Error> {
        let format = opener.setup().format;
        let whole = Some(opener.frame_sender(&format.layout)?);
        Ok(Self { format, whole, private: Vec::new(), unsent: Vec::new() })
    }

    pub(super) fn private(opener: &Opener<'_, S>, has_allocator: bool) -> Result<Self, Error> {
        let format = opener.setup().format;
        let whole = has_allocator.then(|| opener.frame_sender(&format.layout)).transpose()?;
        let shape = format.layout.shape();
        let of_agent = |agent| {
            let layout = FrameLayout::private(shape, agent)?;
            Ok((layout, opener.frame_sender(&layout)?))
        };
        let private = (0..shape.agents).map(of_agent).collect::<Result<_, Error>>()?;
        let blocks = format.layout.payload_bytes() / size_of::<FrameBlock>();
        let blocks = if has_allocator { 0 } else { blocks };
        Ok(Self { format, whole, private, unsent: vec![FrameBlock::zeroed(); blocks] })
    }

    pub(super) fn update_connections(&self) {
        let senders = self.private.iter().map(|(_, sender)| sender).chain(&self.whole);
        for sender in senders {
            // A connection that fails is tried again at the next heartbeat.
            let _ = sender.update_connections();
        }
    }

    /// Sends one frame; each agent's own part of it where frames are private.
    pub(super) fn send(&mut self, fill: Fill<'_>) -> Result<(), LinkError> {
        let Self { format, whole, private, unsent } = self;
        let Some(whole) = whole else {
            let header = fill(unsent.as_mut_bytes())?;
            return send_parts(private, &header, unsent.as_bytes(), format);
        };
        let bytes = format.layout.payload_bytes();
        let mut sample = whole.loan_slice(bytes).map_err(|_| LinkError::Frames)?;
        let header = fill(sample.payload_mut())?;
        send_parts(private, &header, sample.payload(), format)?;
        *sample.user_header_mut() = FrameHeaderPayload::wrap(&header);
        sample.send().map(drop).map_err(|_| LinkError::Frames)
    }
}

/// Cuts a frame that was just written.
fn send_parts<S: LinkService>(
    private: &[(FrameLayout, FrameSender<S>)],
    header: &FrameHeader,
    payload: &[u8],
    format: &FrameFormat,
) -> Result<(), LinkError> {
    if private.is_empty() {
        return Ok(());
    }
    let view = FrameView::new(header, payload, format).map_err(LinkError::Frame)?;
    for (layout, sender) in private {
        let loaned = sender.loan_slice(layout.payload_bytes());
        let mut sample = loaned.map_err(|_| LinkError::Frames)?;
        let header = view.write_private(layout, sample.payload_mut()).map_err(LinkError::Frame)?;
        *sample.user_header_mut() = FrameHeaderPayload::wrap(&header);
        sample.send().map_err(|_| LinkError::Frames)?;
    }
    Ok(())
}
