//! A block of lines that changes in place on a terminal, and its keys: space pauses, `q` quits, arrows scroll.

use std::sync::atomic::{AtomicBool, AtomicIsize, Ordering};
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
use sortie_pages::Canvas;

use crate::terminal;

/// Redraws a block of lines in place.
pub(crate) struct Screen {
    terminal: Term,
    is_unicode: bool,
    drawn: usize,
}

impl Screen {
    pub(crate) fn new() -> Self {
        Self { terminal: Term::stdout(), is_unicode: terminal::is_unicode(), drawn: 0 }
    }

    /// Puts what `draw` makes of the room that there is in the place of what was shown before. A terminal that is gone
    /// or too small is no reason to stop the team.
    pub(crate) fn show(&mut self, draw: impl FnOnce(Canvas) -> Vec<String>) {
        let (height, width) = self.terminal.size();
        // One row stays free for the cursor: a block that scrolls cannot be redrawn.
        let (lines, width) = (usize::from(height).max(2) - 1, usize::from(width).max(2) - 1);
        let mut shown = draw(Canvas { width, lines, is_unicode: self.is_unicode });
        shown.truncate(lines);
        let mut text = String::new();
        for line in &shown {
            text.push_str(&console::truncate_str(line, width, ""));
            text.push_str("\x1b[K\n");
        }
        // Of a block that was longer.
        text.push_str("\x1b[J");
        let _ = self.terminal.move_cursor_up(self.drawn);
        let _ = self.terminal.write_str(&text);
        let _ = self.terminal.flush();
        self.drawn = shown.len();
    }
}

/// Longest time until a stop is noticed, and so until the terminal is as it was: much less than two signals in a row
/// must lie apart to end the program at once.
const LOOK: Duration = Duration::from_millis(50);

/// A thread that reads keys while the terminal passes on each of them at once.
pub(crate) struct Keyboard {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

struct Shared {
    stop: Stop,
    is_done: AtomicBool,
    /// A key has ended the run.
    has_quit: AtomicBool,
    is_paused: Mutex<bool>,
    resumed: Condvar,
    /// Lines that keys asked to scroll down by, and nobody has taken yet.
    scrolled: AtomicIsize,
}

/// What keys scroll down by, and what terminals send for them: arrows in their two modes, pages, and letters as in `less`.
const PAGE: isize = 10;
const SCROLLS: [(&[u8], isize); 8] = [
    (b"\x1b[A", -1),
    (b"\x1bOA", -1),
    (b"k", -1),
    (b"\x1b[B", 1),
    (b"\x1bOB", 1),
    (b"j", 1),
    (b"\x1b[5~", -PAGE),
    (b"\x1b[6~", PAGE),
];

impl Keyboard {
    /// Begins to read, where standard input is a terminal and this process may read from it.
    pub(crate) fn open(stop: &Stop) -> Option<Self> {
        let modes = Modes::of_terminal().filter(|_| is_foreground())?;
        let shared = Arc::new(Shared {
            stop: stop.clone(),
            is_done: AtomicBool::new(false),
            has_quit: AtomicBool::new(false),
            is_paused: Mutex::new(false),
            resumed: Condvar::new(),
            scrolled: AtomicIsize::new(0),
        });
        let reading = Arc::clone(&shared);
        let thread = thread::Builder::new().spawn(move || reading.read(&modes)).ok()?;
        Some(Self { shared, thread: Some(thread) })
    }

    /// Whether a key has ended the run.
    pub(crate) fn has_quit(&self) -> bool {
        self.shared.has_quit.load(Ordering::SeqCst)
    }

    pub(crate) fn is_paused(&self) -> bool {
        *self.shared.is_paused.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Lines that keys have asked to scroll down by since the last call.
    pub(crate) fn take_scrolled(&self) -> isize {
        self.shared.scrolled.swap(0, Ordering::Relaxed)
    }

    /// Returns when the run may go on, or is to end.
    pub(crate) fn wait_while_paused(&self) {
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
            let mut typed = [0; 16];
            match next_keys(&mut typed) {
                Ok(count) => self.obey(&typed[..count]),
                Err(_) => break,
            }
        }
        modes.leave();
        self.set_paused(|_| false);
    }

    /// Does what keys ask for; what is not known is passed over.
    fn obey(&self, mut typed: &[u8]) {
        while let [key, rest @ ..] = typed {
            let scroll = SCROLLS.iter().find(|(sent, _)| typed.starts_with(sent));
            match (key, scroll) {
                (_, Some((_, lines))) => {
                    self.scrolled.fetch_add(*lines, Ordering::Relaxed);
                }
                (b' ', _) => self.set_paused(|is_paused| !is_paused),
                (b'q' | b'Q', _) => {
                    self.has_quit.store(true, Ordering::SeqCst);
                    self.stop.stop();
                }
                _ => {}
            }
            typed = scroll.map_or(rest, |(sent, _)| &typed[sent.len()..]);
        }
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

/// Puts the next keys there, if some come soon, and returns how many bytes they are.
///
/// # Errors
/// The terminal is gone.
fn next_keys(typed: &mut [u8]) -> rustix::io::Result<usize> {
    let pause = Timespec { tv_sec: 0, tv_nsec: LOOK.subsec_nanos().into() };
    let input = stdin();
    match poll(&mut [PollFd::new(&input, PollFlags::IN)], Some(&pause)) {
        Ok(0) | Err(rustix::io::Errno::INTR) => return Ok(0),
        Ok(_) => {}
        Err(error) => return Err(error),
    }
    match rustix::io::read(input, typed)? {
        0 => Err(rustix::io::Errno::IO),
        count => Ok(count),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_scroll_pause_and_quit_however_many_come_at_once() {
        let shared = Shared {
            stop: Stop::new(),
            is_done: AtomicBool::new(false),
            has_quit: AtomicBool::new(false),
            is_paused: Mutex::new(false),
            resumed: Condvar::new(),
            scrolled: AtomicIsize::new(0),
        };
        let scrolled = |keys: &[u8]| {
            shared.obey(keys);
            shared.scrolled.swap(0, Ordering::Relaxed)
        };
        assert_eq!(scrolled(b"\x1b[B\x1bOBj"), 3);
        assert_eq!(scrolled(b"\x1b[6~k\x1b[A"), PAGE - 2);
        assert_eq!(scrolled(b"xj\x1b[5~\x1b"), 1 - PAGE);
        let is_paused = || *shared.is_paused.lock().expect("nobody has panicked");
        assert_eq!((scrolled(b"j j"), is_paused()), (2, true));
        assert_eq!((scrolled(b" "), is_paused()), (0, false));
        assert!(!shared.stop.is_set());
        assert_eq!(scrolled(b"jq"), 1);
        assert!(shared.stop.is_set() && shared.has_quit.load(Ordering::SeqCst));
    }
}
