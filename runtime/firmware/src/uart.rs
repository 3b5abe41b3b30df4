//! The board's UART as links over serial lines take it.

use core::cell::Cell;
use core::convert::Infallible;

use embedded_io::{ErrorType, Read, ReadReady, Write};

use crate::port;

/// Bytes that came and went.
#[derive(Debug, Default)]
pub(crate) struct Traffic {
    pub(crate) read: Cell<u32>,
    pub(crate) sent: Cell<u32>,
}

/// The UART; there is one.
pub(crate) struct Uart<'t>(&'t Traffic);

impl<'t> Uart<'t> {
    /// Switches it on.
    pub(crate) fn new(traffic: &'t Traffic) -> Self {
        port::start();
        Self(traffic)
    }
}

impl ErrorType for Uart<'_> {
    type Error = Infallible;
}

impl ReadReady for Uart<'_> {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(port::holds_byte())
    }
}

impl Read for Uart<'_> {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Infallible> {
        let mut len = 0;
        for place in bytes {
            if !port::holds_byte() {
                break;
            }
            *place = port::take();
            len += 1;
        }
        self.0.read.set(self.0.read.get().wrapping_add(len as u32));
        Ok(len)
    }
}

impl Write for Uart<'_> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        bytes.iter().copied().for_each(port::send);
        self.0.sent.set(self.0.sent.get().wrapping_add(bytes.len() as u32));
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}
