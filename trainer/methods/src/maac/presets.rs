//! The method by its name, and its presets.

use sortie_envs::{Spec, View};
use sortie_learn::configuration::require;
use sortie_learn::run::RunConfig;
use sortie_learn::session::{MethodEntry, Opening, Preset, Setup};
use sortie_learn::{LearnError, Method};
use sortie_nn::random::stream;
use toml::{Table, Value};

use super::critic::critic;
use super::method::Maac;
use super::{Config, CriticKind, CriticShape, KEYS, OwnActions, PolicyValues};
use crate::actor_critic::groups::Groups;

/// MAAC: policies of their own, and a critic that looks at the others.
pub const MAAC: MethodEntry = MethodEntry {
    name: "maac",
    about: "Policies with rewards of their own, and a critic that looks at the others by attention (MAAC, dissertation chapter 3)",
    keys: |_| KEYS,
    presets: &[
        Preset { name: "fast", setup: || fast("maac") },
        Preset { name: "paper", setup: paper },
    ],
    flags: &[],
    compared_with: None,
    in_proportion: &[],
    suit,
    settle_older,
    misfit,
    open,
};

/// COMA: one critic for all, of everything, that learns from each decision once.
pub const COMA: MethodEntry = MethodEntry {
    name: "coma",
    about: "Policies that one critic of everything values, which learns from each decision once (COMA; MAAC is compared with it)",
    presets: &[Preset { name: "fast", setup: || fast("coma") }],
    ..MAAC
};

/// COMA's critic, learning as MAAC does.
pub const COMA_SAC: MethodEntry = MethodEntry {
    name: "coma-sac",
    about: "MAAC with the critic of COMA: one for all, of everything in one row",
    presets: &[Preset { name: "fast", setup: || fast("coma-sac") }],
    ..MAAC
};

/// MADDPG: a critic for each, of everything, whose slopes by the own action teach the policy.
pub const MADDPG: MethodEntry = MethodEntry {
    name: "maddpg",
    about: "Policies that follow the slopes of critics of everything by the own action (MADDPG, discrete; MAAC is compared with it)",
    presets: &[Preset { name: "fast", setup: || fast("maddpg") }],
    ..MAAC
};

/// MADDPG's critics, learning as MAAC does.
pub const MADDPG_SAC: MethodEntry = MethodEntry {
    name: "maddpg-sac",
    about: "MAAC with the critics of MADDPG: of everything in one row",
    presets: &[Preset { name: "fast", setup: || fast("maddpg-sac") }],
    ..MAAC
};

/// DDPG: as MADDPG, but critics see what their agents see.
pub const DDPG: MethodEntry = MethodEntry {
    name: "ddpg",
    about: "Policies that follow the slopes of critics of the own observation by the own action (DDPG, discrete; MAAC is compared with it)",
    presets: &[Preset { name: "fast", setup: || fast("ddpg") }],
    ..MAAC
};

fn fast(method: &str) -> Setup {
    let run = RunConfig { steps: 400_000, evaluate_every: 50_000, ..RunConfig::default() };
    compared(method, run, Config::default())
}

/// A setup of MAAC as another method of the dissertation's table 3.1 has it.
fn compared(method: &str, run: RunConfig, mut config: Config) -> Setup {
    let Config { network, returns, replay, entropy, update, .. } = &mut config;
    network.critic = match method {
        "coma" | "coma-sac" => CriticKind::One,
        "maddpg" | "maddpg-sac" => CriticKind::All,
        "ddpg" => CriticKind::Own,
        _ => network.critic,
    };
    let mut instances = 64;
    match method {
        "maddpg" | "ddpg" => update.own_actions = OwnActions::Relaxed,
        "coma" => {
            instances = 8;
            (returns.steps, returns.lambda, replay.on_policy) = (1, 0.8, true);
            (entropy.start, entropy.end, entropy.steps) = (0.0, 0.0, 0);
        }
        _ => {}
    }
    Setup { method: method.to_owned(), ..Setup::of(instances, run, &config) }
}

