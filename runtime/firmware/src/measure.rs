//! Decides on what streams in, and tells what it came to and what that needed.

use sortie_core::DecideError;

use crate::file::File;
use crate::{console, known, machine, stack};

/// Why a program ends: a line, and a zero.
pub(crate) type Reason = &'static [u8];

/// What decides, and what it decides on.
pub(crate) trait Deciding {
    /// Reads what comes next; false behind the last, nothing where the file ends too early or there is no room.
    fn read(&mut self) -> Option<bool>;

    /// Decides on it.
    fn decide(&mut self) -> Result<(), DecideError>;

    /// Shows the numbers that it came to.
    fn answer(&self, number: impl FnMut(f32));

    /// Entities that are visible, where it is of any.
    fn visible(&self) -> usize {
        0
    }
}

/// Bytes that are known before it runs.
pub(crate) struct Needs {
    /// The plans.
    pub(crate) plan: usize,
    pub(crate) arena: usize,
    /// What one agent remembers.
    pub(crate) states: usize,
    /// What is known of the loaded plans.
    pub(crate) loaded: usize,
}

unsafe extern "C" {
    static __flash_bytes: u8;
    static __harness_bytes: u8;
}

/// What all decisions came to, and what they needed.
struct Sums {
    decisions: u64,
    hash: u64,
    most_ticks: u32,
    /// Entities that were visible in the longest decision.
    most_visible: u64,
    ticks: u64,
    stack: usize,
}

/// Tells everything, or why not.
#[inline(always)]
pub(crate) fn run<D: Deciding>(needs: &Needs, load: impl FnOnce(File) -> Result<D, Reason>) -> ! {
    match measured(needs, load) {
        Ok(()) => console::end(0),
        Err(why) => console::fail(why),
    }
}

#[inline(always)]
fn measured<D: Deciding>(
    needs: &Needs,
    load: impl FnOnce(File) -> Result<D, Reason>,
) -> Result<(), Reason> {
    machine::start_counter();
    let start = machine::now();
    known::run_instructions();
    console::tell(b"ticks-of-100000", since(start).into());
    needs.tell();
    let cases = File::open(b"cases.bin\0").ok_or(&b"there are no cases\n\0"[..])?;
    let base = stack::stack_pointer();
    stack::paint(base);
    let mut deciding = load(cases)?;
    console::tell(b"stack-of-loading", stack::used(base) as u64);
    let (mut sums, mut refused) = (Sums::NONE, false);
    while deciding.read().ok_or(&b"the cases end too early, or are of another policy\n\0"[..])? {
        stack::paint(base);
        let start = machine::now();
        let decided = deciding.decide();
        let ticks = since(start);
        refused |= decided.is_err();
        sums.add(ticks, stack::used(base), deciding.visible());
        deciding.answer(|number| sums.hash(number));
    }
    sums.tell();
    if refused { Err(b"a case is refused\n\0") } else { Ok(()) }
}

/// Ticks since `start`.
#[inline(always)]
fn since(start: u32) -> u32 {
    machine::now().wrapping_sub(start) & machine::MOST_TICKS
}

impl Needs {
    #[unsafe(link_section = ".harness")]
    #[inline(never)]
    fn tell(&self) {
        console::tell(b"flash", (&raw const __flash_bytes).addr() as u64);
        console::tell(b"harness", (&raw const __harness_bytes).addr() as u64);
        console::tell(b"plan", self.plan as u64);
        console::tell(b"arena", self.arena as u64);
        console::tell(b"states", self.states as u64);
        console::tell(b"loaded", self.loaded as u64);
    }
}

impl Sums {
    /// Of no decision; the hash is FNV-1a of 64 bits.
    const NONE: Self = Self {
        decisions: 0,
        hash: 0xcbf2_9ce4_8422_2325,
        most_ticks: 0,
        most_visible: 0,
        ticks: 0,
        stack: 0,
    };

    /// A decision more.
    #[unsafe(link_section = ".harness")]
    #[inline(never)]
    fn add(&mut self, ticks: u32, stack: usize, visible: usize) {
        self.decisions += 1;
        if ticks > self.most_ticks {
            (self.most_ticks, self.most_visible) = (ticks, visible as u64);
        }
        self.ticks += u64::from(ticks);
        self.stack = self.stack.max(stack);
    }

    /// A number that it came to.
    #[unsafe(link_section = ".harness")]
    #[inline(never)]
    fn hash(&mut self, number: f32) {
        for byte in number.to_bits().to_le_bytes() {
            self.hash = (self.hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }

    #[unsafe(link_section = ".harness")]
    #[inline(never)]
    fn tell(&self) {
        console::tell(b"decisions", self.decisions);
        console::tell(b"hash", self.hash);
        console::tell(b"most-ticks", self.most_ticks.into());
        console::tell(b"most-visible", self.most_visible);
        console::tell(b"ticks", self.ticks);
        console::tell(b"stack", self.stack as u64);
    }
}
