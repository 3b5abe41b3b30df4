//! What a running team says is written down, and others can read it.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use serde_json::Value;

use crate::support::{
    BUNDLE, Ending as _, Playing, TestDomain, assert_fails, json, kill, output, python, sortie,
    stderr, wait_until,
};

/// What helps where Python has no reader.
const NO_MCAP: &str = "records are read by others: `.ci/install python`, then `export VIRTUAL_ENV=$PWD/target/python/venv`";

/// Messages by topic, as the format's own reader counts them, and the ticks of `/tick`.
fn read_by_others(file: &Path) -> (BTreeMap<String, u64>, Vec<Value>) {
    const SCRIPT: &str = "
import collections, json, sys
from mcap.reader import make_reader
WARM_UP = 3
counts, ticks = collections.Counter(), []
with open(sys.argv[1], 'rb') as file:
    for schema, channel, message in make_reader(file).iter_messages():
        # Frames by which a team warms up are no ticks.
        warms_up = channel.topic == '/frame' and message.data[6] == WARM_UP
        counts['warm-up' if warms_up else channel.topic] += 1
        if channel.topic == '/tick':
            ticks.append(json.loads(message.data))
print(json.dumps([counts, ticks]))
";
    let read = Command::new(python()).args(["-c", SCRIPT]).arg(file).output().expect("Python");
    assert!(read.status.success(), "{}{NO_MCAP}", stderr(&read));
    serde_json::from_slice(&read.stdout).expect("JSON")
}

/// The ticks of a record.
pub(crate) fn recorded_ticks(file: &str) -> Vec<Value> {
    read_by_others(Path::new(file)).1
}

#[test]
fn a_team_at_work_is_recorded_and_others_read_it() {
    let domain = TestDomain::new("record");
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("run.mcap");
    let name = file.to_str().expect("a name");
    let up = Playing::new(&domain);
    let record = ["record", BUNDLE, "--output", name, "--domain", &domain.id, "--ticks", "300"];
    let told = json(&[&record[..], &["--json"]].concat());
    // Others want the cores as well, and who is late by 16 ticks misses one: it says so.
    let [recorded, missed] = ["ticks", "missed"].map(|key| told[key].as_u64().expect(key));
    assert!((300..330).contains(&recorded) && missed < 100, "{told}");
    let [running, bytes] = ["bytes_running", "bytes"].map(|key| told[key].as_u64().expect(key));
    // The bundle, of a megabyte, stays as it is.
    assert!(bytes < running / 3 * 2, "{told}");
    assert_fails(&output(&record), 2, &["is there already", "--output"]);
    let other = folder.path().join("other.mcap");
    let other = ["record", "models/routing", "--output", other.to_str().expect("a name")];
    let refused = output(&[&other[..], &["--domain", &domain.id]].concat());
    assert_fails(&refused, 78, &["is not the team's bundle"]);
    up.shut_down(&domain);

    let (counts, ticks) = read_by_others(&file);
    assert!(counts["/frame"] >= 300 && counts["/status"] > 0, "{counts:?}");
    assert_eq!(ticks.len() as u64, recorded);
    let numbers: Vec<u64> = ticks.iter().filter_map(|tick| tick["tick"].as_u64()).collect();
    assert!(numbers.is_sorted_by(|one, next| one < next), "{numbers:?}");
    let span = numbers[numbers.len() - 1] - numbers[0] + 1;
    assert!(span <= recorded + missed, "{span} frames, {recorded} recorded, {missed} missed");
    // Of agents that exist each answers every frame but an episode's last; few are late here.
    let amid = ticks.iter().filter(|tick| tick["ends"] == false);
    let answers = amid.map(|tick| tick["agents"].as_array().map_or(0, Vec::len));
    let answers: Vec<usize> = answers.collect();
    let whole = answers.iter().filter(|agents| (2..=5).contains(*agents)).count();
    assert!(whole * 10 > answers.len() * 9, "{answers:?}");
    let of_ticks: usize =
        ticks.iter().map(|tick| tick["agents"].as_array().map_or(0, Vec::len)).sum();
    assert!(counts["/action"] >= of_ticks as u64, "{counts:?}");
    // All of it is decided again, by the record alone.
    let remade = json(&["remake", name, "--json"]);
    assert_eq!(remade["different"], 0, "{remade}");
    // The allocation that was in force when the record began comes with its sender's next heartbeat, some ticks later: of
    // all that is recorded that is the lesser part, however many want the cores.
    let [actions, before] =
        ["actions", "before_record"].map(|key| remade[key].as_u64().expect(key));
    assert!(actions + before >= of_ticks as u64 && actions > before, "{remade}");
    assert!(remade["allocations"].as_u64() > Some(20), "{remade}");
    let allocated = ticks.iter().filter(|tick| tick["allocation"][0].is_u64()).count();
    assert!(allocated > 250 && counts["/allocation"] > 20, "{counts:?}");
}

