//! What is wrong with the machine, or with a domain.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::{Duration, Instant};

use sortie_core::link::{Clock, StatRx};
use sortie_core::wire::{Role, StatMsg};

use crate::control::{Answer, team_info};
use crate::domain::{Domain, DomainFacts, Membership, SHARED_MEMORY, preflight};
use crate::error::Error;
use crate::iox::{
    IoxWatcher, LinkSetup, ServedSetup, ServedWatcher, dead_nodes, served_bytes, worst_case_bytes,
};
use crate::policy::{Port, ServedFacts};
use crate::process_info::{HostProcess, version};
use crate::stop::MonotonicClock;

/// What a domain of eight agents takes at most, where none runs.
const USUAL_BYTES: u64 = 512 << 10;
/// Every process tells of itself in this time.
const LISTENING: Duration = Duration::from_millis(350);
/// Checks of the machine that keep every process out of a domain.
const KEEP_OUT: [&str; 4] = ["base directory", "ownership", "socket paths", "open files"];
/// Pause between two looks.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// Looks at the machine, and at the domain if it runs, which it joins for a moment.
///
/// # Errors
/// The domain could not be looked at.
pub fn examine(domain: &Domain) -> Result<Vec<Finding>, Error> {
    let mut findings = examine_machine(domain);
    let is_sound = findings
        .iter()
        .all(|found| !KEEP_OUT.contains(&found.check) || found.severity == Severity::Fine);
    if !is_sound {
        // Nobody can enter such a domain, nor trust it.
        return Ok(findings);
    }
    if domain.is_alive()? {
        let objects = domain.check_objects();
        let is_closed = objects.is_ok();
        findings.push(Finding::of(
            "shared objects",
            objects,
            "the user's alone",
            "close it, and ask who opened it: whoever can write there can end the team",
        ));
        if !is_closed {
            return Ok(findings);
        }
        let membership = domain.enter()?;
        examine_running(&membership, &mut findings)?;
    } else {
        findings.push(examine_leftovers(domain)?);
    }
    Ok(findings)
}

fn examine_machine(domain: &Domain) -> Vec<Finding> {
    let existing = domain.base().ancestors().find(|path| path.exists()).unwrap_or(Path::new("/"));
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    vec![
        Finding::of(
            "base directory",
            preflight::check_tmpfs(existing),
            "on tmpfs",
            "set `SORTIE_BASE` to a directory on tmpfs",
        ),
        Finding::of(
            "ownership",
            preflight::check_ownership(domain),
            "the user's alone",
            "whoever else may write there can replace what the team uses",
        ),
        Finding::of(
            "socket paths",
            preflight::check_path_length(domain),
            "short enough",
            "use a shorter domain id, or a shorter `SORTIE_BASE`",
        ),
        Finding::of(
            "shared memory",
            preflight::check_tmpfs(Path::new(SHARED_MEMORY))
                .and_then(|()| preflight::check_space(USUAL_BYTES)),
            "enough for a team",
            "remove what fills /dev/shm, or enlarge it: `mount -o remount,size=64m /dev/shm`",
        ),
        Finding::of(
            "open files",
            preflight::check_descriptors(),
            "enough for a team",
            "raise the limit: `ulimit -n 1024`",
        ),
        match cores {
            1 => Finding::new(
                Severity::Warning,
                "cores",
                "1 core",
                "runners and world take turns: expect late ticks",
            ),
            _ => Finding::fine("cores", format!("{cores} cores")),
        },
    ]
}

fn examine_leftovers(domain: &Domain) -> Result<Finding, Error> {
    let objects = domain.shared_memory()?.len();
    if objects == 0 && !domain.base().exists() {
        return Ok(Finding::fine("leftovers", "nothing runs, and nothing is left"));
    }
    Ok(Finding::new(
        Severity::Warning,
        "leftovers",
        format!("nothing runs, {objects} objects in shared memory are left of killed processes"),
        "nothing: the next start of a process of this domain removes them",
    ))
}

