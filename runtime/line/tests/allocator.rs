//! An allocator on another host, over a socket of this machine.
#![allow(clippy::unwrap_used, missing_docs)]

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use sortie_core::{AllocateError, AllocationState, Allocator, EntityMask, Shape, UNASSIGNED};
use sortie_line::{
    AllocatorAtHome, Away, Carrier, FarAllocator, FarPoll, Key, LineSettings, Offer, Team, Udp,
};

const OFFER: Offer = Offer { abi: 3, contract: 7, model: [1; 16], agents: 0 };
const SHAPE: Shape = Shape { agents: 3, entities: 5, tasks: 2, actions: 4, features: 2 };
const LONG: Duration = Duration::from_secs(20);
/// Bytes of a datagram with a question, and of none that says only who is there.
const QUESTION: usize = 80;

/// Gives agents subtasks by their first feature; refuses a state whose last feature is negative.
struct ByFeature;

impl Allocator for ByFeature {
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        if state.rows.last().is_some_and(|last| *last < 0.0) {
            return Err(AllocateError::NonFinite);
        }
        for (agent, task) in allocation.iter_mut().enumerate() {
            let is_there = state.present.contains(agent) && state.available[agent] == 1;
            let wish = (state.rows[agent * state.stride] as u32 + state.entity_task[agent]) as u8;
            *task = if is_there && state.open_tasks >> wish & 1 == 1 { wish } else { UNASSIGNED };
        }
        Ok(())
    }
}

/// An allocator elsewhere, until it is told to stop or the world ends.
struct Elsewhere {
    is_stopped: Arc<AtomicBool>,
    thread: JoinHandle<FarPoll>,
}

impl Elsewhere {
    fn join(settings: LineSettings) -> Self {
        Self::join_with(settings, ByFeature)
    }

    fn join_with(settings: LineSettings, mut allocator: impl Allocator + Send + 'static) -> Self {
        let is_stopped = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&is_stopped);
        let run = move || {
            let taken = Away::connect(settings, OFFER, LONG, &|| false).unwrap();
            let mut far = FarAllocator::new(taken.line);
            while !stopped.load(Ordering::Relaxed) {
                match far.poll(&mut allocator) {
                    FarPoll::Wait { until_ns } => far.wait(until_ns),
                    FarPoll::Again | FarPoll::CutOff | FarPoll::Heard => {}
                    ended => return ended,
                }
            }
            FarPoll::Again
        };
        Self { is_stopped, thread: thread::spawn(run) }
    }

    fn die(self) {
        self.is_stopped.store(true, Ordering::Relaxed);
        self.thread.join().unwrap();
    }
}

/// A socket that loses questions, as long as that is wanted: what is long.
struct Losing {
    socket: Udp,
    loses: Arc<AtomicBool>,
}

impl Carrier for Losing {
    fn send(&self, datagram: &[u8], to: Option<SocketAddr>) {
        if datagram.len() < QUESTION || !self.loses.load(Ordering::Relaxed) {
            self.socket.send(datagram, to);
        }
    }

    fn receive(&self, room: &mut [u8]) -> Option<(usize, Option<SocketAddr>)> {
        self.socket.receive(room)
    }

    fn wait(&self, most: Duration) {
        self.socket.wait(most);
    }

    fn address(&self) -> String {
        self.socket.address()
    }
}

fn home(patience: Duration) -> (AllocatorAtHome, LineSettings) {
    home_that_loses(patience, Arc::default())
}

fn home_that_loses(patience: Duration, loses: Arc<AtomicBool>) -> (AllocatorAtHome, LineSettings) {
    let socket = Udp::listen("127.0.0.1:0".parse().unwrap()).unwrap();
    let address = socket.own_address().unwrap();
    let carrier = Arc::new(Losing { socket, loses });
    let judge = |offer: &Offer| match *offer == OFFER {
        true => Ok(Team::new(SHAPE, 0, 65)),
        false => Err("it is another one".to_owned()),
    };
    let settings = LineSettings { carrier, key: Key::plain(), copies: 1 };
    let home = AllocatorAtHome::open(settings.clone(), judge, patience, || ()).unwrap();
    (home, LineSettings { carrier: Arc::new(Udp::connect(address).unwrap()), ..settings })
}

