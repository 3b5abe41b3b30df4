//! What is wrong with a policy that is served.

use std::time::{Duration, Instant};

use sortie_core::link::StatRx;
use sortie_core::wire::StatMsg;

use super::engine;
use super::finding::{Finding, Severity};
use crate::build::version;
use crate::domain::{Membership, preflight};
use crate::error::Error;
use crate::iox::{ServedSetup, ServedWatcher, served_bytes};
use crate::policy::{Port, ServedFacts};

/// A server tells of itself three times in this time.
const LISTENING: Duration = Duration::from_millis(350);
/// Pause between two looks.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// Looks at the policy that is served in a domain, if one was. Returns whether that is so.
pub(super) fn examine(membership: &Membership, findings: &mut Vec<Finding>) -> Result<bool, Error> {
    let domain = membership.domain();
    let Some(facts) = ServedFacts::read(domain)? else { return Ok(false) };
    if let Err(error) = facts.check(domain, None) {
        let advice = "start server and robot of the same version";
        findings.push(Finding::new(Severity::Problem, "policy", error.to_string(), advice));
        return Ok(true);
    }
    let format = facts.schema.format()?;
    findings.push(Finding::of(
        "room for the policy",
        preflight::check_space(served_bytes(&format)),
        "remove what fills /dev/shm, or enlarge it: `mount -o remount,size=64m /dev/shm`",
    ));
    let mut watcher = {
        let _starting = membership.lock_start()?;
        ServedWatcher::open(&ServedSetup { domain, format, linger: Duration::ZERO })?
    };
    let heard = listen(&mut watcher)?;
    findings.push(Finding::fine("policy", describe(&facts, format.schema())));
    match heard {
        None => findings.push(Finding::new(
            Severity::Problem,
            "server",
            "nobody answers: robots act by their fallback",
            "look whether it is stopped, or start it: `sortie serve PLAN --domain ID`",
        )),
        Some((first, last)) => findings.extend(examine_server(&first, &last)),
    }
    Ok(true)
}

/// The first and the newest status of the server. One that is dead or stopped is not heard: a new listener gets what was
/// said before it came from the living alone.
fn listen(watcher: &mut ServedWatcher) -> Result<Option<(StatMsg, StatMsg)>, Error> {
    let until = Instant::now() + LISTENING;
    let mut heard: Option<(StatMsg, StatMsg)> = None;
    while Instant::now() < until {
        watcher.receive_statuses(&mut |status| {
            heard = match heard {
                Some((first, _)) if status.has(StatMsg::BYE) && first.pid != status.pid => heard,
                _ if status.has(StatMsg::BYE) => None,
                Some((first, _)) if first.pid == status.pid => Some((first, *status)),
                _ => Some((*status, *status)),
            };
        })?;
        std::thread::sleep(LOOK_EVERY);
    }
    Ok(heard)
}

/// `obs [40] -> actions [12], schema 0123…, deadline 20 ms, fallback hold`.
fn describe(facts: &ServedFacts, schema: u64) -> String {
    let named = |ports: &[Port]| -> String {
        let one = |port: &Port| format!("{} [{}]", port.name, port.length).trim_start().to_owned();
        ports.iter().map(one).collect::<Vec<_>>().join(", ")
    };
    let (inputs, outputs) = (named(&facts.schema.inputs), named(&facts.schema.outputs));
    let (deadline, fallback) = (facts.deadline().as_secs_f64() * 1e3, facts.fallback);
    format!(
        "{inputs} -> {outputs}, schema {schema:016x}, deadline {deadline} ms, fallback {fallback}"
    )
}

/// Counters of a status, by their places.
const ANSWERS: usize = 0;
const MISSED: usize = 1;
const LATE: usize = 2;
const FALLBACKS: usize = 5;
const REFUSED: usize = 6;

/// What a server has done, and whether it does it in time just now.
fn examine_server(first: &StatMsg, last: &StatMsg) -> [Finding; 2] {
    let count = |status: &StatMsg, index: usize| status.counters.get(index).copied().unwrap_or(0);
    let since = |index| count(last, index).saturating_sub(count(first, index));
    let [answers, missed, late, fallbacks, refused] =
        [ANSWERS, MISSED, LATE, FALLBACKS, REFUSED].map(|index| count(last, index));
    let [a, b, c, d, ..] = last.model;
    let found = format!(
        "process {}, model {a:02x}{b:02x}{c:02x}{d:02x}{}, {answers} answers, {late} late, {fallbacks} fallbacks, \
         {missed} missed, {refused} refused, version {}",
        last.pid,
        engine(last),
        version(last.build)
    );
    let asked = since(ANSWERS) + since(MISSED) + since(REFUSED);
    let bad = since(LATE) + since(FALLBACKS) + since(MISSED) + since(REFUSED);
    let now = match (asked, bad) {
        (0, _) => Finding::fine("robot", "none asks just now"),
        (_, 0) => Finding::fine("robot", format!("{asked} answers just now, all in time")),
        _ => Finding::new(
            Severity::Warning,
            "robot",
            format!(
                "{bad} of {asked} observations just now are late, missed, refused or fallbacks"
            ),
            "a longer deadline, `--rt` and `--core`, or another observation: the robot's program knows the reasons",
        ),
    };
    [Finding::fine("server", found), now]
}
