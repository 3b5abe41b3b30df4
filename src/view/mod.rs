//! `sortie view`: one episode as a page to look at, step by step.

mod allocator;
mod capture;
mod data;
mod episode;
mod events;
mod mind;
mod page;
mod value_networks;
mod values;

use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;
use sortie_envs::save_the_city::golden::Playback;
use sortie_envs::save_the_city::{ACTION_NAMES, DecisionPoints, SIDE, SaveTheCity};
use sortie_learn::LearnError;
use sortie_learn::evaluate::{Allocate, EvaluationPlan, Scene, ScriptedActors, Team};
use sortie_learn::methods::alma::{Conditioning, NetworkPolicy};

use crate::allocation::AllocatorChoice;
use crate::environment;
use crate::failure::{Exit, Failure, Outcome};
use crate::files::{Kind, try_output, write_output};
use crate::options::Common;
use crate::output::{plural, print_json, say};
use crate::policy::{Backend, DeployedPolicy};
use crate::proposals::ProposalArguments;
use crate::subject::Subject;
use crate::subject_allocator::{self, SubjectAllocator};
use capture::{Captured, Thinker, capture};
use data::Page;
use episode::{Played, Replayed, open_recording};
use mind::DeployedMind;
use values::TeamValueProbe;

/// Look at one episode: where everybody is, who is assigned where, what each agent computes
///
/// SUBJECT is a training run, a bundle, `scripted`, or a recorded episode (`sortie eval
/// --episodes-out`). The page is one HTML file that needs nothing else and works offline.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie view models/save-the-city -o episode.html --episode 7
  sortie view episodes/00007.json --policy runs/first -o episode.html")]
pub(crate) struct ViewArguments {
    /// A training run, a bundle, `scripted`, or the file of a recorded episode
    subject: PathBuf,
    /// The page to write
    #[arg(short, long, value_name = "FILE.html")]
    output: PathBuf,
    /// Number of the episode to play, as `sortie eval --episodes-out` counts them; default: 0
    #[arg(long, value_name = "N")]
    episode: Option<u32>,
    /// Environment and scenario set; default: those of the subject
    #[arg(long, value_name = "ENV[/SET]")]
    env: Option<String>,
    /// Who assigns agents to subtasks [default: learned where the subject has it, else coordinated;
    /// for a recording what its label says]
    #[arg(long, value_enum)]
    allocation: Option<AllocatorChoice>,
    /// Show what this run or bundle computes in a recorded episode
    #[arg(long, value_name = "RUN|BUNDLE", visible_aliases = ["run", "bundle"])]
    policy: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

#[derive(Serialize)]
struct Report<'a> {
    file: &'a Path,
    steps: usize,
}

pub(crate) fn run(arguments: &ViewArguments) -> Outcome {
    let file = &arguments.output;
    try_output(file, Kind::Page)?;
    let subject = arguments.subject.as_path();
    let page = if subject.is_file() {
        recorded_page(arguments, subject)?
    } else {
        played_page(arguments)?
    };
    write_output(file, page::html(&page).as_bytes())?;
    let report = Report { file, steps: page.steps.len() };
    if arguments.common.json {
        print_json(&report);
    } else {
        say!("{}: {}", file.display(), plural(report.steps, "step"));
    }
    Ok(())
}

fn played_page(arguments: &ViewArguments) -> Result<Page, Failure> {
    if arguments.policy.is_some() {
        return Err(usage("--policy is for recorded episodes; name the run or bundle itself"));
    }
    let subject = Subject::find(&arguments.subject)?;
    let set = subject.scenario_set(arguments.env.as_deref())?;
    let number = arguments.episode.unwrap_or(0) as usize;
    let plan = EvaluationPlan::new(set.set(), number + 1, arguments.common.seed)?;
    if let Subject::Bundle(bundle) = &subject {
        environment::check_fits(bundle, &plan.set)?;
    }
    let draws = (ProposalArguments::default(), arguments.common.seed);
    let (allocation, mut allocator) = subject_allocator::open_for(
        &subject,
        arguments.allocation,
        &subject,
        &arguments.subject.to_string_lossy(),
        Backend::Plan,
        draws,
    )?;
    let mut allocator = allocator.allocator()?;
    let mut played = Played { plan: &plan, allocator: allocator.as_mut() };
    let probe = TeamValueProbe::of(&subject)?;
    let captured = think(Some(&subject), arguments.common.seed, |thinker| {
        capture(&mut played, thinker, probe, plan.interval)
    })?;
    let mut notes = Vec::new();
    if matches!(subject, Subject::Scripted) {
        notes.push("The scripted low level has no network: no utilities, no attention.".into());
    }
    Ok(Page {
        allocation: Some(allocation.into()),
        env: set.to_string(),
        episode: Some((arguments.common.seed, number)),
        notes,
        ..page_of(arguments.subject.display().to_string(), captured)
    })
}

