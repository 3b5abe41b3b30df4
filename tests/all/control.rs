//! A running team is told what to do through the command line.

use std::path::PathBuf;
use std::process::Stdio;

use crate::support::{
    BUNDLE, Ending as _, TestDomain, assert_fails, json, output, sortie, stderr, wait_until,
};

/// Asks until the answer is as expected.
fn await_info(domain: &str, is_expected: impl Fn(&[serde_json::Value]) -> bool) {
    wait_until("the processes are as expected", || {
        let told = output(&["control", "info", "--domain", domain, "--json"]);
        let answer: serde_json::Value = serde_json::from_slice(&told.stdout).unwrap_or_default();
        answer["processes"].as_array().is_some_and(|processes| is_expected(processes))
    });
}

#[test]
fn a_team_that_is_up_does_what_it_is_told() {
    let domain = TestDomain::new("control");
    let tell = |order: &str| json(&["control", order, "--domain", &domain.id, "--json"]);
    let mut up = sortie(&["up", BUNDLE, "--domain", &domain.id, "--quiet", "--isolate"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the command line starts");
    // A world, five runners, a leading allocator and its standby.
    await_info(&domain.id, |processes| {
        let leads = |process: &&serde_json::Value| process["leads"] == true;
        processes.len() == 8 && processes.iter().filter(leads).count() == 2
    });
    let folder = tempfile::tempdir().expect("a folder");
    let record = folder.path().join("run.mcap");
    let record = record.to_str().expect("a name");
    let mut recorder =
        sortie(&["record", BUNDLE, "--output", record, "--domain", &domain.id, "--quiet"])
            .stdout(Stdio::null())
            .spawn()
            .expect("the command line starts");
    wait_until("it records", || std::fs::metadata(record).is_ok_and(|file| file.len() > 0));
    assert_eq!(tell("pause")["processes"][0]["role"], "world");
    let told = output(&["control", "info", "--domain", &domain.id]);
    let lines = String::from_utf8_lossy(&told.stdout).into_owned();
    assert!(lines.starts_with("world ") && lines.contains("paused"), "{lines}");
    let told = output(&["doctor", "--domain", &domain.id]);
    assert!(String::from_utf8_lossy(&told.stdout).contains("stands still, as it was told"));
    assert!(lines.contains("agents 4, model ") && lines.contains("leads in term 1"), "{lines}");
    assert_eq!(tell("resume")["processes"][0]["paused"], false);
    let leader = tell("step-down");
    assert_eq!(leader["processes"][0]["role"], "allocator", "{leader}");
    await_info(&domain.id, |processes| {
        let leads = |process: &&serde_json::Value| {
            process["role"] == "allocator" && process["leads"] == true
        };
        processes.iter().find(leads).is_some_and(|process| process["term"] == 2)
    });
    let reload =
        |bundle: &str| output(&["control", "reload", bundle, "--domain", &domain.id, "--json"]);
    let model = |told: &serde_json::Value| told["processes"][0]["model"].clone();
    let info = tell("info");
    let decides = |process: &&serde_json::Value| process["role"] != "world";
    let decides = info["processes"].as_array().expect("processes").iter().find(decides);
    let small = decides.expect("a runner")["model"].clone();
    let reloaded = reload(&format!("{BUNDLE}-large"));
    assert_eq!(reloaded.status.code(), Some(0), "{}", stderr(&reloaded));
    let reloaded: serde_json::Value = serde_json::from_slice(&reloaded.stdout).expect("JSON");
    let processes = reloaded["processes"].as_array().expect("processes").clone();
    // Five runners and two allocators.
    assert_eq!(processes.len(), 7, "{reloaded}");
    assert!(processes.iter().all(|process| process["outcome"] == "done"), "{reloaded}");
    let large = model(&reloaded);
    assert!(large != small && processes.iter().all(|process| process["model"] == large));
    assert_fails(&reload("models/save-the-village"), 66, &["save-the-village"]);
    let one = ["control", "reload", BUNDLE, "--domain", &domain.id, "--process", "1"];
    assert_fails(&output(&one), 2, &["as a whole"]);
    await_info(&domain.id, |processes| {
        processes.iter().all(|process| process["role"] == "world" || process["model"] == large)
    });
    let swap = |arguments: &[&str]| {
        let domain = ["--domain", &domain.id, "--json"];
        output(&[&["control", "swap", BUNDLE], arguments, &domain[..]].concat())
    };
    // The other bundle decides otherwise: too much so for the shadow, and too much so for a team that has changed to it.
    let kept = swap(&["--shadow", "1s", "--back-if", "disagreement=0.001"]);
    assert_fails(&kept, 1, &["% otherwise: the team keeps what it has"]);
    let turned = swap(&["--back-if", "disagreement=0.001"]);
    assert_eq!(turned.status.code(), Some(1), "{}", stderr(&turned));
    let turned: serde_json::Value = serde_json::from_slice(&turned.stdout).expect("JSON");
    assert_eq!((&turned["turned_back"], &turned["generation"]), (&true.into(), &2.into()));
    await_info(&domain.id, |processes| {
        processes.iter().all(|process| {
            process["generation"] == 3 && (process["role"] == "world" || process["model"] == large)
        })
    });
    let changed = swap(&[
        "--shadow",
        "1s",
        "--at",
        "next-episode",
        "--back-if",
        "fallbacks",
        "--watch",
        "1s",
    ]);
    assert_eq!(changed.status.code(), Some(0), "{}", stderr(&changed));
    let changed: serde_json::Value = serde_json::from_slice(&changed.stdout).expect("JSON");
    assert_eq!(model(&changed), small);
    assert!(changed["shadow"]["agreement"]["of"].as_u64() > Some(10), "{changed}");
    let nobody = output(&["control", "pause", "--domain", &domain.id, "--process", "1"]);
    assert_fails(&nobody, 69, &["no process that could do it has answered"]);
    assert_eq!(tell("shut-down")["processes"][0]["outcome"], "done");
    assert_eq!(up.ended().code(), Some(0));
    assert_eq!(recorder.ended().code(), Some(0));
    // Both bundles decided, in turns, and two allocators: all of it is made again.
    let remade = json(&["remake", record, "--json"]);
    assert_eq!((&remade["different"], &remade["of_others"]), (&0.into(), &0.into()), "{remade}");
    assert!(remade["actions"].as_u64() > Some(1_000), "{remade}");
    let over = output(&["control", "info", "--domain", &domain.id]);
    assert_fails(&over, 69, &["no world has started in domain"]);
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn processes_that_run_graphs_say_so() {
    let domain = TestDomain::new("graphs");
    let team = ["up", BUNDLE, "--domain", &domain.id, "--quiet", "--backend", "tract"];
    let mut up = sortie(&team)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the command line starts");
    let runs_graph = |process: &serde_json::Value| {
        process["engine"] == "tract: allocates, no promise about bits or time"
    };
    await_info(&domain.id, |processes| {
        let is_told =
            |process: &serde_json::Value| runs_graph(process) == (process["role"] != "world");
        ["world", "runner", "allocator"].iter().all(|role| {
            let mut of_role =
                processes.iter().filter(|process| process["role"] == *role).peekable();
            of_role.peek().is_some() && of_role.all(is_told)
        })
    });
    wait_until("the doctor hears it", || {
        let told = output(&["doctor", "--domain", &domain.id]);
        let told = String::from_utf8_lossy(&told.stdout).into_owned();
        ["runner ", "allocator "].iter().all(|role| {
            let mut lines = told.lines();
            lines.any(|line| line.contains(role) && line.contains(", runs the graph: allocates"))
        })
    });
    json(&["control", "shut-down", "--domain", &domain.id, "--json"]);
    assert_eq!(up.ended().code(), Some(0));
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}
