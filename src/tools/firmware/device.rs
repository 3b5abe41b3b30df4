//! What the program on the board tells.

use std::collections::BTreeMap;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use super::toolchain::started;
use sortie_cli::failure::{Exit, Failure};

/// How often an emulator is asked whether it has ended.
const PAUSE: Duration = Duration::from_millis(10);

/// The numbers that a program told, by name.
pub(crate) struct Told(BTreeMap<String, u64>);

impl Told {
    /// Runs an emulator to its end, `limit` at most.
    pub(crate) fn by(mut emulator: Command, limit: Duration) -> Result<Self, Failure> {
        let name = emulator.get_program().to_string_lossy().into_owned();
        emulator.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = emulator.spawn().map_err(|error| started(&name, &error))?;
        let failed = |error: std::io::Error| started(&name, &error);
        let begun = Instant::now();
        while child.try_wait().map_err(failed)?.is_none() {
            if begun.elapsed() > limit {
                child.kill().map_err(failed)?;
                child.wait().map_err(failed)?;
                let message = format!("the board did not end within {} s", limit.as_secs());
                return Err(Failure::new(Exit::NotRunning, message));
            }
            sleep(PAUSE);
        }
        let output = child.wait_with_output().map_err(failed)?;
        // Where the console is depends on the emulator.
        let said = [output.stdout, output.stderr].concat();
        let said = String::from_utf8_lossy(&said);
        if output.status.success() {
            return Ok(Self::read(&said));
        }
        let last = said.lines().rfind(|line| !line.is_empty()).unwrap_or("nothing was said");
        Err(Failure::difference(format!("the program on the board failed: {last}")))
    }

    /// Reads lines of a name and a number in hexadecimal digits; others are somebody else's.
    fn read(said: &str) -> Self {
        let line = |line: &str| {
            let (name, number) = line.split_once(' ')?;
            let number = u64::from_str_radix(number, 16).ok().filter(|_| number.len() == 16)?;
            Some((name.to_owned(), number))
        };
        Self(said.lines().filter_map(line).collect())
    }

    /// A number.
    pub(crate) fn number(&self, name: &str) -> Result<u64, Failure> {
        let missing =
            || Failure::new(Exit::Bug, format!("the board told no `{name}`; please report this"));
        self.0.get(name).copied().ok_or_else(missing)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(line: &str) -> Command {
        let mut shell = Command::new("sh");
        shell.args(["-c", line]);
        shell
    }

    #[test]
    fn a_program_tells_numbers_and_why_it_failed() {
        let limit = Duration::from_secs(60);
        let told =
            Told::by(shell("echo hash 00000000000000ff; echo qemu: note 12"), limit).unwrap();
        assert_eq!(told.number("hash").unwrap(), 255);
        assert_eq!(told.number("qemu:").map_err(|failure| failure.exit), Err(Exit::Bug));
        let failed = Told::by(shell("echo the plan is refused; echo; exit 3"), limit).map(drop);
        let failed = failed.unwrap_err();
        assert_eq!(failed.exit, Exit::Difference);
        assert!(failed.message.ends_with(": the plan is refused"), "{}", failed.message);
    }

    #[test]
    fn a_program_that_hangs_is_ended() {
        let failed = Told::by(shell("exec sleep 600"), Duration::from_millis(50)).map(drop);
        assert_eq!(failed.unwrap_err().exit, Exit::NotRunning);
    }
}
