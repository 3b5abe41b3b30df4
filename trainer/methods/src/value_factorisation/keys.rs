//! The methods by their names, their presets and keys.

use sortie_envs::View;
use sortie_learn::configuration::{EXPLORATION, Key, OPTIMISER, Range, Section};
use sortie_learn::run::RunConfig;
use sortie_learn::session::{EnvironmentChoice, MethodEntry, Opening, Preset, Setup};
use sortie_learn::{LearnError, Method};
use toml::Table;

use super::config::Config;
use super::method::ValueFactorisation;
use super::mixer::MixerKind;
use super::partition::Partitions;
use super::split_attention::WIDTHS;

/// A-QMIX: agents that look at entities, under a mixer that does.
pub const QMIX: MethodEntry = MethodEntry {
    name: "qmix",
    about: "Utilities of agents that attend to entities, mixed by what a hypernetwork sees (A-QMIX, dissertation chapter 5)",
    sections: KEYS,
    presets: &[Preset { name: "fast", setup: || fast(|_| {}) }],
    open,
};

/// VDN: the utilities are added.
pub const VDN: MethodEntry = MethodEntry {
    name: "vdn",
    about: "The same agents, whose utilities are added (VDN)",
    presets: &[Preset {
        name: "fast",
        setup: || fast(|config| config.mixer.kind = MixerKind::Sum),
    }],
    ..QMIX
};

/// REFIL: A-QMIX that learns from imagined groups besides.
pub const REFIL: MethodEntry = MethodEntry {
    name: "refil",
    about: "A-QMIX that learns besides from imagined groups, drawn at random (REFIL, dissertation chapter 5)",
    presets: &[Preset {
        name: "fast",
        setup: || fast(|config| config.imagination.partitions = Partitions::Drawn),
    }],
    ..QMIX
};

fn fast(change: impl FnOnce(&mut Config)) -> Setup {
    let mut config = Config::default();
    change(&mut config);
    Setup {
        environment: EnvironmentChoice { instances: 16, ..EnvironmentChoice::default() },
        run: RunConfig { steps: 100_000, evaluate_every: 10_000, ..RunConfig::default() },
        own: table(&config),
        ..Setup::default()
    }
}

/// The configuration as a file has it; through text, in which numbers have no more digits than they need.
fn table(config: &Config) -> Table {
    let text = toml::to_string(config).expect("sizes and rates are values of a file");
    text.parse().expect("what was written can be read")
}

fn open(opening: &Opening<'_>) -> Result<Box<dyn Method>, LearnError> {
    let config: Config = opening.setup.own()?;
    let Opening { spec, .. } = opening;
    let misfit = |reason: String| {
        Err(LearnError::Config(format!("`{}` in `{}`: {reason}", opening.setup.method, spec.name)))
    };
    if spec.view != View::Entities {
        return misfit(
            "its agents look at entities, of which this environment shows none".to_owned(),
        );
    }
    if !WIDTHS.contains(&config.network.width) {
        return misfit(format!(
            "`network.width` is {}, must be one of {WIDTHS:?}",
            config.network.width
        ));
    }
    let kept = config.replay.capacity / opening.setup.environment.instances;
    if kept <= 4 * config.returns.steps {
        return misfit(format!(
            "`replay.capacity` leaves {kept} states for each instance, too few"
        ));
    }
    Ok(Box::new(ValueFactorisation::new(config, opening)))
}

const SHARE: Range = Range::Number(0.0, 1.0);
const SIZE: i64 = 20_000_000;

const KEYS: &[Section] = &[
    Section {
        name: "network",
        about: "The agents' network, and the hypernetwork of the mixer.",
        keys: &[
            Key::new(
                "width",
                "columns",
                Range::Whole(16, 128),
                "Width of embedding and attention: 16, 32, 64 or 128.",
            ),
            Key::new(
                "active_inputs",
                "columns",
                Range::Whole(1, 1024),
                "Non-zero inputs that the first weights are sized for; rows are mostly zeros.",
            ),
            Key::new(
                "skip",
                "",
                Range::Truth,
                "Whether an agent's own embedding reaches the layer before the head, past the attention.",
            ),
        ],
    },
    Section {
        name: "mixer",
        about: "How the utilities of a team become its value.",
        keys: &[
            Key::new(
                "kind",
                "",
                Range::OneOf(&["sum", "linear", "qmix"]),
                "Their sum (VDN), a weighted sum and a value of the state, or two layers with non-negative weights (QMIX).",
            ),
            Key::new(
                "mixing",
                "columns",
                Range::Whole(1, 1024),
                "Width between the layers of `qmix`.",
            ),
        ],
    },
    Section {
        name: "imagination",
        about: "Utilities of agents that see only their part of a partition, or only the rest, mixed to the same value.",
        keys: &[
            Key::new(
                "partitions",
                "",
                Range::OneOf(&["none", "drawn", "companions", "drawn-companions"]),
                "None, drawn anew for every use of a state (REFIL), who truly belongs together (fixed oracle), or both (randomised oracle).",
            ),
            Key::new("share", "share of the loss", SHARE, "What imagined values count."),
        ],
    },
    Section {
        name: "returns",
        about: "How rewards become targets.",
        keys: &[
            Key::new("steps", "steps", Range::Whole(1, 1000), "Steps before a target bootstraps."),
            Key::new("discount", "factor per step", SHARE, "Worth of a reward one step later."),
        ],
    },
    Section {
        name: "replay",
        about: "What is kept, and how much of it an update sees.",
        keys: &[
            Key::new("capacity", "states", Range::Whole(1, SIZE), "States kept, of all instances."),
            Key::new("batch", "states", Range::Whole(1, 65_536), "States in an update."),
            Key::new(
                "steps_per_update",
                "environment steps",
                Range::Whole(1, SIZE),
                "Steps from one update to the next.",
            ),
        ],
    },
    Section {
        name: "exploration",
        about: "How often agents take a random available action.",
        keys: EXPLORATION,
    },
    Section { name: "optimiser", about: "How the weights follow the gradient.", keys: OPTIMISER },
];
