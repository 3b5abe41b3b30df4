//! Runs that nothing can waste: killed, started twice, with other values, in places that are taken.

use std::fs;
use std::io::Read;
use std::path::Path;
use std::process::Stdio;

use crate::support::{
    Ending as _, SMALL, assert_fails, interrupt, output, sortie, stderr, wait_until,
};

/// `sortie train alma` with small settings and these.
fn train<'a>(more: &[&'a str]) -> Vec<&'a str> {
    [&["train", "alma", "--threads", "1"][..], &SMALL, more].concat()
}

/// The weights and the optimiser of a run's newest checkpoint.
fn newest_tensors(folder: &str) -> Vec<u8> {
    let entries = fs::read_dir(Path::new(folder).join("checkpoints")).expect("checkpoints");
    let newest = entries.flatten().map(|entry| entry.path()).max().expect("a checkpoint");
    fs::read(newest.join("tensors.safetensors")).expect("its tensors")
}

fn succeed(arguments: &[&str]) {
    let output = output(arguments);
    assert!(output.status.success(), "{}", stderr(&output));
}

struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Self {
        Self(tempfile::tempdir().expect("a temporary folder"))
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).display().to_string()
    }
}

#[test]
fn a_run_that_was_killed_goes_on_whatever_it_had_written() {
    let place = Place::new();
    let whole = place.path("whole");
    succeed(&train(&["--out", &whole, "--steps", "2000", "-q"]));
    for until in ["train.toml", "checkpoints/000000000000", "checkpoints/000000001008"] {
        let run = place.path(&until.replace('/', "-"));
        let arguments = train(&["--out", &run, "--steps", "2000", "-q"]);
        let mut child = sortie(&arguments).spawn().expect("the command line starts");
        wait_until("it has come that far", || Path::new(&run).join(until).exists());
        child.kill().expect("it is killed");
        child.ended();
        let again = output(&train(&["--out", &run, "--steps", "2000", "-q"]));
        assert_fails(&again, 2, &[&run, "--resume"]);
        succeed(&["train", "alma", "--resume", &run, "-q"]);
        assert_eq!(newest_tensors(&whole), newest_tensors(&run), "killed at {until}");
    }
}

#[test]
fn a_sweep_that_was_killed_goes_on_with_the_same_command() {
    let place = Place::new();
    let out = place.path("sweep");
    let arguments = train(&["--seeds", "1..2", "--out", &out, "--steps", "3000", "-q"]);
    let mut child = sortie(&arguments).spawn().expect("the command line starts");
    wait_until("a run has begun", || Path::new(&format!("{out}-s1/train.toml")).exists());
    child.kill().expect("it is killed");
    child.ended();
    succeed(&arguments);
    for seed in 1..=2 {
        assert!(Path::new(&format!("{out}-s{seed}/result.json")).exists(), "seed {seed}");
    }
}

#[test]
fn a_seed_that_a_killed_sweep_was_about_to_begin_is_gone_on_with() {
    let place = Place::new();
    let out = place.path("sweep-s1");
    let new_run = train(&["--out", &out, "--steps", "300", "-q"]);
    succeed(&new_run);
    let result = Path::new(&out).join("result.json");
    fs::remove_file(&result).expect("a result");
    assert!(!output(&new_run).status.success(), "a folder with a run is not overwritten");
    let parent = std::process::id().to_string();
    succeed(&[&new_run[..], &["--sweep", &parent]].concat());
    assert!(result.exists());
}

