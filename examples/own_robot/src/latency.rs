//! How long a decision takes: called directly, over shared memory, and over a Unix socket with the same bytes.

use std::error::Error;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};
use std::{env, fs};

use sortie_core::plan::AlignedBytes;
use sortie_core::wire::{AnswerHead, AnswerStatus, MessageError, ObservationHead, ServedFormat};

use crate::connect;
use crate::direct::Direct;

/// What the process at the other end of the socket is started with.
pub(crate) const ANSWER: &str = "answer";
const ROUNDS: usize = 20;
/// Decisions of each kind in a round.
const DECISIONS: usize = 500;
/// Decisions of each kind before those that count.
const WARM: usize = 100;

/// Alternates the three in rounds, with a pause before every decision.
pub(crate) fn measure(pause: Duration) -> Result<(), Box<dyn Error>> {
    let (mut direct, mut served, mut socket) = (Direct::new()?, connect()?, Socket::open()?);
    let mut calls = || direct.force(0.5).map(drop).map_err(Into::into);
    let mut asks = || match served.decide(&[&[0.5]], &[])?.status {
        AnswerStatus::Answered => Ok(()),
        status => Err(format!("{status:?}: give the server a longer `--deadline-ms`").into()),
    };
    let mut sends = || socket.force(0.5).map(drop);
    type Decide<'a> = &'a mut dyn FnMut() -> Result<(), Box<dyn Error>>;
    let mut kinds: [(&str, Decide<'_>, Vec<Duration>); 3] = [
        ("direct call", &mut calls, Vec::new()),
        ("shared memory", &mut asks, Vec::new()),
        ("Unix datagrams", &mut sends, Vec::new()),
    ];
    for _ in 0..ROUNDS {
        for (_, decide, took) in &mut kinds {
            for decision in 0..WARM + DECISIONS {
                if !pause.is_zero() {
                    std::thread::sleep(pause);
                }
                let asked = Instant::now();
                decide()?;
                if decision >= WARM {
                    took.push(asked.elapsed());
                }
            }
        }
    }
    for (name, _, took) in &mut kinds {
        print(name, took);
    }
    Ok(())
}

/// Median and 99th percentile.
pub(crate) fn print(name: &str, took: &mut [Duration]) {
    took.sort_unstable();
    let at = |share: usize| took[(took.len() - 1) * share / 100].as_nanos() as f64 / 1000.0;
    println!("{name:15} p50 {:8.2} us  p99 {:8.2} us", at(50), at(99));
}

fn format() -> Result<ServedFormat, MessageError> {
    ServedFormat::new(0, 1, 1, 0)
}

/// The policy in a process at the other end of a socket.
struct Socket {
    socket: UnixDatagram,
    format: ServedFormat,
    observation: AlignedBytes,
    answer: AlignedBytes,
}

impl Socket {
    fn open() -> Result<Self, Box<dyn Error>> {
        let folder = env::temp_dir().join(format!("own-robot-{}", std::process::id()));
        fs::create_dir(&folder)?;
        let socket = UnixDatagram::bind(folder.join("robot"))?;
        Command::new(env::current_exe()?).arg(ANSWER).arg(&folder).spawn()?;
        // It is there once it has sent something.
        socket.recv(&mut [0])?;
        socket.connect(folder.join("policy"))?;
        fs::remove_dir_all(folder)?;
        let format = format()?;
        let observation = AlignedBytes::zeroed(format.observation_bytes());
        let answer = AlignedBytes::zeroed(format.answer_bytes());
        Ok(Self { socket, format, observation, answer })
    }

    fn force(&mut self, position: f32) -> Result<f32, Box<dyn Error>> {
        let bytes = self.observation.as_mut_slice();
        self.format.write_observation(&ObservationHead::default(), &[&[position]], &[], bytes)?;
        self.socket.send(bytes)?;
        self.socket.recv(self.answer.as_mut_slice())?;
        Ok(self.format.read_answer(self.answer.as_slice())?.outputs[0])
    }
}

impl Drop for Socket {
    fn drop(&mut self) {
        // An empty message ends the other process.
        let _ = self.socket.send(&[]);
    }
}

/// The process at the other end.
pub(crate) fn answer(folder: &Path) -> Result<(), Box<dyn Error>> {
    let (mut policy, format) = (Direct::new()?, format()?);
    let socket = UnixDatagram::bind(folder.join("policy"))?;
    socket.connect(folder.join("robot"))?;
    socket.send(&[1])?;
    let mut observation = AlignedBytes::zeroed(format.observation_bytes());
    let mut answer = AlignedBytes::zeroed(format.answer_bytes());
    while socket.recv(observation.as_mut_slice())? > 0 {
        let view = format.read_observation(observation.as_slice())?;
        let force = policy.force(view.inputs[0])?;
        format.write_answer(&AnswerHead::default(), &[force], answer.as_mut_slice())?;
        socket.send(answer.as_slice())?;
    }
    Ok(())
}
