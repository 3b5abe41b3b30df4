//! The microcontroller's end of a line.

use embedded_io::{Read, ReadReady, Write};
use heapless::Deque;
use zerocopy::IntoBytes;

use super::line::{Broken, Line, LineCounters};
use super::packet::{
    ActionPacket, FramePacket, Packer, Packet, SMALL_PACKET, StatusPacket, Unpacker,
};
use super::view;
use crate::link::{
    ActionTx, AllocRx, Bell, Clock, Frame, FrameBlock, FrameRx, LinkError, Processor, StatTx, Wake,
};
use crate::wire::{ActionMsg, AllocMsg, FrameError, FrameFormat, FrameHeader, Role, StatMsg};

/// Allocations that wait for the runner; the oldest gives way.
const ALLOCATIONS: usize = 4;

/// A runner's link over a serial line, at whose other end a [`Relay`](super::Relay) belongs to the team.
///
/// Frames show what the runner's agents see, and nothing else. There is no common clock: a frame's
/// times are when its first byte was seen, and how long its deadline was away when it was sent.
pub struct Serial<'b, IO> {
    line: Line<IO, &'b mut [u8]>,
    processor: &'b dyn Processor,
    format: FrameFormat,
    kept: Slot<'b>,
    spare: Slot<'b>,
    /// `spare` holds a frame that nobody has been shown.
    is_waiting: bool,
    allocations: Deque<AllocMsg, ALLOCATIONS>,
}

struct Slot<'b> {
    /// `None`: there is no frame.
    header: Option<FrameHeader>,
    payload: &'b mut [FrameBlock],
}

impl Slot<'_> {
    fn frame(&self) -> Option<Frame<'_>> {
        let header = self.header.as_ref()?;
        Some(Frame { header, payload: self.payload.as_bytes() })
    }

    /// Whether the frame is of this domain, and not older than that which arrives.
    fn overtakes(&self, arriving: &FramePacket, schema: u64) -> bool {
        self.header.is_some_and(|own| own.fits(schema) && own.tick >= arriving.tick)
    }
}

impl<'b, IO: Read + ReadReady + Write> Serial<'b, IO> {
    /// `memory` holds two payloads of the format, `packet` as many bytes as a frame's packet may have:
    /// [`packet_bytes`](super::packet_bytes) at most.
    ///
    /// # Errors
    /// [`FrameError::Length`]: `memory` is too small.
    pub fn new(
        io: IO,
        processor: &'b dyn Processor,
        format: FrameFormat,
        memory: &'b mut [FrameBlock],
        packet: &'b mut [u8],
    ) -> Result<Self, LinkError> {
        let blocks = format.layout.payload_bytes() / size_of::<FrameBlock>();
        let too_small = LinkError::Frame(FrameError::Length);
        let (kept, rest) = memory.split_at_mut_checked(blocks).ok_or(too_small)?;
        let (spare, _) = rest.split_at_mut_checked(blocks).ok_or(too_small)?;
        Ok(Self {
            line: Line::new(io, packet),
            processor,
            format,
            kept: Slot { header: None, payload: kept },
            spare: Slot { header: None, payload: spare },
            is_waiting: false,
            allocations: Deque::new(),
        })
    }

    /// What came over the line.
    pub fn counters(&self) -> &LineCounters {
        &self.line.counters
    }

