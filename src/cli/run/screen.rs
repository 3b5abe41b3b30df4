//! A block of lines on a terminal that changes in place.

use console::Term;

use crate::terminal;
use crate::views::Canvas;

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
