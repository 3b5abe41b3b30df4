//! Whoever watches a running team is told who is gone and who came instead, and so is Prometheus.

use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

use serde_json::Value;

use crate::support::{
    BUNDLE, Ending as _, Playing, TestDomain, assert_fails, json, kill, output, python, resume,
    sortie, stderr, stop, wait_until,
};

/// What helps where Python has no client of Prometheus.
const NO_CLIENT: &str = "metrics are read by their own client: `.ci/install python`, then `export \
    VIRTUAL_ENV=$PWD/target/python/venv`";

/// The page and the metrics of a team, and where they are.
struct Served {
    process: Child,
    place: String,
}

impl Served {
    fn of(domain: &TestDomain) -> Self {
        let mut command = sortie(&["top", "--domain", &domain.id, "--serve", "0"]);
        let mut process = command.stdout(Stdio::piped()).spawn().expect("it starts");
        let said = BufReader::new(process.stdout.take().expect("a pipe")).lines().next();
        let said = said.expect("a line").expect("text");
        let place = said.split("/ and ").next().expect("an address").to_owned();
        assert!(place.starts_with("http://127.0.0.1:"), "{said}");
        Self { process, place }
    }

    /// What Prometheus' own client reads, by family: its type, and each sample's labels and value.
    fn metrics(&self) -> Value {
        const SCRIPT: &str = "
import json, sys, urllib.request
from prometheus_client.parser import text_string_to_metric_families
with urllib.request.urlopen(sys.argv[1] + '/metrics') as answer:
    assert answer.headers['Content-Type'].startswith('text/plain; version=0.0.4'), answer.headers
    text = answer.read().decode()
print(json.dumps({
    family.name: {'type': family.type, 'help': family.documentation,
                  'samples': [[sample.labels, sample.value] for sample in family.samples]}
    for family in text_string_to_metric_families(text)
}))
";
        let read = Command::new(python()).args(["-c", SCRIPT, &self.place]).output();
        let read = read.expect("Python");
        assert!(read.status.success(), "{}{NO_CLIENT}", stderr(&read));
        serde_json::from_slice(&read.stdout).expect("JSON")
    }

    /// A sample of an agent.
    fn of_agent(&self, family: &str, agent: &str) -> Option<f64> {
        let metrics = self.metrics();
        let samples = metrics[family]["samples"].as_array()?;
        samples.iter().find(|sample| sample[0]["agent"] == agent)?[1].as_f64()
    }