    /// Takes in what has arrived. Of the frames, the newest stays.
    fn pump(&mut self) -> Result<(), Broken> {
        let Self { line, processor, format, spare, .. } = self;
        while let Some((bytes, started_ns)) = line.receive(*processor)? {
            let mut packet = Unpacker(bytes);
            let taken = match packet.take() {
                Some(Packet::Frame(head))
                    if self.is_waiting && spare.overtakes(&head, format.schema) =>
                {
                    line.counters.overtaken += 1;
                    true
                }
                Some(Packet::Frame(head)) => {
                    let payload = spare.payload.as_mut_bytes();
                    let FrameFormat { layout, schema } = &*format;
                    spare.header = view::read(&head, packet, layout, *schema, started_ns, payload);
                    self.is_waiting = spare.header.is_some();
                    self.is_waiting
                }
                Some(Packet::Allocation(allocation)) if packet.is_empty() => {
                    let message = allocation.message(processor.now_ns());
                    message.is_some_and(|message| {
                        if self.allocations.is_full() {
                            self.allocations.pop_front();
                        }
                        self.allocations.push_back(message).is_ok()
                    })
                }
                _ => false,
            };
            if !taken {
                line.counters.refused += 1;
            }
        }
        Ok(())
    }

    fn send(&mut self, packet: &Packet<'_>) -> Option<()> {
        let mut bytes = [0; SMALL_PACKET];
        let mut packer = Packer::new(&mut bytes);
        packer.put(packet)?;
        self.line.send(packer.seal()?).ok()
    }
}

impl<IO: Read + ReadReady + Write> FrameRx for Serial<'_, IO> {
    fn receive_frames(
        &mut self,
        accept: &mut dyn FnMut(Frame<'_>) -> bool,
    ) -> Result<bool, LinkError> {
        self.pump().map_err(|Broken| LinkError::Frames)?;
        let is_waiting = core::mem::take(&mut self.is_waiting);
        let waiting = if is_waiting { self.spare.frame() } else { None };
        let is_accepted = waiting.is_some_and(accept);
        if is_accepted {
            core::mem::swap(&mut self.kept, &mut self.spare);
        }
        Ok(is_accepted)
    }

    fn frame(&self) -> Option<Frame<'_>> {
        self.kept.frame()
    }
}

impl<IO: Read + ReadReady + Write> AllocRx for Serial<'_, IO> {
    fn receive_allocations(&mut self, take: &mut dyn FnMut(&AllocMsg)) -> Result<(), LinkError> {
        self.pump().map_err(|Broken| LinkError::Allocations)?;
        while let Some(allocation) = self.allocations.pop_front() {
            take(&allocation);
        }
        Ok(())
    }
}

impl<IO: Read + ReadReady + Write> ActionTx for Serial<'_, IO> {
    fn send_action(&mut self, action: &ActionMsg) -> Result<(), LinkError> {
        let packet = Packet::Action(ActionPacket::new(action));
        self.send(&packet).ok_or(LinkError::Actions)
    }
}

impl<IO: Read + ReadReady + Write> StatTx for Serial<'_, IO> {
    fn send_status(&mut self, status: &StatMsg) -> Result<(), LinkError> {
        let packet = Packet::Status(StatusPacket::new(status));
        self.send(&packet).ok_or(LinkError::Statuses)
    }
}

impl<IO: Read + ReadReady + Write> Bell for Serial<'_, IO> {
    /// Whatever comes wakes; nothing else does.
    fn token(&self) -> u32 {
        self.line.counters.packets as u32
    }

    fn wait_until(&mut self, token: u32, until_ns: u64) -> Wake {
        // A line that fails is told to whoever reads next.
        while self.pump().is_ok() && self.token() == token {
            if self.processor.now_ns() >= until_ns {
                return Wake::Timeout;
            }
            self.processor.rest();
        }
        Wake::Rung
    }

    /// The relay rings for what it is sent.
    fn ring(&mut self, _role: Role) -> Result<(), LinkError> {
        Ok(())
    }
}

impl<IO> Clock for Serial<'_, IO> {
    fn now_ns(&self) -> u64 {
        self.processor.now_ns()
    }
}

impl FrameBlock {
    /// As many as the two payloads of a [`Serial`] need, for frames of `shape`.
    pub const fn for_serial(shape: crate::Shape) -> usize {
        2 * crate::wire::payload_bytes(shape) / size_of::<Self>()
    }
}
