//! Both ends of a line over real sessions of zenoh on this machine.
#![allow(clippy::unwrap_used, missing_docs)]

use std::fs;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use embedded_io::{Read, ReadReady, Write};
use sortie_core::Shape;
use sortie_line::{Away, Home, Key, LineError, LineSettings, Offer, Taken, Team};
use sortie_zenoh::{End, ZenohCarrier, ZenohError, ZenohSettings};

const OFFER: Offer = Offer { abi: 3, contract: 7, model: [1; 16], agents: 0b110 };
const SHAPE: Shape = Shape { agents: 3, entities: 5, tasks: 2, actions: 4, features: 6 };
const PATIENCE: Duration = Duration::from_secs(10);

/// A locator that nobody listens at.
fn free(protocol: &str) -> String {
    let socket = TcpListener::bind("127.0.0.1:0").unwrap();
    format!("{protocol}/127.0.0.1:{}", socket.local_addr().unwrap().port())
}

/// What the ends of one line have in common.
#[derive(Clone)]
struct Line {
    name: &'static str,
    locator: Option<String>,
    configuration: Option<PathBuf>,
    key: Key,
}

impl Line {
    fn at(locator: &str) -> Self {
        let locator = Some(locator.to_owned());
        Self { name: "default/1,2", locator, configuration: None, key: Key::plain() }
    }

    fn open(&self, end: End) -> LineSettings {
        let (locator, configuration) = (self.locator.as_deref(), self.configuration.as_deref());
        let settings = ZenohSettings { end, locator, configuration, line: self.name };
        let carrier = Arc::new(ZenohCarrier::open(&settings).unwrap());
        LineSettings { carrier, key: self.key.clone(), copies: 1 }
    }

    /// The end of a team, which takes one runner only.
    fn home(&self, host: u16) -> Home {
        let judge = move |offer: &Offer| match *offer == OFFER {
            true => Ok(Team::new(SHAPE, 1_000, host)),
            false => Err("it is another one".to_owned()),
        };
        Home::open(self.open(End::Home), judge, || ()).unwrap()
    }

    fn join(&self) -> Result<Taken, LineError> {
        Away::connect(self.open(End::Away), OFFER, PATIENCE, &|| false)
    }
}

/// What comes, once something does.
fn read(port: &mut (impl Read + ReadReady)) -> Vec<u8> {
    let until = Instant::now() + PATIENCE;
    while !port.read_ready().unwrap() {
        assert!(Instant::now() < until, "nothing comes");
        std::thread::yield_now();
    }
    let mut bytes = vec![0; 64];
    let len = port.read(&mut bytes).unwrap();
    bytes.truncate(len);
    bytes
}

/// Both say something, and hear what the other says.
fn talk(home: &Home, line: &mut Away, words: &[u8]) {
    let mut port = home.port();
    line.write_all(words).unwrap();
    line.send();
    assert_eq!(read(&mut port), words);
    port.write_all(words).unwrap();
    home.send();
    assert_eq!(read(line), words);
}

#[test]
fn either_end_may_die_and_come_back() {
    for protocol in ["tcp", "udp"] {
        let line = Line::at(&free(protocol));
        let home = line.home(2);
        let first = line.join().unwrap();
        assert_eq!((first.team.shape(), first.team.host), (SHAPE, 2));
        let mut first = first.line;
        talk(&home, &mut first, b"one");
        // The runner's process dies, and another one is started.
        drop(first);
        let mut second = line.join().unwrap().line;
        talk(&home, &mut second, b"two");
        // The team's process dies, and another one is started: it has to be asked anew.
        drop(home);
        let home = line.home(3);
        let until = Instant::now() + PATIENCE;
        while !second.is_replaced() {
            assert!(Instant::now() < until, "it is not noticed");
            second.send();
            second.read_ready().unwrap();
            std::thread::yield_now();
        }
        drop(second);
        let third = line.join().unwrap();
        assert_eq!(third.team.host, 3);
        let mut third = third.line;
        talk(&home, &mut third, b"three");
    }
}

#[test]
fn last_words_arrive_before_the_end() {
    for round in 0..20 {
        let line = Line::at(&free(["tcp", "udp"][round % 2]));
        let home = line.home(2);
        let mut away = line.join().unwrap().line;
        talk(&home, &mut away, b"here");
        let mut port = home.port();
        for _ in 0..5 {
            port.write_all(b"still here").unwrap();
            home.send();
        }
        port.write_all(b"the end").unwrap();
        home.send_last();
        drop((port, home));
        let mut heard = Vec::new();
        while !heard.ends_with(b"the end") {
            heard.extend(read(&mut away));
        }
    }
}

#[test]
fn a_runner_may_be_there_first() {
    let line = Line::at(&free("tcp"));
    let joining = {
        let line = line.clone();
        std::thread::spawn(move || line.join().map(|taken| taken.team.host))
    };
    // It looks for its team at least twice.
    std::thread::sleep(Duration::from_millis(300));
    let _home = line.home(5);
    assert_eq!(joining.join().unwrap().unwrap(), 5);
}

