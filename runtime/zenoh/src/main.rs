//! The command line of Sortie with zenoh linked in, for lines between hosts and for ROS 2.
//!
//! Other verbs are as in `sortie`, which goes on as this program where an address begins with `zenoh`, or a node of ROS 2 is wanted.

mod ros2;

use std::process::ExitCode;
use std::sync::Arc;

use sortie_cli::failure::{Exit, Failure};
use sortie_cli::zenoh::{LineThrough, PolicyNode, RosNode, RosTeam, TeamNode, Zenoh};
use sortie_cli::{Program, run_program};
use sortie_ipc::PolicySchema;
use sortie_line::Carrier;
use sortie_zenoh::{End, ZenohCarrier, ZenohError, ZenohSettings};

fn main() -> ExitCode {
    // Where RUST_LOG asks for it zenoh tells what it does.
    zenoh::try_init_log_from_env();
    run_program(&Program {
        version: sortie_version::SHORT,
        built: sortie_version::LONG,
        tools: None,
        zenoh: Some(&Linked),
    })
}

/// What this program has and `sortie` has not.
struct Linked;

impl Zenoh for Linked {
    fn line(&self, end: &LineThrough<'_>) -> Result<Arc<dyn Carrier>, Failure> {
        let mut agents = end.agents.to_vec();
        agents.sort_unstable();
        let agents = match agents.as_slice() {
            [] => "allocator".to_owned(),
            agents => agents.iter().map(u16::to_string).collect::<Vec<_>>().join(","),
        };
        let settings = ZenohSettings {
            end: if end.is_home { End::Home } else { End::Away },
            locator: end.locator,
            configuration: end.configuration,
            line: &format!("{}/{agents}", end.domain),
        };
        let carrier = ZenohCarrier::open(&settings).map_err(failure)?;
        Ok(Arc::new(carrier))
    }

    fn team(&self, node: &RosNode<'_>, team: RosTeam) -> Result<Box<dyn TeamNode>, Failure> {
        ros2::team_node(node, team)
    }

    fn policy(
        &self,
        node: &RosNode<'_>,
        policy: &PolicySchema,
    ) -> Result<Box<dyn PolicyNode>, Failure> {
        ros2::policy_node(node, policy)
    }
}

fn failure(error: ZenohError) -> Failure {
    let exit = match &error {
        ZenohError::Configuration { file, .. } if !file.exists() => Exit::Missing,
        ZenohError::Configuration { .. } => Exit::BadData,
        ZenohError::Setting { .. } => Exit::Usage,
        ZenohError::Session { .. } => Exit::InputOutput,
    };
    Failure::new(exit, error.to_string().replace('\n', " "))
}
