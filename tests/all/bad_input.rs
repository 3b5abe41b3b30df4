//! Broken bundles, plans and domains: one line of error, the documented exit code, nothing left running.

use std::fs;
use std::path::Path;
use std::process::{Child, Stdio};

use sortie_bundle::{hex, sha256};

use crate::support::{
    self, BUNDLE, Ending as _, TestDomain, assert_fails, copied_bundle, interrupt, output, sortie,
    wait_until,
};

fn path_of(path: &Path) -> String {
    path.display().to_string()
}

#[test]
fn a_folder_without_a_bundle_is_named() {
    assert_fails(&output(&["run", "no/such/bundle"]), 66, &["no/such/bundle", "does not exist"]);
}

#[test]
fn a_truncated_network_is_named() {
    let folder = copied_bundle();
    let onnx = folder.path().join("agent.onnx");
    let bytes = fs::read(&onnx).expect("the network");
    fs::write(&onnx, &bytes[..bytes.len() / 2]).expect("half of it");
    let bundle = path_of(folder.path());
    assert_fails(&output(&["run", &bundle]), 65, &["agent.onnx", "SHA-256", "again"]);
}

#[test]
fn a_broken_allocator_is_named() {
    let folder = copied_bundle();
    let bundle = path_of(folder.path());
    let path = folder.path().join("allocator_team_value.onnx");
    let onnx = fs::read(&path).expect("the allocator's network");
    fs::write(&path, &onnx[..onnx.len() / 2]).expect("half of it");
    let words = ["allocator_team_value.onnx", "SHA-256", "again"];
    assert_fails(&output(&["run", &bundle]), 65, &words);

    // An agent's network in its place, vouched for.
    let agent = fs::read(Path::new(&bundle).join("agent.onnx")).expect("the agent's network");
    fs::write(&path, &agent).expect("the wrong network");
    let manifest = Path::new(&bundle).join("bundle.toml");
    let text = fs::read_to_string(&manifest).expect("the manifest");
    let text = text.replace(&hex(&sha256(&onnx)), &hex(&sha256(&agent)));
    fs::write(&manifest, text).expect("a manifest with its hash");
    for backend in ["plan", "tract"] {
        let arguments = ["run", &bundle, "--backend", backend];
        assert_fails(&output(&arguments), 65, &[&bundle, "allocator", "network"]);
    }
    let fallback = ["run", &bundle, "--allocation", "coordinated", "--in-process", "-q"];
    let played = output(&[&fallback[..], &["--episodes", "1"]].concat());
    assert!(played.status.success(), "{}", support::stderr(&played));

    fs::remove_file(&path).expect("the network");
    let words = ["allocator_team_value.onnx", "missing"];
    assert_fails(&output(&["run", &bundle]), 66, &words);
}

#[test]
fn an_allocator_that_was_not_learned_is_not_invented() {
    let folder = copied_bundle();
    let manifest = folder.path().join("bundle.toml");
    let text = fs::read_to_string(&manifest).expect("the manifest");
    let text = text.replace("allocator = \"team-value\"\n", "");
    fs::write(&manifest, text).expect("a manifest without allocator");
    let arguments = ["run", &path_of(folder.path()), "--allocation", "learned"];
    assert_fails(&output(&arguments), 2, &["no learned allocator", "--allocation"]);
}

#[test]
fn a_truncated_onnx_file_is_refused_by_the_compiler() {
    let folder = copied_bundle();
    let onnx = folder.path().join("agent.onnx");
    let bytes = fs::read(&onnx).expect("the network");
    fs::write(&onnx, &bytes[..bytes.len() / 2]).expect("half of it");
    let plan = path_of(&folder.path().join("half.plan"));
    assert_fails(&output(&["compile", &path_of(&onnx), "-o", &plan]), 65, &["agent.onnx"]);
    assert!(!Path::new(&plan).exists());
}

#[test]
fn a_missing_part_is_named() {
    let folder = copied_bundle();
    fs::remove_file(folder.path().join("card.md")).expect("the card");
    assert_fails(&output(&["run", &path_of(folder.path())]), 66, &["card.md", "missing"]);
}

#[test]
fn a_broken_manifest_is_named() {
    let folder = copied_bundle();
    fs::write(folder.path().join("bundle.toml"), "format = [").expect("a broken manifest");
    assert_fails(&output(&["run", &path_of(folder.path())]), 65, &["bundle.toml"]);
}

