//! `sortie why`: what an agent saw, wanted and was told when it decided.

use std::cell::{Cell, RefCell};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::Args;
use sortie_bundle::Bundle;
use sortie_core::choose::masked_argmax;
use sortie_core::wire::{ActionMsg, AllocMsg};
use sortie_core::{DecideError, Policy};
use sortie_ipc::{Domain, Heard};
use sortie_learn::draft::DecoratedPolicy;
use sortie_plans::AttentionProbe;
use sortie_stage::Thought;

use super::comparison::Comparison;
use super::contents::{Contents, Shown, Told};
use super::reasons::{Allocated, Reasons};
use super::roles::{Made, Roles};
use super::{Deployed, short_id};
use crate::deployment::open_bundle;
use crate::failure::{Exit, Failure, Outcome};
use crate::listener::Listener;
use crate::output::{Common, print_json, tell};
use crate::policy::{Backend, DeployedPolicy};
use crate::views::probes::{TeamNetwork, attention_of};

/// How many ticks after its frame an answer may still come.
const PATIENCE: u64 = 3;
/// The longest sleep between two looks at a running team.
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// How long a running team is listened to, which may have to begin an episode first.
const LISTEN_FOR: Duration = Duration::from_secs(60);

/// Tell why an agent of a team did what it did, in a record or just now
///
/// What it saw of itself, the utilities of all actions that it could take, whom it attended to, which subtask it acted for, and
/// what the allocator's network expected of every team then: its own subtask beside the others where it could have worked
/// instead. All of it is computed anew from the record, as `sortie remake` does, with the bits of the deployed network.
///
/// Without a record it is of a running team: of the agent's next decision that can be made again, which for one that remembers is
/// in the next episode. The team does not notice.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie why run.mcap --agent 3 --tick 812
  sortie why run.mcap --agent 0 --tick 17 --json
  sortie why --agent 3 --bundle models/save-the-city    # of a team that is up, now")]
pub(crate) struct WhyArguments {
    /// The record, as `sortie record` writes it
    #[arg(requires = "tick")]
    record: Option<PathBuf>,
    /// Agent that decided
    #[arg(long, value_name = "NUMBER")]
    agent: u16,
    /// Tick in which it did, as /tick of the record counts them
    #[arg(long, value_name = "NUMBER", requires = "record")]
    tick: Option<u32>,
    /// Bundle that decided [default: the one of those that the record brings along]
    #[arg(long, value_name = "FOLDER", required_unless_present = "record")]
    bundle: Option<PathBuf>,
    /// Domain of a running team
    #[arg(long, env = "SORTIE_DOMAIN", default_value = "default")]
    domain: String,
    #[command(flatten)]
    common: Common,
}

pub(crate) fn run(arguments: &WhyArguments) -> Outcome {
    let named = arguments.bundle.as_deref();
    let (contents, asked) = match &arguments.record {
        Some(record) => {
            let contents = Contents::read(record)?;
            let asked = Asked::find(&contents, arguments)?;
            (contents, asked)
        }
        None => overheard(arguments)?,
    };
    let bundles = contents.bundles(named)?;
    let decided = bundles.iter().find(|bundle| short_id(bundle) == asked.answer.model);
    let bundle = decided.ok_or_else(|| lacks("the bundle that decided"))?;
    let reasons = reasons(&contents, bundle, &asked)?;
    if arguments.common.json {
        print_json(&reasons);
    } else {
        reasons.print();
    }
    Ok(())
}

/// The answer that is asked about.
struct Asked {
    answer: ActionMsg,
    /// Its place among the record's runners.
    runner: usize,
}