#[test]
fn strangers_and_others_are_not_taken() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("line.key");
    Key::create(&path).unwrap();
    let line = Line { key: Key::read(&path).unwrap(), ..Line::at(&free("tcp")) };
    let home = line.home(2);
    // Who has the key is heard: the sessions have met.
    let mut taken = line.join().unwrap().line;
    talk(&home, &mut taken, b"here");
    let stranger = Line { key: Key::plain(), ..line.clone() };
    let patience = Duration::from_secs(1);
    let nobody = Away::connect(stranger.open(End::Away), OFFER, patience, &|| false).err();
    assert!(matches!(nobody, Some(LineError::NoAnswer { .. })), "{nobody:?}");
    let other = Offer { contract: 8, ..OFFER };
    let refused = Away::connect(line.open(End::Away), other, PATIENCE, &|| false).err();
    let refused = refused.unwrap().to_string();
    assert!(refused.ends_with("refuses: it is another one"), "{refused}");
}

/// A router of zenoh's, and the configuration of those who meet there.
fn router(folder: &Path) -> (zenoh::Session, PathBuf) {
    let locator = free("tcp");
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "'router'"),
        ("listen/endpoints", &format!("['{locator}']")),
        ("scouting/multicast/enabled", "false"),
    ] {
        config.insert_json5(key, value).unwrap();
    }
    let session = zenoh::Wait::wait(zenoh::open(config)).unwrap();
    let file = folder.join("client.json5");
    let text = format!("{{ mode: 'client', connect: {{ endpoints: ['{locator}'] }} }}");
    fs::write(&file, text).unwrap();
    (session, file)
}

#[test]
fn teams_that_meet_at_a_router_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let (_router, file) = router(folder.path());
    let of =
        |name| Line { name, locator: None, configuration: Some(file.clone()), key: Key::plain() };
    let (north, south) = (of("north/1,2"), of("south/1,2"));
    let homes = [north.home(1), south.home(2)];
    for (line, home, host) in [(&south, &homes[1], 2), (&north, &homes[0], 1)] {
        let taken = line.join().unwrap();
        assert_eq!(taken.team.host, host);
        let mut away = taken.line;
        talk(home, &mut away, b"met");
    }
}

/// Certificates of somebody whom nobody knows, for this machine, and zenoh's configuration with them.
fn certified(folder: &Path, name: &str) -> PathBuf {
    let made = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
    let path = |what: &str| folder.join(format!("{name}.{what}"));
    fs::write(path("pem"), made.cert.pem()).unwrap();
    fs::write(path("key"), made.signing_key.serialize_pem()).unwrap();
    let (pem, key, file) = (path("pem"), path("key"), path("json5"));
    let text = format!(
        "{{ transport: {{ link: {{ tls: {{ root_ca_certificate: {pem:?}, listen_certificate: {pem:?}, \
         listen_private_key: {key:?}, enable_mtls: true, connect_certificate: {pem:?}, \
         connect_private_key: {key:?} }} }} }} }}"
    );
    fs::write(&file, text).unwrap();
    file
}

#[test]
fn tls_takes_whose_certificate_is_known() {
    let folder = tempfile::tempdir().unwrap();
    let locator = free("tls").replace("127.0.0.1", "localhost");
    let known = certified(folder.path(), "known");
    let line = Line { configuration: Some(known), ..Line::at(&locator) };
    let home = line.home(2);
    let unknown = Some(certified(folder.path(), "unknown"));
    let stranger = Line { configuration: unknown, ..line.clone() };
    let patience = Duration::from_secs(2);
    let nobody = Away::connect(stranger.open(End::Away), OFFER, patience, &|| false).err();
    assert!(matches!(nobody, Some(LineError::NoAnswer { .. })), "{nobody:?}");
    let mut taken = line.join().unwrap().line;
    talk(&home, &mut taken, b"known");
}

#[test]
fn what_zenoh_does_not_take_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("broken.json5");
    fs::write(&file, "{ mode: 'boss' }").unwrap();
    let open = |locator, configuration| {
        let line = "default/1,2";
        let settings = ZenohSettings { end: End::Home, locator, configuration, line };
        ZenohCarrier::open(&settings).err().unwrap()
    };
    let broken = open(None, Some(file.as_path()));
    assert!(matches!(broken, ZenohError::Configuration { .. }), "{broken}");
    let unknown = open(Some("pigeon/127.0.0.1:7447"), None);
    assert!(unknown.to_string().contains("pigeon"), "{unknown}");
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let locator = format!("tcp/{}", taken.local_addr().unwrap());
    let busy = open(Some(&locator), None);
    assert!(matches!(busy, ZenohError::Session { .. }), "{busy}");
}
