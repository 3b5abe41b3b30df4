//! An allocator on another host: who stands in for it at home asks it, and leaves the lead to others where it does not answer.

use std::cell::{Cell, RefCell};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use embedded_io::{Read, ReadReady, Write};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use sortie_core::link::{Clock, Processor};
use sortie_core::{AllocateError, AllocationState, Allocator, EntityMask};

use crate::away::{Away, Rest};
use crate::datagram::{Offer, Team};
use crate::home::{Home, HomePort};
use crate::runner::FarPoll;
use crate::{LineError, LineSettings};

/// Both ends say so often that they are there.
const HEARTBEAT: Duration = Duration::from_millis(100);
/// After so long without a word the other end is taken for gone.
const SILENCE: Duration = Duration::from_millis(350);

/// What is said to an allocator on another host.
#[derive(Debug, Serialize, Deserialize)]
enum Asked {
    /// The team is there.
    Present,
    /// Who is to work on what?
    State(u32, State),
    /// The world has ended.
    End,
}

/// What it says.
#[derive(Debug, Serialize, Deserialize)]
enum Answered {
    /// It is there.
    Present,
    /// Subtasks of all agents for the question of this number; none: it refuses.
    Allocation(u32, Option<Vec<u8>>),
}

/// An [`AllocationState`] on its way.
#[derive(Debug, Serialize, Deserialize)]
struct State {
    tasks: usize,
    stride: usize,
    rows: Vec<f32>,
    present: Vec<u64>,
    entity_task: Vec<u32>,
    open_tasks: u32,
    agents: usize,
    available: Vec<u16>,
}

impl State {
    fn of(state: &AllocationState<'_>) -> Self {
        let AllocationState { agents, tasks, rows, stride, present, .. } = *state;
        Self {
            agents,
            tasks,
            stride,
            rows: rows.to_vec(),
            present: present.words().to_vec(),
            entity_task: state.entity_task.to_vec(),
            open_tasks: state.open_tasks,
            available: state.available.to_vec(),
        }
    }

    /// What the allocator makes of it. States that contradict themselves it refuses.
    fn allocate(&self, allocator: &mut dyn Allocator) -> Option<Vec<u8>> {
        let Self { agents, tasks, stride, open_tasks, .. } = *self;
        let state = AllocationState {
            agents,
            tasks,
            rows: &self.rows,
            stride,
            present: EntityMask::from_words(&self.present),
            entity_task: &self.entity_task,
            open_tasks,
            available: &self.available,
        };
        let mut allocation = vec![sortie_core::UNASSIGNED; agents.min(sortie_core::limits::AGENTS)];
        state.check(&allocation).ok()?;
        allocator.allocate(&state, &mut allocation).ok().map(|()| allocation)
    }
}

/// The bytes of a line as the messages that they are: every datagram has whole ones.
#[derive(Default)]
struct Inbox(Vec<u8>);

impl Inbox {
    fn read<P: Read + ReadReady>(&mut self, port: &mut P) {
        let mut room = [0; 4096];
        while port.read_ready().unwrap_or(false) {
            let len = port.read(&mut room).unwrap_or(0);
            self.0.extend(room.get(..len).unwrap_or_default());
        }
    }

    /// What cannot be read is dropped with all that waits behind it.
    fn next<T: DeserializeOwned>(&mut self) -> Option<T> {
        if self.0.is_empty() {
            return None;
        }
        match postcard::take_from_bytes(&self.0) {
            Ok((message, rest)) => {
                let read = self.0.len() - rest.len();
                self.0.drain(..read);
                Some(message)
            }
            Err(_) => {
                self.0.clear();
                None
            }
        }
    }
}

fn write(port: &mut impl Write, message: &impl Serialize) {
    // States of the limits' sizes are written; memory does not fail.
    if let Ok(bytes) = postcard::to_stdvec(message) {
        let _ = port.write_all(&bytes);
    }
}

/// Stands at home for an allocator on another host. One thread has it.
pub struct AllocatorAtHome {
    home: Home,
    port: RefCell<HomePort>,
    inbox: RefCell<Inbox>,
    came: Arc<Came>,
    /// How long an answer is waited for.
    patience: Duration,
    asked: Cell<u32>,
    said: Cell<Option<Instant>>,
    missed: Cell<Option<Missed>>,
}

/// An answer that did not come in time.
#[derive(Clone, Copy)]
struct Missed {
    at: Instant,
    /// Whoever leads the allocators has been told.
    is_told: bool,
}

#[derive(Default)]
struct Came {
    is_new: Mutex<bool>,
    came: Condvar,
}

impl AllocatorAtHome {
    /// Listens for an allocator that `judge` takes, and which answers within `patience`; `wake` is called when it says something.
    ///
    /// # Errors
    /// As [`Home::open`].
    pub fn open(
        settings: LineSettings,
        judge: impl Fn(&Offer) -> Result<Team, String> + Send + Sync + 'static,
        patience: Duration,
        wake: impl Fn() + Send + Sync + 'static,
    ) -> Result<Self, LineError> {
        let came = Arc::<Came>::default();
        let coming = Arc::clone(&came);
        let home = Home::open(settings, judge, move || {
            *coming.is_new.lock().unwrap_or_else(PoisonError::into_inner) = true;
            coming.came.notify_one();
            wake();
        })?;
        let port = RefCell::new(home.port());
        let (inbox, asked, said, missed) = Default::default();
        Ok(Self { home, port, inbox, came, patience, asked, said, missed })
    }

