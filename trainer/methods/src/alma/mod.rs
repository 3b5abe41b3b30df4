//! ALMA: agents act on the subtasks that an allocator gives them (dissertation chapter 7), with its variants, flat
//! agents and COPA.
//!
//! Two learners: one from [`records`], the preset `fast`, one from [`windows`], the preset `paper`.

pub mod agents;
pub mod coach;
mod export;
mod learned;
pub mod records;
pub mod teams;
pub mod windows;

use sortie_core::limits::TASKS;
use sortie_envs::{Spec, View};
use sortie_learn::configuration::{Section, check_table};
use sortie_learn::run::RunConfig;
use sortie_learn::session::{Flag, MethodEntry, Opening, Preset, Setup};
use sortie_learn::subtasks::RuleAllocator;
use sortie_learn::{LearnError, Method};
use toml::Table;

use agents::Conditioning;
use records::Records;
use windows::WindowLearner;

/// What a run learns by.
#[derive(Clone, Debug, PartialEq)]
pub enum Config {
    /// Records of one step and one subtask: the preset `fast`.
    Records(Box<records::Config>),
    /// Windows of whole episodes: the preset `paper`.
    Windows(Box<windows::Config>),
}

impl Config {
    /// What a setup says.
    ///
    /// # Errors
    /// A key is unknown, or a value impossible.
    pub fn of(setup: &Setup) -> Result<Self, LearnError> {
        let mut own = setup.own.clone();
        settle_older(&mut own);
        check_table("", &own, keys(&own))?;
        let setup = Setup { own, ..setup.clone() };
        Ok(if is_windows(&setup.own) {
            Self::Windows(Box::new(windows::Config::of(&setup)?))
        } else {
            Self::Records(Box::new(records::Config::of(&setup)?))
        })
    }

    fn method(&self) -> &'static str {
        match (self.subtask(), self) {
            (_, Self::Windows(config)) if config.coach.enabled => "copa",
            (Conditioning::None, _) => "flat",
            (Conditioning::Mask | Conditioning::Input, _) => "alma",
        }
    }

    /// Refuses rules of allocation that an environment does not have.
    fn check_rules(&self, spec: &Spec) -> Result<(), LearnError> {
        if !self.subtask().has_subtasks() {
            return Ok(());
        }
        let rules: Vec<&str> = match self {
            Self::Records(config) => config.allocation.rules().collect(),
            Self::Windows(config) => config.rule().into_iter().collect(),
        };
        let check = |rule| RuleAllocator(rule).number(spec).map(drop).map_err(LearnError::Config);
        rules.into_iter().try_for_each(check)
    }

    /// What the agents see of the subtasks.
    pub fn subtask(&self) -> Conditioning {
        match self {
            Self::Records(config) => config.network.subtask,
            Self::Windows(config) => config.low_level.conditioning,
        }
    }
}

fn keys(own: &Table) -> &'static [Section] {
    if is_windows(own) { windows::config::KEYS } else { records::config::KEYS }
}

/// Whether it learns from windows; tables about records do not say so.
fn is_windows(own: &Table) -> bool {
    own.get("learner").and_then(toml::Value::as_str) == Some("windows")
}

/// Runs that do not say whether embeddings skip the attention, and whether heads point, began when none did.
fn settle_older(run: &mut Table) {
    if is_windows(run) {
        settle_head(run, "low_level");
        // It never changed anything: environments tell of no actions that apply to one subtask alone.
        if let Some(section) = run.get_mut("low_level").and_then(toml::Value::as_table_mut) {
            section.remove("task_availability");
        }
        return;
    }
    for path in [&["network"][..], &["allocator", "network"]] {
        let section = path.iter().try_fold(&mut *run, |table, name| {
            table.entry(*name).or_insert_with(|| Table::new().into()).as_table_mut()
        });
        if let Some(section) = section {
            section.entry("skip").or_insert(false.into());
        }
    }
    settle_head(run, "network");
}

fn settle_head(run: &mut Table, section: &str) {
    if let Some(network) = run.get_mut(section).and_then(toml::Value::as_table_mut) {
        network.entry("head").or_insert("numbered".into());
    }
}

