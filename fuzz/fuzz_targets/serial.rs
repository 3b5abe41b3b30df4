//! A serial line that brings any bytes, and packets with any damage: messages are whole, or none.
#![no_main]

mod input;

use std::convert::Infallible;

use embedded_io::{ErrorType, Read, ReadReady, Write};
use input::Input;
use libfuzzer_sys::fuzz_target;
use sortie_core::Shape;
use sortie_core::internal::checksum::crc32c;
use sortie_core::link::{AllocRx, Clock, FrameBlock, FrameRx, Processor, Serial, packet_bytes};
use sortie_core::wire::{FrameFormat, FrameLayout, FrameView};

const SCHEMA: u64 = 0;

struct Still;

impl Clock for Still {
    fn now_ns(&self) -> u64 {
        0
    }
}

impl Processor for Still {}

/// Brings bytes until they end.
struct Line(Vec<u8>);

impl ErrorType for Line {
    type Error = Infallible;
}

impl Read for Line {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Infallible> {
        let len = bytes.len().min(self.0.len());
        bytes.iter_mut().zip(self.0.drain(..len)).for_each(|(to, from)| *to = from);
        Ok(len)
    }
}

impl ReadReady for Line {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(!self.0.is_empty())
    }
}

impl Write for Line {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// A packet with a right checksum, so that its content is looked at.
fn packet(body: &[u8]) -> Vec<u8> {
    let whole = [body, &crc32c(body).to_le_bytes()].concat();
    let mut line = vec![0];
    let mut runs = whole.split(|byte| *byte == 0).peekable();
    while let Some(mut run) = runs.next() {
        while run.len() >= 254 {
            line.push(255);
            line.extend(&run[..254]);
            run = &run[254..];
        }
        line.push(run.len() as u8 + 1);
        line.extend(run);
    }
    line.push(0);
    line
}

fuzz_target!(|bytes: &[u8]| {
    let mut input = Input(bytes);
    let shape = Shape {
        agents: 1 + input.up_to(3),
        entities: 4 + input.up_to(70),
        tasks: input.up_to(32),
        actions: 1 + input.up_to(5),
        features: 1 + input.up_to(70),
    };
    let layout = FrameLayout::new(shape).expect("a small shape");
    let is_noise = input.byte() % 4 == 0;
    let line = Line(if is_noise { input.0.to_vec() } else { packet(input.0) });
    let mut memory = vec![FrameBlock::zeroed(); FrameBlock::for_serial(shape)];
    let mut room = vec![0; packet_bytes(shape)];
    let format = FrameFormat { layout, schema: SCHEMA };
    let mut link = Serial::new(line, &Still, format, &mut memory, &mut room).expect("room");
    link.receive_frames(&mut |frame| {
        if let Ok(view) = FrameView::new(frame.header, frame.payload, &format) {
            assert!(view.present().iter().all(|entity| entity < shape.entities));
        }
        true
    })
    .expect("the line is whole");
    link.receive_allocations(&mut |message| {
        let _ = message.check(SCHEMA, shape);
    })
    .expect("the line is whole");
    let counters = link.counters();
    assert!(is_noise || counters.packets <= 1);
});