#[test]
fn a_record_whose_writer_was_killed_is_finished_and_read() {
    let domain = TestDomain::new("record-killed");
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("run.mcap");
    let name = file.to_str().expect("a name");
    assert_fails(
        &output(&["record", "--output", name, "--domain", &domain.id]),
        69,
        &["no world has started in domain"],
    );
    let up = Playing::new(&domain);
    for _ in 0..3 {
        let mut recorder = sortie(&["record", "--output", name, "--domain", &domain.id, "--quiet"]);
        let mut recorder = recorder.stdout(Stdio::null()).spawn().expect("it starts");
        wait_until("it records", || {
            std::fs::metadata(&file).is_ok_and(|file| file.len() > 200_000)
        });
        recorder.kill().expect("it lives");
        recorder.ended();
        let told = json(&["record", "--finish", name, "--json"]);
        let messages = told["messages"].as_u64().expect("a count");
        let (counts, ticks) = read_by_others(&file);
        assert_eq!(counts.values().sum::<u64>(), messages, "{told}");
        let frames = counts["/frame"] as usize;
        assert!(ticks.len() + 1 >= frames.saturating_sub(1), "{} of {frames}", ticks.len());
        assert!(output(&["record", "--finish", name]).status.success());
        assert_fails(&output(&["remake", name]), 65, &["brings no bundle along", "--bundle"]);
        let remade = json(&["remake", name, "--bundle", BUNDLE, "--json"]);
        assert_eq!(remade["different"], 0, "{remade}");
        std::fs::remove_file(&file).expect("it is there");
    }
    up.shut_down(&domain);
    assert_fails(&output(&["record", "--finish", "Cargo.toml"]), 65, &["no record"]);
}

/// What a recorder prints, a file a line.
fn told(recorder: Child) -> Vec<Value> {
    let told = recorder.wait_with_output().expect("its output");
    assert!(told.status.success(), "{told:?}");
    let lines = told.stdout.split(|byte| *byte == b'\n').filter(|line| !line.is_empty());
    lines.map(|line| serde_json::from_slice(line).expect("JSON")).collect()
}

#[test]
fn a_long_record_goes_into_several_files_of_which_the_newest_are_kept() {
    let domain = TestDomain::new("record-split");
    let folder = tempfile::tempdir().expect("a folder");
    let up = Playing::new(&domain);
    let name = folder.path().join("run.mcap");
    let name = name.to_str().expect("a name");
    // A file that an earlier recorder left stays as it is.
    let earlier = folder.path().join("run-2.mcap");
    std::fs::write(&earlier, "of yesterday").expect("there is room");
    let record = ["record", "--output", name, "--domain", &domain.id, "--json", "--ticks", "500"];
    let record = [&record[..], &["--split", "400kB", "--keep", "2"]].concat();
    let recorder = sortie(&record).stdout(Stdio::piped()).spawn().expect("it starts");
    let files = told(recorder);
    up.shut_down(&domain);
    assert!(files.len() >= 4, "{files:?}");
    let names: Vec<_> = files.iter().filter_map(|file| file["file"].as_str()).collect();
    assert!(names[0].ends_with("/run-1.mcap") && names[1].ends_with("/run-3.mcap"), "{names:?}");
    let ticks: u64 = files.iter().filter_map(|file| file["ticks"].as_u64()).sum();
    assert!((500..530).contains(&ticks), "{ticks}");
    let kept: Vec<_> = names.iter().filter(|name| Path::new(name).exists()).collect();
    assert_eq!(kept, names[names.len() - 2..].iter().collect::<Vec<_>>());
    assert_eq!(std::fs::read(&earlier).expect("it is there"), b"of yesterday");
    // Each file stands for itself. The last but one is full; the last may have begun with the last tick.
    let full = &files[files.len() - 2];
    let name = full["file"].as_str().expect("a name");
    assert_eq!(json(&["remake", name, "--bundle", BUNDLE, "--json"])["different"], 0);
    assert_eq!(
        read_by_others(Path::new(name)).1.len() as u64,
        full["ticks"].as_u64().expect("a count")
    );
    for (argument, value) in
        [("--split", "3 apples"), ("--split", "0B"), ("--last", "s"), ("--keep", "0")]
    {
        assert_fails(&output(&["record", argument, value]), 2, &[argument]);
    }
}

