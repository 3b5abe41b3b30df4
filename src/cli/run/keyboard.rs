//! Keys of the live view: space pauses, `q` quits.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use console::Term;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::getpgrp;
use rustix::stdio::stdin;
use rustix::termios::{
    LocalModes, OptionalActions, SpecialCodeIndex, Termios, tcgetattr, tcgetpgrp, tcsetattr,
};
use sortie_ipc::Stop;

/// Longest time until a stop is noticed, and so until the terminal is as it was: much less than two signals in a row
/// must lie apart to end the program at once.
const LOOK: Duration = Duration::from_millis(50);

/// A thread that reads keys while the terminal passes on each of them at once.
pub(super) struct Keyboard {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

struct Shared {
    stop: Stop,
    is_done: AtomicBool,
    is_paused: Mutex<bool>,
    resumed: Condvar,
}

impl Keyboard {
    /// Begins to read, where standard input is a terminal and this process may read from it.
    pub(super) fn open(stop: &Stop) -> Option<Self> {
        let modes = Modes::of_terminal().filter(|_| is_foreground())?;
        let shared = Arc::new(Shared {
            stop: stop.clone(),
            is_done: AtomicBool::new(false),
            is_paused: Mutex::new(false),
            resumed: Condvar::new(),
        });
        let reading = Arc::clone(&shared);
        let thread = thread::Builder::new().spawn(move || reading.read(&modes)).ok()?;
        Some(Self { shared, thread: Some(thread) })
    }

    pub(super) fn is_paused(&self) -> bool {
        *self.shared.is_paused.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns when the run may go on, or is to end.
    pub(super) fn wait_while_paused(&self) {
        let paused = self.shared.is_paused.lock().unwrap_or_else(PoisonError::into_inner);
        drop(self.shared.resumed.wait_while(paused, |is_paused| *is_paused));
    }
}

impl Drop for Keyboard {
    fn drop(&mut self) {
        self.shared.is_done.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

impl Shared {
    /// Reads until the run ends, however it ends: by its last episode, a key, a signal or a panic.
    fn read(&self, modes: &Modes) {
        while !self.is_done.load(Ordering::Relaxed) && !self.stop.is_set() {
            if !is_foreground() {
                thread::park_timeout(LOOK);
                continue;
            }
            modes.enter();
            match next_key() {
                Ok(Some(b' ')) => self.set_paused(|is_paused| !is_paused),
                Ok(Some(b'q' | b'Q')) => self.stop.stop(),
                Ok(_) => {}
                Err(_) => break,
            }
        }
        modes.leave();
        self.set_paused(|_| false);
    }

    fn set_paused(&self, change: impl FnOnce(bool) -> bool) {
        let mut is_paused = self.is_paused.lock().unwrap_or_else(PoisonError::into_inner);
        *is_paused = change(*is_paused);
        self.resumed.notify_all();
    }
}

/// Whether this process may read from the terminal: one in the background would be stopped.
fn is_foreground() -> bool {
    tcgetpgrp(stdin()).is_ok_and(|group| group == getpgrp())
}

/// The next key, if one comes soon.
///
/// # Errors
/// The terminal is gone.
fn next_key() -> rustix::io::Result<Option<u8>> {
    let pause = Timespec { tv_sec: 0, tv_nsec: LOOK.subsec_nanos().into() };
    let input = stdin();
    match poll(&mut [PollFd::new(&input, PollFlags::IN)], Some(&pause)) {
        Ok(0) | Err(rustix::io::Errno::INTR) => return Ok(None),
        Ok(_) => {}
        Err(error) => return Err(error),
    }
    let mut key = [0];
    match rustix::io::read(input, &mut key)? {
        0 => Err(rustix::io::Errno::IO),
        _ => Ok(Some(key[0])),
    }
}

/// How a terminal treats what is typed.
struct Modes {
    usual: Termios,
    by_key: Termios,
}

impl Modes {
    fn of_terminal() -> Option<Self> {
        let usual = tcgetattr(stdin()).ok()?;
        let mut by_key = usual.clone();
        // Ctrl-C stays a signal; Ctrl-Z would leave a shell with a hidden cursor.
        by_key.local_modes.remove(LocalModes::ICANON | LocalModes::ECHO);
        by_key.special_codes[SpecialCodeIndex::VSUSP] = 0;
        by_key.special_codes[SpecialCodeIndex::VMIN] = 0;
        by_key.special_codes[SpecialCodeIndex::VTIME] = 0;
        Some(Self { usual, by_key })
    }

    /// Has every key come at once, and hides the cursor. A shell may have undone it meanwhile.
    fn enter(&self) {
        let is_usual =
            tcgetattr(stdin()).is_ok_and(|modes| modes.local_modes.contains(LocalModes::ICANON));
        if is_usual {
            let _ = tcsetattr(stdin(), OptionalActions::Now, &self.by_key);
            let _ = Term::stdout().hide_cursor();
        }
    }

    /// Leaves the terminal as it was found.
    fn leave(&self) {
        if is_foreground() {
            let _ = tcsetattr(stdin(), OptionalActions::Now, &self.usual);
        }
        let _ = Term::stdout().show_cursor();
    }
}
