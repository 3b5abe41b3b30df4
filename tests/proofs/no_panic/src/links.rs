//! Links: whatever stands in shared memory, and whatever bytes come over a line.

use core::convert::Infallible;
use core::hint::black_box;

use embedded_io::{ErrorType, Read, ReadReady, Write};
use sortie_core::Shape;
use sortie_core::link::{
    ActionRx, ActionTx, AllocRx, AllocTx, Bell, Clock, FrameBlock, FrameRx, FrameTx, LinkError,
    Processor, Serial, Spsc, SpscEnds, StatRx, StatTx, Wake, frame_words, packet_bytes,
};
use sortie_core::plan::Aligned;
use sortie_core::wire::{
    ActionMsg, AllocMsg, FrameFormat, FrameHeader, FrameLayout, FrameMut, Role, StatMsg,
};
use zerocopy::FromBytes;

const SHAPE: Shape = Shape { agents: 2, entities: 3, tasks: 2, actions: 3, features: 5 };

struct Still;

impl Clock for Still {
    fn now_ns(&self) -> u64 {
        black_box(1)
    }
}

impl Processor for Still {}

/// Every message reaches who it is for.
pub(crate) fn on_a_chip() -> Option<bool> {
    let layout = FrameLayout::new(black_box(SHAPE)).ok()?;
    let mut memory = Spsc::<{ frame_words(SHAPE) }, 1, 1>::new();
    let SpscEnds { mut world, agents: [mut agent], allocators: [mut allocator] } =
        black_box(&mut memory).split(&layout, &Still).ok()?;
    let mut header = Aligned([0; size_of::<FrameHeader>()]);
    let header = *black_box(FrameHeader::mut_from_bytes(&mut header.0).ok()?);
    let fill = &mut |payload: &mut [u8]| {
        FrameMut::new(payload, layout).map_err(LinkError::Frame)?;
        Ok(header)
    };
    world.send_frame(fill).ok()?;
    let token = agent.token();
    let status = Aligned([7; size_of::<StatMsg>()]);
    let status = StatMsg::ref_from_bytes(black_box(&status.0)).ok()?;
    let action = Aligned([7; size_of::<ActionMsg>()]);
    let allocation = Aligned([7; size_of::<AllocMsg>()]);
    let sent = (*black_box(ActionMsg::ref_from_bytes(&action.0).ok()?), status.pid);
    let told = *black_box(AllocMsg::ref_from_bytes(&allocation.0).ok()?);
    agent.send_action(&sent.0).ok()?;
    agent.send_status(status).ok()?;
    allocator.send_status(status).ok()?;
    allocator.send_allocation(&told).ok()?;
    allocator.ring(Role::Runner).ok()?;
    let is_woken = agent.wait_until(token, black_box(9)) == Wake::Rung;
    let shown = agent.receive_frames(&mut |frame| frame.header.tick == header.tick).ok()?;
    let _ = allocator.receive_frames(&mut |_| black_box(false)).ok()?;
    let (mut actions, mut statuses, mut allocations) = (0, 0, 0);
    world.receive_actions(&mut |got| actions += u32::from(*got == sent.0)).ok()?;
    world.receive_statuses(&mut |got| statuses += u32::from(got == status)).ok()?;
    world.receive_allocations(&mut |got| allocations += u32::from(*got == told)).ok()?;
    agent.receive_allocations(&mut |got| allocations += u32::from(*got == told)).ok()?;
    let counts = (actions, statuses, allocations, world.missed_actions());
    Some(is_woken && shown && agent.frame().is_some() && counts == (1, 2, 2, 0))
}

/// Brings bytes until there are none left; takes all that is sent.
struct Noise(u64, usize);

impl ErrorType for Noise {
    type Error = Infallible;
}

impl Read for Noise {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Infallible> {
        for byte in bytes.iter_mut() {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            *byte = (self.0 >> 56) as u8;
        }
        self.1 = self.1.saturating_sub(bytes.len());
        // More than there is room would be a fault of the driver.
        Ok(black_box(bytes.len()))
    }
}

impl ReadReady for Noise {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.1 > 0)
    }
}

impl Write for Noise {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        Ok(black_box(bytes.len()))
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// Noise is no message, whatever it is.
pub(crate) fn over_a_line() -> Option<bool> {
    let layout = FrameLayout::new(black_box(SHAPE)).ok()?;
    let format = FrameFormat { layout, schema: black_box(7) };
    let mut memory = [FrameBlock::zeroed(); FrameBlock::for_serial(SHAPE)];
    let mut packet = [0; packet_bytes(SHAPE)];
    let noise = Noise(black_box(3), black_box(100_000));
    let (memory, packet) = (black_box(&mut memory[..]), black_box(&mut packet[..]));
    let mut link = Serial::new(noise, &Still, format, memory, packet).ok()?;
    let shown = link.receive_frames(&mut |_| true).ok()?;
    let mut allocations = 0;
    link.receive_allocations(&mut |_| allocations += 1).ok()?;
    let token = link.token();
    let is_quiet = link.wait_until(token, black_box(0)) == Wake::Timeout;
    let action = Aligned([7; size_of::<ActionMsg>()]);
    link.send_action(black_box(ActionMsg::ref_from_bytes(&action.0).ok()?)).ok()?;
    let status = Aligned([7; size_of::<StatMsg>()]);
    link.send_status(black_box(StatMsg::ref_from_bytes(&status.0).ok()?)).ok()?;
    let heard = *link.counters();
    Some(!shown && allocations == 0 && is_quiet && heard.packets == 0 && heard.damaged() > 0)
}