#[test]
fn a_flight_recorder_writes_what_was_said_before_a_process_died() {
    let domain = TestDomain::new("record-last");
    let folder = tempfile::tempdir().expect("a folder");
    let up = Playing::new(&domain);
    let [name, first] = ["run.mcap", "run-1.mcap"].map(|name| folder.path().join(name));
    let name = name.to_str().expect("a name");
    let record = ["record", BUNDLE, "--output", name, "--domain", &domain.id, "--json"];
    let record = [&record[..], &["--last", "2s", "--on", "death"]].concat();
    let recorder = sortie(&record).stdout(Stdio::piped()).spawn().expect("it starts");
    let said = || json(&["control", "info", "--domain", &domain.id, "--json"]);
    let newest = || {
        said()["processes"]
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(|it| it["tick"].as_u64())
            .max()
    };
    let begun = newest();
    wait_until("a while has passed", || newest() > begun.map(|tick| tick + 300));
    let runner = said()["processes"]
        .as_array()
        .into_iter()
        .flatten()
        .find(|it| it["role"] == "runner")
        .and_then(|it| it["pid"].as_u64())
        .expect("a runner");
    kill(runner as u32);
    wait_until("its death is written", || first.exists());
    up.shut_down(&domain);
    // Nothing happened afterwards.
    let files = told(recorder);
    assert_eq!(files.len(), 1, "{files:?}");
    assert_eq!(files[0]["why"], format!("runner {runner} fell silent"));
    // Three seconds of a hundred ticks each, one of them after the silence was noticed.
    assert!((200..400).contains(&files[0]["ticks"].as_u64().expect("a count")), "{files:?}");
    let remade = json(&["remake", first.to_str().expect("a name"), "--json"]);
    assert_eq!(remade["different"], 0, "{remade}");
    assert!(remade["actions"].as_u64() > Some(500), "{remade}");
}

/// Where the messages of a channel begin in a record that was not finished, by the numbers that `sortie record` gives them.
fn messages(record: &[u8], channel: u16) -> Vec<usize> {
    const MESSAGE: u8 = 5;
    let mut found = Vec::new();
    let mut at = 8;
    while let Some(length) = record.get(at + 1..at + 9) {
        let length = u64::from_le_bytes(length.try_into().expect("eight")) as usize;
        let head = at + 9;
        if record[at] == MESSAGE && record.get(head..head + 2) == Some(&channel.to_le_bytes()) {
            // Channel, number and two times come before the message.
            found.push(head + 22);
        }
        at = head + length;
    }
    found
}

/// The bundle that decided would do the same again, another one would not always; what agents saw serves where observations do.
fn serves_other_verbs(name: &str) {
    let remade = json(&["remake", name, "--json"]);
    let own = json(&["eval", BUNDLE, "--on", name, "--json"]);
    let all = |told: &Value, key: &str| {
        ["same", "of"].map(|part| told[key][part].as_u64().expect("a count"))
    };
    let [asked, of] = all(&own, "agreement");
    // Agents whose allocation came too late did what is safe, and no policy was asked.
    let all_made = remade["actions"].as_u64().expect("a count");
    assert!(asked == of && (all_made * 9 / 10..=all_made).contains(&of), "{own}");
    let [same, of] = all(&own, "allocations");
    assert!(same == of && of > 0, "{own}");
    let other = json(&["eval", "models/save-the-city-large", "--on", name, "--json"]);
    let share = |key: &str| {
        let [same, of] = all(&other, key);
        same as f64 / of as f64
    };
    assert!((0.2..1.0).contains(&share("agreement")), "{other}");
    assert!(share("where_it_counts") > share("agreement"), "{other}");
    let refused = output(&["eval", "models/routing", "--on", name]);
    assert_fails(&refused, 78, &["is of contract", "models/routing has"]);
    let verified =
        json(&["verify", BUNDLE, "--observations", name, "--against", "golden", "--json"]);
    assert!(verified.to_string().contains(&format!("\"inputs\":{asked}")), "{verified}");
}

