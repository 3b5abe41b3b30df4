//! The device at the other end of the line: an emulator whose UART is this program's pipe.

use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::spawn;
use std::time::Duration;

use super::counted::Counted;
use crate::firmware::toolchain::started;
use sortie_cli::failure::{Exit, Failure};

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

/// An emulator that runs.
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
