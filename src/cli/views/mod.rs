//! What is shown of episodes: pages of teams that have played, and of teams that play.
//!
//! Environments are shown by their pictures; the rest of the command line knows them by their names alone.

mod figures;
mod live;
pub(crate) mod probes;
mod save_the_city;

use std::path::Path;

pub(crate) use figures::{figures, outcome};
pub(crate) use live::{Hashes, Live, live};
use sortie_bundle::Bundle;
use sortie_envs::{DecisionPoints, ENVIRONMENTS, Environment, Split, golden};
use sortie_learn::subtasks::{
    Agents, Allocate, AllocatedScene, AllocatedTeam, AllocatorNetworks, LearnedAllocator,
    PolicyAgents, ScriptedAgents,
};
use sortie_learn::{Act, LearnError};
use sortie_pages::{Captured, Heading, TeamLog, page, play, play_deployed};

use crate::allocation::AllocatorChoice;
use crate::allocator::ProposalArguments;
use crate::environment::{ScenarioSetName, check_fits, scripted};
use crate::failure::{Exit, Failure};
use crate::methods::{LearnedMethod, choose};
use crate::policy::{Backend, DeployedPolicy};
use crate::replay;
use crate::subject::{self, Subject};
use probes::{thinking_aloud, values_of};

pub use live::{PAGE_PROGRAM, cast};

/// Which episode is wanted as a page.
#[derive(Debug)]
pub(crate) struct Wanted<'a> {
    /// Where the page goes by the command line's words: a run, a bundle, `scripted` or a recording.
    pub(crate) subject: &'a Path,
    /// What is played instead of what the subject was made for.
    pub(crate) env: Option<&'a str>,
    pub(crate) episode: usize,
    pub(crate) seed: u64,
    pub(crate) allocation: Option<AllocatorChoice>,
    /// Whose thoughts are shown in a recording.
    pub(crate) policy: Option<&'a Path>,
}

impl Wanted<'_> {
    /// What a page calls its subject: who gets the page sent need not know the folders above.
    fn name(&self) -> String {
        last_name(self.subject)
    }

    fn heading(&self, env: String) -> Heading {
        let episode = Some((self.seed, self.episode));
        Heading { subject: self.name(), env, episode, ..Heading::default() }
    }
}

fn last_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// The page of an episode.
pub(crate) struct Page {
    pub(crate) html: String,
    pub(crate) steps: usize,
}

impl Page {
    fn new(heading: &Heading, captured: &Captured) -> Self {
        Self { html: page(heading, captured), steps: captured.steps.len() }
    }
}

/// The page of an episode that the subject plays.
pub(crate) fn played(wanted: &Wanted<'_>) -> Result<Page, Failure> {
    let subject = Subject::find(wanted.subject)?;
    if let Subject::Run(learned) = &subject
        && learned.method.subtasks().is_none()
    {
        return of_run(wanted, learned);
    }
    let set = subject.scenario_set(wanted.env)?;
    let has_subtasks = match &subject {
        Subject::Scripted => set.has_subtasks()?,
        Subject::Bundle(_) => subject.has_subtasks(),
        Subject::Run(_) => true,
    };
    if has_subtasks {
        return allocated(wanted, &subject, &set);
    }
    if let Some(asked) = wanted.allocation {
        return Err(asked.of_no_use());
    }
    let mut heading = wanted.heading(set.to_string());
    let captured = match &subject {
        Subject::Bundle(bundle) => deployed(wanted, bundle, &set)?,
        _ => {
            heading
                .notes
                .push("The scripted team has no network: no utilities, no attention.".into());
            let world = set.open(Split::Test)?;
            watched(wanted, &*world, &mut scripted(&set, &*world, wanted.seed)?)?
        }
    };
    Ok(Page::new(&heading, &captured))
}

/// The page of a run whose agents have no subtasks.
fn of_run(wanted: &Wanted<'_>, learned: &LearnedMethod) -> Result<Page, Failure> {
    if let Some(asked) = wanted.allocation {
        return Err(asked.of_no_use());
    }
    let mut choice = learned.description.config.environment.clone();
    if let Some(name) = wanted.env {
        choose(&mut choice, name)?;
    }
    let world = learned.open_as(&choice)?;
    let captured = watched(wanted, &*world, &mut *learned.method.team())?;
    let mut heading = wanted.heading(choice.to_string());
    if !captured.is_told() {
        heading.notes.push("Utilities and attention are shown of bundles: export the run.".into());
    }
    Ok(Page::new(&heading, &captured))
}

/// Has a team play whose agents nobody allocates.
fn watched(
    wanted: &Wanted<'_>,
    world: &dyn Environment,
    team: &mut dyn Act,
) -> Result<Captured, Failure> {
    let log = TeamLog::new(team, u32::MAX, None);
    Ok(play(world, wanted.seed, wanted.episode, log)?)
}

