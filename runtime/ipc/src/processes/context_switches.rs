//! How often the scheduler took the processor away from this thread.

use std::fs::File;
use std::os::unix::fs::FileExt;

/// Where Linux tells it; other systems do not.
const FILE: &str = "/proc/thread-self/status";
const LINE: &str = "nonvoluntary_ctxt_switches:";

/// The counter of the thread that opened it.
pub(super) struct ContextSwitches(Option<File>);

impl ContextSwitches {
    pub(super) fn of_this_thread() -> Self {
        Self(File::open(FILE).ok())
    }

    /// Involuntary switches so far, if the system tells.
    pub(super) fn count(&self) -> Option<u64> {
        // The kernel's page; the line is the last one.
        let mut page = [0; 4096];
        let length = self.0.as_ref()?.read_at(&mut page, 0).ok()?;
        let text = std::str::from_utf8(page.get(..length)?).ok()?;
        let line = text.lines().find_map(|line| line.strip_prefix(LINE))?;
        line.trim().parse().ok()
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn linux_tells() {
        assert!(ContextSwitches::of_this_thread().count().is_some());
    }
}
