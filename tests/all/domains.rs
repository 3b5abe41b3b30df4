//! What keeps teams apart, and what the machine must give them: refused by name, with what to do.

use std::fs;
use std::io::{BufRead, BufReader};
use std::os::unix::fs::{PermissionsExt, chown};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use crate::support::{self, BUNDLE, TestDomain, assert_fails, interrupt, output, sortie, stderr};

/// A team that plays until it is interrupted.
struct Playing(Child);

impl Playing {
    fn start(domain: &TestDomain, more: &[&str]) -> Self {
        let mut child = sortie(&["up", BUNDLE, "--domain", &domain.id])
            .args(more)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the command line starts");
        let lines = BufReader::new(child.stderr.take().expect("standard error"));
        let mut lines = lines.lines().map_while(Result::ok);
        assert!(lines.any(|line| line.contains("leads the allocators")), "it does not play");
        // Whoever stops reading is no reason for a team to end.
        Self(child)
    }

    fn end(mut self) {
        interrupt(&self.0);
        assert_eq!(self.0.wait().expect("its status").code(), Some(130));
    }
}

#[test]
fn a_team_of_another_bundle_or_rule_is_refused_at_once() {
    let domain = TestDomain::new("mixed");
    let team = Playing::start(&domain, &["--allocation", "coordinated"]);
    // One that is not refused ends as well, once it has played.
    let verb = ["up", "--domain", &domain.id, "-q", "--episodes", "1", "--rate", "0"];
    let up = |more: &[&str]| output(&[&verb, more].concat());
    let other_rule = up(&[BUNDLE, "--allocation", "random"]);
    let words = ["another allocation rule", "random here, coordinated there", "--domain NAME"];
    assert_fails(&other_rule, 75, &words);
    assert_fails(&other_rule, 75, &["--mix-teams"]);
    let role = |role: &str, more: &[&str]| {
        output(&[&["process", role, BUNDLE, "--domain", &domain.id], more].concat())
    };
    assert_fails(&role("allocator", &["--allocation", "random"]), 75, &["another allocation rule"]);
    // A runner acts on whatever allocation comes: here its seat is taken.
    assert_fails(&role("runner", &["--agents", "0"]), 75, &["agent 0", "already taken"]);
    let copy = support::copied_bundle();
    let manifest = copy.path().join("bundle.toml");
    let text = fs::read_to_string(&manifest).expect("the manifest");
    fs::write(&manifest, text + "\n# another\n").expect("another bundle");
    let copy = copy.path().display().to_string();
    let other_bundle = up(&[&copy, "--allocation", "coordinated"]);
    assert_fails(&other_bundle, 75, &["a team of another bundle", "--domain NAME"]);
    // What is asked for is done: the world's place is taken, and nothing else.
    let world = output(
        &[
            &["process", "world", &copy, "--domain", &domain.id],
            &["--allocation", "random", "--mix-teams"][..],
        ]
        .concat(),
    );
    assert_fails(&world, 75, &["the world of domain", "already taken", "--domain NAME"]);
    team.end();
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

/// A verb with its domains under this folder.
fn under(base: &Path, arguments: &[&str]) -> Output {
    sortie(arguments).env("SORTIE_BASE", base).output().expect("the command line starts")
}

#[test]
fn folders_that_others_own_or_may_open_are_refused() {
    let parent = tempfile::tempdir_in("/dev/shm").expect("a folder");
    let domain = parent.path().join("team");
    fs::create_dir(&domain).expect("a folder");
    let verbs = [
        &["run", BUNDLE, "--episodes", "1", "--rate", "0", "--domain", "team"][..],
        &["up", BUNDLE, "--episodes", "1", "--rate", "0", "--domain", "team"],
    ];
    let refused = |words: &[&str]| {
        for verb in verbs {
            assert_fails(&under(parent.path(), verb), 74, words);
        }
        let doctor = under(parent.path(), &["doctor", "--domain", "team"]);
        let told = String::from_utf8_lossy(&doctor.stdout).into_owned();
        assert!(words.iter().all(|word| told.contains(word)), "{told}");
        assert_fails(&doctor, 1, &["problem"]);
    };
    fs::set_permissions(&domain, fs::Permissions::from_mode(0o777)).expect("its mode");
    refused(&[&domain.display().to_string(), "open to other users", "chmod 700"]);
    fs::set_permissions(&domain, fs::Permissions::from_mode(0o700)).expect("its mode");
    let played = under(parent.path(), verbs[0]);
    assert!(played.status.success(), "{}", stderr(&played));
    // Only the superuser can give a folder away.
    if chown(parent.path(), Some(65_534), None).is_ok() {
        refused(&["belongs to user 65534", "SORTIE_BASE"]);
    }
}

#[test]
fn a_base_that_is_not_there_is_named() {
    let nowhere = under(Path::new("/nowhere"), &["run", BUNDLE, "--episodes", "1"]);
    assert_fails(&nowhere, 74, &["/nowhere: is no directory", "SORTIE_BASE"]);
}

/// Runs `arguments` under a shell that has done this before.
fn after(preparation: &str, arguments: &[&str]) -> Output {
    let mut shell = Command::new("sh");
    shell.current_dir(env!("CARGO_MANIFEST_DIR"));
    shell.args(["-c", &format!("{preparation} && exec \"$@\""), "sh"]);
    shell.arg(sortie(&[]).get_program()).args(arguments).output().expect("a shell")
}

#[test]
fn too_few_descriptors_are_named() {
    let domain = TestDomain::new("few");
    for limit in ["20", "50", "100"] {
        for verb in ["run", "up"] {
            let arguments = [verb, BUNDLE, "--episodes", "1", "--domain", &domain.id];
            let refused = after(&format!("ulimit -n {limit}"), &arguments);
            assert_fails(&refused, 74, &[&format!("takes {limit} open files"), "ulimit -n"]);
        }
    }
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn a_folder_in_the_place_of_an_object_is_removed_as_promised() {
    let domain = TestDomain::new("folder");
    let uid = rustix::process::getuid().as_raw();
    let object = PathBuf::from(format!("/dev/shm/sortie-{uid}-{}-bell", domain.id));
    fs::create_dir(&object).expect("a folder");
    let doctor = output(&["doctor", "--domain", &domain.id]);
    let told = String::from_utf8_lossy(&doctor.stdout).into_owned();
    assert!(told.contains("the next start of a process of this domain removes them"), "{told}");
    let arguments = ["run", BUNDLE, "--episodes", "1", "--rate", "0", "--domain", &domain.id];
    let played = output(&arguments);
    assert!(played.status.success(), "{}", stderr(&played));
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

/// What a user namespace with a small `/dev/shm` of its own finds, if the system allows one.
#[test]
fn a_full_shared_memory_is_named_while_a_team_runs() {
    let script = r#"
        mount -t tmpfs -o size=8m tmpfs /dev/shm || { echo UNAVAILABLE; exit 0; }
        "$@" up models/save-the-city --rate 100 --restart never > /dev/null 2> /dev/shm/told &
        team=$!
        until grep -q "leads the allocators" /dev/shm/told; do sleep 0.02; done
        head -c 16m /dev/zero > /dev/shm/filler 2> /dev/null
        for verb in "doctor" "control info" "process allocator models/save-the-city --allocation learned"; do
            "$@" $verb 2>&1
            echo "== $verb: $?"
        done
        kill -INT $team
        wait $team
        echo "== up: $?"
        rm /dev/shm/filler /dev/shm/told
        ls -A /dev/shm
        echo "== end"
    "#;
    let mut shell = Command::new("unshare");
    shell.current_dir(env!("CARGO_MANIFEST_DIR"));
    shell.args(["--user", "--map-root-user", "--mount", "sh", "-c", script, "sh"]);
    let shown = shell.arg(sortie(&[]).get_program()).output();
    let Ok(shown) = shown else { return };
    let text = String::from_utf8_lossy(&shown.stdout).into_owned();
    if !shown.status.success() || text.contains("UNAVAILABLE") {
        eprintln!("NOT TESTED with a full /dev/shm: no namespace of one's own here");
        return;
    }
    let part = |name: &str| {
        let end = text.find(&format!("== {name}")).unwrap_or_else(|| panic!("{name}: {text}"));
        let begin = text[..end].rfind("\n== ").map_or(0, |at| at + 1);
        text[begin..]
            .lines()
            .take_while(|line| !line.starts_with(&format!("== {name}")))
            .collect::<Vec<_>>()
            .join("\n")
    };
    assert!(part("doctor").contains("/dev/shm: has 0 KiB free"), "{text}");
    assert!(part("doctor").contains("/dev/shm: is full"), "{text}");
    assert!(part("control info").contains("error: /dev/shm: is full"), "{text}");
    assert!(part("process allocator").contains("/dev/shm"), "{text}");
    assert!(text.contains("== up: 130"), "{text}");
    assert!(text.ends_with("== up: 130\n== end\n"), "leftovers: {text}");
}