/// The episode of a bundle whose agents nobody allocates, each in a process.
fn deployed(
    wanted: &Wanted<'_>,
    bundle: &Bundle,
    set: &ScenarioSetName,
) -> Result<Captured, Failure> {
    check_fits(bundle, set)?;
    let cast = cast(bundle, set)?;
    play_deployed(&cast, wanted.seed, wanted.episode)
        .map_err(|error| Failure::new(Exit::BadData, error.to_string()))
}

/// The page of a team whose agents are assigned to subtasks.
fn allocated(
    wanted: &Wanted<'_>,
    subject: &Subject,
    set: &ScenarioSetName,
) -> Result<Page, Failure> {
    let environment = subject.open(set)?;
    let (name, draws) =
        (wanted.subject.to_string_lossy(), (ProposalArguments::default(), wanted.seed));
    let team = (subject, set.entry());
    let (allocation, mut allocator) =
        subject::open_for(team, wanted.allocation, subject, &name, Backend::Plan, draws)?;
    let captured = think(Some(subject), wanted.seed, allocator.allocator()?, |team| {
        let log: TeamLog<'_, dyn Act> = TeamLog::new(team, subject.interval(), values_of(subject)?);
        Ok(play(&*environment, wanted.seed, wanted.episode, log)?)
    })?;
    let mut heading = wanted.heading(set.to_string());
    heading.allocation = Some(allocation.into());
    if matches!(subject, Subject::Scripted) {
        heading
            .notes
            .push("The scripted low level has no network: no utilities, no attention.".into());
    }
    Ok(Page::new(&heading, &captured))
}

/// Sets up who is asked, for as long as `watch` lasts.
fn think(
    subject: Option<&Subject>,
    seed: u64,
    allocator: Box<dyn Allocate + '_>,
    watch: impl FnOnce(&mut AllocatedTeam<'_>) -> Result<Captured, Failure>,
) -> Result<Captured, Failure> {
    let interval = subject.map_or(DecisionPoints::ACTION_LENGTH, Subject::interval);
    let agents: Box<dyn Agents + '_> = match subject {
        Some(Subject::Bundle(bundle)) => {
            let mut deployed = DeployedPolicy::open(bundle, Backend::Plan)?;
            let mut thoughts = Vec::new();
            let mut captured = {
                let mut policy = thinking_aloud(bundle, deployed.policy()?, &mut thoughts)?;
                let agents = Box::new(PolicyAgents::new(&mut policy));
                watch(&mut AllocatedTeam::new(agents, allocator, interval))?
            };
            captured.give_thoughts(thoughts);
            return Ok(captured);
        }
        Some(Subject::Run(run)) => {
            let subtasks = run.method.subtasks().ok_or_else(unmasked)?;
            // Who points allocates agents that follow a script: they have nothing to tell.
            let pointing = |learned: &LearnedAllocator<'_>| {
                matches!(learned.networks, AllocatorNetworks::Pointing(_))
            };
            let tell_nothing = subtasks.allocator.as_ref().is_some_and(pointing);
            let captured = watch(&mut AllocatedTeam::new(subtasks.agents, allocator, interval))?;
            let is_told = tell_nothing || captured.is_told();
            return if is_told { Ok(captured) } else { Err(unmasked()) };
        }
        Some(Subject::Scripted) => Box::new(ScriptedAgents::new(seed)),
        None => Box::new(Nobody),
    };
    watch(&mut AllocatedTeam::new(agents, allocator, interval))
}

/// Whom agents attend to is known where the subtask mask is all that they see.
fn unmasked() -> Failure {
    let message =
        "the agents of this run do not act under the subtask mask; only such agents can be viewed";
    Failure::new(Exit::Usage, message)
}

/// Agents that are not asked.
struct Nobody;

impl Agents for Nobody {
    fn act(&mut self, _: &[AllocatedScene<'_>], _: &mut [u16], _: usize) -> Result<(), LearnError> {
        Ok(())
    }
}

/// The page of a recorded episode, given as text.
pub(crate) fn recorded(wanted: &Wanted<'_>, text: &str) -> Result<Page, Failure> {
    let file = wanted.subject.display();
    let entry =
        golden::environment(text).map_err(|error| replay::unreadable(error).within(&file))?;
    if entry.name == save_the_city::ENVIRONMENT {
        return save_the_city::recorded(wanted, text);
    }
    let message = format!(
        "`{file}` is a recording of an environment whose episodes can only be viewed as they are played"
    );
    Err(Failure::new(Exit::Usage, message))
}

/// Why a team does not play in a page.
pub(crate) fn not_live(wanted: &Wanted<'_>) -> Failure {
    let names: Vec<&str> = ENVIRONMENTS.iter().map(|entry| entry.name).collect();
    let message = format!(
        "`{}` cannot play in a page: --live takes bundles of {}, such as models/{}",
        wanted.subject.display(),
        names.join(", "),
        names[0]
    );
    Failure::new(Exit::Usage, message)
}