/// Reasons are those of the decision in the record.
fn explains(whole: &[u8], name: &str) {
    let actions = messages(whole, 2);
    let action = actions[actions.len() / 2];
    let bytes = |at: usize| whole[action + at..action + at + 4].try_into().expect("four");
    let (agent, tick) = (u32::from(whole[action + 40]).to_string(), u32::from_le_bytes(bytes(16)));
    let tick = tick.to_string();
    let asked = ["why", name, "--agent", &agent, "--tick", &tick];
    let told = json(&[&asked[..], &["--json"]].concat());
    assert_eq!([&told["agent"], &told["tick"]].map(Value::to_string), [&*agent, &*tick]);
    let best = &told["actions"][0];
    assert_eq!(best["action"], told["action"], "{told}");
    let utility = f64::from(f32::from_le_bytes(bytes(48)));
    assert!((best["utility"].as_f64().expect("a number") - utility).abs() < 1e-4, "{told}");
    let weights = told["attention"].as_array().into_iter().flatten();
    let sum: f64 = weights.filter_map(|it| it["weights"][0].as_f64()).sum();
    assert!((sum - 1.0).abs() < 1e-2, "{told}");
    // The search found the best of all allocations, so that nobody is better off elsewhere.
    let places = told["allocation"]["tasks"].as_array().expect("open subtasks");
    let own = |place: &&Value| place["task"] == told["task"];
    let others = |place: &&Value| place["instead"].as_f64().is_some_and(|gain| gain > 1e-3);
    assert_eq!(places.iter().filter(own).count(), 1, "{told}");
    assert_eq!(places.iter().filter(others).count(), 0, "{told}");
    assert_eq!(told["allocation"]["regret"], 0.0, "{told}");
    let text = String::from_utf8(output(&asked).stdout).expect("text");
    let words = ["did: ", "utilities: ", "attended to: ", "saw of itself: ", "with it instead"];
    assert!(words.iter().all(|word| text.contains(word)), "{text}");
    let never = ["why", name, "--agent", &agent, "--tick", "4000000000"];
    assert_fails(&output(&never), 66, &["no action of agent"]);
}

/// The same of a running team, of whatever an agent does next. A rule allocates, which is not always as good as the network.
#[test]
fn reasons_are_told_of_a_running_team() {
    let domain = TestDomain::new("why");
    let up = Playing::with(&domain, &["--rate", "100", "--allocation", "random"]);
    let why = ["why", "--agent", "1", "--bundle", BUNDLE, "--domain", &domain.id, "--json"];
    let told: Vec<Value> = (0..5).map(|_| json(&why)).collect();
    up.shut_down(&domain);
    for told in &told {
        let best = &told["actions"][0];
        assert!(told["agent"] == 1 && best["action"] == told["action"], "{told}");
        assert!(told["allocation"]["regret"].as_f64() > Some(-0.01), "{told}");
    }
    let ticks = told.windows(2).all(|two| two[0]["tick"].as_u64() < two[1]["tick"].as_u64());
    assert!(ticks, "{told:?}");
    assert!(told.iter().any(|told| told["allocation"]["regret"].as_f64() > Some(0.1)), "{told:?}");
    let without = output(&["why", "--agent", "1", "--domain", &domain.id]);
    assert_fails(&without, 2, &["required arguments"]);
}

#[test]
fn whatever_is_changed_in_a_record_that_a_decision_read_or_made_is_named() {
    let domain = TestDomain::new("remake");
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("run.mcap");
    let name = file.to_str().expect("a name");
    let up = Playing::new(&domain);
    let mut recorder = sortie(&["record", BUNDLE, "--output", name, "--domain", &domain.id]);
    let mut recorder = recorder.stdout(Stdio::null()).spawn().expect("it starts");
    wait_until("it records", || std::fs::metadata(&file).is_ok_and(|file| file.len() > 1_600_000));
    recorder.kill().expect("it lives");
    recorder.ended();
    up.shut_down(&domain);
    let whole = std::fs::read(&file).expect("it is there");
    let remade = json(&["remake", name, "--json"]);
    assert_eq!((&remade["different"], &remade["torn_at"]), (&0.into(), &Value::Null));
    std::fs::write(&file, &whole[..whole.len() - 1]).expect("there is room");
    assert!(json(&["remake", name, "--json"])["torn_at"].as_u64() > Some(1_000_000));
    explains(&whole, name);
    serves_other_verbs(name);
    // A number that an agent sees, an action, its utility, and the first subtask of an allocation.
    let features = 64 + 64;
    let [frames, actions, allocations] = [1, 2, 3].map(|channel| messages(&whole, channel));
    let number = |at: usize| u64::from_le_bytes(whole[at..at + 8].try_into().expect("eight"));
    let action = actions[actions.len() / 2];
    let is_answered = |frame: &&usize| number(**frame + 24) == number(action + 16);
    let shown = frames.iter().find(is_answered).expect("the frame of the action") + features;
    let feature = (shown..).step_by(4).find(|at| whole[*at + 3] != 0).expect("a number");
    for (at, words) in [
        (feature + 2, &["the "][..]),
        (action + 42, &["the action is"]),
        (action + 48, &["the utility is"]),
        (allocations[allocations.len() / 2] + 64, &["the allocation is"]),
    ] {
        let mut changed = whole.clone();
        changed[at] ^= 1;
        std::fs::write(&file, changed).expect("there is room");
        let refused = output(&["remake", name]);
        assert_fails(&refused, 1, words);
        assert_fails(&refused, 1, &["tick ", "in the record", "made again"]);
    }
}