/// Steps from which on episodes count as long.
const LONG: u32 = 50;

/// What `fast` is in an environment. Critics of any kind have about as many parameters as MAAC's.
fn suit(preset: &str, setup: &mut Setup, spec: &Spec) {
    if preset != "fast" {
        return;
    }
    let run = setup.run.clone();
    let (run, mut config) = match (spec.episode_limit >= LONG, spec.roles.is_empty()) {
        (true, _) => long(run),
        (false, true) => alike(run),
        (false, false) => (run, Config::default()),
    };
    let suited = compared(&setup.method, run.clone(), config.clone());
    if let Ok(Config { network, update, .. }) = suited.own() {
        let groups = Groups::new(spec, network.shared, network.identity);
        let maac = config.critic_shape();
        (config.network.critic, config.update.own_actions) = (network.critic, update.own_actions);
        config.network.critic_width = width_like(maac, config.critic_shape(), &groups);
    }
    let environment = setup.environment.clone();
    *setup = Setup { environment, ..compared(&setup.method, run, config) };
}

/// How wide a critic is that has as many parameters as another, or hardly more.
fn width_like(other: CriticShape, shape: CriticShape, groups: &Groups) -> usize {
    if shape == other {
        return shape.width;
    }
    let count = |shape| critic(shape, groups, &mut stream(1, 1, 0)).1.values.len();
    let want = count(other);
    let has = |width: &usize| count(CriticShape { width: *width, ..shape }) >= want;
    (4..=256).find(has).unwrap_or(other.width)
}

/// Where episodes are long, what an action leads to shows later: agents hold their actions for some steps while they
/// learn, try out more at first, and follow what they come nearer to.
fn long(run: RunConfig) -> (RunConfig, Config) {
    let mut long = Config::default();
    let Config { network, returns, replay, entropy, optimiser, .. } = &mut long;
    (network.critic_width, network.heads) = (32, 2);
    (network.identity, network.input_scale) = (false, 3.0);
    (returns.steps, returns.discount) = (1, 0.97);
    (returns.decision_interval, returns.shaping) = (3, 10.0);
    (replay.batch, replay.steps_per_period, replay.capacity) = (256, 384, 48_000);
    (entropy.start, entropy.end, entropy.steps) = (0.15, 0.012, 2_500_000);
    (optimiser.critic_rate, optimiser.target_rate) = (0.003, 0.05);
    (RunConfig { steps: 2_500_000, evaluate_every: 100_000, ..run }, long)
}

/// Where episodes are short and all are alike, nobody has to know who is who, and rewards come at once.
fn alike(run: RunConfig) -> (RunConfig, Config) {
    let mut alike = Config::default();
    let Config { network, returns, replay, entropy, optimiser, .. } = &mut alike;
    network.identity = false;
    (returns.steps, replay.batch) = (1, 256);
    (entropy.start, entropy.end, entropy.steps) = (0.1, 0.01, 1_000_000);
    optimiser.target_rate = 0.05;
    (RunConfig { steps: 1_000_000, evaluate_every: 100_000, ..run }, alike)
}

fn paper() -> Setup {
    let run = RunConfig { steps: 5_000_000, evaluate_every: 100_000, ..RunConfig::default() };
    Setup::of(12, run, &Config::paper())
}

