//! Methods that learn in any environment, from training to evaluation.

use crate::support::{self, assert_fails, json, output};

/// A run of a second.
const SMALL: [&str; 12] = [
    "--env",
    "group-matching/4x3x2",
    "--steps",
    "2000",
    "--set",
    "network.width=16",
    "--set",
    "replay.batch=32",
    "--set",
    "run.evaluate_every=1000",
    "--set",
    "run.final_episodes=50",
];

/// Agents with a memory.
const REMEMBERING: [&str; 8] = [
    "--set",
    "network.memory=24",
    "--set",
    "replay.unit=episodes",
    "--set",
    "replay.batch=8",
    "--set",
    "replay.steps_per_update=0",
];

fn train(method: &str, folder: &str, more: &[&str]) {
    let mut arguments =
        vec!["train", method, "--out", folder, "-q", "--set", "run.evaluate_episodes=20"];
    arguments.extend(SMALL);
    arguments.extend(more);
    let output = output(&arguments);
    assert!(output.status.success(), "{}", support::stderr(&output));
}

#[test]
fn a_run_is_inspected_evaluated_prolonged_and_exported() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| place.path().join(name).display().to_string();
    let (run, bundle) = (path("run"), path("bundle"));
    train("refil", &run, &[]);
    let facts = json(&["inspect", &run, "--json"]);
    assert_eq!(facts["configuration"]["imagination"]["partitions"], "drawn");
    assert_eq!(facts["curve"].as_array().map(Vec::len), Some(2));
    let evaluate = |subject: &str| json(&["eval", subject, "--episodes", "40", "--json"]);
    let learned = evaluate(&run);
    assert_eq!(learned["env"], "group-matching/4x3x2");
    assert!(learned["matches"].is_f64() && learned["by_team"]["2+2"].is_object(), "{learned}");

    let exported = json(&["export", &run, "--out", &bundle, "--episodes", "40", "--json"]);
    assert_eq!(exported["sha256"].as_str().map(str::len), Some(64));
    let verified = json(&["verify", &bundle, "--inputs", "32", "--json"]);
    let engines = verified["engines"].as_array().expect("engines");
    assert!(engines.iter().all(|engine| engine["action_mismatches"] == 0), "{verified}");
    let deployed = evaluate(&bundle);
    for figure in ["success", "return_mean", "length_mean", "by_team"] {
        assert_eq!(deployed[figure], learned[figure], "{figure}");
    }

    let longer = output(&["train", "refil", "--resume", &run, "--steps", "3000", "-q"]);
    assert!(longer.status.success(), "{}", support::stderr(&longer));
    let facts = json(&["inspect", &run, "--json"]);
    assert_eq!(facts["curve"].as_array().map(Vec::len), Some(3));
    let words = ["train", "vdn", "--resume", &run];
    assert_fails(&output(&words), 2, &["learns by `refil`, not by `vdn`"]);
}

#[test]
fn agents_with_a_memory_are_deployed_as_they_were_measured() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| place.path().join(name).display().to_string();
    let (run, bundle) = (path("run"), path("bundle"));
    train("vdn", &run, &REMEMBERING);
    let exported = output(&["export", &run, "--out", &bundle, "--episodes", "10", "-q"]);
    assert!(exported.status.success(), "{}", support::stderr(&exported));
    assert_eq!(json(&["inspect", &bundle, "--json"])["network"]["hidden"], 24);
    let verified = json(&["verify", &bundle, "--inputs", "32", "--json"]);
    let engines = verified["engines"].as_array().expect("engines");
    assert!(engines.len() > 2, "{verified}");
    assert!(engines.iter().all(|engine| engine["action_mismatches"] == 0), "{verified}");
    let evaluate = |subject: &str| json(&["eval", subject, "--episodes", "40", "--json"]);
    let (learned, deployed) = (evaluate(&run), evaluate(&bundle));
    for figure in ["success", "return_mean", "length_mean", "by_team"] {
        assert_eq!(deployed[figure], learned[figure], "{figure}");
    }

    let domain = support::TestDomain::new("remember");
    let play = |more: &[&str]| {
        let arguments = ["run", &bundle, "--episodes", "3", "--seed", "3", "--json", "--domain"];
        json(&[&arguments, &[domain.id.as_str()][..], more].concat())
    };
    let (processes, in_process) = (play(&["--isolate"]), play(&["--in-process"]));
    for figure in ["success", "return_mean", "by_team", "decisions"] {
        assert_eq!(processes[figure], in_process[figure], "{figure}");
    }
}