fn wait_for(what: &str, is_so: impl Fn() -> bool) {
    let until = Instant::now() + LONG;
    while !is_so() {
        assert!(Instant::now() < until, "{what}");
        thread::yield_now();
    }
}

fn ask(mut allocator: impl Allocator, rows: &[f32; 10]) -> Result<[u8; 3], AllocateError> {
    let state = AllocationState {
        agents: 3,
        tasks: 2,
        rows,
        stride: 2,
        present: EntityMask::from_words(&[0b11011]),
        entity_task: &[0, 1, 0, 1, 2],
        open_tasks: 0b11,
        available: &[1, 1, 0],
    };
    let mut allocation = [7; 3];
    allocator.allocate(&state, &mut allocation).map(|()| allocation)
}

#[test]
fn it_allocates_as_it_would_here() {
    let (home, settings) = home(LONG);
    assert!(!home.tend(), "nobody is there");
    let elsewhere = Elsewhere::join(settings);
    wait_for("nobody comes", || home.tend());
    for first in 0..3_u8 {
        let mut rows = [0.5; 10];
        (rows[0], rows[2]) = (f32::from(first), 0.0);
        assert_eq!(ask(&home, &rows), ask(ByFeature, &rows));
    }
    let refused = [-1.0; 10];
    assert!(ask(ByFeature, &refused).is_err() && ask(&home, &refused).is_err());
    assert!(!home.tend(), "others are asked about that state");
    wait_for("who refuses is there", || home.tend());
    home.end();
    assert_eq!(elsewhere.thread.join().unwrap(), FarPoll::Ended);
}

/// Answers once it may.
struct Held(Receiver<()>);

impl Allocator for Held {
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        self.0.recv().map_err(|_| AllocateError::TooLarge)?;
        ByFeature.allocate(state, allocation)
    }
}

#[test]
fn a_late_answer_is_none_to_the_next_question() {
    let (home, settings) = home(Duration::from_secs(1));
    let (release, may) = channel();
    let elsewhere = Elsewhere::join_with(settings, Held(may));
    wait_for("nobody comes", || home.tend());
    let (first, mut second) = ([0.0; 10], [0.0; 10]);
    second[0] = 1.0;
    assert_ne!(ask(ByFeature, &first), ask(ByFeature, &second));
    assert!(ask(&home, &first).is_err());
    // Both are answered now, one behind the other.
    release.send(()).unwrap();
    release.send(()).unwrap();
    assert_eq!(ask(&home, &second), ask(ByFeature, &second));
    elsewhere.die();
}

#[test]
fn who_does_not_answer_is_not_there() {
    let patience = Duration::from_millis(40);
    let (home, settings) = home(patience);
    let first = Elsewhere::join(settings.clone());
    wait_for("nobody comes", || home.tend());
    first.die();
    let asked = Instant::now();
    assert!(ask(&home, &[0.0; 10]).is_err());
    assert!(asked.elapsed() >= patience, "it was given up too early");
    assert!(!home.tend(), "it has not answered");
    // Another one is taken in its time, and answers.
    let second = Elsewhere::join(settings);
    wait_for("the second one is not taken", || home.tend());
    assert_eq!(ask(&home, &[0.0; 10]), ask(ByFeature, &[0.0; 10]));
    second.die();
}

#[test]
fn who_is_heard_and_has_not_answered_leaves_the_state_to_others() {
    let loses = Arc::new(AtomicBool::new(false));
    // Several times the other end says that it is there while it is waited for.
    let (home, settings) = home_that_loses(Duration::from_millis(350), Arc::clone(&loses));
    let elsewhere = Elsewhere::join(settings);
    wait_for("nobody comes", || home.tend());
    loses.store(true, Ordering::Relaxed);
    assert!(ask(&home, &[0.0; 10]).is_err());
    assert!(!home.tend(), "it may not lead where it has no answer");
    loses.store(false, Ordering::Relaxed);
    wait_for("it is not heard again", || home.tend());
    assert_eq!(ask(&home, &[0.0; 10]), ask(ByFeature, &[0.0; 10]));
    assert!(home.tend());
    elsewhere.die();
}
