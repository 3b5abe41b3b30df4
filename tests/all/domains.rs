//! What keeps teams apart, and what the machine must give them: refused by name, with what to do.

use std::fs;
use std::io::{BufRead, BufReader};
use std::os::unix::fs::{PermissionsExt, chown};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use crate::support::{
    self, BUNDLE, Ending as _, TestDomain, assert_fails, interrupt, json, kill, output, sortie,
    stderr, wait_until,
};

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
        assert_eq!(self.0.ended().code(), Some(130));
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

/// Tries each of the paths in every way, and prints the ways that are open, as `write PATH`.
const INTRUDER: &str = r#"
    for path; do
        head -c 1 "$path" && echo "read $path"
        ls "$path"/ && echo "list $path"
        (exec 3<>"$path") && echo "write $path"
        truncate -c -s 0 "$path" && echo "truncate $path"
        flock -n "$path" true && echo "lock $path"
        chmod a+rw "$path" && echo "chmod $path"
        mv "$path" "$path.moved" && echo "move $path"
        rm -rf "$path" && [ ! -e "$path" ] && echo "remove $path"
    done 2> /dev/null
"#;

/// The ways that are open to another user, of `read`, `list`, `write`, `truncate`, `lock`, `chmod`, `move` and `remove`.
fn ways_of_another_user(paths: &[PathBuf]) -> Vec<String> {
    let mut intruder = Command::new("sh");
    intruder.uid(65_534).gid(65_534).args(["-c", INTRUDER, "sh"]).args(paths);
    let told = intruder.stderr(Stdio::inherit()).output().expect("a shell of another user");
    let ways = String::from_utf8_lossy(&told.stdout).into_owned();
    ways.lines().filter(|line| line.contains(" /dev/shm/")).map(str::to_owned).collect()
}

/// A folder and all that is in it.
fn collect(path: PathBuf, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(&path).into_iter().flatten().flatten() {
        collect(entry.path(), found);
    }
    found.push(path);
}

/// The processes of a domain by role.
fn roles(domain: &TestDomain, role: &str) -> Vec<u32> {
    let told = output(&["control", "info", "--domain", &domain.id, "--json"]);
    let told: serde_json::Value = serde_json::from_slice(&told.stdout).unwrap_or_default();
    let processes = told["processes"].as_array().cloned().unwrap_or_default();
    let of_role = processes.iter().filter(|process| process["role"] == role);
    of_role.filter_map(|process| process["pid"].as_u64()?.try_into().ok()).collect()
}

#[test]
fn another_user_reaches_nothing_of_a_running_team() {
    if !rustix::process::getuid().is_root() {
        eprintln!("NOT TESTED as another user: only the superuser can be somebody else");
        return;
    }
    let domain = TestDomain::new("other");
    let team = Playing::start(&domain, &["--isolate"]);
    let mut paths = Vec::new();
    domain.leftovers().into_iter().for_each(|path| collect(path, &mut paths));
    assert!(paths.len() > 30, "objects, locks and sockets: {paths:?}");
    assert_eq!(ways_of_another_user(&paths), [""; 0]);
    // What is open is found.
    let open = tempfile::Builder::new().tempfile_in("/dev/shm").expect("a file");
    fs::set_permissions(open.path(), fs::Permissions::from_mode(0o666)).expect("its mode");
    let ways = ways_of_another_user(&[open.path().to_path_buf()]);
    let expected =
        ["read", "write", "truncate", "lock"].map(|way| format!("{way} {}", open.path().display()));
    assert_eq!(ways, expected);
    let examined = json(&["doctor", "--domain", &domain.id, "--json"]);
    assert_eq!(examined["problems"], 0, "{examined}");
    let before = roles(&domain, "runner");
    assert_eq!(before.len(), 5, "a runner for each agent");
    kill(before[0]);
    wait_until("the runner is back", || {
        let now = roles(&domain, "runner");
        now.len() == 5 && !now.contains(&before[0])
    });
    let object = paths.iter().find(|path| path.to_string_lossy().ends_with("-bell"));
    let object = object.expect("the doorbell");
    fs::set_permissions(object, fs::Permissions::from_mode(0o606)).expect("its mode");
    let examined = output(&["doctor", "--domain", &domain.id]);
    let told = String::from_utf8_lossy(&examined.stdout).into_owned();
    assert!(told.contains(&format!("{}: is open to other users", object.display())), "{told}");
    assert_fails(&examined, 1, &["1 problem"]);
    assert_fails(&output(&["control", "info", "--domain", &domain.id]), 74, &["chmod go="]);
    fs::set_permissions(object, fs::Permissions::from_mode(0o600)).expect("its mode");
    team.end();
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
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
