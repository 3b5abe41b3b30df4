//! Both ends over a socket of this machine, with somebody between them who loses, doubles and keeps what is said.

mod memory;

use std::convert::Infallible;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use embedded_io::{Read, ReadReady, Write};
use sortie_core::Shape;

use crate::datagram::{Head, Kind, seal};
use crate::{Away, Home, Key, LineError, LineSettings, Offer, Taken, Team, Udp};

const OFFER: Offer = Offer { abi: 3, contract: 7, model: [1; 16], agents: 0b110 };
const SHAPE: Shape = Shape { agents: 3, entities: 5, tasks: 2, actions: 4, features: 6 };
const ANY: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::LOCALHOST), 0);

fn judge(offer: &Offer) -> Result<Team, String> {
    match *offer == OFFER {
        true => Ok(Team::new(SHAPE, 1_000, 2)),
        false => Err("it is another one".to_owned()),
    }
}

/// Of the end of a runner whose team listens at this address.
fn settings(address: SocketAddr, key: Key) -> LineSettings {
    LineSettings { carrier: Arc::new(Udp::connect(address).unwrap()), key, copies: 1 }
}

fn home(key: Key) -> (Home, SocketAddr) {
    home_at(ANY, key)
}

fn home_at(address: SocketAddr, key: Key) -> (Home, SocketAddr) {
    let carrier = Arc::new(Udp::listen(address).unwrap());
    let address = carrier.own_address().unwrap();
    (Home::open(LineSettings { carrier, key, copies: 1 }, judge, || ()).unwrap(), address)
}

fn connect(address: SocketAddr, key: Key, offer: Offer) -> Result<Taken, LineError> {
    Away::connect(settings(address, key), offer, Duration::from_millis(600), &|| false)
}

/// What comes within a while.
fn read(port: &mut (impl Read<Error = Infallible> + ReadReady<Error = Infallible>)) -> Vec<u8> {
    let until = Instant::now() + Duration::from_millis(50);
    while !port.read_ready().unwrap() && Instant::now() < until {
        std::thread::yield_now();
    }
    let (mut bytes, mut part) = (Vec::new(), [0; 7]);
    loop {
        match port.read(&mut part).unwrap() {
            0 => return bytes,
            len => bytes.extend(&part[..len]),
        }
    }
}

#[test]
fn what_is_said_arrives_in_one_piece() {
    let (home, address) = home(Key::plain());
    let Taken { mut line, team, round_trip } = connect(address, Key::plain(), OFFER).unwrap();
    assert_eq!((team.shape(), team.period_ns, team.host), (SHAPE, 1_000, 2));
    assert!(round_trip < Duration::from_millis(100), "{round_trip:?}");
    let mut port = home.port();
    // Nobody is told anything before the runner has said something itself.
    port.write_all(b"to nobody").unwrap();
    home.send();
    line.write_all(b"one ").unwrap();
    line.write_all(b"after the other").unwrap();
    line.send();
    assert_eq!(read(&mut port), b"one after the other");
    port.write_all(b"shown").unwrap();
    home.send();
    assert_eq!(read(&mut line), b"shown");
    port.write_all(b"the end").unwrap();
    home.send_last();
    assert_eq!(read(&mut line), b"the end");
    assert!(home.silence().is_some_and(|silence| silence < Duration::from_secs(1)));
}

#[test]
fn whoever_was_welcomed_hears_the_last_words_without_having_said_any() {
    let (home, address) = home(Key::plain());
    let Taken { mut line, .. } = connect(address, Key::plain(), OFFER).unwrap();
    home.port().write_all(b"the end").unwrap();
    home.send_last();
    assert_eq!(read(&mut line), b"the end");
}

#[test]
fn strangers_and_others_are_not_taken() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("line.key");
    Key::create(&path).unwrap();
    let key = Key::read(&path).unwrap();
    let (home, address) = home(key.clone());
    let nobody = connect(address, Key::plain(), OFFER).err();
    assert!(matches!(nobody, Some(LineError::NoAnswer { .. })), "{nobody:?}");
    let refused = connect(address, key.clone(), Offer { contract: 8, ..OFFER }).err();
    let refused = refused.unwrap().to_string();
    assert!(refused.ends_with("refuses: it is another one"), "{refused}");
    let first = connect(address, key.clone(), OFFER).unwrap().line;
    let mut first_said = first.clone();
    first_said.write_all(b"here").unwrap();
    first.send();
    assert_eq!(read(&mut home.port()), b"here");
    // While it is heard nobody else acts for its agents, and then somebody may.
    let second = connect(address, key.clone(), OFFER).err();
    assert!(matches!(second, Some(LineError::Busy { .. })), "{second:?}");
    let later = settings(address, key);
    let later = Away::connect(later, OFFER, Duration::from_secs(3), &|| false);
    let mut later = later.unwrap().line;
    later.write_all(b"next").unwrap();
    later.send();
    assert_eq!(read(&mut home.port()), b"next");
    first_said.write_all(b"late").unwrap();
    first.send();
    assert_eq!(read(&mut home.port()), b"");
}

