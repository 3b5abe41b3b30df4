//! Nodes of ROS 2 over a session of zenoh.

use std::collections::{HashMap, VecDeque};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use sortie_cli::failure::{Exit, Failure, Outcome};
use sortie_cli::zenoh::{
    FromRobot, PassedOn, PolicyNode, RosNode, RosRelease, RosTeam, TeamNode, ToRobot,
};
use sortie_ipc::{Heard, PolicySchema, Port};
use sortie_ros2::messages::{Empty, Message};
use sortie_ros2::{
    self as ros2, Answer, BridgeError, Carrier, Kind, NameError, Node, Observed, PolicyFacts,
    Release, TeamBridge, TeamFacts, Token,
};
use sortie_zenoh::{ZenohError, read_configuration};
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::CongestionControl;
use zenoh::sample::Sample;
use zenoh::{Session, Wait};

use crate::failure;

/// Most observations that wait for the policy: as many as subscribers to sensors keep.
const WAITING: usize = 5;

/// What a session gets that goes to a router; one with a configuration of its own is as that says.
const SETTINGS: [(&str, &str); 4] = [
    // A client: the router passes on all that it says and reads, wherever nodes listen.
    ("mode", "\"client\""),
    // A router that was started anew is found at once.
    ("connect/retry", "{ period_init_ms: 100, period_max_ms: 1000, period_increase_factor: 2 }"),
    ("scouting/multicast/enabled", "false"),
    ("transport/shared_memory/enabled", "false"),
];

/// Passes on what a team says.
pub(crate) fn team_node(end: &RosNode<'_>, team: RosTeam) -> Result<Box<dyn TeamNode>, Failure> {
    let RosTeam { format, ahead_ns } = team;
    let session = RosSession::open(end)?;
    let node = session.node(end)?;
    let bridge = TeamBridge::open(session, &node, TeamFacts { format, ahead_ns }).map_err(ended)?;
    Ok(Box::new(Team(bridge)))
}

/// Reads observations and publishes actions.
pub(crate) fn policy_node(
    end: &RosNode<'_>,
    policy: &PolicySchema,
) -> Result<Box<dyn PolicyNode>, Failure> {
    let session = RosSession::open(end)?;
    let node = session.node(end)?;
    let arrivals = Arc::clone(&session.arrivals);
    let node = ros2::PolicyNode::open(session, &node, facts_of(policy)).map_err(ended)?;
    Ok(Box::new(Policy { node, arrivals, robot: None, held: None }))
}

struct Team(TeamBridge<RosSession>);

impl TeamNode for Team {
    fn hear(&mut self, heard: Heard<'_>) -> Outcome {
        let Self(bridge) = self;
        let passed_on = match heard {
            Heard::Frame(header, payload) => bridge.frame(header, payload),
            Heard::Action(message) => bridge.action(message),
            Heard::Allocation(message) => bridge.allocation(message),
            Heard::Status(_) => Ok(()),
        };
        passed_on.map_err(ended)
    }

    fn passed_on(&self) -> PassedOn {
        let bridged = self.0.bridged();
        PassedOn {
            observations: bridged.observations,
            actions: bridged.actions,
            allocations: bridged.allocations,
            refused: bridged.refused,
        }
    }
}

struct Policy {
    node: ros2::PolicyNode<RosSession>,
    arrivals: Arc<Arrivals>,
    /// Who published the newest observation.
    robot: Option<[u8; 16]>,
    /// The first observation of another robot, until its episode has begun.
    held: Option<Vec<f32>>,
}