fn examine_running(membership: &Membership, findings: &mut Vec<Finding>) -> Result<(), Error> {
    let served = examine_served(membership, findings)?;
    let Some(facts) = membership.facts()? else {
        if served {
            return Ok(());
        }
        findings.push(Finding::new(
            Severity::Problem,
            "world",
            "processes wait for a world, or for a policy",
            "start one: `sortie up BUNDLE`, or `sortie serve PLAN`",
        ));
        return Ok(());
    };
    findings.push(Finding::of(
        "room for the domain",
        preflight::check_space(worst_case_bytes(&facts)?),
        "enough",
        "remove what fills /dev/shm, or enlarge it: `mount -o remount,size=64m /dev/shm`",
    ));
    if let Err(error) = examine_team(membership, &facts, served, findings) {
        let advice = "mend what is named above, and ask again";
        findings.push(Finding::new(Severity::Problem, "processes", error.to_string(), advice));
    }
    Ok(())
}

/// Listens to what the processes tell of themselves.
fn examine_team(
    membership: &Membership,
    facts: &DomainFacts,
    is_served: bool,
    findings: &mut Vec<Finding>,
) -> Result<(), Error> {
    let format = facts.format()?;
    let domain = membership.domain();
    let name = format!("watcher/{}", std::process::id());
    let setup =
        LinkSetup { domain, format, name: &name, bell: facts.bell(), linger: Duration::ZERO };
    let mut watcher: IoxWatcher = {
        let _starting = membership.lock_start()?;
        IoxWatcher::open(&setup)?
    };
    let (statuses, world) = listen(&mut watcher)?;
    if is_served && statuses.is_empty() && !membership.has_world()? {
        findings.push(Finding::fine("team", "none: the last one has ended"));
        return Ok(());
    }
    findings.push(match world {
        Frames::Come => Finding::fine("world", "sends frames"),
        Frames::Paused => Finding::new(
            Severity::Warning,
            "world",
            "stands still, as it was told",
            "let it go on: `sortie control resume --domain ID`",
        ),
        // Without an allocator nobody gets whole frames, and nobody else opens those of an agent.
        Frames::Missing if facts.has_private_frames() && is_told_by_world(&statuses) => {
            Finding::fine("world", "tells of itself; its frames are the agents' own")
        }
        Frames::Missing => Finding::new(
            Severity::Problem,
            "world",
            "sends no frames",
            "look whether it is stopped, or start one: `sortie up BUNDLE`",
        ),
    });
    findings.extend(statuses.values().map(examine_process));
    findings.push(examine_seats(membership, &statuses, format.layout.every_agent())?);
    findings.extend(examine_absent(membership, facts)?);
    findings.push(examine_allocators(&statuses, facts.has_allocation()));
    drop(watcher);
    findings.push(match dead_nodes(domain)? {
        0 => Finding::fine("dead nodes", "none"),
        dead => Finding::new(
            Severity::Warning,
            "dead nodes",
            format!("{dead} of processes that were killed"),
            "nothing: they cost a start half a millisecond, and go with the domain's next cold start",
        ),
    });
    Ok(())
}

/// Whether a world is at work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Frames {
    Come,
    Paused,
    Missing,
}

/// The newest status of every process that lives, and whether frames come.
fn listen(watcher: &mut IoxWatcher) -> Result<(BTreeMap<u32, StatMsg>, Frames), Error> {
    let until = Instant::now() + LISTENING;
    let mut statuses = BTreeMap::new();
    let (mut first, mut frames) = (None, Frames::Missing);
    while Instant::now() < until {
        watcher.receive_statuses(&mut |status| {
            if status.has(StatMsg::BYE) {
                statuses.remove(&status.pid);
            } else {
                statuses.insert(status.pid, *status);
            }
        })?;
        if let Some(frame) = watcher.newest_frame()? {
            let is_later = frame.tick > *first.get_or_insert(frame.tick);
            if frame.is_pause {
                frames = Frames::Paused;
            } else if is_later {
                frames = Frames::Come;
            }
        }
        std::thread::sleep(LOOK_EVERY);
    }
    // The dead told of themselves as well: their last status stays.
    let now_ns = MonotonicClock.now_ns();
    statuses.retain(|_, status| lives(status, now_ns));
    Ok((statuses, frames))
}

/// Whether a process is there; of one on another host: whether it was heard a while ago.
fn lives(status: &StatMsg, now_ns: u64) -> bool {
    let HostProcess { host, pid } = HostProcess::of(status.pid);
    match host {
        0 => Path::new("/proc").join(pid.to_string()).exists(),
        _ => now_ns.saturating_sub(status.t_ns) < FAR_SILENCE_NS,
    }
}

