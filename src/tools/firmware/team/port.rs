//! The relay's end of the line, in memory.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::rc::Rc;

use embedded_io::{ErrorType, Read, ReadReady, Write};

/// One end of a line: what is written goes, packet by packet, and what has come is read. Copies are the same end.
#[derive(Clone, Debug, Default)]
pub(crate) struct Port(Rc<RefCell<Ends>>);

#[derive(Debug, Default)]
struct Ends {
    begun: Vec<u8>,
    goes: Vec<Vec<u8>>,
    comes: VecDeque<u8>,
}

impl Port {
    /// The packets that were written since the last call.
    pub(crate) fn take(&self) -> Vec<Vec<u8>> {
        std::mem::take(&mut self.0.borrow_mut().goes)
    }

    /// Bytes come.
    pub(crate) fn bring(&self, bytes: &[u8]) {
        self.0.borrow_mut().comes.extend(bytes);
    }
}

impl ErrorType for Port {
    type Error = Infallible;
}

impl Read for Port {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Infallible> {
        let comes = &mut self.0.borrow_mut().comes;
        let len = comes.len().min(bytes.len());
        bytes.iter_mut().zip(comes.drain(..len)).for_each(|(to, from)| *to = from);
        Ok(len)
    }
}

impl ReadReady for Port {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(!self.0.borrow().comes.is_empty())
    }
}

impl Write for Port {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        self.0.borrow_mut().begun.extend(bytes);
        Ok(bytes.len())
    }

    /// A packet ends.
    fn flush(&mut self) -> Result<(), Infallible> {
        let mut ends = self.0.borrow_mut();
        let packet = std::mem::take(&mut ends.begun);
        ends.goes.push(packet);
        Ok(())
    }
}
