//! The device at the other end of the line: an emulator whose UART is this program's pipe.

use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::spawn;
use std::time::Duration;

use serde::Serialize;
use sortie_cli::failure::{Exit, Failure};

use crate::firmware::toolchain::started;

/// What sits at the other end of the line.
pub(crate) trait Device {
    /// Gives it bytes, and waits until it rests. Returns what it has sent since, and what it has counted.
    fn exchange(&mut self, bytes: &[u8]) -> Result<(Vec<u8>, Counted), Failure>;

    /// Gives it bytes, and switches it off and on at once. Returns what it says when it has begun anew.
    fn restart(&mut self, bytes: &[u8]) -> Result<(Vec<u8>, Counted), Failure>;
}

/// What an emulator's pipes bring.
enum Said {
    Bytes(Vec<u8>),
    Line(String),
}

/// A board in an emulator.
pub(crate) struct Emulator {
    /// The emulator's command line.
    command: Box<dyn Fn() -> Command>,
    limit: Duration,
    running: Running,
}

struct Running {
    child: Child,
    line: ChildStdin,
    said: Receiver<Said>,
    /// Bytes that it was given.
    given: u32,
    /// Bytes that it has sent, and those of them that have been passed on.
    sent: Vec<u8>,
    passed_on: u32,
    counted: Counted,
    has_rested: bool,
}

impl Emulator {
    /// Switches a board on, which may be silent for so long, and waits until its program rests.
    pub(crate) fn start(
        command: impl Fn() -> Command + 'static,
        limit: Duration,
    ) -> Result<Self, Failure> {
        let running = Running::start(command())?;
        Ok(Self { command: Box::new(command), limit, running })
    }
}

impl Device for Emulator {
    fn exchange(&mut self, bytes: &[u8]) -> Result<(Vec<u8>, Counted), Failure> {
        // Who rests, and is given nothing, has nothing to say.
        if bytes.is_empty() && self.running.has_rested {
            return Ok((Vec::new(), self.running.counted));
        }
        self.running.give(bytes)?;
        self.running.rest(self.limit)
    }

    fn restart(&mut self, bytes: &[u8]) -> Result<(Vec<u8>, Counted), Failure> {
        self.running.give(bytes)?;
        self.running = Running::start((self.command)())?;
        self.running.rest(self.limit)
    }
}

impl Running {
    fn start(mut command: Command) -> Result<Self, Failure> {
        let name = command.get_program().to_string_lossy().into_owned();
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().map_err(|error| started(&name, &error))?;
        let (sender, said) = channel();
        let pipes = (child.stdin.take(), child.stdout.take(), child.stderr.take());
        let (Some(line), Some(bytes), Some(lines)) = pipes else {
            return Err(Failure::new(Exit::Bug, "a child has no pipes"));
        };
        pass_bytes(bytes, sender.clone());
        pass_lines(lines, sender);
        let (sent, counted) = (Vec::new(), Counted::default());
        Ok(Self { child, line, said, given: 0, sent, passed_on: 0, counted, has_rested: false })
    }

    fn give(&mut self, bytes: &[u8]) -> Result<(), Failure> {
        let given = self.line.write_all(bytes).and_then(|()| self.line.flush());
        given.map_err(|error| ended(&error.to_string()))?;
        self.given = self.given.wrapping_add(bytes.len() as u32);
        Ok(())
    }

