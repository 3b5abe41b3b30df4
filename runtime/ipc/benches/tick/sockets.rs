//! Unix datagram sockets: the world sends every agent the frame, and receives its answer.

use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::time::Instant;

use super::{AGENTS, FRAME_WORDS, decide};

/// Bytes of a frame, and of an action.
const FRAME: usize = 8 * FRAME_WORDS;
const ACTION: usize = 64;

fn world_path(place: &Path) -> PathBuf {
    place.join("world")
}

fn agent_path(place: &Path, agent: usize) -> PathBuf {
    place.join(agent.to_string())
}

/// An agent: answers every tick until the last.
pub(crate) fn agent(place: &Path, agent: usize) {
    let socket = UnixDatagram::bind(agent_path(place, agent)).unwrap();
    socket.connect(world_path(place)).unwrap();
    let mut frame = [0_u8; FRAME];
    // Says that it is there.
    socket.send(&[0; ACTION]).unwrap();
    while socket.recv(&mut frame).unwrap() == FRAME {
        let sum = frame.iter().fold(0, |sum, byte| sum ^ byte);
        std::hint::black_box(sum);
        decide(1);
        socket.send(&[1; ACTION]).unwrap();
    }
}

/// Makes the place of the sockets; before the first agent is started.
pub(crate) fn world_socket(place: &Path) -> UnixDatagram {
    std::fs::create_dir(place).unwrap();
    UnixDatagram::bind(world_path(place)).unwrap()
}

/// The world: times so many ticks, in nanoseconds.
pub(crate) fn world(socket: &UnixDatagram, place: &Path, ticks: usize) -> Vec<u64> {
    let agents: Vec<PathBuf> = (0..AGENTS).map(|agent| agent_path(place, agent)).collect();
    let await_all = || {
        for _ in 0..AGENTS {
            assert_eq!(socket.recv(&mut [0; ACTION]).unwrap(), ACTION);
        }
    };
    await_all();
    let mut times = Vec::with_capacity(ticks);
    for tick in 0..ticks {
        let started = Instant::now();
        let frame = [tick as u8; FRAME];
        for agent in &agents {
            socket.send_to(&frame, agent).unwrap();
        }
        await_all();
        times.push(started.elapsed().as_nanos() as u64);
    }
    for agent in &agents {
        socket.send_to(&[], agent).unwrap();
    }
    times
}
