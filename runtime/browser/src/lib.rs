//! A team in its world, for a page: what `sortie view --live` puts into it.
//!
//! The page's script calls the functions below. What they tell is text that it reads from the program's memory: JSON, or why
//! something is refused. An instance plays one episode; the next one has an instance of its own.
#![cfg_attr(target_arch = "wasm32", no_std)]

extern crate alloc;

use alloc::boxed::Box;
use alloc::string::{String, ToString};
use alloc::vec;

use serde::Serialize;
use sortie_stage::{Cast, News, Player, StageError, golden_hash, memory};

#[cfg(target_arch = "wasm32")]
#[global_allocator]
static HEAP: dlmalloc::GlobalDlmalloc = dlmalloc::GlobalDlmalloc;

/// A mistake of this program: the page shows that it has ended.
#[cfg(target_arch = "wasm32")]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    core::arch::wasm32::unreachable()
}

/// The text is JSON.
const TOLD: i32 = 1;
/// There is nothing to tell.
const NOTHING: i32 = 0;
/// The text says why.
const REFUSED: i32 = -1;

/// One instance of the page's program. It lives as long as the instance.
pub struct Program {
    cast: Cast,
    player: Player<'static>,
    text: String,
}

/// Room for so many bytes, which [`open`] or [`certify`] takes over.
#[unsafe(no_mangle)]
pub extern "C" fn room(bytes: usize) -> *mut u8 {
    Box::leak(vec![0; bytes].into_boxed_slice()).as_mut_ptr()
}

/// Begins an episode of a seed with a team; null where the bytes are none.
///
/// # Safety
/// `bytes` and `length` are of one [`room`], which was not given here before.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn open(
    bytes: *mut u8,
    length: usize,
    seed: u64,
    episode: u32,
) -> *mut Program {
    // SAFETY: as the caller promises.
    let program = unsafe { cast(bytes, length) }.and_then(|cast| {
        let memory = Box::leak(Box::new(memory(&cast).ok()?));
        let player = Player::new(memory, &cast, seed, episode as usize).ok()?;
        Some(Program { cast, player, text: String::new() })
    });
    program.map_or(core::ptr::null_mut(), |program| Box::into_raw(Box::new(program)))
}

/// The hash of the utilities of a team's golden observations, without a world; 0 where the bytes are none, or a plan refuses them.
///
/// # Safety
/// As of [`open`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn certify(bytes: *mut u8, length: usize) -> u64 {
    // SAFETY: as the caller promises.
    unsafe { cast(bytes, length) }.and_then(|cast| golden_hash(&cast).ok()).unwrap_or(0)
}

/// A team of a page's bytes.
///
/// # Safety
/// As of [`open`].
unsafe fn cast(bytes: *mut u8, length: usize) -> Option<Cast> {
    // SAFETY: of a `room`, as the caller promises: it was leaked as a boxed slice of this length, and nobody else has it.
    let bytes = unsafe { Box::from_raw(core::ptr::slice_from_raw_parts_mut(bytes, length)) };
    Cast::from_bytes(&bytes).ok()
}

/// Where the text of the last call lies.
#[unsafe(no_mangle)]
pub extern "C" fn text(program: &Program) -> *const u8 {
    program.text.as_ptr()
}

/// Bytes of it.
#[unsafe(no_mangle)]
pub extern "C" fn text_bytes(program: &Program) -> usize {
    program.text.len()
}

/// What to show first.
#[unsafe(no_mangle)]
pub extern "C" fn opening(program: &mut Program) -> i32 {
    let opening = program.player.open();
    program.tell(opening.map(Some).map_err(reason))
}

/// The next step.
#[unsafe(no_mangle)]
pub extern "C" fn step(program: &mut Program) -> i32 {
    let step = program.player.step();
    program.tell(step.map_err(reason))
}

/// Puts an agent, or a thing behind the agents, elsewhere.
#[unsafe(no_mangle)]
pub extern "C" fn place(program: &mut Program, entity: usize, x: f64, y: f64) -> i32 {
    program.change(|player| player.place(entity, [x, y]))
}

/// Does to a thing what may come about by chance as well: sets a building on fire.
#[unsafe(no_mangle)]
pub extern "C" fn disturb(program: &mut Program, thing: usize) -> i32 {
    program.change(|player| player.disturb(thing))
}

/// Ends an agent's process, or starts one.
#[unsafe(no_mangle)]
pub extern "C" fn kill_or_revive(program: &mut Program, agent: usize) -> i32 {
    program.change(|player| player.kill_or_revive(agent))
}

/// Has somebody else allocate.
#[unsafe(no_mangle)]
pub extern "C" fn choose_allocator(program: &mut Program, choice: usize) -> i32 {
    program.change(|player| player.choose_allocator(choice))
}

/// Repeats an agent's decision so many times, for whoever takes the time.
#[unsafe(no_mangle)]
pub extern "C" fn repeat_decision(program: &mut Program, agent: usize, times: u32) -> i32 {
    for _ in 0..times {
        match program.player.repeat_decision(agent) {
            Ok(true) => {}
            Ok(false) => return NOTHING,
            Err(error) => return program.refuse(error.to_string()),
        }
    }
    TOLD
}

/// The hash of the golden observations' utilities; 0 where a plan refuses them.
#[unsafe(no_mangle)]
pub extern "C" fn golden(program: &Program) -> u64 {
    golden_hash(&program.cast).unwrap_or(0)
}

/// Plays on unseen; how many decisions have been counted, `most` at most. Negative where a role ended.
#[unsafe(no_mangle)]
pub extern "C" fn rehearse(program: &mut Program, most: u32) -> i32 {
    match program.player.rehearse(most.into()) {
        Ok(decisions) => decisions as i32,
        Err(error) => program.refuse(error.to_string()),
    }
}

/// The hash of the utilities that [`rehearse`] counted.
#[unsafe(no_mangle)]
pub extern "C" fn rehearsed(program: &Program) -> u64 {
    program.player.rehearsed()
}

fn reason(error: StageError) -> String {
    error.to_string()
}

impl Program {
    fn change(&mut self, change: impl FnOnce(&mut Player<'static>) -> Result<News, String>) -> i32 {
        let news = change(&mut self.player);
        self.tell(news.map(Some))
    }

    /// Keeps what is to be told.
    fn tell(&mut self, told: Result<Option<impl Serialize>, String>) -> i32 {
        match told.map(|told| told.map(|told| serde_json::to_string(&told))) {
            Ok(None) => NOTHING,
            Ok(Some(Ok(json))) => {
                self.text = json;
                TOLD
            }
            Ok(Some(Err(error))) => self.refuse(error.to_string()),
            Err(why) => self.refuse(why),
        }
    }

    fn refuse(&mut self, why: String) -> i32 {
        self.text = why;
        REFUSED
    }
}