    /// What is answered to a request.
    fn answer(&self, path: &str) -> String {
        const SCRIPT: &str = "
import sys, urllib.request, urllib.error
try:
    answer = urllib.request.urlopen(sys.argv[1])
except urllib.error.HTTPError as error:
    answer = error
print(answer.status, answer.headers['Content-Type'])
print(answer.read().decode())
";
        let place = format!("{}{path}", self.place);
        let read = Command::new(python()).args(["-c", SCRIPT, &place]).output().expect("Python");
        assert!(read.status.success(), "{}", stderr(&read));
        String::from_utf8_lossy(&read.stdout).into_owned()
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

#[test]
fn a_runner_that_is_killed_is_seen_to_be_gone_and_to_be_replaced() {
    let domain = TestDomain::new("top");
    let look = ["top", "--domain", &domain.id, "--json", "--for", "1"];
    assert_fails(&output(&look), 69, &["no world has started in domain"]);
    let up = Playing::new(&domain);
    let mut served = Served::of(&domain);
    let told = json(&look);
    let processes = told["processes"].as_array().expect("processes");
    let of_role = |role: &str| processes.iter().filter(|it| it["role"] == role).count();
    let roles = ["world", "runner", "allocator"].map(of_role);
    assert_eq!(roles, [1, 5, 2], "{told}");
    let leads = |it: &&Value| it["leads_in_term"].is_u64();
    assert_eq!(processes.iter().filter(leads).count(), 2, "{told}");
    assert!(told["frame"]["tick"].as_u64() > Some(0), "{told}");
    assert!(told["ticks_per_s"].as_f64() > Some(0.0), "{told}");
    assert!(told["allocation"]["total"].as_u64() > Some(0), "{told}");
    // Cities have two to five agents: the first plays in all of them.
    let first = &told["agents"][0];
    assert!(first["action_name"].is_string() && first["subtask"].is_u64(), "{told}");
    let pid = first["process"].as_u64().expect("who acts for it") as u32;
    let runs = processes.iter().find(|it| it["pid"] == pid).expect("it tells of itself");
    assert_eq!((&runs["role"], &runs["agents"][0]), (&"runner".into(), &0.into()));
    assert!(first["fallback_share"].as_f64() < Some(1.0), "{told}");
    assert!(first["decide_us"]["p50"].as_f64() > Some(0.0), "{told}");

    // Who would start another one at once is stopped meanwhile.
    stop(up.0.id());
    kill(pid);
    wait_until("it is absent", || json(&look)["agents"][0]["standing"] == "absent");
    assert_eq!(served.of_agent("sortie_agent_absent", "0"), Some(1.0));
    assert!(served.of_agent("sortie_agent_fallbacks", "0") > Some(0.0));
    assert_eq!(json(&look)["agents"][0]["fallback_share"], 1.0);
    resume(up.0.id());
    wait_until("another one acts", || {
        let told = json(&look);
        let now = &told["agents"][0];
        now["standing"] == "plays" && now["process"].as_u64().is_some_and(|it| it as u32 != pid)
    });
    wait_until("it is told", || served.of_agent("sortie_agent_absent", "0") == Some(0.0));

    let metrics = served.metrics();
    let family = |name: &str, kind: &str| {
        assert_eq!(metrics[name]["type"], kind, "{metrics}");
        metrics[name]["samples"].as_array().expect("samples").clone()
    };
    assert_eq!(family("sortie_team_info", "gauge")[0][0]["domain"], domain.id.as_str());
    assert!(family("sortie_ticks", "counter")[0][1].as_f64() > Some(100.0), "{metrics}");
    assert_eq!(family("sortie_agent_asked", "counter").len(), 5);
    assert_eq!(family("sortie_leader_term", "gauge").len(), 2);
    assert_eq!(family("sortie_agent_decide_seconds", "gauge")[0][0]["quantile"], "0.5");
    let is_told = |family: &Value| family["help"].as_str().is_some_and(|help| help.ends_with('.'));
    assert!(metrics.as_object().expect("families").values().all(is_told), "{metrics}");

    let page = served.answer("/");
    assert!(page.starts_with("200 text/html") && page.contains(&domain.id), "{page}");
    assert!(page.contains("http-equiv=\"refresh\"") && page.contains("ticks a second"), "{page}");
    assert!(served.answer("/elsewhere").starts_with("404 "));
    let printed = output(&["top", "--domain", &domain.id, "--prometheus", "--for", "0.5"]);
    assert!(String::from_utf8_lossy(&printed.stdout).contains("# TYPE sortie_ticks_total counter"));
    let table = output(&["top", "--domain", &domain.id, "--for", "0.5"]);
    let table = String::from_utf8_lossy(&table.stdout).into_owned();
    assert!(table.lines().all(|line| line.chars().count() <= 80), "{table}");
    assert!(table.starts_with("domain ") && table.contains("\nprocess "), "{table}");
    let again = ["top", "--domain", &domain.id, "--serve"];
    let taken = served.place.trim_start_matches("http://");
    assert_fails(&output(&[&again[..], &[taken]].concat()), 75, &[taken, "--serve ADDRESS:PORT"]);
    up.end(&domain);
    assert_eq!(served.process.ended().code(), Some(0));
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

/// The learned allocator gives what its search finds to be the best; a rule does not know what is.
#[test]
fn a_bundle_tells_how_far_allocations_are_from_the_best() {
    for (rule, is_best) in [("learned", true), ("random", false)] {
        let domain = TestDomain::new("regret");
        let up = Playing::with(&domain, &["--rate", "100", "--allocation", rule]);
        let look = ["top", "--domain", &domain.id, "--for", "1", "--bundle"];
        let told = || json(&[&look[..], &[BUNDLE, "--json"]].concat())["allocation"].clone();
        wait_until("an allocation is judged", || told()["value"].is_f64());
        let regrets = (0..3).map(|_| told()["regret"].as_f64().expect("a regret"));
        let regrets: Vec<f64> = regrets.collect();
        let most = regrets.iter().copied().fold(0.0, f64::max);
        assert!(regrets.iter().all(|regret| *regret > -1e-3), "{regrets:?}");
        assert_eq!(most < 1e-3, is_best, "{rule}: {regrets:?}");
        let page = output(&[&look[..], &[BUNDLE]].concat());
        assert!(String::from_utf8_lossy(&page.stdout).contains("regret, beside the best"));
        let others = output(&[&look[..], &["models/gridworld"]].concat());
        assert_fails(&others, 78, &["models/gridworld", "not what this team plays by"]);
        up.end(&domain);
    }
}

#[test]
fn a_line_is_told_each_time_until_the_team_ends() {
    let domain = TestDomain::new("follow");
    let up = Playing::new(&domain);
    let arguments = ["top", "--domain", &domain.id, "--json", "--follow", "--for", "0.2"];
    let mut top = sortie(&arguments).stdout(Stdio::piped()).spawn().expect("it starts");
    let mut lines = BufReader::new(top.stdout.take().expect("a pipe")).lines();
    let mut ticks = Vec::new();
    for line in lines.by_ref().take(3) {
        let told: Value = serde_json::from_str(&line.expect("a line")).expect("JSON");
        ticks.push(told["ticks_total"].as_u64().expect("a count"));
    }
    assert!(ticks.is_sorted_by(|one, next| one < next), "{ticks:?}");
    up.end(&domain);
    assert_eq!(top.ended().code(), Some(0));
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}
