//! An episode of SaveTheCity as a page.

mod capture;
mod values;

use std::path::Path;

use serde::Serialize;
use sortie_envs::save_the_city::golden::Playback;
use sortie_envs::save_the_city::{ACTION_NAMES, ENTRY, SIDE};
use sortie_envs::{DecisionPoints, Split};
use sortie_learn::LearnError;
use sortie_learn::play::watch;
use sortie_learn::subtasks::{
    Agents, Allocate, AllocatedScene, AllocatedTeam, NoSubtasks, PolicyAgents, ScriptedAgents,
};
use sortie_stage::save_the_city::{
    AgentFacts, BuildingFacts, EpisodeResult, Event, Names, State, Step,
};

use crate::allocation::{Allocation, AllocatorChoice};
use crate::allocator::ProposalArguments;
use crate::environment;
use crate::failure::{Exit, Failure};
use crate::policy::{Backend, DeployedPolicy};
use crate::subject::{self, Subject, SubjectAllocator};
use crate::views::captured::noted;
use crate::views::page::{Deeds, FORMAT, Web, html, script, style};
use crate::views::{Page, Wanted};
use capture::{Captured, capture, open_recording, play_again};
use values::TeamValueProbe;

pub(super) const WEB: Web = Web {
    styles: &[
        include_str!("web/colours.css"),
        style::BASICS,
        include_str!("web/focus.css"),
        style::LAYOUT,
        include_str!("web/desk.css"),
        style::RESULT,
        include_str!("web/map.css"),
        style::PLAYBACK,
        style::LANES,
        include_str!("web/timeline.css"),
        style::AGENT,
        include_str!("web/buildings.css"),
        style::DIALOG,
    ],
    map: "Map",
    panels: include_str!("web/panels.html"),
    scripts: &[
        include_str!("web/status.js"),
        script::SUMS,
        include_str!("web/entities.js"),
        script::NUMBERS,
        script::ELEMENTS,
        script::ACTS,
        include_str!("web/signs.js"),
        include_str!("web/map.js"),
        include_str!("web/agent.js"),
        include_str!("web/building.js"),
        script::LANES,
        include_str!("web/timeline.js"),
        script::PLAYER,
    ],
    deeds: Deeds {
        hint: "Drag an agent to another cell.",
        controls: include_str!("web/deeds.html"),
        keys: include_str!("web/keys.html"),
        script: include_str!("web/deeds.js"),
    },
};

/// The page of an episode that the subject plays.
pub(super) fn played(wanted: &Wanted<'_>, subject: &Subject) -> Result<Page, Failure> {
    let set = wanted.set.clone().unwrap_or_default();
    let (number, seed) = (wanted.episode, wanted.seed);
    let environment = subject.open(&set)?;
    let draws = (ProposalArguments::default(), seed);
    let (allocation, mut allocator) = subject::open_for(
        (subject, set.entry()),
        wanted.allocation,
        subject,
        &wanted.subject.to_string_lossy(),
        Backend::Plan,
        draws,
    )?;
    let (probe, interval) = (TeamValueProbe::of(subject)?, subject.interval());
    let captured = think(Some(subject), seed, allocator.allocator()?, |team| {
        capture(team, probe, interval, |team, steps| {
            // As evaluations number them.
            let mut world = environment.open(1, Split::Test);
            watch(&mut *world, team, number..number + 1, seed, steps)?;
            Ok(())
        })
    })?;
    let mut notes = Vec::new();
    if matches!(subject, Subject::Scripted) {
        notes.push("The scripted low level has no network: no utilities, no attention.".into());
    }
    Ok(page(&Data {
        allocation: Some(allocation.into()),
        env: set.to_string(),
        episode: Some((seed, number)),
        notes,
        ..data_of(wanted.name(), captured)
    }))
}

/// The page of a recorded episode.
pub(super) fn recorded(wanted: &Wanted<'_>, text: &str) -> Result<Page, Failure> {
    let file = wanted.subject;
    let asked = wanted.allocation.map(AllocatorChoice::name);
    match (asked, wanted.policy) {
        (Some("random"), _) => {
            return Err(usage("a random allocation cannot be computed again from a recording"));
        }
        (Some("learned"), None) => {
            return Err(usage("name the team that learned to allocate: --policy RUN or BUNDLE"));
        }
        _ => {}
    }
    let mut playback = open_recording(file, text)?;
    let policy = wanted.policy;
    let subject = policy.map(Subject::find).transpose()?;
    let world = playback.world();
    if let Some(Subject::Bundle(bundle)) = &subject {
        let spec = sortie_envs::Environment::spec(world);
        environment::check_spec(bundle, spec, &world.scenario_set().name)?;
    }
    let env = format!("{}/{}", ENTRY.name, world.scenario_set().name);
    let choice = wanted.allocation.or_else(|| {
        let is_learned = subject.as_ref().is_some_and(Subject::has_allocator);
        let labelled = of_label(&playback.labels().policy);
        labelled.filter(|choice| *choice != AllocatorChoice::Learned || is_learned)
    });
    let name = playback.labels().name.clone();
    let notes = notes_on_recording(&playback, choice, policy);
    let open = |choice| {
        let owner = policy.unwrap_or(file).to_string_lossy();
        let draws = (ProposalArguments::default(), wanted.seed);
        SubjectAllocator::open(choice, subject.as_ref(), &owner, Backend::Plan, draws)
    };
    let mut allocator = choice.map(open).transpose()?;
    let allocator: Box<dyn Allocate + '_> = match &mut allocator {
        Some(allocator) => allocator.allocator()?,
        None => Box::new(NoSubtasks),
    };
    let probe = subject.as_ref().map(TeamValueProbe::of).transpose()?.flatten();
    let interval = interval_of(subject.as_ref());
    let captured = think(subject.as_ref(), wanted.seed, allocator, |team| {
        capture(team, probe, interval, |team, steps| play_again(&mut playback, team, steps))
    })?;
    Ok(page(&Data {
        allocation: choice.map(|choice| choice.name().into()),
        env,
        notes,
        ..data_of(name, captured)
    }))
}