const MIXER: Flag = Flag { name: "--mixer", assignments: &["mixer.kind={}"] };
const TEAM_MAX: Flag = Flag { name: "--team-max", assignments: &["allocation.team_max={}"] };

/// ALMA: agents act on the subtasks that an allocator gives them.
pub const ALMA: MethodEntry = MethodEntry {
    name: "alma",
    about: "Subtask-masked utilities under an allocation (ALMA, dissertation chapter 7)",
    keys,
    presets: &[
        Preset { name: "fast", setup: || fast(|_| {}) },
        Preset { name: "paper", setup: || paper(|_| {}) },
    ],
    flags: &[
        MIXER,
        TEAM_MAX,
        Flag { name: "--no-mask", assignments: &["network.subtask=input"] },
        Flag { name: "--no-mask", assignments: &["low_level.conditioning=input"] },
        Flag { name: "--allocation", assignments: &["allocation.by={}"] },
        Flag {
            name: "--allocation",
            assignments: &[
                "allocation.learned=0",
                "allocation.coordinated=0",
                "allocation.heuristic=0",
                "allocation.random=0",
                "allocation.{}=1",
            ],
        },
    ],
    compared_with: None,
    in_proportion: &["exploration.steps", "allocator.learns_from", "allocator.decides_from"],
    suit,
    settle_older,
    misfit,
    open,
};

/// The same agents without subtasks.
pub const FLAT: MethodEntry = MethodEntry {
    name: "flat",
    about: "The same without subtasks: everybody sees everything and earns the whole team's reward",
    presets: &[
        Preset {
            name: "fast",
            setup: || fast(|config| config.network.subtask = Conditioning::None),
        },
        Preset {
            name: "paper",
            setup: || paper(|config| config.low_level.conditioning = Conditioning::None),
        },
    ],
    flags: &[MIXER],
    compared_with: Some(&ALMA),
    misfit: shows_no_entities,
    ..ALMA
};

/// COPA: flat agents whom a coach tells strategies; it learns from windows by either preset.
pub const COPA: MethodEntry = MethodEntry {
    name: "copa",
    about: "Flat agents and a coach that sees everything and tells each of them a strategy now and then",
    presets: &[
        Preset { name: "fast", setup: coached },
        Preset { name: "paper", setup: || paper(windows::Config::enable_coach) },
    ],
    flags: &[],
    compared_with: Some(&ALMA),
    misfit: shows_no_entities,
    ..ALMA
};

fn fast(change: fn(&mut records::Config)) -> Setup {
    let mut config = records::Config::default();
    change(&mut config);
    Setup::of(16, RunConfig::default(), &config)
}

fn paper(change: fn(&mut windows::Config)) -> Setup {
    let run = RunConfig { steps: 10_000_000, evaluate_episodes: 160, ..RunConfig::default() };
    let mut config = windows::Config::default();
    change(&mut config);
    Setup::of(8, run, &config)
}

/// Learned from windows too, under the conditions of the other methods' preset `fast`.
fn coached() -> Setup {
    let mut config = windows::Config::like_fast();
    config.enable_coach();
    Setup::of(8, RunConfig::default(), &config)
}

/// What `fast` is where actions are aimed at entities, as in battles: what is seen there are measures more than codes.
fn suit(preset: &str, setup: &mut Setup, spec: &Spec) {
    if preset != "fast" || spec.targets.is_empty() || is_windows(&setup.own) {
        return;
    }
    let columns = (spec.shape.features + spec.shape.actions) as f64;
    if let Some(network) = setup.own.get_mut("network").and_then(toml::Value::as_table_mut) {
        let values =
            [("width", 128.into()), ("base", 128.into()), ("active_inputs", columns.into())];
        network.extend(values.map(|(key, value): (&str, toml::Value)| (key.to_owned(), value)));
    }
    setup.run.steps = 400_000;
}

fn misfit(spec: &Spec) -> Option<&'static str> {
    if spec.shape.tasks == 0 || !spec.rewards.tasks {
        return Some("it has no subtasks with rewards of their own");
    }
    if spec.shape.tasks > TASKS {
        return Some("it has more than 32 subtasks, which the method `allocator` alone learns");
    }
    spec.rules.is_empty().then_some("it has no rule of allocation that stands in at first")
}

