//! Recorded episodes of SaveTheCity, which are played again for their page.

use std::path::Path;

use sortie_envs::save_the_city::ENTRY;
use sortie_envs::save_the_city::golden::{self, Playback};
use sortie_envs::{DecisionPoints, Environment};
use sortie_learn::play::{Onlooker, Watched};
use sortie_learn::random::{Purpose, generator};
use sortie_learn::subtasks::{Allocate, AllocatedTeam, NoSubtasks};
use sortie_learn::{Act, Ask, Scene, Scenes};
use sortie_pages::{Captured, Heading, StepLog, TeamLog};

use super::probes::values_of;
use super::{Page, Wanted, last_name, think};
use crate::allocation::{Allocation, AllocatorChoice};
use crate::allocator::ProposalArguments;
use crate::environment;
use crate::failure::{Exit, Failure};
use crate::policy::Backend;
use crate::replay;
use crate::subject::{Subject, SubjectAllocator};

/// The environment that is recorded so.
pub(super) const ENVIRONMENT: &str = ENTRY.name;

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
        environment::check_spec(bundle, world.spec(), &world.scenario_set().name)?;
    }
    let choice = wanted.allocation.or_else(|| {
        let is_learned = subject.as_ref().is_some_and(Subject::has_allocator);
        let labelled = of_label(&playback.labels().policy);
        labelled.filter(|choice| *choice != AllocatorChoice::Learned || is_learned)
    });
    let heading = Heading {
        subject: playback.labels().name.clone(),
        env: format!("{ENVIRONMENT}/{}", world.scenario_set().name),
        allocation: choice.map(|choice| choice.name().into()),
        notes: notes(&playback, choice, policy),
        ..Heading::default()
    };
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
    let probe = subject.as_ref().map(values_of).transpose()?.flatten();
    let interval = subject.as_ref().map_or(DecisionPoints::ACTION_LENGTH, Subject::interval);
    let captured = think(subject.as_ref(), wanted.seed, allocator, |team| {
        play_again(&mut playback, TeamLog::new(team, interval, probe))
    })?;
    Ok(Page::new(&heading, &captured))
}

fn notes(
    playback: &Playback,
    choice: Option<AllocatorChoice>,
    policy: Option<&Path>,
) -> Vec<String> {
    // Whoever gets the page sent need not know the folders above.
    let acting = playback.labels().policy.rsplit('/').next().unwrap_or_default();
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
    notes.push(match policy.map(last_name) {
        Some(policy) => {
            format!("Utilities and attention are what {policy} computes in the recorded states.")
        }
        None => "No network was given: --policy RUN or BUNDLE adds what it computes.".into(),
    });
    notes
}

/// Reads a recording and checks that it replays bit for bit.
fn open_recording(file: &Path, text: &str) -> Result<Playback, Failure> {
    let name = file.display().to_string();
    let unreadable = |error| replay::unreadable(error).within(&name);
    let replayed = golden::replay(&name, text).map_err(unreadable)?;
    match replayed.mismatches.first() {
        Some(first) => Err(replay::difference(first, replayed.mismatches.len())),
        None => Playback::new(text).map_err(unreadable),
    }
}

/// Goes through a recorded episode: its actions stand, whatever the team that is asked would do.
fn play_again(
    playback: &mut Playback,
    mut log: TeamLog<'_, AllocatedTeam<'_>>,
) -> Result<Captured, Failure> {
    fn watched(playback: &Playback) -> Watched<'_> {
        Watched { episode: 0, worlds: playback.world(), instance: 0 }
    }
    let mut steps = StepLog::default();
    steps.started(watched(playback))?;
    let mut state = Vec::new();
    let (mut begins, mut tasks_changed) = (true, false);
    // No allocator that can be asked again draws from it.
    let mut unused = [generator(0, Purpose::Evaluation, 0)];
    while let Some(actions) = playback.next_actions().map(<[u16]>::to_vec) {
        let environment: &dyn Environment = playback.world();
        state.clear();
        environment.save(0, &mut state);
        let scene = Scene { instance: 0, state: &state, begins, tasks_changed };
        let scenes = &Scenes { environment, scenes: &[scene] };
        let mut chosen = vec![0; environment.spec().shape.agents];
        log.act(Ask { scenes, random: &mut unused, actions: &mut chosen })?;
        log.team.did(0, &actions);
        let Some(outcome) = playback.step().map_err(Failure::bug)? else { break };
        steps.stepped(watched(playback), &actions, &outcome)?;
        (begins, tasks_changed) = (false, outcome.tasks_changed);
    }
    Ok(log.captured(steps))
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

fn usage(message: &str) -> Failure {
    Failure::new(Exit::Usage, message)
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