#[test]
fn a_bundle_of_a_newer_format_asks_for_an_update() {
    let folder = copied_bundle();
    fs::write(folder.path().join("bundle.toml"), "format = 999\n").expect("a newer manifest");
    let words = ["bundle.toml", "999", "update"];
    assert_fails(&output(&["run", &path_of(folder.path())]), 78, &words);
}

#[test]
fn a_plan_of_another_version_is_refused_by_name() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let plan = folder.path().join("agent.plan");
    let onnx = format!("{BUNDLE}/agent.onnx");
    let compiled = output(&["compile", &onnx, "-o", &path_of(&plan)]);
    assert!(compiled.status.success(), "{}", support::stderr(&compiled));
    let mut bytes = fs::read(&plan).expect("the plan");
    bytes[8] = 99;
    fs::write(&plan, bytes).expect("a plan of another version");
    assert_fails(&output(&["inspect", &path_of(&plan)]), 78, &["agent.plan", "99", "compile"]);
}

/// A shipped bundle whose manifest says something else.
fn edited_bundle(from: &str, to: &str) -> tempfile::TempDir {
    let folder = copied_bundle();
    let manifest = folder.path().join("bundle.toml");
    let text = fs::read_to_string(&manifest).expect("the manifest");
    assert!(text.contains(from), "{from}");
    fs::write(&manifest, text.replace(from, to)).expect("another manifest");
    folder
}

#[test]
fn a_bundle_of_an_unknown_environment_is_refused_wherever_it_is_opened() {
    for (from, to, word) in [
        ("environment = \"save-the-city/2-5a_2-5b\"", "environment = \"pacman\"", "pacman"),
        ("environment_version = \"1\"", "environment_version = \"7\"", "version 7"),
        ("team_max = ", "team_max = 9", "team_max"),
        ("n_max = ", "n_max = 9", "n_max"),
    ] {
        let folder = edited_bundle(from, to);
        let bundle = path_of(folder.path());
        for verb in ["inspect", "run", "verify"] {
            assert_fails(&output(&[verb, &bundle]), 65, &[&bundle, word]);
        }
    }
}

#[test]
fn what_is_no_regular_file_is_not_waited_for() {
    let folder = copied_bundle();
    let golden = folder.path().join("golden.json");
    fs::remove_file(&golden).expect("the golden observations");
    rustix::fs::mkfifoat(rustix::fs::CWD, &golden, rustix::fs::Mode::from_raw_mode(0o600))
        .expect("a pipe");
    let words = ["golden.json", "not a regular file"];
    assert_fails(&output(&["run", &path_of(folder.path())]), 65, &words);
}

#[test]
fn a_file_that_is_larger_than_any_network_is_not_read() {
    let folder = copied_bundle();
    let onnx = fs::OpenOptions::new().write(true).open(folder.path().join("agent.onnx"));
    onnx.and_then(|file| file.set_len(3 << 30)).expect("a sparse file");
    let words = ["agent.onnx", "bytes"];
    assert_fails(&output(&["run", &path_of(folder.path())]), 65, &words);
}

#[test]
fn an_unknown_environment_lists_the_known_ones() {
    let words = ["mars", "save-the-city"];
    assert_fails(&output(&["eval", "scripted", "--env", "mars"]), 2, &words);
    let words = ["9z_9z", "2-5a_2-5b"];
    assert_fails(&output(&["eval", "scripted", "--env", "save-the-city/9z_9z"]), 2, &words);
    assert_fails(&output(&["bench", "env", "--env", "save-the-city/9z_9z"]), 2, &words);
}

#[test]
fn an_environment_that_a_method_does_not_fit_is_named_with_what_fits() {
    let words =
        ["`alma`", "`group-matching`", "no subtasks", "what fits: flat, copa, qmix, vdn, refil"];
    let refused = ["train", "alma", "--env", "group-matching", "--out", "no-such-folder"];
    assert_fails(&output(&refused), 2, &words);
    let stepped = output(&["bench", "env", "--env", "group-matching", "--seconds", "0.01"]);
    assert!(stepped.status.success(), "{}", support::stderr(&stepped));
}

#[test]
fn a_team_over_the_limits_of_the_bundle_is_refused() {
    let arguments = ["run", BUNDLE, "--env", "save-the-city/24a_24b"];
    assert_fails(&output(&arguments), 78, &[BUNDLE, "24a_24b", "49 entities"]);
}