fn shows_no_entities(spec: &Spec) -> Option<&'static str> {
    let lack = "its agents look at entities, of which this environment shows none";
    (spec.view != View::Entities).then_some(lack)
}

fn open(opening: &Opening<'_>) -> Result<Box<dyn Method>, LearnError> {
    let Opening { setup, environment, seed, threads } = *opening;
    let config = Config::of(setup)?;
    config.check_rules(environment.spec())?;
    let (asked, found) = (&setup.method, config.method());
    if asked != found {
        let reason = format!("`{asked}` with these values is `{found}`: `sortie train {found}`");
        return Err(LearnError::Config(reason));
    }
    Ok(match config {
        Config::Records(config) => Box::new(Records::new(&config, environment, seed, threads)),
        Config::Windows(_) if setup.environment.failures > 0.0 => {
            let reason = "`environment.failures` is for the preset `fast`: the allocator that proposes counts on all agents";
            return Err(LearnError::Config(reason.to_owned()));
        }
        Config::Windows(config) => {
            Box::new(WindowLearner::new(&config, environment.spec(), seed, threads))
        }
    })
}

#[cfg(test)]
mod tests {
    use sortie_envs::{Rewards, Rule, Shape};

    use super::*;

    #[test]
    fn fast_suits_actions_that_are_aimed() {
        for (entry, width) in [(ALMA, 128), (FLAT, 128), (COPA, 64)] {
            let name = "skirmish/6-8sz-symmetric";
            let world = sortie_envs::open(name, sortie_envs::Split::Train, 1, &Default::default());
            let mut setup = entry.preset("fast").unwrap();
            let usual = setup.run.steps;
            suit("fast", &mut setup, world.unwrap().spec());
            let config = Config::of(&setup).unwrap();
            let found = match &config {
                Config::Records(config) => config.network.width,
                Config::Windows(config) => config.low_level.width,
            };
            assert_eq!((found, setup.run.steps < usual), (width, width == 128), "{}", entry.name);
        }
    }

    #[test]
    fn runs_that_began_when_no_head_pointed_go_on_with_numbers() {
        for (preset, section) in [("fast", "network"), ("paper", "low_level")] {
            let mut own = ALMA.preset(preset).unwrap().own;
            let head = |own: &Table| own[section]["head"].as_str().map(str::to_owned);
            assert_eq!(head(&own).as_deref(), Some("pointing"), "{preset}");
            own[section].as_table_mut().unwrap().remove("head");
            settle_older(&mut own);
            assert_eq!(head(&own).as_deref(), Some("numbered"), "{preset}");
        }
    }

    #[test]
    fn what_an_environment_lacks_is_said() {
        let mut spec = Spec {
            shape: Shape { agents: 2, entities: 4, tasks: 2, actions: 3, features: 2 },
            rewards: Rewards { tasks: true, agents: false },
            rules: vec![Rule::new("nearest", "")],
            ..Spec::default()
        };
        assert_eq!(misfit(&spec), None);
        let mut fast = records::Config::default();
        let checked = |fast: &records::Config| {
            let refused = Config::Records(Box::new(fast.clone())).check_rules(&spec);
            refused.err().map(|error| error.to_string())
        };
        assert_eq!(checked(&fast), None);
        fast.allocation.heuristic = 1.0;
        assert!(checked(&fast).is_some_and(|lack| lack.contains("`heuristic`")));
        fast.allocation.rule = "nearest".to_owned();
        assert_eq!(checked(&fast), None);
        let mut paper = windows::Config::default();
        paper.allocation.by = "farthest".to_owned();
        let refused = Config::Windows(Box::new(paper)).check_rules(&spec).unwrap_err();
        assert!(refused.to_string().contains("it has `nearest`"), "{refused}");
        spec.rules.clear();
        assert!(misfit(&spec).is_some_and(|lack| lack.contains("no rule")));
        spec.shape.tasks = 0;
        assert!(misfit(&spec).is_some_and(|lack| lack.contains("no subtasks")));
        // Who sees none needs none.
        assert_eq!((FLAT.misfit)(&spec), None);
        spec.view = View::Vectors;
        assert!((COPA.misfit)(&spec).is_some_and(|lack| lack.contains("shows none")));
    }
}