fn page(data: &Data) -> Page {
    Page { html: html(&WEB, data), steps: data.steps.len() }
}

fn notes_on_recording(
    playback: &Playback,
    choice: Option<AllocatorChoice>,
    policy: Option<&Path>,
) -> Vec<String> {
    let acting = &playback.labels().policy;
    let mut notes = vec![format!("A recording of: {acting}.")];
    notes.push(match choice {
        Some(choice) => {
            format!("Recordings hold no allocation; here it is computed again: {}.", choice.name())
        }
        None => {
            "The recording does not say who was assigned where; --allocation RULE adds a rule's \
                 allocation."
                .into()
        }
    });
    notes.push(match policy {
        Some(policy) => {
            let policy = policy.display();
            format!("Utilities and attention are what {policy} computes in the recorded states.")
        }
        None => "No network was given: --policy RUN or BUNDLE adds what it computes.".into(),
    });
    notes
}

/// Sets up who is asked, for as long as `watch` lasts.
fn think(
    subject: Option<&Subject>,
    seed: u64,
    allocator: Box<dyn Allocate + '_>,
    watch: impl FnOnce(AllocatedTeam<'_>) -> Result<Captured, Failure>,
) -> Result<Captured, Failure> {
    let interval = interval_of(subject);
    let agents: Box<dyn Agents + '_> = match subject {
        Some(Subject::Bundle(bundle)) => {
            let mut deployed = DeployedPolicy::open(bundle, Backend::Plan)?;
            let mut thoughts = Vec::new();
            let policy = noted(bundle, deployed.policy()?, &mut thoughts)?;
            let agents = Box::new(PolicyAgents::new(policy));
            let mut captured = watch(AllocatedTeam::new(agents, allocator, interval))?;
            captured.give_thoughts(thoughts);
            return Ok(captured);
        }
        Some(Subject::Run(run)) => {
            let agents = run.method.subtasks().map(|subtasks| subtasks.agents);
            let captured =
                watch(AllocatedTeam::new(agents.ok_or_else(unmasked)?, allocator, interval))?;
            let is_told = captured.states.first().is_some_and(|state| state.thoughts.is_some());
            return if is_told { Ok(captured) } else { Err(unmasked()) };
        }
        Some(Subject::Scripted) => Box::new(ScriptedAgents::new(seed)),
        None => Box::new(Nobody),
    };
    watch(AllocatedTeam::new(agents, allocator, interval))
}

fn interval_of(subject: Option<&Subject>) -> u32 {
    subject.map_or(DecisionPoints::ACTION_LENGTH, Subject::interval)
}

/// Whom agents attend to is known where the subtask mask is all that they see.
fn unmasked() -> Failure {
    usage(
        "the agents of this run do not act under the subtask mask; only \
         such agents can be viewed",
    )
}

/// Agents that are not asked.
struct Nobody;

impl Agents for Nobody {
    fn act(&mut self, _: &[AllocatedScene<'_>], _: &mut [u16], _: usize) -> Result<(), LearnError> {
        Ok(())
    }
}

fn data_of(subject: String, captured: Captured) -> Data {
    let Captured { agents, buildings, states, steps, result } = captured;
    let events = Names { agents: &agents, buildings: &buildings }.events(&states);
    Data {
        format: FORMAT,
        subject,
        allocation: None,
        env: String::new(),
        episode: None,
        notes: Vec::new(),
        side: SIDE,
        actions: &ACTION_NAMES,
        agents,
        buildings,
        states,
        steps,
        events,
        result,
    }
}

fn usage(message: &str) -> Failure {
    Failure::new(Exit::Usage, message)
}

/// Who allocated in a recording of `sortie eval --episodes-out`, by its label, where that can be
/// computed again: random choices are lost.
fn of_label(policy: &str) -> Option<AllocatorChoice> {
    let (_, allocation) = policy.rsplit_once(", ")?;
    let name = allocation.strip_suffix(" allocation")?;
    match name {
        "learned" => Some(AllocatorChoice::Learned),
        "random" => None,
        rule => Allocation::named(rule).ok().map(AllocatorChoice::Rule),
    }
}

#[derive(Debug, Serialize)]
struct Data {
    format: u32,
    /// What was viewed: a run, a bundle, `scripted` or the name of a recording.
    subject: String,
    /// Who assigned agents; `None` where a recording does not say.
    allocation: Option<String>,
    /// `ENV/SET`.
    env: String,
    /// Seed and number of a played episode.
    episode: Option<(u64, usize)>,
    /// What the reader must know about where figures come from.
    notes: Vec<String>,
    side: u8,
    actions: &'static [&'static str],
    agents: Vec<AgentFacts>,
    buildings: Vec<BuildingFacts>,
    /// One more than steps: the last one is final.
    states: Vec<State>,
    steps: Vec<Step>,
    events: Vec<Event>,
    result: EpisodeResult,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_of_own_recordings_name_who_allocated() {
        let name = |label| of_label(label).map(AllocatorChoice::name);
        assert_eq!(name("runs/a, b, heuristic allocation"), Some("heuristic"));
        assert_eq!(name("scripted, coordinated allocation"), Some("coordinated"));
        assert_eq!(name("runs/a, learned allocation"), Some("learned"));
        for unknown in ["scripted, random allocation", "a, planned from learned allocation", "a"] {
            assert_eq!(name(unknown), None);
        }
    }
}