impl PolicyNode for Policy {
    fn next(&mut self, most: Duration) -> Result<Option<FromRobot>, Failure> {
        if let Some(numbers) = self.held.take() {
            return Ok(Some(FromRobot::Observation(numbers)));
        }
        let sample = match self.arrivals.next(most) {
            None => return Ok(None),
            Some(Arrived::Reset) => return Ok(Some(FromRobot::Reset)),
            Some(Arrived::Observation(sample)) => sample,
        };
        let attachment = sample.attachment().map(|it| it.to_bytes()).unwrap_or_default();
        let Observed { numbers, attachment } =
            match self.node.read(&sample.payload().to_bytes(), &attachment) {
                Ok(observed) => observed,
                Err(error) => return Ok(Some(FromRobot::Refused(error.to_string()))),
            };
        // A program that was started anew knows nothing of the episode that the one before was in.
        let before = self.robot.replace(attachment.gid);
        if before.is_some_and(|robot| robot != attachment.gid) {
            self.held = Some(numbers);
            return Ok(Some(FromRobot::Reset));
        }
        Ok(Some(FromRobot::Observation(numbers)))
    }

    fn answer(&mut self, answer: ToRobot<'_>) -> Outcome {
        let answer = match answer {
            ToRobot::Outputs(outputs) => Answer::Outputs(outputs),
            ToRobot::Choice(action) => Answer::Choice(action.into()),
        };
        self.node.answer(answer, now_ns()).map_err(ended)
    }
}

/// What came and was not read yet.
#[derive(Debug, Default)]
struct Arrivals {
    waiting: Mutex<Waiting>,
    came: Condvar,
}

#[derive(Debug, Default)]
struct Waiting {
    /// Before all observations that wait.
    is_reset: bool,
    /// Rising.
    observations: VecDeque<Sample>,
}

enum Arrived {
    Reset,
    Observation(Sample),
}

impl Arrivals {
    /// What is behind the lock is whole at any time.
    fn waiting(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What was observed before is of the episode that has ended.
    fn reset(&self) {
        *self.waiting() = Waiting { is_reset: true, observations: VecDeque::new() };
        self.came.notify_one();
    }

    fn observe(&self, sample: Sample) {
        let mut waiting = self.waiting();
        if waiting.observations.len() == WAITING {
            waiting.observations.pop_front();
        }
        waiting.observations.push_back(sample);
        drop(waiting);
        self.came.notify_one();
    }

    fn next(&self, most: Duration) -> Option<Arrived> {
        let is_empty = |waiting: &mut Waiting| !waiting.is_reset && waiting.observations.is_empty();
        let waited = self.came.wait_timeout_while(self.waiting(), most, is_empty);
        let (mut waiting, _) = waited.unwrap_or_else(PoisonError::into_inner);
        if std::mem::take(&mut waiting.is_reset) {
            return Some(Arrived::Reset);
        }
        waiting.observations.pop_front().map(Arrived::Observation)
    }
}

/// A session with the tokens and topics of one node.
#[derive(Debug)]
struct RosSession {
    session: Session,
    tokens: Vec<LivelinessToken>,
    /// By their keys.
    topics: HashMap<String, Topic>,
    subscribers: Vec<Subscriber<()>>,
    arrivals: Arc<Arrivals>,
}

/// A topic that the node publishes.
#[derive(Debug)]
struct Topic {
    publisher: Publisher<'static>,
    is_read: Arc<AtomicBool>,
}

impl RosSession {
    fn open(end: &RosNode<'_>) -> Result<Self, Failure> {
        let mut configuration = read_configuration(end.configuration).map_err(failure)?;
        if let Some(router) = end.router {
            let to = format!("[{router:?}]");
            let goes_there = [("connect/endpoints", to.as_str()), ("listen/endpoints", "[]")];
            for (key, value) in SETTINGS.into_iter().chain(goes_there) {
                let set = configuration.insert_json5(key, value);
                set.map_err(|error| {
                    let (value, reason) = (value.to_owned(), error.to_string());
                    failure(ZenohError::Setting { value, reason })
                })?;
            }
        }
        let session = zenoh::open(configuration).wait().map_err(|_| nobody(end))?;
        let (tokens, subscribers) = (Vec::new(), Vec::new());
        let (topics, arrivals) = (HashMap::new(), Arc::default());
        Ok(Self { session, tokens, topics, subscribers, arrivals })
    }