/// Of critics there were two, by what attention is.
fn settle_older(run: &mut Table) {
    let Some(network) = run.get_mut("network").and_then(Value::as_table_mut) else { return };
    if let Some(attention) = network.remove("attention") {
        let uniform = attention.as_str() == Some("uniform");
        let critic = if uniform { "uniform" } else { "attention" };
        network.insert("critic".to_owned(), critic.into());
    }
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
    let Config { network, returns, replay, update, .. } = &config;
    let attends = matches!(network.critic, CriticKind::Attention | CriticKind::Uniform);
    require(
        !attends || network.critic_width.is_multiple_of(network.heads),
        &format!(
            "`network.critic_width` is {}, must be a multiple of `network.heads`, {}",
            network.critic_width, network.heads
        ),
    )?;
    let kept = replay.capacity / opening.setup.environment.instances;
    require(
        kept > 2 * returns.steps && replay.capacity >= replay.first,
        &format!(
            "`replay.capacity` leaves {kept} decisions for each instance, too few for `returns.steps` or `replay.first`"
        ),
    )?;
    require(
        update.own_actions != OwnActions::Relaxed
            || matches!(network.critic, CriticKind::All | CriticKind::Own),
        "`update.own_actions=relaxed` needs `network.critic=all` or `own`: others are not shown the own action",
    )?;
    require(
        !replay.on_policy || returns.steps == 1,
        "`replay.on_policy` needs `returns.steps=1`; `returns.lambda` says what later rewards count",
    )?;
    require(
        (update.own_actions, update.policy_values) != (OwnActions::Drawn, PolicyValues::Kept)
            || replay.on_policy,
        "`update.own_actions=drawn` needs `update.policy_values=fresh` or `replay.on_policy`: actions that are kept are of older policies",
    )?;
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

    #[test]
    fn critics_of_all_methods_have_about_as_many_parameters() {
        for set in ["treasure-4", "treasure-8", "rover-tower-8", "rover-tower-14", "navigation-3"] {
            let set = format!("particle/{set}");
            let world = sortie_envs::open(&set, Split::Train, 1, &Default::default()).unwrap();
            let count = |entry: &MethodEntry| {
                let mut setup = entry.preset("fast").unwrap();
                suit("fast", &mut setup, world.spec());
                assert_eq!(setup.method, entry.name);
                let config: Config = setup.own().unwrap();
                let groups =
                    Groups::new(world.spec(), config.network.shared, config.network.identity);
                let critic = critic(config.critic_shape(), &groups, &mut stream(1, 1, 0));
                critic.1.values.len() as f64
            };
            let maac = count(&MAAC);
            for entry in [COMA, COMA_SAC, MADDPG, MADDPG_SAC, DDPG] {
                let ratio = count(&entry) / maac;
                assert!((1.0..1.12).contains(&ratio), "{} in {set}: {ratio}", entry.name);
            }
        }
    }

    #[test]
    fn files_of_older_runs_say_what_attention_is() {
        for (older, kind) in [("learned", CriticKind::Attention), ("uniform", CriticKind::Uniform)]
        {
            let run = "method = \"maac\"\nversion = \"0.1.0\"\nseed = 1\nthreads = 1\n";
            let text = format!("{run}[network]\nheads = 2\nattention = \"{older}\"\n");
            let Config { network, .. } = MAAC.read(&text).unwrap().own().unwrap();
            assert_eq!((network.critic, network.heads), (kind, 2));
        }
    }

    #[test]
    fn what_does_not_go_together_is_refused() {
        let world = sortie_envs::open("particle/treasure-4", Split::Train, 1, &Default::default());
        let world = world.unwrap();
        let opened = |entry: MethodEntry, assignment: &str| {
            let setup = entry.set(&entry.preset("fast").unwrap(), assignment).unwrap();
            let opening = Opening { setup: &setup, environment: &*world, seed: 1, threads: 1 };
            entry.method(&opening).map(drop).map_err(|error| error.to_string())
        };
        assert_eq!(opened(MAAC, "network.heads=2"), Ok(()));
        for (entry, assignment, named) in [
            (MAAC, "network.heads=3", "network.heads"),
            (MAAC, "update.own_actions=relaxed", "network.critic=all"),
            (MAAC, "update.own_actions=drawn", "update.policy_values=fresh"),
            (MAAC, "replay.on_policy=true", "returns.steps=1"),
            (MAAC, "replay.capacity=300", "replay.capacity"),
        ] {
            let error = opened(entry, assignment).unwrap_err();
            assert!(error.contains(named), "{assignment}: {error}");
        }
    }
}