/// A rule that draws does so from the seed of its team, which the record has.
#[test]
fn what_an_allocator_drew_is_drawn_again() {
    let domain = TestDomain::new("drawn");
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("run.mcap");
    let name = file.to_str().expect("a name");
    let up = Playing::with(
        &domain,
        &["--rate", "200", "--allocation", "random", "--seed", "18446744073709551615"],
    );
    let record = ["record", BUNDLE, "--output", name, "--ticks", "200", "--json"];
    json(&[&record[..], &["--domain", &domain.id]].concat());
    up.shut_down(&domain);
    let remade = json(&["remake", name, "--json"]);
    assert_eq!(remade["different"], 0, "{remade}");
    assert!(remade["allocations"].as_u64() > Some(10), "{remade}");
}

/// What happens to a team at 1 kHz all the time: its allocator steps down or is killed, so are runners, or all change the bundle.
fn disturb(domain: &TestDomain, turn: usize) {
    let order = |order: &[&str]| output(&[&["control"], order, &["--domain", &domain.id]].concat());
    let told = order(&["info", "--json"]).stdout;
    let told: Value = serde_json::from_slice(&told).unwrap_or_default();
    let victims = |leads: bool| {
        let processes = told["processes"].as_array().into_iter().flatten();
        let processes = processes.filter(|it| it["role"] != "world" && it["leads"] == leads);
        processes.filter_map(|it| it["pid"].as_u64()).collect::<Vec<_>>()
    };
    match turn % 5 {
        0 => drop(order(&["reload", &format!("{BUNDLE}-large")])),
        1 => drop(order(&["step-down"])),
        2 => drop(order(&["reload", BUNDLE])),
        which => {
            let victims = victims(which == 3);
            victims.get(turn % victims.len().max(1)).into_iter().for_each(|pid| kill(*pid as u32));
        }
    }
}

/// Ten thousand ticks; `TICKS=1000000` of them in the same way takes an hour.
#[test]
fn what_a_team_did_under_kills_and_changes_is_made_again() {
    let domain = TestDomain::new("disturbed");
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("run.mcap");
    let name = file.to_str().expect("a name");
    let ticks = std::env::var("TICKS").unwrap_or_else(|_| "10000".to_owned());
    let up = Playing::with(&domain, &["--rate", "1000"]);
    let record =
        ["record", BUNDLE, "--output", name, "--ticks", &ticks, "--json", "--domain", &domain.id];
    let mut recorder = sortie(&record).stdout(Stdio::piped()).spawn().expect("it starts");
    let mut turns = 0;
    while recorder.try_wait().expect("a status").is_none() {
        disturb(&domain, turns);
        turns += 1;
    }
    let recorded = recorder.wait_with_output().expect("its output");
    up.shut_down(&domain);
    let began = std::time::Instant::now();
    let remade = json(&["remake", name, "--json"]);
    let took = began.elapsed();
    println!("{turns} turns; {}{remade} in {took:?}", String::from_utf8_lossy(&recorded.stdout));
    assert_eq!((&remade["different"], &remade["of_others"]), (&0.into(), &0.into()), "{remade}");
    let [made, frames] = ["actions", "frames"].map(|key| remade[key].as_u64().expect(key));
    assert!(turns > 5 && made > frames, "{turns} turns: {remade}");
}