impl Asked {
    /// The newest of this tick: ticks are counted anew where another world takes over.
    fn find(contents: &Contents, arguments: &WhyArguments) -> Result<Self, Failure> {
        let WhyArguments { agent, .. } = *arguments;
        let tick = arguments.tick.unwrap_or_default();
        let mut found = None;
        contents.replay(&mut |told| match told {
            Told::Action(it) if !it.has(ActionMsg::BYE) => {
                if it.agent == agent && it.tick as u32 == tick {
                    found = Some(it);
                }
            }
            Told::Action(_) | Told::Allocation(_) | Told::Frame(_) => {}
        })?;
        let answer = found.ok_or_else(|| {
            let message = format!("the record has no action of agent {agent} in tick {tick}");
            Failure::new(Exit::Missing, message)
        })?;
        Ok(Self::new(contents, answer))
    }

    fn new(contents: &Contents, answer: ActionMsg) -> Self {
        let runner = contents.runners.iter().position(|pid| *pid == answer.runner);
        Self { answer, runner: runner.unwrap_or_default() }
    }

    /// The allocation that it acted on, if this is it.
    fn its_allocation(&self, told: &Told) -> Option<AllocMsg> {
        let Self { answer, .. } = self;
        match told {
            Told::Allocation(it) if it.order() == (answer.alloc_term, answer.alloc_epoch) => {
                Some(*it)
            }
            _ => None,
        }
    }

    /// Whether what is told comes too late to have a part in the answer.
    fn is_over(&self, told: &Told) -> bool {
        let Self { answer, .. } = self;
        match told {
            Told::Action(it) => it.runner == answer.runner && it.tick > answer.tick,
            Told::Frame(it) => it.header.tick > answer.tick + PATIENCE,
            Told::Allocation(_) => false,
        }
    }
}

/// Listens to a running team until its agent has decided something that can be decided again.
fn overheard(arguments: &WhyArguments) -> Result<(Contents, Asked), Failure> {
    let WhyArguments { agent, bundle, domain, .. } = arguments;
    let remembers = match bundle {
        Some(folder) => {
            let bundle = open_bundle(folder)?;
            DeployedPolicy::open(&bundle, Backend::Plan)?.team()?.begin_episode()
        }
        None => false,
    };
    let mut listener = Listener::enter(&Domain::new(domain)?, "why")?;
    let mut contents = Contents::of_team(listener.facts(), &[])?;
    let (mut knows, began) = (!remembers, Instant::now());
    let answer = loop {
        let mut answer = None;
        listener.look(&mut |heard, _| {
            if let Heard::Action(it) = heard
                && it.agent == *agent
                && !it.has(ActionMsg::BYE)
            {
                knows |= it.has(ActionMsg::STATE_RESET);
                answer = answer.or(Some(*it).filter(|it| knows && contents.has_what_it_saw(it)));
            }
            contents.hear(heard);
        })?;
        if let Some(answer) = answer {
            break answer;
        }
        if listener.is_alone() || began.elapsed() > LISTEN_FOR {
            let message = format!("agent {agent} has decided nothing that can be decided again");
            return Err(Failure::new(Exit::Missing, message));
        }
        listener.wait(LOOK_EVERY);
    };
    let asked = Asked::new(&contents, answer);
    Ok((contents, asked))
}

