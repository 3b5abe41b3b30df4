//! How runs are set up: presets, keys, files of today and of before.

use sortie_envs::Split;
use sortie_envs::registry::Setting;
use sortie_learn::LearnError;
use sortie_learn::configuration::paths;
use sortie_learn::run::RunDescription;
use sortie_learn::session::{MethodEntry, Opening, Setup};
use sortie_methods::alma::{ALMA, COPA, FLAT};
use sortie_methods::{METHODS, find};
use sortie_nn::layers::products::Products;
use toml::{Table, Value};

/// Every preset of every method.
fn presets() -> impl Iterator<Item = (&'static MethodEntry, &'static str, Setup)> {
    METHODS.iter().flat_map(|entry| {
        let setup = |name| entry.preset(name).unwrap();
        entry.presets.iter().map(move |preset| (entry, preset.name, setup(preset.name)))
    })
}

fn with(entry: &MethodEntry, preset: &str, assignments: &[&str]) -> Setup {
    let set = |setup: Setup, assignment: &&str| entry.set(&setup, assignment);
    assignments.iter().try_fold(entry.preset(preset).unwrap(), set).unwrap()
}

/// Why the method refuses to learn.
fn refusal(entry: &MethodEntry, setup: &Setup, environment: &str) -> String {
    let opened = sortie_envs::open(environment, Split::Train, 1, &setup.environment.settings);
    let environment = opened.unwrap();
    let opening = Opening { setup, environment: &*environment, seed: 1, threads: 1 };
    match entry.method(&opening) {
        Err(error @ (LearnError::Config(_) | LearnError::Misfit(_))) => error.to_string(),
        Err(error) => panic!("another error: {error}"),
        Ok(_) => panic!("it learns"),
    }
}

fn keys_of(within: &str, table: &Table, to: &mut Vec<String>) {
    for (name, value) in table {
        let path = if within.is_empty() { name.clone() } else { format!("{within}.{name}") };
        match value {
            Value::Table(inner) => keys_of(&path, inner, to),
            _ => to.push(path),
        }
    }
}

#[test]
fn every_key_is_described_and_every_preset_is_within_the_limits() {
    for (entry, name, setup) in presets() {
        entry.check(&setup).unwrap();
        let sections = entry.sections(&setup.own);
        let table: Table = setup.to_toml().unwrap().parse().unwrap();
        let (mut there, mut known) = (Vec::new(), paths(&sections).collect::<Vec<_>>());
        keys_of("", &table, &mut there);
        // What an environment can be set to, it says itself.
        there.retain(|key| !key.starts_with("environment.settings."));
        there.sort();
        known.sort();
        assert_eq!(there, known, "{} {name}", entry.name);
        for section in sections {
            assert!(section.about.ends_with('.'), "{}", section.name);
            for key in section.keys {
                assert!(key.about.ends_with('.') && !key.about.contains('|'), "{}", key.name);
            }
        }
    }
}

#[test]
fn what_is_written_reads_back() {
    for (entry, name, setup) in presets() {
        let setup = entry.set(&setup, "environment.settings.episode_limit=99").unwrap();
        for text in [setup.to_toml().unwrap(), entry.explained(&setup).unwrap()] {
            assert_eq!(entry.read(&text).unwrap(), setup, "{} {name}: {text}", entry.name);
        }
        let run = RunDescription::new(setup, 7, 2);
        let text = run.to_toml().unwrap();
        assert_eq!(RunDescription::from_toml(&text).unwrap(), run, "{text}");
        assert_eq!(entry.read(&text).unwrap(), run.config, "{text}");
    }
    let error = RunDescription::from_toml("method = \"alma\"\nversion = \"0\"").unwrap_err();
    assert!(error.to_string().contains("`seed`"), "{error}");
}

#[test]
fn a_file_that_somebody_wrote_leaves_out_what_it_does_not_change() {
    let written = ALMA.read("[replay]\nbatch = 7\n").unwrap();
    assert_eq!(written, with(&ALMA, "fast", &["replay.batch=7"]));
    let written = ALMA.read("learner = \"windows\"\n[learning]\nwindows = 7\n").unwrap();
    assert_eq!(written, with(&ALMA, "paper", &["learning.windows=7"]));
    assert_eq!(COPA.read("").unwrap(), COPA.preset("fast").unwrap());
}

