//! The method by its name, and its presets.

use sortie_envs::{Spec, View};
use sortie_learn::run::RunConfig;
use sortie_learn::session::{MethodEntry, Opening, Preset, Setup};
use sortie_learn::{LearnError, Method};

use super::config::{
    Config, EntropyConfig, NetworkConfig, OptimiserConfig, ReplayConfig, ReturnsConfig,
};
use super::keys::KEYS;
use super::method::Maac;

/// MAAC: policies of their own, and a critic that looks at the others.
pub const MAAC: MethodEntry = MethodEntry {
    name: "maac",
    about: "Policies with rewards of their own, and a critic that looks at the others by attention (MAAC, dissertation chapter 3)",
    keys: |_| KEYS,
    presets: &[Preset { name: "fast", setup: fast }, Preset { name: "paper", setup: paper }],
    flags: &[],
    in_proportion: &[],
    suit,
    settle_older: |_| {},
    misfit,
    open,
};

fn fast() -> Setup {
    let run = RunConfig { steps: 400_000, evaluate_every: 50_000, ..RunConfig::default() };
    Setup::of(64, run, &Config::default())
}

/// Steps from which on episodes count as long.
const LONG: u32 = 50;

/// What `fast` is in an environment.
fn suit(preset: &str, setup: &mut Setup, spec: &Spec) {
    if preset != "fast" {
        return;
    }
    let run = setup.run.clone();
    let (run, own) = match (spec.episode_limit >= LONG, spec.roles.is_empty()) {
        (true, _) => long(run),
        (false, true) => alike(run),
        (false, false) => return,
    };
    let environment = setup.environment.clone();
    *setup = Setup { method: setup.method.clone(), environment, ..Setup::of(64, run, &own) };
}

/// Where episodes are long, what an action leads to shows later: agents hold their actions for some steps while they
/// learn, try out more at first, and follow what they come nearer to.
fn long(run: RunConfig) -> (RunConfig, Config) {
    let fast = Config::default();
    let long = Config {
        network: NetworkConfig {
            critic_width: 32,
            heads: 2,
            identity: false,
            input_scale: 3.0,
            ..fast.network
        },
        returns: ReturnsConfig { steps: 1, discount: 0.97, decision_interval: 3, shaping: 10.0 },
        replay: ReplayConfig { batch: 256, steps_per_period: 384, capacity: 48_000, ..fast.replay },
        entropy: EntropyConfig { start: 0.15, end: 0.012, steps: 2_500_000 },
        optimiser: OptimiserConfig { critic_rate: 0.003, target_rate: 0.05, ..fast.optimiser },
        update: fast.update,
    };
    (RunConfig { steps: 2_500_000, evaluate_every: 100_000, ..run }, long)
}

/// Where episodes are short and all are alike, nobody has to know who is who, and rewards come at once.
fn alike(run: RunConfig) -> (RunConfig, Config) {
    let fast = Config::default();
    let alike = Config {
        network: NetworkConfig { identity: false, ..fast.network },
        returns: ReturnsConfig { steps: 1, ..fast.returns },
        replay: ReplayConfig { batch: 256, ..fast.replay },
        entropy: EntropyConfig { start: 0.1, end: 0.01, steps: 1_000_000 },
        optimiser: OptimiserConfig { target_rate: 0.05, ..fast.optimiser },
        update: fast.update,
    };
    (RunConfig { steps: 1_000_000, evaluate_every: 100_000, ..run }, alike)
}

fn paper() -> Setup {
    let run = RunConfig { steps: 5_000_000, evaluate_every: 100_000, ..RunConfig::default() };
    Setup::of(12, run, &Config::paper())
}

fn misfit(spec: &Spec) -> Option<&'static str> {
    if spec.view != View::Vectors {
        return Some(
            "its agents see one row of numbers each, this environment shows something else",
        );
    }
    (!spec.rewards.agents)
        .then_some("its agents learn from rewards of their own, of which this environment has none")
}

fn open(opening: &Opening<'_>) -> Result<Box<dyn Method>, LearnError> {
    let config: Config = opening.setup.own()?;
    let network = &config.network;
    if !network.critic_width.is_multiple_of(network.heads) {
        return Err(LearnError::Config(format!(
            "`network.critic_width` is {}, must be a multiple of `network.heads`, {}",
            network.critic_width, network.heads
        )));
    }
    let kept = config.replay.capacity / opening.setup.environment.instances;
    if kept <= 2 * config.returns.steps || config.replay.capacity < config.replay.first {
        return Err(LearnError::Config(format!(
            "`replay.capacity` leaves {kept} decisions for each instance, too few for `returns.steps` or `replay.first`"
        )));
    }
    Ok(Box::new(Maac::new(config, opening)))
}

#[cfg(test)]
mod tests {
    use sortie_envs::Split;

    use super::*;

    /// Batch, steps before a value, environment steps of an action, identity, and steps of the run.
    fn suited(preset: &str, set: &str) -> (usize, usize, usize, bool, u64) {
        let world = sortie_envs::open(set, Split::Train, 1, &Default::default()).unwrap();
        let mut setup = MAAC.preset(preset).unwrap();
        suit(preset, &mut setup, world.spec());
        assert_eq!(setup.method, "maac");
        let Config { network, returns, replay, .. } = setup.own().unwrap();
        let (batch, interval) = (replay.batch, returns.decision_interval);
        (batch, returns.steps, interval, network.identity, setup.run.steps)
    }

    #[test]
    fn fast_suits_long_episodes_and_agents_that_are_all_alike() {
        let short = suited("fast", "particle/rover-tower-4");
        assert_eq!(short, (128, 3, 1, true, 400_000));
        assert_eq!(suited("fast", "particle/treasure-4"), (256, 1, 3, false, 2_500_000));
        assert_eq!(suited("fast", "particle/navigation-3"), (256, 1, 1, false, 1_000_000));
        let published = suited("paper", "particle/rover-tower-4");
        assert_eq!(published.0, 1_024);
        for set in ["particle/treasure-4", "particle/navigation-3"] {
            assert_eq!(suited("paper", set), published, "{set}");
        }
    }
}
