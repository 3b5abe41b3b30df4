//! The live picture of a run: where it is, how fast the team ticks, and the state as its environment draws it, in a block of
//! lines that changes in place; and its keys: space pauses, `q` quits.

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
use sortie_pages::{Canvas, Scene, draw};

use crate::latency::Percentiles;
use crate::terminal;
use crate::worlds::tally::Tally;

/// All that one picture shows.
pub(super) struct Picture<'a> {
    pub(super) scene: Scene<'a>,
    pub(super) episode: usize,
    /// `None` = without end.
    pub(super) episodes: Option<usize>,
    /// Of the finished episodes.
    pub(super) tally: &'a Tally,
    pub(super) step: u32,
    pub(super) tick: Percentiles,
    /// What a person may do.
    pub(super) hint: &'a str,
}

/// The picture as lines of text, without line ends.
pub(super) fn lines(picture: &Picture<'_>, canvas: Canvas) -> Vec<String> {
    // Above and below: headline and hint.
    let room = Canvas { lines: canvas.lines.saturating_sub(2), ..canvas };
    let drawing = draw(&picture.scene, room);
    let gap = if drawing.legend.is_empty() { "" } else { "    " };
    let mut lines = vec![headline(picture)];
    lines.extend(drawing.lines);
    lines.push(format!("{}{gap}{}", drawing.legend, picture.hint));
    lines
}

fn headline(picture: &Picture<'_>) -> String {
    let of = picture.episodes.map_or(String::new(), |episodes| format!(" of {episodes}"));
    let Tally { episodes, solved, returns, .. } = picture.tally;
    let came = match picture.scene.spec.has_success {
        true => format!("solved {solved} of {episodes}"),
        false if *episodes == 0 => "no return yet".to_owned(),
        false => format!("mean return {:.1} of {episodes}", returns / *episodes as f64),
    };
    format!(
        "episode {}{of}, step {:3}   {came}   tick p50 {:.0} us, p99 {:.0} us",
        picture.episode, picture.step, picture.tick.p50, picture.tick.p99,
    )
}

/// Redraws a block of lines in place.
pub(super) struct Screen {
    terminal: Term,
    is_unicode: bool,
    drawn: usize,
}

impl Screen {
    pub(super) fn new() -> Self {
        Self { terminal: Term::stdout(), is_unicode: terminal::is_unicode(), drawn: 0 }
    }

    /// Puts what `draw` makes of the room that there is in the place of what was shown before. A terminal that is gone
    /// or too small is no reason to stop the team.
    pub(super) fn show(&mut self, draw: impl FnOnce(Canvas) -> Vec<String>) {
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
pub(super) struct Keyboard {
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
}

impl Keyboard {
    /// Begins to read, where standard input is a terminal and this process may read from it.
    pub(super) fn open(stop: &Stop) -> Option<Self> {
        let modes = Modes::of_terminal().filter(|_| is_foreground())?;
        let shared = Arc::new(Shared {
            stop: stop.clone(),
            is_done: AtomicBool::new(false),
            has_quit: AtomicBool::new(false),
            is_paused: Mutex::new(false),
            resumed: Condvar::new(),
        });
        let reading = Arc::clone(&shared);
        let thread = thread::Builder::new().spawn(move || reading.read(&modes)).ok()?;
        Some(Self { shared, thread: Some(thread) })
    }

    /// Whether a key has ended the run.
    pub(super) fn has_quit(&self) -> bool {
        self.shared.has_quit.load(Ordering::SeqCst)
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
                Ok(Some(b'q' | b'Q')) => {
                    self.has_quit.store(true, Ordering::SeqCst);
                    self.stop.stop();
                }
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

#[cfg(test)]
mod tests {
    use sortie_envs::random::generator;
    use sortie_envs::{ENVIRONMENTS, Split};

    use super::*;
    use crate::environment::ScenarioSetName;

    #[test]
    fn every_environment_is_drawn_between_the_headline_and_the_hint() {
        console::set_colors_enabled(false);
        for entry in ENVIRONMENTS {
            let name = ScenarioSetName::parse(entry.name).expect("its usual set");
            let mut world = name.open(Split::Train).expect("it opens");
            world.reset(0, &mut generator(1));
            let mut state = Vec::new();
            world.save(0, &mut state);
            let agents = world.spec().shape.agents;
            let (allocation, actions) = (vec![0; agents], vec![0; agents]);
            let spec = world.spec();
            let picture = world.picture(&state);
            let scene =
                Scene { spec, picture: &picture, allocation: &allocation, actions: &actions };
            let mut tally = Tally::default();
            (tally.episodes, tally.solved, tally.returns) = (1, 1, 2.5);
            let picture = Picture {
                scene,
                episode: 2,
                episodes: Some(20),
                tally: &tally,
                step: 7,
                tick: Percentiles { p50: 20.4, p99: 80.0, p999: None, max: 90.0 },
                hint: "q quits",
            };
            let canvas = Canvas { width: 79, lines: 23, is_unicode: false };
            let shown = lines(&picture, canvas);
            let came = if spec.has_success { "solved 1 of 1" } else { "mean return 2.5 of 1" };
            let headline =
                format!("episode 2 of 20, step   7   {came}   tick p50 20 us, p99 80 us");
            assert_eq!(shown[0], headline);
            let text = shown.join("\n");
            assert!(text.ends_with("q quits"), "{text}");
            // Whoever is drawn by actions alone takes a line for each agent.
            assert!((2 + agents.min(3)..=23).contains(&shown.len()), "{text}");
            assert!(shown.iter().all(|line| line.is_ascii() && line.len() <= 79), "{text}");
        }
    }
}