#[test]
fn a_second_world_of_a_domain_is_refused() {
    let domain = TestDomain::new("twice");
    let arguments = ["run", BUNDLE, "--domain", &domain.id, "--episodes", "10000", "-q"];
    let mut first = sortie(&arguments).args(["--rate", "20"]).spawn().expect("the first world");
    support::wait_until("the first world leads", || {
        domain.leftovers().iter().any(|path| path.join("domain.toml").exists())
    });
    let second = output(&["run", BUNDLE, "--domain", &domain.id, "--episodes", "1"]);
    assert_fails(&second, 75, &["world", &domain.id]);
    support::interrupt(&first);
    assert_eq!(first.ended().code(), Some(130));
    assert_eq!(domain.leftovers(), Vec::<std::path::PathBuf>::new());
}

#[test]
fn shared_memory_on_a_disk_is_refused() {
    let mut command = sortie(&["run", BUNDLE, "--episodes", "1"]);
    command.env("SORTIE_BASE", env!("CARGO_TARGET_TMPDIR"));
    let output = command.output().expect("the command line starts");
    assert_fails(&output, 74, &[env!("CARGO_TARGET_TMPDIR"), "tmpfs"]);
}

#[test]
fn output_that_nobody_reads_ends_the_program_without_a_word() {
    let (reader, writer) = std::io::pipe().expect("a pipe");
    drop(reader);
    let mut command = sortie(&["inspect", BUNDLE]);
    command.stdout(writer).stderr(std::process::Stdio::piped());
    let output = command.output().expect("sortie runs");
    assert_eq!((output.status.code(), support::stderr(&output).as_str()), (Some(141), ""));
}

#[test]
fn files_of_another_kind_are_not_overwritten() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let letter = place.path().join("letter.txt").display().to_string();
    fs::write(&letter, "dear").expect("a file");
    for arguments in [
        &["view", "scripted", "-o", &letter][..],
        &["eval", BUNDLE, "--episodes", "1", "--dump", &letter],
        &["compile", "models/save-the-city/agent.onnx", "-o", &letter],
    ] {
        assert_fails(&output(arguments), 2, &[&letter, "is there already", "another name"]);
    }
    assert_eq!(fs::read_to_string(&letter).expect("the file"), "dear");
    let onnx = place.path().join("agent.onnx").display().to_string();
    fs::copy("models/save-the-city/agent.onnx", &onnx).expect("a copy");
    assert_fails(&output(&["compile", &onnx, "-o", &onnx]), 2, &[&onnx, "not a plan"]);
}

#[test]
fn places_out_of_reach_are_refused_before_anything_is_played() {
    // Playing so many episodes would take the time limit of any test.
    let many = ["--episodes", "4000000", "--json"];
    let nowhere = [&["eval", BUNDLE, "--dump", "/nowhere/x"][..], &many].concat();
    assert_fails(&output(&nowhere), 66, &["/nowhere/x"]);
}

#[test]
fn values_of_a_configuration_are_refused_with_their_key() {
    let train = |more: &[&str]| {
        let place = tempfile::tempdir().expect("a temporary folder");
        let out = place.path().join("run").display().to_string();
        output(&[&["train", "alma", "--out", &out, "--steps", "100"][..], more].concat())
    };
    for assignment in [
        "network.width=1000000000",
        "network.base=1000000000",
        "replay.capacity=4294967295",
        "replay.batch=1000000000",
        "environment.instances=1000000000",
        "optimiser.learning_rate=NaN",
    ] {
        let key = assignment.split('=').next().expect("a key");
        assert_fails(&train(&["--set", assignment]), 2, &[key, "must be"]);
    }
    for (assignment, parts) in [
        ("environment.set=foo", ["`foo`", "`2-5a_2-5b`"]),
        ("environment.settings.reward_scale=0", ["`reward_scale` is 0", "above 0"]),
        ("environment.constants.episode_limits=5", ["`episode_limits`", "`episode_limit`"]),
    ] {
        assert_fails(&train(&["--set", assignment]), 2, &parts);
    }
    let place = tempfile::tempdir().expect("a temporary folder");
    let file = place.path().join("mine.toml").display().to_string();
    fs::write(&file, "[replay]\nbatsch = 3\n").expect("a file");
    assert_fails(&train(&["--config", &file]), 2, &[&file, "line 2", "`replay.batch`?"]);
    fs::write(&file, "[environment]\nset = foo\n").expect("a file");
    assert_fails(&train(&["--config", &file]), 65, &[&file, "line 2", "set = foo"]);
}