#[test]
fn a_sweep_refuses_runs_of_another_configuration() {
    let place = Place::new();
    let out = place.path("sweep");
    let sweep = ["--seeds", "1..2", "--out", &out, "--steps", "300", "-q"];
    succeed(&train(&sweep));
    for (more, key) in [
        (&["--set", "network.base=32"][..], "network.base"),
        (&["--set", "returns.discount=0.9", "--set", "run.steps=500"], "`run.steps` = 300"),
    ] {
        let refused = output(&train(&[&sweep[..], more].concat()));
        assert_fails(&refused, 2, &[&format!("{out}-s1"), key]);
    }
    // A seed that was learned on its own, and one that was stopped, count as much.
    let alone = place.path("sweep-s3");
    succeed(&train(&["--out", &alone, "--seed", "4", "--steps", "300", "-q"]));
    let more = ["--seeds", "3..3", "--out", &out, "--steps", "300", "-q"];
    assert_fails(&output(&train(&more)), 2, &[&alone, "`seed` = 4"]);
}

#[test]
fn one_run_is_learned_by_one_process() {
    let place = Place::new();
    let run = place.path("run");
    let arguments = train(&["--out", &run, "--steps", "1000000", "-q"]);
    let mut child = sortie(&arguments).spawn().expect("the command line starts");
    wait_until("it has begun", || Path::new(&run).join("checkpoints/000000000000").exists());
    let second = output(&["train", "alma", "--resume", &run]);
    assert_fails(&second, 75, &[&run, &child.id().to_string()]);
    interrupt(&child);
    assert_eq!(child.ended().code(), Some(130));
}

/// Its checkpoints are small, and it says what they are good for.
#[test]
fn a_run_that_keeps_no_replay_is_used_and_not_resumed() {
    let place = Place::new();
    let run = place.path("run");
    let without =
        ["--out", &run, "--steps", "1000000", "-q", "--set", "run.checkpoint_replay=false"];
    let child = sortie(&train(&without)).stderr(Stdio::piped()).spawn();
    let mut child = child.expect("the command line starts");
    wait_until("it has begun", || Path::new(&run).join("checkpoints/000000000000").exists());
    interrupt(&child);
    assert_eq!(child.ended().code(), Some(130));
    let mut told = String::new();
    let said = child.stderr.take().expect("standard error").read_to_string(&mut told);
    assert!(said.is_ok() && told.contains(&format!("`sortie eval {run}`")), "{told}");
    assert!(!told.contains("--resume"), "{told}");
    let resumed = output(&["train", "alma", "--resume", &run]);
    assert_fails(&resumed, 2, &["`run.checkpoint_replay=false`", "`run.from`"]);
    succeed(&["eval", &run, "--episodes", "2"]);
}

#[test]
fn a_run_goes_on_as_it_was_configured_only_longer() {
    let place = Place::new();
    let run = place.path("run");
    succeed(&train(&["--out", &run, "--steps", "600", "-q"]));
    let before = fs::read_to_string(format!("{run}/train.toml")).expect("its configuration");
    let go_on = |method: &str, more: &[&str]| {
        output(&[&["train", method, "--resume", &run, "-q"][..], more].concat())
    };
    assert_fails(&go_on("flat", &[]), 2, &["`alma`", "`flat`"]);
    assert_eq!(go_on("alma", &["--seed", "5"]).status.code(), Some(2));
    assert_fails(&go_on("alma", &["--steps", "500"]), 2, &["`run.steps`", "600"]);
    let longer = go_on("alma", &["--steps", "1200"]);
    assert!(longer.status.success(), "{}", stderr(&longer));
    let after = fs::read_to_string(format!("{run}/train.toml")).expect("its configuration");
    assert_eq!(after, before.replace("steps = 600\n", "steps = 1200\n"));
    assert!(Path::new(&run).join("checkpoints/000000001200").exists());
    assert!(Path::new(&run).join("result.json").exists());
}