/// Plays the record up to the answer, and has it given aloud.
fn reasons(contents: &Contents, bundle: &Bundle, asked: &Asked) -> Result<Reasons, Failure> {
    let mut deployed = Deployed::open_agents(contents, bundle)?;
    let features = usize::from(bundle.contract().features);
    // Whom it attended to is read from the graph, which takes more than what decides.
    let layers = attention_of(bundle).unwrap_or_else(|failure| {
        tell!("warning: whom it attended to is not known: {}", failure.message);
        None
    });
    let probe = layers.map(|layers| AttentionProbe::new(layers, features));
    let ear = Ear { is_open: Cell::new(false), probe, heard: RefCell::new(None) };
    let mut team = deployed.team()?;
    team.policies = team
        .policies
        .into_iter()
        .enumerate()
        .map(|(index, policy)| match index == asked.runner {
            true => aloud(policy, asked.answer.agent, &ear),
            false => policy,
        })
        .collect();
    let mut comparison = Comparison::default();
    let mut roles = Roles::new(contents, bundle, vec![team], &mut comparison)?;
    let (mut is_over, mut allocated) = (false, None);
    contents.replay(&mut |told| {
        is_over |= asked.is_over(&told);
        if is_over {
            return;
        }
        let its = asked.its_allocation(&told);
        roles.hear(told);
        if let Some((it, frame)) = its.and_then(|it| Some((it, roles.frame(it.tick)?))) {
            allocated = Some(worth(contents, bundle, (&it, frame), asked.answer.agent));
        }
    })?;
    let before = roles.made();
    ear.is_open.set(true);
    roles.answer(asked.answer.runner);
    is_known(before, roles.made())?;
    let frame = roles.frame(asked.answer.tick).ok_or_else(|| lacks("its frame"))?;
    let heard = ear.heard.borrow_mut().take();
    let view = frame.view(&contents.format)?;
    let allocated = allocated.transpose()?;
    Ok(Reasons::new(bundle.contract(), (&asked.answer, &view), heard, allocated))
}

fn lacks(what: &str) -> Failure {
    Failure::new(Exit::Missing, format!("the record lacks {what}"))
}

/// Whether the answer could be given again.
fn is_known(before: Made, made: Made) -> Outcome {
    let why_not = [
        (made.before_record > before.before_record, "its frame, or the allocation it acted on"),
        (made.of_engines > before.of_engines, "its network: it ran in an engine"),
        (made.without_memory > before.without_memory, "what it remembered from before"),
    ];
    match why_not.iter().find(|(is_so, _)| *is_so) {
        Some((_, what)) => Err(lacks(what)),
        None => Ok(()),
    }
}

/// What the team's network thinks of an allocation, whoever made it; the tasks alone where no network values teams.
fn worth(
    contents: &Contents,
    bundle: &Bundle,
    (allocation, frame): (&AllocMsg, &Shown),
    agent: u16,
) -> Result<Allocated, Failure> {
    let view = frame.view(&contents.format)?;
    let state = view.allocation_state();
    let values_teams = bundle.allocator_onnx().is_some();
    let mut network = values_teams.then(|| TeamNetwork::open(bundle)).transpose()?;
    let worth = network.as_mut().map(|network| -> Result<_, Failure> {
        let best = network.best(&state)?;
        Ok([network.worth(state, &allocation.task)?, network.worth(state, &best)?])
    });
    let worth = worth.transpose()?;
    let mut values = network.as_mut().map(|network| network.of_state(state)).transpose()?;
    let team_max = usize::from(bundle.manifest().limits.team_max);
    let judged = (values.as_deref_mut(), worth);
    Allocated::new(allocation, &state, (agent, team_max), judged)
        .map_err(|error| Failure::new(Exit::BadData, error.to_string()))
}

/// Hears what an agent thinks once it is open.
struct Ear {
    is_open: Cell<bool>,
    probe: Option<AttentionProbe>,
    /// What it thinks, or why its policy refuses.
    heard: RefCell<Option<Result<Thought, DecideError>>>,
}

/// A runner's policy, of one of whose agents thoughts are heard.
fn aloud<'a>(policy: Box<dyn Policy + 'a>, agent: u16, ear: &'a Ear) -> Box<dyn Policy + 'a> {
    Box::new(DecoratedPolicy::new(policy, move |policy, observation, _| {
        if !ear.is_open.get() || observation.self_index != usize::from(agent) {
            return policy.decide(observation);
        }
        let mut utilities = vec![0.0; policy.actions()];
        if let Err(refusal) = policy.utilities(observation, &mut utilities) {
            ear.heard.replace(Some(Err(refusal)));
            return Err(refusal);
        }
        let attention = ear.probe.as_ref().map(|probe| probe.by_entity(observation));
        let thought = Thought::new(&utilities, attention.transpose()?.unwrap_or_default());
        ear.heard.replace(Some(Ok(thought)));
        masked_argmax(&utilities, observation.available)
    }))
}
