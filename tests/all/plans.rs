//! Which plan acts: the one that the bundle ships, without anything that reads ONNX files.

use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use sortie_bundle::{hex, sha256};
use sortie_core::plan::{HEADER_BYTES, Header, Profile, Proof, checksums};

use crate::support::{BUNDLE, assert_fails, copied_bundle, json, output, stderr};

/// The program in a folder of its own: `sortie-tools` does not lie beside it.
struct Alone {
    folder: tempfile::TempDir,
}

impl Alone {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let program = folder.path().join("sortie");
        // A link would be followed to where the other program lies.
        fs::copy(env!("CARGO_BIN_EXE_sortie"), program).expect("a copy of the program");
        Self { folder }
    }

    fn output(&self, arguments: &[&str]) -> Output {
        let mut command = Command::new(self.folder.path().join("sortie"));
        command.current_dir(env!("CARGO_MANIFEST_DIR")).args(arguments);
        // No plan that was compiled before.
        command.env("XDG_CACHE_HOME", self.folder.path().join("cache"));
        command.output().expect("the program starts")
    }
}

fn without_plans() -> (tempfile::TempDir, PathBuf) {
    let folder = copied_bundle();
    let manifest = folder.path().join("bundle.toml");
    let text = fs::read_to_string(&manifest).expect("the manifest");
    let is_plan = |line: &&str| line.contains(".plan\" = ");
    assert_eq!(text.lines().filter(is_plan).count(), 2, "{text}");
    let kept: Vec<&str> = text.lines().filter(|line| !is_plan(line)).collect();
    fs::write(&manifest, kept.join("\n")).expect("a manifest without plans");
    let path = folder.path().to_owned();
    (folder, path)
}

fn text(path: &Path) -> &str {
    path.to_str().expect("a readable path")
}