    /// Says that the team is there, where that is due. Returns whether the allocator is: it was heard lately, and not asked in vain
    /// since.
    pub fn tend(&self) -> bool {
        if self.said.get().is_none_or(|said| said.elapsed() >= HEARTBEAT) {
            self.say(&Asked::Present);
        }
        self.read();
        let silence = self.home.silence();
        silence.is_some_and(|silence| silence < SILENCE) && !self.is_mute(silence)
    }

    /// Whether it was asked in vain and has said nothing since. That is told at least once: where the question or its answer was
    /// lost, it may have been heard in the same moment.
    fn is_mute(&self, silence: Option<Duration>) -> bool {
        let Some(missed) = self.missed.get() else { return false };
        self.missed.set(Some(Missed { is_told: true, ..missed }));
        !missed.is_told || silence.is_none_or(|silence| silence >= missed.at.elapsed())
    }

    /// The last words: the world has ended.
    pub fn end(&self) {
        write(&mut *self.port.borrow_mut(), &Asked::End);
        self.home.send_last();
    }

    fn say(&self, message: &Asked) {
        write(&mut *self.port.borrow_mut(), message);
        self.home.send();
        self.said.set(Some(Instant::now()));
    }

    /// The answer to the newest question, if it has come.
    fn read(&self) -> Option<Option<Vec<u8>>> {
        let mut inbox = self.inbox.borrow_mut();
        inbox.read(&mut *self.port.borrow_mut());
        let mut found = None;
        while let Some(answer) = inbox.next() {
            match answer {
                Answered::Allocation(number, allocation) if number == self.asked.get() => {
                    found = Some(allocation);
                }
                Answered::Allocation(..) | Answered::Present => {}
            }
        }
        found
    }

    fn wait(&self, most: Duration) {
        let is_new = self.came.is_new.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = self.came.came.wait_timeout_while(is_new, most, |is_new| !*is_new);
        *waited.unwrap_or_else(PoisonError::into_inner).0 = false;
    }
}

impl Allocator for &AllocatorAtHome {
    /// Asks, and waits. Without an answer in time, or where the other end refuses, it refuses: [`AllocatorAtHome::tend`] then says
    /// that the allocator is not there, so that others are asked, and say why if they refuse too.
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        let until = Instant::now() + self.patience;
        self.asked.set(self.asked.get().wrapping_add(1));
        self.say(&Asked::State(self.asked.get(), State::of(state)));
        loop {
            let left = until.saturating_duration_since(Instant::now());
            match self.read() {
                Some(Some(answer)) if answer.len() == allocation.len() => {
                    allocation.copy_from_slice(&answer);
                    self.missed.set(None);
                    return Ok(());
                }
                None if !left.is_zero() => self.wait(left),
                _ => {
                    self.missed.set(Some(Missed { at: Instant::now(), is_told: false }));
                    // No error of allocators says that there was no answer.
                    return Err(AllocateError::BadLength);
                }
            }
        }
    }
}

/// An allocator whose team is on another host, polled by whoever drives it.
pub struct FarAllocator {
    line: Away,
    rest: Rest,
    inbox: Inbox,
    said: Option<Instant>,
    is_cut: bool,
}

impl FarAllocator {
    /// Over the line of a team that has taken it.
    pub fn new(line: Away) -> Self {
        let rest = line.rest();
        Self { line, rest, inbox: Inbox::default(), said: None, is_cut: false }
    }

    /// Answers the newest question.
    pub fn poll(&mut self, allocator: &mut dyn Allocator) -> FarPoll {
        self.line.hear();
        if self.line.is_replaced() {
            return FarPoll::Replaced;
        }
        let is_silent = self.line.silence() > SILENCE;
        if is_silent != std::mem::replace(&mut self.is_cut, is_silent) {
            return if is_silent { FarPoll::CutOff } else { FarPoll::Heard };
        }
        self.inbox.read(&mut self.line);
        let mut newest = None;
        while let Some(asked) = self.inbox.next() {
            match asked {
                Asked::Present => {}
                Asked::State(number, state) => newest = Some((number, state)),
                Asked::End => return FarPoll::Ended,
            }
        }
        if let Some((number, state)) = newest {
            self.say(&Answered::Allocation(number, state.allocate(allocator)));
        } else if self.said.is_none_or(|said| said.elapsed() >= HEARTBEAT) {
            self.say(&Answered::Present);
        }
        FarPoll::Wait { until_ns: self.rest.now_ns().saturating_add(HEARTBEAT.as_nanos() as u64) }
    }

    /// Sleeps until something comes, or this time of its clock.
    pub fn wait(&self, until_ns: u64) {
        self.rest.until(until_ns);
        self.rest.rest();
    }

    fn say(&mut self, message: &Answered) {
        write(&mut self.line, message);
        self.line.send();
        self.said = Some(Instant::now());
    }
}
