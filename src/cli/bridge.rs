//! ROS 2: `sortie bridge` passes on what a team says, and a served policy decides for whoever publishes observations.

use std::fmt;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::Args;
use serde::Serialize;
use sortie_core::wire::FrameHeader;
use sortie_ipc::{ClientSettings, Domain, Heard, PolicyClient, PolicySchema, Stop};

use crate::failure::{Failure, Outcome};
use crate::listener::{Listener, Missed, wall_clock_ahead_ns};
use crate::output::{Common, plural, print_json, say, tell};
use crate::terminal::{spinner, stop_on_signals};
use crate::zenoh::{
    self, FromRobot, PassedOn, PolicyNode, RosNode, RosRelease, RosTeam, TeamNode, ToRobot,
};

/// The longest sleep between two looks.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// What is refused is told of no more often than this.
const TELL_EVERY: Duration = Duration::from_secs(1);

/// Where `rmw_zenohd` listens unless it is told otherwise.
const ROUTER: &str = "tcp/localhost:7447";

/// A node of ROS 2.
#[derive(Clone, Debug, Args)]
pub(crate) struct RosArguments {
    /// Namespace of the node and its topics, `/team`
    #[arg(long, value_name = "NAMESPACE", default_value = "/", requires = "ros2")]
    namespace: String,
    /// Where `rmw_zenohd` listens, as zenoh writes it [default: tcp/localhost:7447, or as --config says]
    #[arg(long, value_name = "LOCATOR", requires = "ros2")]
    router: Option<String>,
    /// zenoh's own configuration of a session
    // No flag that the environment sets requires another one: on hosts with ROS it is set for all programs.
    #[arg(long, value_name = "FILE", env = "ZENOH_SESSION_CONFIG_URI")]
    config: Option<PathBuf>,
    /// Domain of ROS
    #[arg(long, value_name = "NUMBER", env = "ROS_DOMAIN_ID", default_value_t = 0)]
    ros_domain: u32,
    /// What the hosts with ROS run
    #[arg(long, value_enum, default_value_t = RosRelease::Jazzy, requires = "ros2")]
    release: RosRelease,
}

impl RosArguments {
    fn node<'a>(&'a self, name: &'a str) -> RosNode<'a> {
        let Self { namespace, router, config, ros_domain: domain, release } = self;
        RosNode {
            router: router.as_deref().or(config.is_none().then_some(ROUTER)),
            configuration: config.as_deref(),
            domain: *domain,
            namespace,
            name,
            release: *release,
        }
    }

    /// `/team/observation`.
    fn topic(&self, name: &str) -> String {
        format!("{}/{name}", self.namespace.trim_end_matches('/'))
    }
}

/// Pass on what a running team says, as topics of ROS 2
///
/// What its agents observe and do, and who works on what, for hosts that speak zenoh (rmw_zenoh); ROS itself is not needed here.
/// Nobody in the team waits for it, and nothing comes back. It ends with the team. Messages are in runtime/ros2/sortie_msgs, and
/// what stands on the topics in docs/guide/ros2.md.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie bridge --ros2                                          # topics /agent_0/observation, ..., /allocation
  sortie bridge --ros2 --namespace /team --domain north
  sortie bridge --ros2 --router tcp/192.168.1.5:7447            # rmw_zenohd is on another host
  sortie bridge --ros2 --config zenoh.json5 --json              # by TLS, for instance")]
pub(crate) struct BridgeArguments {
    /// To nodes of ROS 2, the only ones there are so far
    #[arg(long, required = true)]
    ros2: bool,
    /// Domain of the team
    #[arg(long, env = "SORTIE_DOMAIN", default_value = "default")]
    domain: String,
    #[command(flatten)]
    ros: RosArguments,
    #[command(flatten)]
    common: Common,
}

#[derive(Serialize)]
struct Summary<'a> {
    domain: &'a str,
    namespace: &'a str,
    ros_domain: u32,
    #[serde(flatten)]
    passed_on: PassedOn,
    /// Messages that were gone before they were read.
    missed: u64,
}

pub(crate) fn run(arguments: &BridgeArguments) -> Outcome {
    let BridgeArguments { domain: name, ros, common, .. } = arguments;
    let zenoh = zenoh::linked()?;
    let stop = stop_on_signals()?;
    let mut listener = Listener::enter(&Domain::new(name)?, "bridge")?;
    let format = listener.facts().format()?;
    let team = RosTeam { format, ahead_ns: wall_clock_ahead_ns() };
    let mut node = zenoh.team(&ros.node("sortie_bridge"), team)?;
    if !common.json && !common.quiet {
        let agents = format.layout.shape().agents;
        let of_agents = ros.topic(&format!("agent_0...{}", agents.saturating_sub(1)));
        say!("{of_agents}/observation, action; {}", ros.topic("allocation"));
        say!("domain `{name}` is on ROS's domain {}; Ctrl-C ends it", ros.ros_domain);
    }
    let missed = pass_on(&mut listener, node.as_mut(), &stop, *common)?;
    report(arguments, node.passed_on(), missed);
    Ok(())
}

