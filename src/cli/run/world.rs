//! A world process of a supervised team.

use std::time::Duration;

use clap::Args;
use sortie_bundle::Bundle;
use sortie_core::World;
use sortie_envs::Split;
use sortie_envs::random::generator;
use sortie_ipc::{
    Domain, DomainContract, Fill, RealTime, Stop, WorldSettings, world_process,
    world_process_with_fill,
};

use super::onlooker::{Display, Ledger, Onlooker};
use super::registry::policies;
use super::report::{Manner, Setup, report};
use super::team::Absentees;
use super::{positive_seconds, rate};
use crate::allocation::{AllocatorChoice, name_of};
use crate::deployment::model_id;
use crate::environment::{ScenarioSetName, check_fits};
use crate::failure::{Exit, Failure, Outcome};
use crate::policy::{Backend, DeployedPolicy};
use crate::trust::TrustArguments;
use crate::worlds::world::EnvironmentWorld;

/// What a supervised world plays.
#[derive(Clone, Debug, Args)]
pub struct Playing {
    /// Scenario set to play; default: the one that the bundle was trained on
    #[arg(long, value_name = "ENV[/SET]")]
    pub(super) env: Option<String>,
    /// Episodes to play; default: until stopped
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) episodes: Option<u32>,
    /// Ticks a second; agents have 80 % of a tick to act. 0 for as fast as the team acts
    #[arg(long, default_value_t = 100.0, value_name = "HZ", value_parser = rate)]
    pub(super) rate: f64,
    #[command(flatten)]
    pub(super) absentees: Absentees,
    /// With --rate 0, seconds to wait for an action before the fallback is played
    #[arg(long, default_value_t = 2.0, value_name = "S", value_parser = positive_seconds)]
    pub(super) patience: f64,
}

impl Playing {
    fn rate_hz(&self) -> Option<f64> {
        (self.rate > 0.0).then_some(self.rate)
    }

    /// From frame to frame; zero = as long as the team takes.
    pub(super) fn period(&self) -> Duration {
        self.rate_hz().map_or(Duration::ZERO, |hz| Duration::from_secs_f64(1.0 / hz))
    }

    /// Names what is played; the same for a world and the one that takes its place.
    fn key(&self, seed: u64) -> String {
        let Self { env, episodes, absentees, .. } = self;
        let absent = absentees.flag().unwrap_or_default();
        format!("{env:?}, {episodes:?} episodes, seed {seed}{absent}")
    }
}

/// The world that a bundle is to play in.
pub fn open_world(
    bundle: &Bundle,
    asked: Option<&str>,
    seed: u64,
) -> Result<EnvironmentWorld, Failure> {
    let trained_on = &bundle.manifest().contract.environment.name;
    let set = ScenarioSetName::parse(asked.unwrap_or(trained_on))?;
    check_fits(bundle, &set)?;
    Ok(EnvironmentWorld::new(set.open(Split::Train)?, generator(seed)))
}

/// The world's part of a team.
pub(super) struct WorldOfTeam<'a> {
    pub(super) bundle: &'a Bundle,
    pub(super) contract: &'a DomainContract,
    pub(super) allocation: Option<AllocatorChoice>,
    pub(super) backend: Backend,
    pub(super) seed: u64,
    pub(super) json: bool,
    pub(super) quiet: bool,
    pub(super) private: bool,
    pub(super) fill: bool,
    pub(super) trust: &'a TrustArguments,
    pub(super) linger: Option<Duration>,
    pub(super) real_time: RealTime,
}

/// Plays with whoever is there, and reports. Episodes of a world before it that died count.
pub(super) fn play(
    team: &WorldOfTeam<'_>,
    playing: &Playing,
    domain: &Domain,
    stop: &Stop,
) -> Outcome {
    let ledger = Ledger::new(domain, playing.key(team.seed));
    let earlier = ledger.read(domain)?;
    let (set, seed) = (playing.env.as_deref(), next_seed(team.seed, earlier.episodes));
    let mut world = open_world(team.bundle, set, seed)?;
    playing.absentees.check(world.shape().agents)?;
    *world.tally.borrow_mut() = earlier;
    let display = if team.json || team.quiet { Display::Silent } else { Display::Lines };
    let episodes = playing.episodes.map(|episodes| episodes as usize);
    let mut onlooker = Onlooker::new(display, episodes, &world, Some(ledger));
    let left = episodes.map(|episodes| episodes.saturating_sub(onlooker.earlier));
    let ended = match left {
        // The world before died after its last episode.
        Some(0) => Ok(()),
        _ => play_on(team, playing, domain, &mut world, left, &mut onlooker, stop),
    };
    let setup = Setup {
        allocation: name_of(team.allocation).to_string(),
        backend: team.backend.name().to_string(),
        rate_hz: playing.rate_hz(),
    };
    let manner = if team.json { Manner::Json } else { Manner::Tables };
    report(
        &world.tally.borrow(),
        world.environment.borrow().spec(),
        &onlooker,
        setup,
        manner,
        ended.is_ok(),
    );
    if ended.is_ok() {
        onlooker.close();
    }
    ended
}

/// Plays the episodes that are left.
fn play_on(
    team: &WorldOfTeam<'_>,
    playing: &Playing,
    domain: &Domain,
    world: &mut EnvironmentWorld,
    left: Option<usize>,
    onlooker: &mut Onlooker,
    stop: &Stop,
) -> Outcome {
    let settings = WorldSettings {
        allocator: team.allocation.is_some(),
        absent: playing.absentees.seats(),
        strict: false,
        period: playing.period(),
        patience: Duration::from_secs_f64(playing.patience),
        episodes: left.map(|left| left.try_into().unwrap_or(u32::MAX)),
        private: team.private,
        linger: team.linger,
        real_time: team.real_time,
        ..WorldSettings::default()
    };
    let start = |_: &mut _| Ok(());
    let ended = if team.fill {
        let mut policy = DeployedPolicy::open(team.bundle, team.backend)?;
        let mut policy = policy.team()?;
        let registry = policies(team.bundle.folder(), team.trust, team.backend)?;
        let model = model_id(team.bundle);
        let fill = Fill { policy: policy.as_mut(), model, registry: Some(registry) };
        let filled: (&mut dyn World, _) = (world, fill);
        world_process_with_fill(domain, team.contract, filled, &settings, start, onlooker, stop)
    } else {
        world_process(domain, team.contract, world, &settings, start, onlooker, stop)
    };
    match ended {
        Ok(_) => Ok(()),
        Err(sortie_ipc::Error::Interrupted) => Err(Failure::new(Exit::Interrupted, "")),
        Err(error) => Err(error.into()),
    }
}

/// The seed of a world that goes on after so many episodes of another: it plays others.
fn next_seed(seed: u64, episodes: usize) -> u64 {
    seed.wrapping_add((episodes as u64).rotate_left(32))
}