fn recorded_page(arguments: &ViewArguments, file: &Path) -> Result<Page, Failure> {
    if arguments.episode.is_some() || arguments.env.is_some() {
        return Err(usage("--episode and --env choose what is played, but this is a recording"));
    }
    match (arguments.allocation, &arguments.policy) {
        (Some(AllocatorChoice::Random), _) => {
            return Err(usage("a random allocation cannot be computed again from a recording"));
        }
        (Some(AllocatorChoice::Learned), None) => {
            return Err(usage("name the team that learned to allocate: --policy RUN or BUNDLE"));
        }
        _ => {}
    }
    let mut playback = open_recording(file)?;
    let subject = arguments.policy.as_deref().map(Subject::find).transpose()?;
    let world = playback.world();
    if let Some(Subject::Bundle(bundle)) = &subject {
        environment::check_fits(bundle, world.scenario_set())?;
    }
    let env = environment_of(world);
    let policy = arguments.policy.as_deref();
    let choice = arguments.allocation.or_else(|| {
        let is_learned = subject.as_ref().is_some_and(Subject::has_allocator);
        let labelled = allocator::of_label(&playback.labels().policy);
        labelled.filter(|choice| *choice != AllocatorChoice::Learned || is_learned)
    });
    let name = playback.labels().name.clone();
    let notes = notes_on_recording(&playback, choice, policy);
    let open = |choice| {
        let owner = policy.unwrap_or(&arguments.subject).to_string_lossy();
        let draws = (ProposalArguments::default(), arguments.common.seed);
        SubjectAllocator::open(choice, subject.as_ref(), &owner, Backend::Plan, draws)
    };
    let mut allocator = choice.map(open).transpose()?;
    let mut allocator = allocator.as_mut().map(SubjectAllocator::allocator).transpose()?;
    let allocator = allocator.as_mut().map(|allocator| allocator.as_mut() as &mut dyn Allocate);
    let mut replayed = Replayed { playback: &mut playback, allocator };
    let probe = subject.as_ref().map(TeamValueProbe::of).transpose()?.flatten();
    let captured = think(subject.as_ref(), arguments.common.seed, |thinker| {
        capture(&mut replayed, thinker, probe, DecisionPoints::ACTION_LENGTH)
    })?;
    Ok(Page {
        allocation: choice.map(|choice| choice.name().into()),
        env,
        notes,
        ..page_of(name, captured)
    })
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

fn environment_of(world: &SaveTheCity) -> String {
    format!("save-the-city/{}", world.scenario_set().name)
}

/// Sets up who is asked, for as long as `watch` lasts.
fn think(
    subject: Option<&Subject>,
    seed: u64,
    watch: impl FnOnce(Thinker<'_>) -> Result<Captured, Failure>,
) -> Result<Captured, Failure> {
    match subject {
        Some(Subject::Run(run)) => {
            if run.description.config.subtask() != Conditioning::Mask {
                return Err(usage(
                    "the agents of this run do not act under the subtask mask; only \
                                  such agents can be viewed",
                ));
            }
            watch(Thinker::Mind(&mut NetworkPolicy::new(&run.network)))
        }
        Some(Subject::Bundle(bundle)) => {
            let mut deployed = DeployedPolicy::open(bundle, Backend::Plan)?;
            let mut mind = DeployedMind::new(bundle, deployed.policy()?)?;
            watch(Thinker::Mind(&mut mind))
        }
        Some(Subject::Scripted) => watch(Thinker::Silent(&mut ScriptedActors::new(seed))),
        None => watch(Thinker::Silent(&mut Nobody)),
    }
}

/// A team that is not asked.
struct Nobody;

impl Team for Nobody {
    fn act(&mut self, _: &[Scene<'_>], _: &mut [u16], _: usize) -> Result<(), LearnError> {
        Ok(())
    }
}

fn page_of(subject: String, captured: Captured) -> Page {
    let events = events::events(&captured);
    let Captured { agents, buildings, states, steps, result } = captured;
    Page {
        format: data::FORMAT,
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