    /// Waits until the program has read all that it was given, answered, and rests.
    fn rest(&mut self, limit: Duration) -> Result<(Vec<u8>, Counted), Failure> {
        let mut last = String::new();
        let mut rested = None;
        loop {
            if let Some(sent) = rested
                && self.passed_on.wrapping_add(self.sent.len() as u32) == sent
            {
                self.passed_on = sent;
                self.has_rested = true;
                return Ok((std::mem::take(&mut self.sent), self.counted));
            }
            match self.said.recv_timeout(limit) {
                Ok(Said::Bytes(mut bytes)) => self.sent.append(&mut bytes),
                Ok(Said::Line(line)) => {
                    let is_rest = self.counted.read(&line);
                    let is_all = self.counted.rest == u64::from(self.given);
                    rested = (is_rest && is_all).then_some(self.counted.sent as u32);
                    last = line;
                }
                Err(RecvTimeoutError::Disconnected) => return Err(ended(&last)),
                Err(RecvTimeoutError::Timeout) => {
                    let message =
                        format!("the device was silent for {} s: it hangs", limit.as_secs());
                    return Err(Failure::new(Exit::NotRunning, message));
                }
            }
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // Where it has ended by itself there is nobody to be killed.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn ended(last: &str) -> Failure {
    Failure::difference(format!("the program on the board ended: {last}"))
}

/// Reads until the pipe ends, or nobody wants to know.
fn pass_bytes(mut pipe: impl Read + Send + 'static, to: Sender<Said>) {
    spawn(move || {
        let mut bytes = [0; 4096];
        while let Ok(len @ 1..) = pipe.read(&mut bytes) {
            if to.send(Said::Bytes(bytes.iter().take(len).copied().collect())).is_err() {
                break;
            }
        }
    });
}

fn pass_lines(pipe: impl Read + Send + 'static, to: Sender<Said>) {
    spawn(move || {
        for line in BufReader::new(pipe).lines().map_while(Result::ok) {
            if to.send(Said::Line(line)).is_err() {
                break;
            }
        }
    });
}

/// The numbers of the program on the device, by name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub(crate) struct Counted {
    /// Packets with a right checksum.
    pub(crate) packets: u64,
    pub(crate) torn: u64,
    pub(crate) corrupt: u64,
    pub(crate) too_long: u64,
    /// Packets with content that the domain does not have.
    pub(crate) refused: u64,
    /// Frames that came behind a newer one which waited.
    pub(crate) overtaken: u64,
    /// Messages of another schema.
    pub(crate) foreign: u64,
    pub(crate) bad: u64,
    /// Frames and allocations that were older than the newest, or came once more.
    pub(crate) old: u64,
    /// Frames that it decided on.
    pub(crate) decided: u64,
    /// Decisions by the last allocation, when that of the frame had not come in time.
    pub(crate) stale: u64,
    /// Decisions without one.
    pub(crate) unallocated: u64,
    pub(crate) fallbacks: u64,
    /// Bytes.
    #[serde(skip)]
    pub(crate) sent: u64,
    #[serde(skip)]
    pub(crate) rest: u64,
}

impl Counted {
    /// The numbers with their names.
    pub(crate) fn named(&mut self) -> [(&'static str, &mut u64); 15] {
        [
            ("packets", &mut self.packets),
            ("torn", &mut self.torn),
            ("corrupt", &mut self.corrupt),
            ("too-long", &mut self.too_long),
            ("refused", &mut self.refused),
            ("overtaken", &mut self.overtaken),
            ("foreign", &mut self.foreign),
            ("bad", &mut self.bad),
            ("old", &mut self.old),
            ("decided", &mut self.decided),
            ("stale", &mut self.stale),
            ("unallocated", &mut self.unallocated),
            ("fallbacks", &mut self.fallbacks),
            ("sent", &mut self.sent),
            ("rest", &mut self.rest),
        ]
    }

    /// Takes a line of the console; others are somebody else's. Returns whether it is the last of them.
    pub(crate) fn read(&mut self, line: &str) -> bool {
        let Some((name, number)) = line.split_once(' ') else { return false };
        let Ok(number) = u64::from_str_radix(number, 16) else { return false };
        if let Some((_, to)) = self.named().into_iter().find(|(own, _)| *own == name) {
            *to = number;
        }
        name == "rest"
    }

    /// Pieces between zeros that it has counted: each is a packet, or was damaged.
    pub(crate) fn pieces(&self) -> u64 {
        self.packets + self.torn + self.corrupt + self.too_long
    }

    /// Adds what another incarnation counted.
    pub(crate) fn add(&mut self, mut other: Self) {
        for ((_, to), (_, from)) in self.named().into_iter().zip(other.named()) {
            *to += *from;
        }
    }
}