/// Passes on what is said until the team ends or the user does. Returns how many messages were missed.
fn pass_on(
    listener: &mut Listener,
    node: &mut dyn TeamNode,
    stop: &Stop,
    common: Common,
) -> Result<u64, Failure> {
    let spinner = spinner(common);
    let (mut missed, mut is_over) = (Missed::default(), false);
    while !is_over {
        let mut failed = None;
        listener.look(&mut |heard, _| {
            missed.note(heard);
            is_over |=
                matches!(heard, Heard::Frame(header, _) if header.has(FrameHeader::SHUTDOWN));
            if failed.is_none() {
                failed = node.hear(heard).err();
            }
        })?;
        failed.map_or(Ok(()), Err)?;
        spinner.set_message(plural(node.passed_on().all() as usize, "message"));
        is_over |= stop.is_set() || listener.is_alone();
        if !is_over {
            listener.wait(LOOK_EVERY);
        }
    }
    spinner.finish_and_clear();
    Ok(missed.count())
}

fn report(arguments: &BridgeArguments, passed_on: PassedOn, missed: u64) {
    let BridgeArguments { domain, ros: RosArguments { namespace, ros_domain, .. }, common, .. } =
        arguments;
    if common.json {
        print_json(&Summary { domain, namespace, ros_domain: *ros_domain, passed_on, missed });
        return;
    }
    let PassedOn { observations, actions, allocations, refused } = passed_on;
    say!(
        "{observations} observations, {actions} actions, {allocations} allocations passed on; {missed} messages missed, {refused} refused"
    );
}

/// What came from a robot; how it was answered the server counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub(crate) struct Relayed {
    observations: u64,
    /// What was no observation of this policy.
    refused: u64,
}

impl fmt::Display for Relayed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { observations, refused } = self;
        write!(
            f,
            "{observations} observations over ROS, and {refused} that were none of this policy"
        )
    }
}

/// A served policy as a node.
pub(crate) struct Robot {
    node: Box<dyn PolicyNode>,
    policy: PolicySchema,
    is_quiet: bool,
    relayed: Relayed,
    /// When something was told of last.
    told: Option<Instant>,
}

impl Robot {
    pub(crate) fn open(
        ros: &RosArguments,
        policy: &PolicySchema,
        common: Common,
    ) -> Result<Self, Failure> {
        let node = zenoh::linked()?.policy(&ros.node("sortie_policy"), policy)?;
        let is_quiet = common.quiet;
        if !common.json && !is_quiet {
            let (from, to) = (ros.topic("observation"), ros.topic("action"));
            say!("{from} is answered on {to}, domain {} of ROS", ros.ros_domain);
        }
        Ok(Self { node, policy: policy.clone(), is_quiet, relayed: Relayed::default(), told: None })
    }

    /// Asks the server of the domain until it is stopped. The server is stopped where this fails.
    pub(crate) fn relay(mut self, domain: &Domain, stop: &Stop) -> Result<Relayed, Failure> {
        let ended = self.ask(domain, stop);
        stop.stop();
        ended.map(|()| self.relayed)
    }

    fn ask(&mut self, domain: &Domain, stop: &Stop) -> Outcome {
        let mut client = PolicyClient::connect_for_threads(domain, &ClientSettings::default())?;
        let available = vec![1; self.policy.actions];
        while !stop.is_set() {
            let observation = match self.node.next(LOOK_EVERY)? {
                None => continue,
                Some(FromRobot::Observation(numbers)) => numbers,
                Some(FromRobot::Reset) => {
                    client.begin_episode();
                    continue;
                }
                Some(FromRobot::Refused(why)) => {
                    self.refuse(&why);
                    continue;
                }
            };
            let inputs = inputs_of(&self.policy, &observation);
            let action = client.decide(&inputs, &available)?;
            self.relayed.observations += 1;
            match (self.policy.actions, action.action) {
                (0, _) => self.node.answer(ToRobot::Outputs(action.outputs))?,
                (_, Some(choice)) => self.node.answer(ToRobot::Choice(choice))?,
                (_, None) => {}
            }
        }
        Ok(())
    }

    fn refuse(&mut self, why: &str) {
        self.relayed.refused += 1;
        if !self.is_quiet && self.told.is_none_or(|told| told.elapsed() > TELL_EVERY) {
            tell!("refused an observation: {why}");
            self.told = Some(Instant::now());
        }
    }
}

/// The numbers of each input, where they lie one behind the other.
fn inputs_of<'a>(policy: &PolicySchema, numbers: &'a [f32]) -> Vec<&'a [f32]> {
    let mut rest = numbers;
    let one = |length: usize| {
        let (input, behind) = rest.split_at_checked(length).unwrap_or((rest, &[]));
        rest = behind;
        input
    };
    policy.inputs.iter().map(|port| port.length).map(one).collect()
}
