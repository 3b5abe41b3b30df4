//! A line between hosts that brings any datagram, and any words with a right session and checksum: a runner's end, and both ends of
//! an allocator's, hear them or drop them, never a panic.
#![no_main]

mod input;

use std::collections::VecDeque;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, OnceLock, Weak};
use std::time::Duration;

use embedded_io::Write;
use input::Input;
use libfuzzer_sys::fuzz_target;
use sortie_core::{AllocateError, AllocationState, Allocator, EntityMask, Shape, UNASSIGNED};
use sortie_line::{
    AllocatorAtHome, Away, Carrier, FarAllocator, Hear, Home, Joining, Key, LineSettings, Offer,
    Team,
};

const SHAPE: Shape = Shape { agents: 3, entities: 5, tasks: 2, actions: 4, features: 2 };
const OFFER: Offer = Offer { abi: 3, contract: 7, model: [1; 16], agents: 0 };

/// One end of a line within this program.
#[derive(Default)]
struct End {
    coming: Mutex<VecDeque<Vec<u8>>>,
    other: OnceLock<Weak<End>>,
    hear: OnceLock<Hear>,
}

impl End {
    fn pair() -> [Arc<Self>; 2] {
        let ends = [Arc::<Self>::default(), Arc::<Self>::default()];
        let _ = ends[0].other.set(Arc::downgrade(&ends[1]));
        let _ = ends[1].other.set(Arc::downgrade(&ends[0]));
        ends
    }

    /// Who hears is told at once, everybody else has it when it looks.
    fn bring(&self, datagram: &[u8]) {
        match self.hear.get() {
            Some(hear) => hear(datagram, None),
            None => self.coming.lock().unwrap().push_back(datagram.to_vec()),
        }
    }
}

impl Carrier for End {
    fn send(&self, datagram: &[u8], _: Option<SocketAddr>) {
        if let Some(other) = self.other.get().and_then(Weak::upgrade) {
            other.bring(datagram);
        }
    }

    fn receive(&self, room: &mut [u8]) -> Option<(usize, Option<SocketAddr>)> {
        let datagram = self.coming.lock().unwrap().pop_front()?;
        let len = datagram.len().min(room.len());
        room[..len].copy_from_slice(&datagram[..len]);
        Some((len, None))
    }

    fn wait(&self, _: Duration) {}

    fn address(&self) -> String {
        "here".to_owned()
    }

    fn call(&self, hear: Hear) -> Result<(), Hear> {
        self.hear.set(hear)
    }
}

fn settings(end: &Arc<End>) -> LineSettings {
    LineSettings { carrier: end.clone(), key: Key::plain(), copies: 1 }
}

fn judge(offer: &Offer) -> Result<Team, String> {
    if *offer == OFFER { Ok(Team::new(SHAPE, 0, 65)) } else { Err("another one".to_owned()) }
}

/// The far end of a line whose other end listens.
fn joined(end: &Arc<End>) -> Away {
    let mut joining = Joining::new(settings(end), &OFFER).unwrap();
    loop {
        if let Some(taken) = joining.poll().unwrap() {
            return taken.line;
        }
    }
}

/// Takes whatever state it is asked about.
struct FirstOpen;

impl Allocator for FirstOpen {
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        state.check(allocation)?;
        allocation.fill(if state.open_tasks == 0 { UNASSIGNED } else { 0 });
        Ok(())
    }
}

/// Words of an allocator elsewhere, to who stands in for it.
fn said_by_the_allocator(words: &[u8]) {
    let [near, far] = End::pair();
    let home = AllocatorAtHome::open(settings(&near), judge, Duration::ZERO, || ()).unwrap();
    let mut line = joined(&far);
    line.write_all(words).unwrap();
    line.send();
    home.tend();
    let state = AllocationState {
        agents: 3,
        tasks: 2,
        rows: &[0.0; 10],
        stride: 2,
        present: EntityMask::from_words(&[0b11111]),
        entity_task: &[0; 5],
        open_tasks: 0b11,
        available: &[1; 12],
    };
    let mut allocation = [UNASSIGNED; 3];
    let _ = (&home).allocate(&state, &mut allocation);
    // The answer to the question, whose number is one.
    line.write_all(words).unwrap();
    line.send();
    home.tend();
}

/// Words of a team, to an allocator elsewhere.
fn said_by_the_team(words: &[u8]) {
    let [near, far] = End::pair();
    let home = Home::open(settings(&near), judge, || ()).unwrap();
    let mut allocator = FarAllocator::new(joined(&far));
    home.port().write_all(words).unwrap();
    home.send();
    for _ in 0..4 {
        allocator.poll(&mut FirstOpen);
    }
}

/// Any datagrams, to both ends.
fn on_the_line(mut input: Input<'_>) {
    let [near, far] = End::pair();
    let home = Home::open(settings(&near), judge, || ()).unwrap();
    let mut allocator = FarAllocator::new(joined(&far));
    while !input.0.is_empty() {
        let len = input.up_to(200);
        let datagram = input.bytes(len);
        near.bring(datagram);
        far.bring(datagram);
        allocator.poll(&mut FirstOpen);
    }
    drop(home);
}

fuzz_target!(|bytes: &[u8]| {
    let mut input = Input(bytes);
    match input.byte() % 3 {
        0 => said_by_the_allocator(input.0),
        1 => said_by_the_team(input.0),
        _ => on_the_line(input),
    }
});