#[test]
fn what_does_not_fit_is_refused_in_one_line() {
    for (arguments, part) in [
        (
            &["train", "vdn", "--env", "group-matching", "--steps", "0", "--out", "x"][..],
            "`run.steps` is 0",
        ),
        (
            &["train", "vdn", "--out", "nowhere"][..],
            "say where by `--env`: save-the-city, group-matching",
        ),
        (&["train", "vdn", "--env", "nowhere", "--out", "x"], "unknown environment `nowhere`"),
        (&["train", "vdn", "--env", "group-matching/9", "--out", "x"], "9"),
        (
            &["train", "vdn", "--env", "group-matching", "--no-mask", "--out", "x"],
            "drop `--no-mask`",
        ),
        (
            &["train", "vdn", "--env", "group-matching", "--preset", "slow", "--out", "x"],
            "no preset `slow`; there are `fast`, `paper`",
        ),
        (
            &["train", "qmix", "--env", "group-matching", "--set", "mixer.kid=sum", "--out", "x"],
            "mixer.kind",
        ),
        (
            &[
                "train",
                "qmix",
                "--env",
                "group-matching",
                "--set",
                "network.width=17",
                "--out",
                "x",
            ],
            "[16, 32, 64, 128]",
        ),
        (
            &[
                "train",
                "refil",
                "--env",
                "group-matching",
                "--set",
                "environment.settings.noize=1",
                "--out",
                "x",
            ],
            "noize",
        ),
    ] {
        assert_fails(&output(arguments), 2, &[part]);
    }
}

#[test]
fn a_configuration_explains_itself_and_is_read_back() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let printed = output(&[
        "train",
        "refil",
        "--env",
        "group-matching/4x3x2",
        "--set",
        "environment.settings.noise=0.1",
        "--print-config",
    ]);
    assert!(printed.status.success(), "{}", support::stderr(&printed));
    let file = place.path().join("mine.toml");
    std::fs::write(&file, &printed.stdout).expect("a file");
    let again =
        output(&["train", "refil", "--config", &file.display().to_string(), "--print-config"]);
    assert_eq!(String::from_utf8_lossy(&again.stdout), String::from_utf8_lossy(&printed.stdout));
}

/// 31 customers are too many for the usual four vehicles; a preset looks at the world with the settings that it is given.
#[test]
fn a_world_that_only_its_settings_allow_is_learned_in() {
    let words = ["train", "allocator", "--env", "routing/31", "--print-config"];
    assert_fails(&output(&words), 2, &["capacity"]);
    let printed = output(&[&words[..], &["--set", "environment.settings.vehicles=8"]].concat());
    assert!(printed.status.success(), "{}", support::stderr(&printed));
}

#[test]
fn the_page_shows_the_programs_that_are_there() {
    let read = |name: &str| std::fs::read_to_string(name).expect("a file of the project");
    let page = read("docs/guide/your-own.md");
    for program in
        ["own_environment/src/yard.rs", "own_environment/src/main.rs", "own_method/src/main.rs"]
    {
        assert!(page.contains(&read(&format!("examples/{program}"))), "{program}");
    }
}

#[test]
fn a_run_whose_folder_is_not_named_says_in_its_name_what_it_is() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let learn = |more: &[&str]| {
        let words = ["train", "maac", "--env", "particle/rover-tower-8", "--steps", "100", "-q"];
        let mut command = support::sortie(&[&words[..], more].concat());
        command.current_dir(place.path()).output().expect("it starts")
    };
    let first = learn(&["--seed", "3"]);
    assert!(first.status.success(), "{}", support::stderr(&first));
    assert!(place.path().join("runs/maac-particle-rover-tower-8-s3/result.json").exists());
    assert_fails(
        &learn(&["--seed", "3"]),
        2,
        &["runs/maac-particle-rover-tower-8-s3", "another folder"],
    );
}