#[test]
fn a_run_computes_its_products_as_it_began_or_is_asked_to() {
    let place = Place::new();
    let run = place.path("run");
    succeed(&train(&["--out", &run, "--steps", "600", "-q"]));
    let file = format!("{run}/train.toml");
    let before = fs::read_to_string(&file).expect("its configuration");
    let line = before.lines().find(|line| line.starts_with("products = "));
    let line = line.expect("what it computed with").to_owned();
    assert_ne!(line, "products = \"widest\"");
    let checkpoints = fs::read_dir(format!("{run}/checkpoints")).expect("its checkpoints");
    for checkpoint in checkpoints {
        let manifest = checkpoint.expect("a checkpoint").path().join("manifest.toml");
        assert!(fs::read_to_string(&manifest).expect("a manifest").contains(&line));
    }

    // As if it came from another kind of processor.
    let foreign = if cfg!(target_arch = "aarch64") { "avx2" } else { "neon" };
    let moved = before.replace(&line, &format!("products = \"{foreign}\""));
    fs::write(&file, &moved).expect("it is moved");
    let go_on = ["train", "alma", "--resume", &run, "--steps", "1200", "-q"];
    assert_fails(&output(&go_on), 69, &[foreign, "--other-products"]);
    let other = output(&[&go_on[..], &["--other-products"]].concat());
    assert!(other.status.success(), "{}", stderr(&other));
    assert!(stderr(&other).contains("other bits"), "{}", stderr(&other));
    let after = fs::read_to_string(&file).expect("its configuration");
    assert_eq!(after, before.replace("steps = 600\n", "steps = 1200\n"));

    let asked = format!("run.products={foreign}");
    let new = place.path("new");
    let refused = output(&train(&["--out", &new, "--set", &asked, "--steps", "600", "-q"]));
    assert_fails(&refused, 69, &[foreign, "--set run.products="]);
}

#[test]
fn a_run_that_diverges_stops_there_and_says_so() {
    let place = Place::new();
    let run = place.path("run");
    let wild = ["--set", "optimiser.learning_rate=1000", "--set", "optimiser.clip=1000000"];
    let wild = output(&train(&[&["--out", &run, "--steps", "3000"][..], &wild].concat()));
    assert_fails(&wild, 3, &["diverged at step", "learning rate"]);
    assert!(!String::from_utf8_lossy(&wild.stdout).contains("done"));
    succeed(&["eval", &run, "--episodes", "1"]);
}

#[test]
fn what_lies_in_a_folder_is_not_mixed_with_a_run() {
    let place = Place::new();
    let folder = place.path("things");
    fs::create_dir(&folder).expect("a folder");
    succeed(&train(&["--out", &folder, "--steps", "100", "-q"]));
    let other = place.path("others");
    fs::create_dir(&other).expect("a folder");
    fs::write(format!("{other}/letter.txt"), "dear").expect("a file");
    let refused = output(&train(&["--out", &other, "--steps", "100"]));
    assert_fails(&refused, 2, &[&other, "letter.txt", "another folder"]);
    assert_eq!(fs::read_dir(&other).expect("the folder").count(), 1, "nothing was added");
}

#[test]
fn output_that_nobody_reads_changes_nothing() {
    let place = Place::new();
    let (whole, lost) = (place.path("whole"), place.path("lost"));
    succeed(&train(&["--out", &whole, "--steps", "2500"]));
    let arguments = train(&["--out", &lost, "--steps", "2500"]);
    let mut child = sortie(&arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the command line starts");
    drop((child.stdout.take(), child.stderr.take()));
    assert_eq!(child.ended().code(), Some(0));
    assert_eq!(newest_tensors(&whole), newest_tensors(&lost));
    assert!(Path::new(&lost).join("result.json").exists());
}

#[test]
fn lines_fit_a_narrow_terminal() {
    let place = Place::new();
    let told = output(&train(&["--out", &place.path("run"), "--steps", "2500"]));
    let text = String::from_utf8_lossy(&told.stdout).into_owned();
    let measured = text.lines().filter(|line| line.contains("success")).collect::<Vec<_>>();
    assert!(measured.len() >= 3, "{text}");
    assert!(measured.iter().all(|line| line.chars().count() <= 80), "{text}");
    let words = stderr(&told);
    assert!(words.contains("learns from step 500 on and decides from step 625 on"), "{words}");
}
