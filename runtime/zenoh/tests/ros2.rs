//! A team and a served policy as nodes of ROS 2, with the programs that users start.
#![allow(clippy::unwrap_used, missing_docs)]

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::BufReader;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use sortie_core::wire::ActionMsg;
use sortie_ipc::{ClientSettings, Domain, Expected, PolicyClient};
use sortie_record::{Reader, Record};
use sortie_ros2::messages::{Action, Empty, Float32MultiArray, Message, Observation};
use sortie_ros2::{Attachment, Kind, Node, Qos, Release, Token, decode};
use zenoh::sample::Sample;
use zenoh::{Session, Wait};
use zerocopy::FromBytes;

const PATIENCE: Duration = Duration::from_secs(60);
/// That of ROS, so that no node of this machine is met.
const DOMAIN: u32 = 87;

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// A program that ends with the test.
struct Running(Child);

impl Running {
    fn start(domain: &str, words: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sortie-zenoh"));
        command.args(words).args(["--domain", domain]).current_dir(repository());
        Self(command.stdout(Stdio::piped()).spawn().unwrap())
    }

    /// As Ctrl-C does.
    fn interrupt(&self) {
        let pid = rustix::process::Pid::from_child(&self.0);
        rustix::process::kill_process(pid, rustix::process::Signal::INT).unwrap();
    }

    /// What it printed, once it has ended well.
    fn end(mut self) -> String {
        let said = std::io::read_to_string(self.0.stdout.take().unwrap()).unwrap();
        assert!(self.0.wait().unwrap().success(), "{said}");
        said
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Where nodes of ROS meet, and all that is published there.
struct Router {
    session: Session,
    locator: String,
    heard: Receiver<Sample>,
}

impl Router {
    fn start() -> Self {
        let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let locator = format!("tcp/{free}");
        let mut config = zenoh::Config::default();
        for (key, value) in [
            ("mode", "'router'"),
            ("listen/endpoints", &format!("['{locator}']")),
            ("scouting/multicast/enabled", "false"),
            ("transport/shared_memory/enabled", "false"),
        ] {
            config.insert_json5(key, value).unwrap();
        }
        let session = zenoh::open(config).wait().unwrap();
        let (tell, heard) = channel();
        let all = session.declare_subscriber(format!("{DOMAIN}/**"));
        all.callback(move |sample| tell.send(sample).unwrap_or_default())
            .background()
            .wait()
            .unwrap();
        Self { session, locator, heard }
    }

    fn flags(&self) -> Vec<String> {
        let flags = ["--router", &self.locator, "--ros-domain", &DOMAIN.to_string(), "--json"];
        flags.map(str::to_owned).to_vec()
    }

    /// Who is there.
    fn tokens(&self) -> Vec<Token> {
        let all = self.session.liveliness().get(format!("@ros2_lv/{DOMAIN}/**")).wait().unwrap();
        let one = |token: zenoh::query::Reply| {
            Token::parse(token.result().unwrap().key_expr().as_str()).unwrap()
        };
        all.into_iter().map(one).collect()
    }

    fn topics(&self, wanted: Kind) -> Vec<String> {
        let tokens = self.tokens().into_iter().filter(|token| token.kind == wanted);
        let mut topics: Vec<String> = tokens.map(|token| token.topic.unwrap().name).collect();
        topics.sort();
        topics
    }

    fn next(&self) -> Sample {
        self.heard.recv_timeout(PATIENCE).expect("nobody says anything")
    }
}

/// The topic of a sample, and what it says.
fn read<M: Message>(sample: &Sample) -> (String, M) {
    let key: Vec<&str> = sample.key_expr().as_str().split('/').collect();
    let topic = key.get(1..key.len() - 2).unwrap().join("/");
    (topic, decode(&sample.payload().to_bytes()).unwrap())
}

fn attachment(sample: &Sample) -> Attachment {
    Attachment::from_bytes(&sample.attachment().unwrap().to_bytes()).unwrap()
}

/// Waits until it is so.
fn wait_for(what: &str, is_so: impl Fn() -> bool) {
    let until = Instant::now() + PATIENCE;
    while !is_so() {
        assert!(Instant::now() < until, "{what}");
        std::thread::yield_now();
    }
}

fn is_up(domain: &str) -> impl Fn() -> bool {
    let domain = Domain::new(domain).unwrap();
    move || domain.facts().is_ok_and(|facts| facts.is_some())
}

/// The actions of a record, by agent and tick.
fn recorded(path: &Path) -> BTreeMap<(u16, u64), ActionMsg> {
    let mut reader = Reader::new(BufReader::new(File::open(path).unwrap())).unwrap();
    let (mut channel, mut actions) = (None, BTreeMap::new());
    while let Some(record) = reader.next().unwrap() {
        match record {
            Record::Channel { id, topic: "/action", .. } => channel = Some(id),
            Record::Message(message, bytes) if Some(message.channel) == channel => {
                let action = ActionMsg::read_from_bytes(bytes).unwrap();
                actions.insert((action.agent, action.tick), action);
            }
            _ => {}
        }
    }
    actions
}

#[test]
fn what_a_team_says_stands_on_its_topics() {
    let folder = tempfile::tempdir().unwrap();
    let record = folder.path().join("run.mcap");
    let domain = format!("ros2-team-{}", std::process::id());
    let router = Router::start();
    let words = ["up", "models/save-the-city", "--rate", "50", "--episodes", "8", "--quiet"];
    let team = Running::start(&domain, &words);
    wait_for("no team comes up", is_up(&domain));
    let recorder =
        Running::start(&domain, &["record", "--output", record.to_str().unwrap(), "--quiet"]);
    let flags = router.flags();
    let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
    let words = [&["bridge", "--ros2", "--namespace", "/team"], flags.as_slice()].concat();
    let bridge = Running::start(&domain, &words);

    let first = attachment(&router.next());
    let mut topics = vec!["/team/allocation".to_owned()];
    for agent in 0..5 {
        topics.extend(["action", "observation"].map(|of| format!("/team/agent_{agent}/{of}")));
    }
    topics.sort();
    wait_for("topics are missing", || router.topics(Kind::Publisher) == topics);
    assert!(first.sequence >= 1);

    team.end();
    recorder.end();
    let summary = bridge.end();
    let recorded = recorded(&record);
    let (mut compared, mut observations, mut allocations) = (0, 0, 0);
    while let Ok(sample) = router.heard.try_recv() {
        let key = sample.key_expr().as_str();
        if key.contains("/observation/") {
            let (topic, seen) = read::<Observation>(&sample);
            assert_eq!(topic, format!("team/agent_{}/observation", seen.agent));
            observations += 1;
        } else if key.contains("/action/") {
            let (topic, done) = read::<Action>(&sample);
            assert_eq!(topic, format!("team/agent_{}/action", done.agent));
            // The recorder began a little earlier or later.
            if let Some(action) = recorded.get(&(done.agent, done.tick)) {
                let said = (done.action, done.task, done.utility.to_bits(), done.flags);
                let was = (action.action, action.task, action.q.to_bits(), action.flags);
                assert_eq!(said, was);
                compared += 1;
            }
        } else {
            allocations += 1;
        }
    }
    assert!(compared > 100 && observations > 100 && allocations > 5, "{summary}");
    assert!(summary.contains("\"refused\":0"), "{summary}");
}

/// A robot's program: it publishes observations of one number, and waits for the action.
struct Robot<'a> {
    router: &'a Router,
    publisher: sortie_ros2::Publisher,
}

/// Over the router's own session.
struct Through<'a>(&'a Session);