    fn node(&self, end: &RosNode<'_>) -> Result<Node, Failure> {
        let release = match end.release {
            RosRelease::Humble => Release::Humble,
            RosRelease::Jazzy => Release::Jazzy,
        };
        let session = self.session.zid().to_string();
        let node = Node::new(end.domain, &session, end.namespace, end.name, release);
        node.map_err(|error: NameError| Failure::new(Exit::Usage, error.to_string()))
    }

    fn publish(&mut self, key: String) -> zenoh::Result<()> {
        let publisher = self.session.declare_publisher(key.clone());
        let publisher = publisher.congestion_control(CongestionControl::Drop).express(true);
        let publisher = publisher.wait()?;
        let is_read = Arc::new(AtomicBool::new(publisher.matching_status().wait()?.matching()));
        let changing = Arc::clone(&is_read);
        let changes = publisher.matching_listener();
        // As long as the publisher.
        changes
            .callback(move |status| changing.store(status.matching(), Ordering::Relaxed))
            .background()
            .wait()?;
        self.topics.insert(key, Topic { publisher, is_read });
        Ok(())
    }

    fn subscribe(&mut self, topic: &ros2::Topic, key: String) -> zenoh::Result<()> {
        let arriving = Arc::clone(&self.arrivals);
        let is_reset = topic.type_name.as_str() == Empty::NAME;
        let subscriber =
            self.session.declare_subscriber(key).callback(move |sample| match is_reset {
                true => arriving.reset(),
                false => arriving.observe(sample),
            });
        self.subscribers.push(subscriber.wait()?);
        Ok(())
    }
}

/// Why a session says no more.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Closed(String);

impl From<zenoh::Error> for Closed {
    fn from(error: zenoh::Error) -> Self {
        Self(error.to_string())
    }
}

impl Carrier for RosSession {
    type Error = Closed;

    /// Whoever sees the token may publish or subscribe at once.
    fn declare(&mut self, token: &str) -> Result<(), Closed> {
        if let Ok(Token { kind, domain, topic: Some(topic), .. }) = Token::parse(token) {
            let key = topic.key(domain);
            match kind {
                Kind::Publisher => self.publish(key)?,
                Kind::Subscription => self.subscribe(&topic, key)?,
                _ => {}
            }
        }
        self.tokens.push(self.session.liveliness().declare_token(token.to_owned()).wait()?);
        Ok(())
    }

    fn put(&mut self, key: &str, bytes: &[u8], attachment: &[u8]) -> Result<(), Closed> {
        // All that a node publishes to it has declared before.
        let Some(Topic { publisher, .. }) = self.topics.get(key) else { return Ok(()) };
        Ok(publisher.put(bytes).attachment(attachment).wait()?)
    }

    fn is_read(&mut self, key: &str) -> bool {
        self.topics.get(key).is_some_and(|topic| topic.is_read.load(Ordering::Relaxed))
    }
}

fn facts_of(policy: &PolicySchema) -> PolicyFacts {
    let of = |ports: &[Port]| ports.iter().map(|port| (port.name.clone(), port.length)).collect();
    PolicyFacts {
        inputs: of(&policy.inputs),
        outputs: of(&policy.outputs),
        actions: policy.actions,
        joints: policy.robot.as_ref().map(|robot| robot.joint_names.clone()).unwrap_or_default(),
    }
}

/// Nanoseconds since 1970.
fn now_ns() -> u64 {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    now.unwrap_or_default().as_nanos() as u64
}

fn nobody(end: &RosNode<'_>) -> Failure {
    let message = match (end.router, end.configuration.map(Path::display)) {
        (Some(router), _) => format!(
            "no router of zenoh at `{router}`: start `ros2 run rmw_zenoh_cpp rmw_zenohd` there, or say by --router where it is"
        ),
        (None, Some(file)) => format!("zenoh opens no session as {file} says"),
        (None, None) => "zenoh opens no session".to_owned(),
    };
    Failure::new(Exit::NotRunning, message)
}

fn ended(error: BridgeError<Closed>) -> Failure {
    let exit = match error {
        BridgeError::Definition(_) => Exit::Usage,
        _ => Exit::InputOutput,
    };
    Failure::new(exit, error.to_string())
}