#[test]
fn a_printed_configuration_is_a_file_to_learn_by() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let file = place.path().join("mine.toml").display().to_string();
    for more in [&["--steps", "60000"][..], &["--preset", "paper", "--set", "learning.windows=8"]] {
        let print = |more: &[&str]| {
            let printed = output(&[&["train", "alma", "--print-config"][..], more].concat());
            assert!(printed.status.success(), "{}", support::stderr(&printed));
            String::from_utf8(printed.stdout).expect("text")
        };
        let text = print(more);
        assert!(text.contains("# How long to learn.\n#   a whole number from 1"), "{text}");
        fs::write(&file, &text).expect("a file");
        assert_eq!(print(&["--config", &file]), text);
    }
}

/// The verbs that read a file, up to its name.
const READERS: [&[&str]; 5] = [
    &["replay"],
    &["inspect"],
    &["serve"],
    &["compile", "-o", "never.plan"],
    &["train", "alma", "--out", "never", "--config"],
];

#[test]
fn what_may_never_end_is_not_read() {
    for verb in READERS {
        let refused = output(&[verb, &["/dev/zero"]].concat());
        assert_fails(&refused, 65, &["/dev/zero", "is a device"]);
    }
    let npz = ["verify", "tests/golden/onnx-producers/rsl_rl_gru.onnx", "--npz", "/dev/zero"];
    assert_fails(&output(&npz), 65, &["/dev/zero", "is a device"]);
}

/// What the reader of ONNX files gives up on is told in a line, without a word of where it did.
#[test]
fn a_reader_that_gives_up_says_so_once() {
    let file = |end| format!("tests/hostile/index_beyond_its_table.{end}");
    let output = output(&["verify", &file("onnx"), "--npz", &file("npz")]);
    let text = support::stderr(&output);
    assert_fails(&output, 1, &["1 inputs that only one answers"]);
    assert_eq!(text.matches("the reader gave up").count(), 1, "{text}");
    assert!(!text.contains("panicked") && !text.contains(".rs:"), "{text}");
}

/// A pipe that nobody writes to.
fn mute_pipe(folder: &Path) -> String {
    let path = folder.join("pipe");
    rustix::fs::mkfifoat(rustix::fs::CWD, &path, rustix::fs::Mode::RWXU).expect("a pipe");
    path_of(&path)
}

/// Whether a process waits for the pipe: it has that open, and sleeps. Asked the other way round it may have slept before.
fn is_asleep(child: &Child) -> bool {
    let is_open = is_reading(child);
    let line = fs::read_to_string(format!("/proc/{}/stat", child.id())).unwrap_or_default();
    is_open && line.rsplit_once(") ").is_some_and(|(_, state)| state.starts_with('S'))
}

/// Whether a process has the pipe open.
fn is_reading(child: &Child) -> bool {
    let names = fs::read_dir(format!("/proc/{}/fd", child.id())).into_iter().flatten().flatten();
    let mut open = names.filter_map(|entry| fs::read_link(entry.path()).ok());
    open.any(|target| target.file_name().is_some_and(|name| name == "pipe"))
}

#[test]
fn the_first_interrupt_ends_whoever_waits_for_a_pipe() {
    let folder = tempfile::tempdir().expect("a folder");
    let pipe = mute_pipe(folder.path());
    for verb in [READERS[0], READERS[2], READERS[4]] {
        let arguments = [verb, &[pipe.as_str()]].concat();
        let mut child = sortie(&arguments).stderr(Stdio::null()).spawn().expect("it starts");
        wait_until("it waits", || is_asleep(&child));
        interrupt(&child);
        wait_until("it ends", || child.try_wait().expect("its status").is_some());
        let ended = child.ended();
        assert!([Some(130), None].contains(&ended.code()), "{verb:?}: {ended}");
    }
}

#[test]
fn a_pipe_is_as_good_as_the_file_in_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let pipe = mute_pipe(folder.path());
    let episode = "tests/golden/save-the-city/001-2a-BF-scripted.json";
    let reader = sortie(&["replay", &pipe]).stdout(Stdio::piped()).spawn().expect("it starts");
    fs::write(&pipe, fs::read(episode).expect("an episode")).expect("a reader");
    let told = reader.wait_with_output().expect("its output");
    assert!(String::from_utf8_lossy(&told.stdout).contains("all equal"));
}

#[test]
fn counts_and_rates_have_limits() {
    let run = |rate: &str| output(&["run", BUNDLE, &format!("--rate={rate}")]);
    for rate in ["1e-300", "-1", "NaN", "1e300", "0.0001"] {
        assert_fails(&run(rate), 2, &["ticks a second from 0.001 to 1000000"]);
    }
    let seeds = ["train", "alma", "--out", "never", "--seeds", "1..18446744073709551615"];
    assert_fails(&output(&seeds), 2, &["more than 10000 seeds"]);
}