#[test]
fn another_end_of_the_team_is_noticed() {
    let (first, address) = home(Key::plain());
    let mut line = connect(address, Key::plain(), OFFER).unwrap().line;
    line.write_all(b"x").unwrap();
    line.send();
    assert_eq!(read(&mut first.port()), b"x");
    drop(first);
    let _second = home_at(address, Key::plain());
    let until = Instant::now() + Duration::from_secs(5);
    while !line.is_replaced() && Instant::now() < until {
        line.send();
        line.read_ready().unwrap();
        std::thread::yield_now();
    }
    assert!(line.is_replaced());
}

/// Somebody between both ends, who does with every datagram what `fate` says: how many times it goes on, and whether one that
/// went before goes once more.
fn between(
    home: SocketAddr,
    fate: impl Fn(u64) -> (usize, bool) + Send + 'static,
) -> (SocketAddr, Arc<AtomicBool>) {
    let socket = UdpSocket::bind(ANY).unwrap();
    socket.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
    let address = socket.local_addr().unwrap();
    let is_over = Arc::new(AtomicBool::new(false));
    let ends = Arc::clone(&is_over);
    let kept = Mutex::new(Vec::<(Vec<u8>, SocketAddr)>::new());
    let count = AtomicU64::new(0);
    std::thread::spawn(move || {
        let (mut away, mut buffer) = (None, vec![0; 65_536]);
        while !ends.load(Ordering::Relaxed) {
            let Ok((len, from)) = socket.recv_from(&mut buffer) else { continue };
            let to = if from == home {
                away
            } else {
                away = Some(from);
                Some(home)
            };
            let Some(to) = to else { continue };
            let (times, again) = fate(count.fetch_add(1, Ordering::Relaxed));
            (0..times).for_each(|_| drop(socket.send_to(&buffer[..len], to)));
            let mut kept = kept.lock().unwrap();
            kept.push((buffer[..len].to_vec(), to));
            if again {
                let (old, to) = &kept[kept.len() / 2];
                drop(socket.send_to(old, *to));
            }
        }
    });
    (address, is_over)
}

#[test]
fn nothing_comes_twice_and_nothing_old() {
    let (home, address) = home(Key::plain());
    // The ends agree undisturbed; then a third is lost, a third comes twice, and something old comes with every one.
    let (address, is_over) = between(address, |count| match count {
        0..20 => (1, false),
        count if count % 3 == 0 => (0, true),
        count if count % 3 == 1 => (2, true),
        _ => (1, true),
    });
    let mut line = connect(address, Key::plain(), OFFER).unwrap().line;
    let mut port = home.port();
    let (mut at_home, mut away) = (Vec::new(), Vec::new());
    for number in 0_u8..100 {
        line.write_all(&[number]).unwrap();
        line.send();
        port.write_all(&[number]).unwrap();
        home.send();
        at_home.extend(read(&mut port));
        away.extend(read(&mut line));
    }
    is_over.store(true, Ordering::Relaxed);
    for heard in [at_home, away] {
        assert!(heard.len() > 40, "{heard:?}");
        assert!(heard.windows(2).all(|two| two[0] < two[1]), "{heard:?}");
    }
}

#[test]
fn noise_is_nothing() {
    let (home, address) = home(Key::plain());
    let socket = UdpSocket::bind(ANY).unwrap();
    let mut state = 7_u64;
    for len in 0..600 {
        let mut noise = Vec::new();
        for _ in 0..len {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            noise.push((state >> 56) as u8);
        }
        // Of somebody who has the key, and nothing to say.
        let kinds = [Kind::Offer, Kind::Welcome, Kind::Refusal, Kind::Shown, Kind::Answered];
        let head = Head { kind: kinds[len % kinds.len()], session: state, number: state >> 9 };
        socket.send_to(&seal(&Key::plain(), head, &noise), address).unwrap();
        if let Some(magic) = noise.get_mut(..4) {
            magic.copy_from_slice(b"SLN1");
        }
        socket.send_to(&noise, address).unwrap();
    }
    assert_eq!(read(&mut home.port()), b"");
    assert!(connect(address, Key::plain(), OFFER).is_ok());
}