/// Its agents head for what they are given.
#[test]
fn an_allocator_alone_is_deployed_as_it_was_measured() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| place.path().join(name).display().to_string();
    let (run, page) = (path("run"), path("routes.html"));
    let small = [
        "network.width=16",
        "environment.instances=32",
        "optimiser.learning_rate=0.003",
        "run.final_episodes=50",
    ];
    let small = small.iter().flat_map(|set| ["--set", set]);
    let words =
        ["train", "allocator", "--env", "routing/5-15", "--steps", "15000", "-q", "--out", &run];
    let trained = output(&words.into_iter().chain(small).collect::<Vec<_>>());
    assert!(trained.status.success(), "{}", support::stderr(&trained));
    let over = |more: &[&str]| {
        let words = ["eval", &run, "--episodes", "60", "--json"];
        let played = json(&[&words, more].concat());
        played["over_optimum"].as_f64().expect("a ratio")
    };
    assert!(over(&["--proposals", "8"]) < over(&[]), "the best of eight is no better");
    // What learned on any number of customers plays on any other up to as many.
    assert!(over(&["--env", "routing/7"]) > 1.0 && over(&["--allocation", "nearest"]) < 1.4);
    let viewed = output(&["view", &run, "--output", &page]);
    assert!(viewed.status.success(), "{}", support::stderr(&viewed));
    assert!(std::fs::read_to_string(page).is_ok_and(|html| html.contains("customer")));
    let bundle = path("bundle");
    let exported = output(&["export", &run, "--out", &bundle, "--episodes", "10", "-q"]);
    assert!(exported.status.success(), "{}", support::stderr(&exported));
    let play = |subject: &str| json(&["eval", subject, "--episodes", "60", "--json"]);
    let (learned, deployed) = (play(&run), play(&bundle));
    for figure in ["return_mean", "over_optimum", "vehicles", "waves", "by_team"] {
        assert_eq!(deployed[figure], learned[figure], "{figure}");
    }
    let verified = json(&["verify", &bundle, "--inputs", "32", "--json"]);
    let compared = verified["engines"].as_array().expect("engines");
    let named = |name: &str| compared.iter().any(|one| one["name"] == name);
    assert!(named("allocator plan against golden allocations"), "{verified}");
    assert!(named("decoder plan against tract, random inputs"), "{verified}");
    assert!(compared.iter().all(|one| one["action_mismatches"] == 0), "{verified}");

    let domain = support::TestDomain::new("routes");
    let drive = |more: &[&str]| {
        let words = ["run", &bundle, "--episodes", "5", "--seed", "3", "--json", "--domain"];
        json(&[&words, &[domain.id.as_str()][..], more].concat())
    };
    let (processes, in_process) = (drive(&["--isolate"]), drive(&["--in-process"]));
    for figure in ["return_mean", "metrics", "by_team", "decisions", "fallbacks"] {
        assert_eq!(processes[figure], in_process[figure], "{figure}");
    }
    // Deployed it looks ahead from what rows tell, where places are rounded: where a network of so few weights is sure of
    // several customers alike it may send somebody to another one of them.
    let ahead = |subject: &str| {
        let words = ["eval", subject, "--episodes", "60", "--proposals", "8", "--json"];
        json(&words)["over_optimum"].as_f64().expect("a ratio")
    };
    let (of_run, of_bundle) = (ahead(&run), ahead(&bundle));
    assert!((of_run - of_bundle).abs() < 5e-3, "{of_run} {of_bundle}");
    let eight = ["--proposals", "8"];
    let isolated = [&["--isolate"][..], &eight].concat();
    let together = [&["--in-process"][..], &eight].concat();
    let (processes, in_process) = (drive(&isolated), drive(&together));
    for figure in ["return_mean", "metrics", "by_team", "decisions", "fallbacks"] {
        assert_eq!(processes[figure], in_process[figure], "{figure}");
    }
    let words = ["eval", &bundle, "--episodes", "2", "--backend", "tract"];
    assert_fails(&output(&words), 2, &["runs as a plan only"]);
}