#[test]
fn keys_take_values_of_every_kind() {
    let assignments = [
        "environment.set=2-8a_2-8b",
        "replay.batch = 1_024",
        "optimiser.learning_rate=5e-4",
        "replay.symmetries=false",
        "exploration.spread=[0.0, 1.0]",
        "allocator.network.width=32",
        "environment.settings.reward_scale=35",
        "mixer.kind=qmix",
    ];
    let setup = with(&ALMA, "fast", &assignments);
    assert_eq!(setup.environment.set, "2-8a_2-8b");
    assert_eq!(setup.environment.settings["reward_scale"], Setting::Whole(35));
    let own = &setup.own;
    assert_eq!(own["replay"]["batch"].as_integer(), Some(1024));
    assert_eq!(own["optimiser"]["learning_rate"].as_float(), Some(5e-4));
    assert_eq!(own["replay"]["symmetries"].as_bool(), Some(false));
    assert_eq!(own["exploration"]["spread"].as_array().map(Vec::len), Some(2));
    assert_eq!(own["allocator"]["network"]["width"].as_integer(), Some(32));
    assert_eq!(own["mixer"]["kind"].as_str(), Some("qmix"));
}

#[test]
fn wrong_values_are_refused_by_key_value_and_range() {
    let setup = ALMA.preset("fast").unwrap();
    for (assignment, parts) in [
        ("optimiser.learning_rate=NaN", ["`optimiser.learning_rate`", "nan", "0 to 1000"]),
        ("optimiser.learning_rate=1e30", ["`optimiser.learning_rate`", "1", "0 to 1000"]),
        ("optimiser.clip=-1", ["`optimiser.clip`", "-1", "above 0"]),
        ("optimiser.target_rate=5", ["`optimiser.target_rate`", "5", "0 to 1"]),
        ("exploration.start=7", ["`exploration.start`", "7", "0 to 1"]),
        ("run.checkpoint_minutes=NaN", ["`run.checkpoint_minutes`", "nan", "minutes"]),
        ("network.active_inputs=inf", ["`network.active_inputs`", "inf", "columns"]),
        ("network.width=1000000000", ["`network.width`", "1000000000", "1 to 1024"]),
        ("allocator.moved=2", ["`allocator.moved`", "2", "0 to 1"]),
        ("environment.instances=0", ["`environment.instances`", "0", "from 1"]),
        ("replay.batsch=3", ["`replay.batsch`", "no such key", "did you mean `replay.batch`?"]),
        ("learning_rate=3", ["`learning_rate`", "no such key", "`optimiser.learning_rate`?"]),
        ("replay.batch=many", ["`replay.batch`", "`many`", "a whole number"]),
        ("replay.batch", ["`replay.batch`", "not", "`key=value`"]),
    ] {
        let error = ALMA.set(&setup, assignment).unwrap_err().to_string();
        for part in parts {
            assert!(error.contains(part), "{assignment}: no `{part}` in {error}");
        }
    }
}

#[test]
fn wrong_files_are_refused_by_line_and_key() {
    for (text, parts) in [
        ("[replay]\n\nbatch = \"a\"\n", ["line 3", "`replay.batch`", "a whole number"]),
        ("[run]\nsteps = 5\n[replay]\nbatsch = 3\n", ["line 4", "`replay.batsch`", "mean"]),
        ("replay.batch = 0\n", ["line 1", "`replay.batch`", "from 1"]),
        ("[network]\nsubtask = mask\n", ["line 2", "subtask = mask", "quoted"]),
    ] {
        let error = ALMA.read(text).unwrap_err().to_string();
        for part in parts {
            assert!(error.contains(part), "{text}: no `{part}` in {error}");
        }
    }
}

#[test]
fn values_that_do_not_go_together_are_refused() {
    for (entry, preset, assignments, part) in [
        (&ALMA, "fast", &["network.heads=5"][..], "multiple"),
        (&ALMA, "fast", &["mixer.heads=5"], "`mixer.width`"),
        (&ALMA, "fast", &["allocation.learned=0"], "positive"),
        (&ALMA, "fast", &["replay.warm_up=2000000"], "`replay.capacity`"),
        (&ALMA, "fast", &["network.subtask=none"], "`sortie train flat`"),
        (&FLAT, "fast", &["network.subtask=mask"], "`sortie train alma`"),
        (&ALMA, "paper", &["low_level.heads=5"], "multiple"),
        (&ALMA, "paper", &["learning.episodes=9"], "`learning.windows`"),
        (&ALMA, "paper", &["coach.enabled=true"], "`none`"),
        (&FLAT, "paper", &["coach.enabled=true"], "`sortie train copa`"),
        (&COPA, "fast", &["coach.enabled=false"], "`sortie train flat`"),
    ] {
        let error = refusal(entry, &with(entry, preset, assignments), "save-the-city");
        assert!(error.contains(part), "{assignments:?}: {error}");
    }
}

#[test]
fn a_method_refuses_an_environment_that_it_cannot_learn_in() {
    for (entry, environment, lack) in [
        (ALMA, "group-matching/4x3x2", "no subtasks"),
        (FLAT, "gridworld/task1-2", "shows none"),
        (COPA, "gridworld/task1-2", "shows none"),
    ] {
        let error = refusal(&entry, &entry.preset("fast").unwrap(), environment);
        let words = [entry.name, environment.split('/').next().unwrap(), lack];
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
    }
}