#[test]
fn a_shipped_team_acts_where_nothing_reads_onnx_files() {
    let alone = Alone::new();
    let played = ["--episodes", "1", "--json"];
    for verb in [&["run", BUNDLE, "--in-process"][..], &["eval", BUNDLE]] {
        let output = alone.output(&[verb, &played].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        assert_eq!(stderr(&output), "");
    }
}

#[test]
fn what_reads_onnx_files_is_missed_by_name_and_the_command_that_makes_it() {
    let alone = Alone::new();
    let (_folder, bundle) = without_plans();
    let onnx = format!("{BUNDLE}/agent.onnx");
    for arguments in [
        &["verify", BUNDLE][..],
        &["run", BUNDLE, "--backend", "tract"],
        &["compile", &onnx, "-o", "/nowhere/agent.plan"],
        &["run", text(&bundle)],
    ] {
        let words = ["sortie-tools", "missing", "cargo build", "-p sortie-tools"];
        assert_fails(&alone.output(arguments), 69, &words);
    }
}

#[test]
fn a_second_program_of_another_version_is_refused_by_name() {
    let alone = Alone::new();
    let (_folder, bundle) = without_plans();
    let other = alone.folder.path().join("sortie-tools");
    fs::write(&other, "#!/bin/sh\necho 'sortie 0.0.9 (abcdef0 2020-01-01)'\n").expect("a program");
    fs::set_permissions(&other, Permissions::from_mode(0o755)).expect("a program");
    for arguments in [
        &["verify", BUNDLE][..],
        &["run", BUNDLE, "--backend", "tract"],
        &["inspect", BUNDLE],
        &["run", text(&bundle)],
    ] {
        let words = ["sortie-tools", "0.0.9 (abcdef0 2020-01-01)", "cargo build"];
        assert_fails(&alone.output(arguments), 78, &words);
    }
}

#[test]
fn a_bundle_without_plans_plays_as_one_with_plans() {
    let (_folder, bundle) = without_plans();
    let played = |bundle: &str| json(&["eval", bundle, "--episodes", "5", "--json"]);
    let (with, without) = (played(BUNDLE), played(text(&bundle)));
    assert_eq!(with["return_mean"], without["return_mean"]);
}

#[test]
fn compiling_a_bundle_gives_it_the_plans_that_were_shipped() {
    let (folder, bundle) = without_plans();
    let written = folder.path().join("written");
    json(&["compile", text(&bundle), "-o", text(&written), "--json"]);
    for name in ["agent.plan", "allocator.plan"] {
        let [shipped, compiled] =
            [Path::new(BUNDLE), &written].map(|bundle| unmeasured(&bundle.join(name)));
        assert_eq!(shipped, compiled, "{name}");
    }
}

/// A plan without its largest distance from the graph, in which processors differ by the last bits.
fn unmeasured(path: &Path) -> (Header, Vec<u8>) {
    let plan = fs::read(path).expect("a plan");
    let (header, _) = Header::read(&plan).expect("its header");
    let Proof::Distance { max_distance, inputs } = header.proof else { panic!("{header:?}") };
    assert!(max_distance > 0.1 && max_distance <= 16.0, "{header:?}");
    let proof = Proof::Distance { max_distance: 0.0, inputs };
    (Header { proof, ..header }, plan[HEADER_BYTES..].to_vec())
}

#[test]
fn a_plan_is_inspected_by_the_measure_of_its_version() {
    let shipped = format!("{BUNDLE}/agent.plan");
    let before = "tests/golden/plans/agent-2.0.plan";
    for (plan, word, key, other) in [
        (shipped.as_str(), "rounding", "max_distance", "max_rel_error"),
        (before, "largest_error", "max_rel_error", "max_distance"),
    ] {
        let facts = json(&["inspect", plan, "--json"]);
        assert!(facts[key].is_number() && facts[other].is_null(), "{facts}");
        let text = output(&["inspect", plan]);
        assert!(String::from_utf8_lossy(&text.stdout).contains(word), "{plan}");
    }
}

#[test]
fn a_changed_plan_never_acts() {
    let folder = copied_bundle();
    let plan = folder.path().join("agent.plan");
    let mut bytes = fs::read(&plan).expect("the plan");
    *bytes.last_mut().expect("weights") ^= 1;
    fs::write(&plan, bytes).expect("another plan");
    let words = ["agent.plan", "SHA-256"];
    assert_fails(&output(&["run", text(folder.path())]), 65, &words);
}

/// Another policy in a shipped plan: the sign of every weight is turned, and all checksums and hashes fit.
fn forged(part: &str) -> tempfile::TempDir {
    let folder = copied_bundle();
    let path = folder.path().join(part);
    let honest = fs::read(&path).expect("the plan");
    let (header, _) = Header::read(&honest).expect("its header");
    let place = |offset: u32, length: u32| offset as usize..(offset + length) as usize;
    let program = place(header.program_offset, header.program_len);
    let weights = place(header.weights_offset, header.weights_len);
    let mut plan = honest.clone();
    plan[weights.clone()].chunks_exact_mut(4).for_each(|weight| weight[3] ^= 0x80);
    let sums = checksums(&header, &plan[program], &plan[weights]);
    plan[..HEADER_BYTES].copy_from_slice(&header.to_bytes(sums));
    fs::write(&path, &plan).expect("another plan");
    let manifest = folder.path().join("bundle.toml");
    let text = fs::read_to_string(&manifest).expect("the manifest");
    let text = text.replace(&hex(&sha256(&honest)), &hex(&sha256(&plan)));
    fs::write(&manifest, text).expect("a manifest with its hash");
    folder
}

#[test]
fn a_forged_plan_that_its_bundle_vouches_for_never_acts() {
    for part in ["agent.plan", "allocator.plan"] {
        let folder = forged(part);
        let bundle = text(folder.path());
        assert_fails(&output(&["run", bundle, "--in-process"]), 65, &[bundle, "golden answers"]);
        // Who asks how far it is off gets the table.
        let verified = output(&["verify", bundle, "--inputs", "8", "--against", "tract"]);
        assert_eq!(verified.status.code(), Some(1));
    }
}

/// Agents that decide by several graphs, which have no memory.
#[test]
fn plans_without_the_memory_that_their_bundle_states_never_act() {
    let place = tempfile::tempdir().expect("a temporary folder");
    for file in fs::read_dir("models/treasure-8").expect("the bundle").flatten() {
        fs::copy(file.path(), place.path().join(file.file_name())).expect("a copy");
    }
    let manifest = place.path().join("bundle.toml");
    let stated = fs::read_to_string(&manifest).expect("the manifest");
    assert_eq!(stated.matches("hidden = 0").count(), 1);
    fs::write(&manifest, stated.replace("hidden = 0", "hidden = 4")).expect("another manifest");
    let words = ["the recurrent state is 0 in the file, the contract says 4"];
    assert_fails(&output(&["eval", text(place.path()), "--episodes", "1"]), 78, &words);
}

#[test]
fn the_int8_plan_of_a_bundle_is_judged_by_what_it_achieves() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("agent.plan");
    let compile = ["compile", BUNDLE, "-o", text(&path), "--profile", "int8", "--json"];
    let written = json(&compile);
    let number = |part: &str, name: &str| written[part][name].as_f64().expect("a number");
    let paired = |name: &str| number("paired", name);
    assert!(paired("success_int8") >= paired("success_exact") - 0.01, "{written}");
    assert!(paired("success_exact") > 0.87 && paired("episodes") == 2000.0, "{written}");
    assert!(paired("seed") != paired("rounding_seed"), "{written}");
    let rule = written["paired"]["rule"].as_str().expect("a rule");
    assert!(["2,000", "0.01"].iter().all(|part| rule.contains(part)), "{rule}");
    // With the nearest weights it is less than 0.85.
    let same = number("agreement", "equal_actions") / number("agreement", "observations");
    assert!(same > 0.93, "{written}");
    let (header, _) = Header::read(&fs::read(&path).expect("the plan")).expect("its header");
    assert_eq!(header.profile, Profile::Int8);
    assert!((f64::from(header.action_mismatch) - (1.0 - same)).abs() < 1e-6);
}

#[test]
fn bundles_without_a_judgement_have_no_int8_plan() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("agent.plan");
    let compile = |bundle: &str, more: &[&str]| {
        output(&[&["compile", bundle, "-o", text(&path)], more].concat())
    };
    let int8 = ["--profile", "int8"];
    assert_fails(&compile("models/treasure-8", &int8), 2, &["success", "cannot be solved"]);
    let observed = ["--profile", "int8", "--observations", "seen.bin"];
    assert_fails(&compile(BUNDLE, &observed), 2, &["--observations", "ONNX"]);
    assert_fails(&compile(BUNDLE, &["--profile", "fused"]), 2, &["int8", "agent.onnx"]);
    assert_fails(&compile(BUNDLE, &["--dsp"]), 2, &["--profile int8"]);
    assert!(!path.exists());
}