impl sortie_ros2::Carrier for Through<'_> {
    type Error = std::io::Error;

    fn declare(&mut self, _token: &str) -> Result<(), Self::Error> {
        Ok(())
    }

    fn put(&mut self, key: &str, bytes: &[u8], attachment: &[u8]) -> Result<(), Self::Error> {
        let put = self.0.put(key.to_owned(), bytes).attachment(attachment).wait();
        put.map_err(|error| std::io::Error::other(error.to_string()))
    }
}

impl<'a> Robot<'a> {
    fn new(router: &'a Router, name: &str) -> Self {
        let session = router.session.zid().to_string();
        let node = Node::new(DOMAIN, &session, "/cart", name, Release::Jazzy).unwrap();
        let publisher = node.publisher::<Float32MultiArray>(1, "observation", Qos::SENSOR).unwrap();
        Self { router, publisher }
    }

    fn observe(&mut self, numbers: &[f32]) {
        let message = Float32MultiArray { data: numbers.to_vec(), ..Float32MultiArray::default() };
        self.publisher.publish(&mut Through(&self.router.session), &message, 5).unwrap();
    }

    fn act(&mut self, number: f32) -> Vec<f32> {
        self.observe(&[number]);
        loop {
            let sample = self.router.next();
            if sample.key_expr().as_str().contains("/action/") {
                return read::<Float32MultiArray>(&sample).1.data;
            }
        }
    }

    fn episode(&mut self) -> Vec<Vec<f32>> {
        [0.5, -0.25, 1.0, 0.125].map(|number| self.act(number)).to_vec()
    }
}