#[test]
fn flags_stand_for_keys_of_whatever_learner() {
    let flagged = |preset, flag, value| {
        ALMA.set_flag(&ALMA.preset(preset).unwrap(), flag, value).map_err(|error| error.to_string())
    };
    let subtask = |preset| flagged(preset, "--no-mask", "").unwrap().own;
    assert_eq!(subtask("fast")["network"]["subtask"].as_str(), Some("input"));
    assert_eq!(subtask("paper")["low_level"]["conditioning"].as_str(), Some("input"));
    let own = flagged("fast", "--allocation", "random").unwrap().own;
    let weight = |name: &str| own["allocation"][name].as_float();
    let weights = ["learned", "coordinated", "heuristic", "random"].map(weight);
    assert_eq!(weights, [Some(0.0), Some(0.0), Some(0.0), Some(1.0)]);
    let own = flagged("paper", "--allocation", "random").unwrap().own;
    assert_eq!(own["allocation"]["by"].as_str(), Some("random"));
    assert!(flagged("paper", "--mixer", "sum").unwrap_err().contains("drop `--mixer`"));
    assert!(flagged("fast", "--mixer", "many").unwrap_err().contains("`mixer.kind`"));
    for (name, flag) in [("flat", "--no-mask"), ("copa", "--allocation"), ("vdn", "--no-mask")] {
        let entry = find(name).unwrap();
        let error = entry.set_flag(&entry.preset("fast").unwrap(), flag, "random").unwrap_err();
        assert!(error.to_string().contains(&format!("drop `{flag}`")), "{error}");
    }
}

#[test]
fn a_short_run_explores_and_hands_over_in_proportion() {
    let keys =
        [["exploration", "steps"], ["allocator", "learns_from"], ["allocator", "decides_from"]];
    let schedule = |steps: u64, given: &str| {
        let mut setup = ALMA.preset("fast").unwrap();
        setup.run.steps = steps;
        ALMA.fit_to_length(&mut setup, |key| key == given);
        keys.map(|[section, key]| setup.own[section][key].as_integer().unwrap())
    };
    assert_eq!(schedule(60_000, ""), [6_000, 12_000, 15_000]);
    assert_eq!(schedule(60_000, "allocator.learns_from"), [6_000, 120_000, 15_000]);
    for steps in [600_000, 1_500_000] {
        assert_eq!(schedule(steps, ""), [60_000, 120_000, 150_000], "as it always was");
    }
    let paper = ALMA.preset("paper").unwrap();
    let mut short = Setup { run: paper.run.clone(), ..paper.clone() };
    short.run.steps = 1_000;
    ALMA.fit_to_length(&mut short, |_| false);
    assert_eq!(short.own, paper.own);
}

#[test]
fn settings_of_an_environment_are_read_under_their_name_of_before() {
    let assignment = "environment.constants.reward_scale=35.0";
    let setup = with(&ALMA, "fast", &[assignment]);
    assert_eq!(setup.environment.settings["reward_scale"], Setting::Number(35.0));
    let text = RunDescription::new(setup.clone(), 1, 1).to_toml().unwrap();
    let older = text.replace("[environment.settings]", "[environment.constants]");
    assert_ne!(older, text);
    assert_eq!(RunDescription::from_toml(&older).unwrap().config, setup);
    assert_eq!(ALMA.read(&older).unwrap(), setup);
}

#[test]
fn a_run_of_before_computes_its_products_as_it_did() {
    let text = RunDescription::new(ALMA.preset("fast").unwrap(), 1, 1).to_toml().unwrap();
    let older = text.replace("products = \"widest\"\n", "");
    assert_ne!(older, text);
    let read = RunDescription::from_toml(&older).unwrap();
    assert_eq!(read.config.run.products, Products::usual().to_string());
}

#[test]
fn a_run_of_before_has_no_skip_and_is_repeated_without() {
    let text = RunDescription::new(ALMA.preset("fast").unwrap(), 1, 1).to_toml().unwrap();
    let older = text.replace("skip = true\n", "");
    assert_ne!(older, text);
    let run = RunDescription::from_toml(&older).unwrap().config;
    let sortie_methods::alma::Config::Records(config) =
        sortie_methods::alma::Config::of(&run).unwrap()
    else {
        panic!("another learner");
    };
    assert!(!config.network.skip && !config.allocator.network.skip);
    let repeated = ALMA.read(&older).unwrap();
    assert_eq!(repeated.own["network"]["skip"].as_bool(), Some(false));
    assert_eq!(repeated.own["allocator"]["network"]["skip"].as_bool(), Some(false));
    // A file that somebody wrote leaves out what it does not change.
    let written = ALMA.read("[network]\nwidth = 32\n").unwrap();
    assert_eq!(written.own["network"]["skip"].as_bool(), Some(true));
}