fn is_told_by_world(statuses: &BTreeMap<u32, StatMsg>) -> bool {
    statuses.values().any(|status| status.role == Role::World as u8)
}

/// How long nothing may be heard of a process on another host, which tells of itself ten times a second.
const FAR_SILENCE_NS: u64 = 500_000_000;
/// Index of missed wake-ups in the counters of a status.
const MISSED_WAKE_UPS: usize = 10;
/// Index of the longest time that a frame of a world came after it was due.
const LONGEST_DELAY_NS: usize = 14;
/// Index of the periods that a world skipped.
const SKIPPED_PERIODS: usize = 15;

/// What a process has done; a supervisor takes no part in ticks.
fn ticks(role: &str, status: &StatMsg, missed: u64) -> String {
    let [ticks, late] = [status.counters[0], status.counters[2]];
    if role == Role::Supervisor.name() {
        return String::new();
    }
    let told = format!(", {ticks} ticks, {late} late, {missed} lost wake-ups");
    match status.counters.get(LONGEST_DELAY_NS) {
        Some(&delay_ns) if delay_ns > 0 => {
            let (delay_ms, skipped) = (delay_ns as f64 / 1e6, skipped_periods(status));
            told + &format!(", frames up to {delay_ms:.1} ms after due, {skipped} periods skipped")
        }
        _ => told,
    }
}

fn skipped_periods(status: &StatMsg) -> u64 {
    status.counters.get(SKIPPED_PERIODS).copied().unwrap_or(0)
}

/// What runs its network, where that is no plan.
fn engine(status: &StatMsg) -> &'static str {
    match status.has(StatMsg::GRAPH) {
        true => ", runs the graph: allocates, no promise about bits or time",
        false => "",
    }
}

fn examine_process(status: &StatMsg) -> Finding {
    let role = Role::from_number(status.role).map_or("process", Role::name);
    let is_allocator = status.role == Role::Allocator as u8;
    let leads = if is_allocator && status.has(StatMsg::LEADER) { ", leads" } else { "" };
    let model = match status.model {
        // A world has none.
        [0, 0, 0, 0, ..] => String::new(),
        [a, b, c, d, ..] => format!(", model {a:02x}{b:02x}{c:02x}{d:02x}"),
    };
    let missed = status.counters.get(MISSED_WAKE_UPS).copied().unwrap_or(0);
    let found = format!(
        "{role} {}{leads}{model}{}{}, version {}",
        HostProcess::of(status.pid),
        engine(status),
        ticks(role, status, missed),
        version(status.build)
    );
    if status.has(StatMsg::DEGRADED) {
        let advice = "look at the allocators: agents act without an allocation";
        return Finding::new(Severity::Warning, "process", found, advice);
    }
    if status.role == Role::World as u8 && skipped_periods(status) > 0 {
        let advice =
            "look what stops it or keeps the machine busy, or lower its rate: periods were skipped";
        return Finding::new(Severity::Warning, "process", found, advice);
    }
    if missed == 0 {
        return Finding::fine("process", found);
    }
    Finding::new(
        Severity::Warning,
        "process",
        found,
        "expected only where a process was killed; otherwise please report it",
    )
}

/// Who acts for every agent. A seat that is held by a process that tells nothing is taken all the same.
fn examine_seats(
    membership: &Membership,
    statuses: &BTreeMap<u32, StatMsg>,
    agents: u64,
) -> Result<Finding, Error> {
    let runners = statuses.values().filter(|status| status.role == Role::Runner as u8);
    let missing = agents & !runners.fold(0, |seats, status| seats | status.agents);
    if missing == 0 {
        return Ok(Finding::fine("seats", "a process acts for every agent"));
    }
    let (mut free, mut silent, mut holders) = (Vec::new(), Vec::new(), BTreeSet::new());
    for agent in (0..u64::BITS).filter(|agent| missing >> agent & 1 == 1) {
        match membership.holder_of(Role::Runner, 1 << agent)? {
            None => free.push(agent.to_string()),
            Some(pid) => {
                silent.push(agent.to_string());
                holders.insert(pid.to_string());
            }
        }
    }
    let (found, advice) = if free.is_empty() {
        let holders = Vec::from_iter(holders).join(", ");
        (
            format!(
                "process {holders} has the seats of agents {}, and is silent",
                silent.join(", ")
            ),
            "look whether it is stopped, and let it go on or end it: then another can take its place; where it stands for another \
             host, whether `sortie join` runs there",
        )
    } else {
        (
            format!("nobody acts for agents {}", free.join(", ")),
            "start a runner: `sortie process runner BUNDLE --domain ID --agents …`",
        )
    };
    Ok(Finding::new(Severity::Problem, "seats", found, advice))
}

