//! Links: whatever bytes come over a line.

use core::convert::Infallible;
use core::hint::black_box;

use embedded_io::{ErrorType, Read, ReadReady, Write};
use sortie_core::Shape;
use sortie_core::link::{
    ActionTx, AllocRx, Bell, Clock, FrameBlock, FrameRx, Processor, Serial, StatTx, Wake,
    packet_bytes,
};
use sortie_core::plan::Aligned;
use sortie_core::wire::{ActionMsg, FrameFormat, FrameLayout, StatMsg};
use zerocopy::FromBytes;

const SHAPE: Shape = Shape { agents: 2, entities: 3, tasks: 2, actions: 3, features: 5 };

struct Still;

impl Clock for Still {
    fn now_ns(&self) -> u64 {
        black_box(1)
    }
}

impl Processor for Still {}

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