#[test]
fn a_served_policy_answers_who_publishes_observations() {
    let domain = format!("ros2-policy-{}", std::process::id());
    let router = Router::start();
    let flags = router.flags();
    let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
    let words = ["serve", "examples/embed_c/cart.plan", "--ros2", "--namespace", "/cart"];
    // No answer of a busy machine is late.
    let deadline = ["--deadline-ms", "5000"];
    let served = Running::start(&domain, &[&words, deadline.as_slice(), &flags].concat());
    // Its tokens come one after the other.
    wait_for("no node comes", || router.tokens().len() == 4);
    assert_eq!(router.topics(Kind::Subscription), ["/cart/observation", "/cart/reset"]);
    assert_eq!(router.topics(Kind::Publisher), ["/cart/action"]);

    let mut robot = Robot::new(&router, "robot");
    let first = robot.episode();
    assert_ne!(first, robot.episode(), "the recurrent state goes on");
    let reset = Node::new(DOMAIN, "1", "/cart", "operator", Release::Jazzy).unwrap();
    let mut reset = reset.publisher::<Empty>(1, "reset", Qos::TOPIC).unwrap();
    reset.publish(&mut Through(&router.session), &Empty::default(), 5).unwrap();
    assert_eq!(first, robot.episode(), "a reset begins an episode");
    // Of the wrong length: it is not answered, and changes nothing.
    robot.observe(&[1.0, 2.0]);
    assert_eq!(Robot::new(&router, "other").episode(), first, "another robot begins one, too");

    served.interrupt();
    let summary = served.end();
    assert!(summary.contains("\"refused\":1"), "{summary}");
    assert!(summary.contains("\"observations\":16"), "{summary}");
    assert_eq!(first, asked_in_shared_memory(&format!("{domain}-own")));
}

/// What robots get that ask without ROS.
fn asked_in_shared_memory(domain: &str) -> Vec<Vec<f32>> {
    let served = Running::start(domain, &["serve", "examples/embed_c/cart.plan", "--quiet"]);
    let expected = Expected { inputs: &[("", 1)], outputs: &[("", 1)], actions: 0 };
    let patient = Some(PATIENCE);
    let settings = ClientSettings { deadline: patient, patience: PATIENCE, ..Default::default() };
    let domain = Domain::new(domain).unwrap();
    let mut client = PolicyClient::connect(&domain, &expected, &settings).unwrap();
    let act = |number: f32| client.decide(&[&[number]], &[]).unwrap().outputs.to_vec();
    let episode = [0.5, -0.25, 1.0, 0.125].map(act).to_vec();
    served.interrupt();
    served.end();
    episode
}

#[test]
fn the_program_without_zenoh_goes_on_as_the_one_that_has_it() {
    let folder = tempfile::tempdir().unwrap();
    let built = Path::new(env!("CARGO_BIN_EXE_sortie-zenoh"));
    let plain = folder.path().join("sortie");
    // An example, which is built with all tests, not with one of them.
    fs::copy(built.with_file_name("examples").join("sortie"), &plain).unwrap();
    let said = |words: &[&str]| {
        let output = Command::new(&plain).args(words).env_remove("SORTIE_DOMAIN").output().unwrap();
        (output.status.code().unwrap(), String::from_utf8(output.stderr).unwrap())
    };
    let bridge = ["bridge", "--ros2", "--domain", "ros2-nobody"];
    let (code, missing) = said(&bridge);
    assert_eq!(code, 69);
    assert!(missing.contains("zenoh is in `sortie-zenoh`, which is not at"), "{missing}");

    let beside = folder.path().join("sortie-zenoh");
    fs::copy(built, &beside).unwrap();
    let (code, nobody) = said(&bridge);
    assert_eq!(code, 69);
    assert!(nobody.contains("no world has started in domain `ros2-nobody`"), "{nobody}");
    let router = ["--router", "tcp/127.0.0.1:1"];
    let plan = repository().join("examples/embed_c/cart.plan");
    let (code, nobody) =
        said(&[&["serve", plan.to_str().unwrap(), "--ros2"], router.as_slice()].concat());
    assert_eq!(code, 69);
    assert!(nobody.contains("no router of zenoh at `tcp/127.0.0.1:1`"), "{nobody}");

    fs::remove_file(&beside).unwrap();
    fs::write(&beside, "#!/bin/sh\necho sortie 0.0.0\n").unwrap();
    let executable = std::os::unix::fs::PermissionsExt::from_mode(0o755);
    fs::set_permissions(&beside, executable).unwrap();
    let (code, other) = said(&bridge);
    assert_eq!(code, 78);
    assert!(other.contains("is version 0.0.0, this is"), "{other}");
}
