//! Both ends over a carrier in memory, which does to datagrams whatever a carrier may do.

use std::collections::VecDeque;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

use embedded_io::{Read, ReadReady, Write};

use super::{OFFER, judge};
use crate::{Away, Carrier, Home, HomePort, Key, LineSettings};

/// What both ways have in common: the weather, and all that was ever said.
struct Sky {
    state: Mutex<u64>,
    said: Mutex<Vec<Vec<u8>>>,
    /// Nothing is lost or late.
    is_calm: AtomicBool,
}

impl Sky {
    /// One of `of`, by chance.
    fn draw(&self, of: usize) -> usize {
        let mut state = self.state.lock().unwrap();
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (*state >> 33) as usize % of
    }
}

/// What goes one way.
#[derive(Default)]
struct Way {
    waiting: Mutex<VecDeque<Vec<u8>>>,
    came: Condvar,
    /// Comes after the next.
    late: Mutex<Option<Vec<u8>>>,
}

/// An end of a line in memory.
struct Memory {
    sky: Arc<Sky>,
    out: Arc<Way>,
    back: Arc<Way>,
}

/// Both ends: the team's, and the runner's.
fn pair(seed: u64) -> (Arc<Sky>, Arc<Memory>, Arc<Memory>) {
    let (state, said, is_calm) = (Mutex::new(seed), Mutex::default(), AtomicBool::new(true));
    let sky = Arc::new(Sky { state, said, is_calm });
    let ways = [Arc::<Way>::default(), Arc::<Way>::default()];
    let end = |[out, back]: [&Arc<Way>; 2]| {
        Arc::new(Memory { sky: Arc::clone(&sky), out: Arc::clone(out), back: Arc::clone(back) })
    };
    let (home, away) = (end([&ways[0], &ways[1]]), end([&ways[1], &ways[0]]));
    (sky, home, away)
}

impl Carrier for Memory {
    fn send(&self, datagram: &[u8], _: Option<SocketAddr>) {
        let Self { sky, out, .. } = self;
        let datagram = datagram.to_vec();
        let fate = if sky.is_calm.load(Ordering::Relaxed) { 4 } else { sky.draw(5) };
        let mut late = out.late.lock().unwrap();
        let mut waiting = out.waiting.lock().unwrap();
        match fate {
            0 => {}
            1 => waiting.extend([datagram.clone(), datagram.clone()]),
            2 if late.is_none() => *late = Some(datagram.clone()),
            _ => {
                waiting.push_back(datagram.clone());
                waiting.extend(late.take());
            }
        }
        // Somebody repeats what was said before, in either direction and any session.
        let mut said = sky.said.lock().unwrap();
        said.push(datagram);
        waiting.push_back(said[sky.draw(said.len())].clone());
        drop(waiting);
        out.came.notify_all();
    }

    fn receive(&self, room: &mut [u8]) -> Option<(usize, Option<SocketAddr>)> {
        let datagram = self.back.waiting.lock().unwrap().pop_front()?;
        room[..datagram.len()].copy_from_slice(&datagram);
        Some((datagram.len(), None))
    }

    fn wait(&self, most: Duration) {
        let waiting = self.back.waiting.lock().unwrap();
        drop(self.back.came.wait_timeout_while(waiting, most, |waiting| waiting.is_empty()));
    }

    fn address(&self) -> String {
        "memory".to_owned()
    }
}

/// All that has come.
fn all(port: &mut (impl Read + ReadReady)) -> Vec<u8> {
    let (mut bytes, mut part) = (Vec::new(), [0; 16]);
    while port.read_ready().unwrap() {
        let len = port.read(&mut part).unwrap();
        bytes.extend(&part[..len]);
    }
    bytes
}

/// Both say 100 numbers, of this session only. Returns what the team heard, and what the runner did.
fn talk(home: &Home, at_home: &Memory, line: &mut Away, session: u8) -> [Vec<u8>; 2] {
    let mut port = home.port();
    let mut heard = [Vec::new(), Vec::new()];
    for number in 0..100 {
        // The first of all arrives, since nobody is told anything before.
        at_home.sky.is_calm.store(number == 0, Ordering::Relaxed);
        line.write_all(&[session, number]).unwrap();
        line.send();
        // Another thread hears for the team.
        let until = Instant::now() + Duration::from_secs(30);
        let is_heard = |port: &mut HomePort| match number {
            0 => port.read_ready().unwrap(),
            _ => at_home.back.waiting.lock().unwrap().is_empty(),
        };
        while !is_heard(&mut port) && Instant::now() < until {
            std::thread::yield_now();
        }
        port.write_all(&[session, number]).unwrap();
        home.send();
        heard[0].extend(all(&mut port));
        heard[1].extend(all(line));
    }
    heard
}

#[test]
fn nothing_old_is_acted_upon_whatever_a_carrier_does() {
    for seed in 1..=10 {
        let (sky, at_home, away) = pair(seed);
        for session in 0..4 {
            let settings = |carrier| LineSettings {
                carrier,
                key: Key::plain(),
                copies: 1 + seed as usize % 2,
            };
            sky.is_calm.store(true, Ordering::Relaxed);
            let home = Home::open(settings(at_home.clone()), judge, || ()).unwrap();
            let patience = Duration::from_secs(30);
            let taken = Away::connect(settings(away.clone()), OFFER, patience, &|| false);
            let mut line = taken.unwrap().line;
            for heard in talk(&home, &at_home, &mut line, session) {
                let told = format!("seed {seed}, session {session}: {heard:?}");
                assert!(heard.len() > 20 && heard.len() % 2 == 0, "{told}");
                let (heard, _) = heard.as_chunks::<2>();
                assert!(heard.iter().all(|[of, _]| *of == session), "{told}");
                assert!(heard.windows(2).all(|two| two[0][1] < two[1][1]), "{told}");
            }
        }
    }
}