/// Whom the world takes for absent; nothing where no world answers.
fn examine_absent(membership: &Membership, facts: &DomainFacts) -> Result<Option<Finding>, Error> {
    let answers = team_info(membership, facts)?;
    let world = answers.iter().find(|answer| answer.process.role == Role::World);
    Ok(world.map(|Answer { process, tick, .. }| {
        if process.absent == 0 {
            return Finding::fine("absent agents", "none");
        }
        let agents = (0..u64::BITS).filter(|agent| process.absent >> agent & 1 == 1);
        let agents = agents.map(|agent| agent.to_string()).collect::<Vec<_>>();
        let first = if agents.len() > 1 { "the first " } else { "" };
        let since = match process.absent_since {
            0 => "from the beginning".to_string(),
            since => {
                let (since, ago) = (since as u32, tick.saturating_sub(since));
                format!("since tick {since}, {ago} ticks ago")
            }
        };
        let agents = agents.join(", ");
        Finding::new(
            Severity::Warning,
            "absent agents",
            format!(
                "{agents}, {first}{since}: left out of allocations, since nobody acts for them"
            ),
            "start a runner: they are counted on again as soon as it acts",
        )
    }))
}

fn examine_allocators(statuses: &BTreeMap<u32, StatMsg>, has_allocation: bool) -> Finding {
    let is_allocator = |status: &&StatMsg| status.role == Role::Allocator as u8;
    let allocators = statuses.values().filter(is_allocator).count();
    let leaders =
        statuses.values().filter(is_allocator).filter(|status| status.has(StatMsg::LEADER));
    match (leaders.count(), allocators) {
        (0, 0) if !has_allocation => {
            Finding::fine("allocator", "none: there is nothing to allocate")
        }
        (0, _) => Finding::new(
            Severity::Problem,
            "allocator",
            "none leads; agents act on their last allocation, then without",
            "start one: `sortie process allocator BUNDLE --domain ID`",
        ),
        (_, 1) => Finding::new(
            Severity::Warning,
            "allocator",
            "one leads, none stands by",
            "start another: `sortie process allocator BUNDLE --domain ID`",
        ),
        (_, count) => Finding::fine("allocator", format!("one leads, {} stand by", count - 1)),
    }
}

/// How bad a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Severity {
    /// As it should be.
    Fine,
    /// Works, but is worth a look.
    Warning,
    /// Something will not work.
    Problem,
}

/// One thing that was looked at.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// What was looked at.
    pub check: &'static str,
    /// How bad it is.
    pub severity: Severity,
    /// What was found.
    pub found: String,
    /// What to do about it; empty where nothing is to be done.
    pub advice: &'static str,
}

impl Finding {
    fn new(
        severity: Severity,
        check: &'static str,
        found: impl Into<String>,
        advice: &'static str,
    ) -> Self {
        Self { check, severity, found: found.into(), advice }
    }

    fn fine(check: &'static str, found: impl Into<String>) -> Self {
        Self::new(Severity::Fine, check, found, "")
    }

    /// What a check came to.
    fn of(
        check: &'static str,
        result: Result<(), Error>,
        fine: &str,
        advice: &'static str,
    ) -> Self {
        match result {
            Ok(()) => Self::fine(check, fine),
            Err(error) => Self::new(Severity::Problem, check, error.to_string(), advice),
        }
    }
}

/// Looks at the policy that is served in a domain, if one was. Returns whether that is so.
fn examine_served(membership: &Membership, findings: &mut Vec<Finding>) -> Result<bool, Error> {
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
        "enough",
        "remove what fills /dev/shm, or enlarge it: `mount -o remount,size=64m /dev/shm`",
    ));
    let mut watcher = {
        let _starting = membership.lock_start()?;
        ServedWatcher::open(&ServedSetup { domain, format, linger: Duration::ZERO })?
    };
    let heard = listen_to_server(&mut watcher)?;
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
fn listen_to_server(watcher: &mut ServedWatcher) -> Result<Option<(StatMsg, StatMsg)>, Error> {
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
