//! Plain iceoryx2: its topics and its events with their defaults, as its own examples use them.

use std::time::Instant;

use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;

use super::{AGENTS, FRAME_WORDS, decide, read};

/// The tick that ends the agents.
const END: u64 = u64::MAX;

type Frame = [u64; FRAME_WORDS];
/// Tick and agent.
type Action = [u64; 8];

/// Where the library keeps its files: in memory, as ours are.
fn root(place: &str) -> String {
    format!("/dev/shm/{place}-root")
}

/// Removes what the library leaves behind of a domain whose processes are gone.
pub(crate) fn clean_up(place: &str) {
    let _ = std::fs::remove_dir_all(root(place));
    for entry in std::fs::read_dir("/dev/shm").unwrap().flatten() {
        if entry.file_name().to_string_lossy().starts_with(place) {
            let _ = std::fs::remove_file(entry.path());
        }
    }
}

fn node(place: &str) -> Node<ipc::Service> {
    let mut config = Config::default();
    config.global.prefix = FileName::new(place.as_bytes()).unwrap();
    config.global.set_root_path(&Path::new(root(place).as_bytes()).unwrap());
    set_log_level(LogLevel::Fatal);
    NodeBuilder::new()
        .config(&config)
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create()
        .unwrap()
}

fn name(name: &str) -> ServiceName {
    ServiceName::new(name).unwrap()
}

macro_rules! topic {
    ($node:expr, $name:literal, $type:ty) => {
        $node
            .service_builder(&name($name))
            .publish_subscribe::<$type>()
            .max_publishers(AGENTS)
            .max_subscribers(AGENTS)
            .max_nodes(AGENTS + 1)
            .open_or_create()
            .unwrap()
    };
}

struct Bells {
    own: Listener<ipc::Service>,
    peers: Notifier<ipc::Service>,
}

fn bells(node: &Node<ipc::Service>, own: &str, peers: &str) -> Bells {
    let service = |bell: &str| {
        node.service_builder(&name(bell))
            .event()
            .max_listeners(AGENTS)
            .max_notifiers(AGENTS)
            .max_nodes(AGENTS + 1)
            .open_or_create()
            .unwrap()
    };
    let own = service(own).listener_builder().create().unwrap();
    Bells { own, peers: service(peers).notifier_builder().create().unwrap() }
}

fn newest<T: std::fmt::Debug + ZeroCopySend>(
    topic: &Subscriber<ipc::Service, T, ()>,
    mut take: impl FnMut(&T),
) {
    while let Some(sample) = topic.receive().unwrap() {
        take(sample.payload());
    }
}

/// An agent: answers every tick until the last.
pub(crate) fn agent(place: &str, agent: usize) {
    let node = node(place);
    let frames = topic!(node, "frame", Frame).subscriber_builder().create().unwrap();
    let actions: Publisher<_, Action, ()> =
        topic!(node, "action", Action).publisher_builder().create().unwrap();
    let bells = bells(&node, "agents", "world");
    // Tick 0: the agent is there.
    actions.send_copy([0, agent as u64, 0, 0, 0, 0, 0, 0]).unwrap();
    bells.peers.notify().unwrap();
    loop {
        bells.own.blocking_wait(|_| {}).unwrap();
        let mut ticked = None;
        newest(&frames, |frame| {
            read(frame);
            ticked = Some(frame[0]);
        });
        match ticked {
            None => continue,
            Some(END) => return,
            Some(tick) => {
                decide(1);
                actions.send_copy([tick, agent as u64, 0, 0, 0, 0, 0, 0]).unwrap();
                bells.peers.notify().unwrap();
            }
        }
    }
}

/// The world's ports, open before the first agent is started.
pub(crate) struct PlainWorld {
    frames: Publisher<ipc::Service, Frame, ()>,
    actions: Subscriber<ipc::Service, Action, ()>,
    bells: Bells,
    _node: Node<ipc::Service>,
}

impl PlainWorld {
    pub(crate) fn open(place: &str) -> Self {
        let node = node(place);
        Self {
            frames: topic!(node, "frame", Frame).publisher_builder().create().unwrap(),
            actions: topic!(node, "action", Action).subscriber_builder().create().unwrap(),
            bells: bells(&node, "world", "agents"),
            _node: node,
        }
    }

    /// Times so many ticks, in nanoseconds.
    pub(crate) fn run(&self, ticks: usize) -> Vec<u64> {
        self.await_all(0);
        let mut times = Vec::with_capacity(ticks);
        for tick in 1..=ticks as u64 {
            let started = Instant::now();
            self.send(tick);
            self.await_all(tick);
            times.push(started.elapsed().as_nanos() as u64);
        }
        self.send(END);
        times
    }

    fn send(&self, tick: u64) {
        let frame = self.frames.loan_uninit().unwrap();
        frame.write_payload([tick; FRAME_WORDS]).send().unwrap();
        self.bells.peers.notify().unwrap();
    }

    fn await_all(&self, tick: u64) {
        let mut answered = 0_u32;
        loop {
            newest(&self.actions, |action| {
                answered |= if action[0] == tick { 1 << action[1] } else { 0 };
            });
            if answered.count_ones() == AGENTS as u32 {
                return;
            }
            self.bells.own.blocking_wait(|_| {}).unwrap();
        }
    }
}
