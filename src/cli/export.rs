//! `sortie export`: a training run, or a policy of somebody else, becomes a bundle.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;
use sortie_bundle::files::check_folder;
use sortie_bundle::{
    AGENT, BundleError, CARD, ContractV1, Draft, Golden, Limits, Network, POLICY, POLICY_ROLES,
    PolicyRoles, hex,
};
use sortie_core::Policy;
use sortie_envs::{Environment, Spec, Split};
use sortie_learn::Act;
use sortie_learn::draft::{
    EPISODES, Measured, MethodRun, Recorder, contract, described, draft_method, limits,
    measured_table,
};
use sortie_learn::evaluate::Evaluation;
use sortie_learn::play::{PolicyTeam, evaluate, evaluate_watched};
use sortie_learn::run::read_curve;
use sortie_learn::subtasks::Allocate;
use sortie_plans::{
    CompileError, FlatPolicy, InputRole, PolicyFacts, PolicyInput, PolicyOptions, TeamPolicy,
    TeamSizes, read_onnx,
};

use crate::allocation::Allocation;
use crate::environment::ScenarioSetName;
use crate::failure::{Exit, Failure, Outcome};
use crate::foreign::PolicyArguments;
use crate::methods::LearnedMethod;
use crate::output::{Common, print_json, say};
use crate::seeds::SeedRange;
use crate::terminal::{self, CountedEpisodes};
use crate::tools::{check_program, compiler, engines, with_plans};

/// Whom agents that are allocated are measured under: their own allocator, and the environment's first rules.
const LEARNED: &str = "learned";
const RULES: usize = 2;

/// Export a training run as a bundle: networks as ONNX, contract, golden observations, card and curve
///
/// The averaged weights are evaluated first, over fresh greedy episodes; the card tells the result.
///
/// An ONNX file, a policy that somebody else trained, becomes a bundle as well, whose agents decide by it on their own
/// rows of --env. It must choose one of the environment's actions.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie export runs/first --out models/first
  sortie export runs/large --env save-the-city/12a_12b --env save-the-city/24a_24b --out models/large
  sortie export agent.onnx --env group-matching/8x6x2 --out models/mine")]
pub(crate) struct ExportArguments {
    /// Folder of the run, or the ONNX file of a policy
    #[arg(value_name = "RUN|ONNX")]
    run: PathBuf,
    /// Folder of the new bundle
    #[arg(long, value_name = "BUNDLE")]
    out: PathBuf,
    /// Scenario set to measure on, and to size the bundle for; may be given several times [default:
    /// what the run learned on; an ONNX file needs it]
    #[arg(long, value_name = "ENV[/SET]")]
    env: Vec<String>,
    /// Episodes to evaluate for the card, on each set and under each allocation
    #[arg(long, default_value_t = 2000, value_parser = clap::value_parser!(u32).range(1..))]
    episodes: u32,
    /// Take the episodes of several seeds together, A and B included, --episodes of each; one seed may be an easy one
    #[arg(long, value_name = "A..B")]
    seeds: Option<SeedRange>,
    /// Largest team of one subtask that the deployed allocator forms [default: as in training]
    #[arg(long, value_name = "AGENTS", value_parser = clap::value_parser!(u16).range(1..))]
    team_max: Option<u16>,
    #[command(flatten)]
    common: Common,
    // Last: what follows would stand under its heading.
    #[command(flatten)]
    policy: PolicyArguments,
}

#[derive(Serialize)]
struct Report {
    bundle: PathBuf,
    sha256: String,
}

pub(crate) fn run(arguments: &ExportArguments) -> Outcome {
    check_place(&arguments.out)?;
    check_program()?;
    if arguments.run.is_file() {
        return export_policy(arguments);
    }
    if arguments.policy.options() != PolicyOptions::default() {
        let reason = "what is said about a policy's inputs and outputs goes with an ONNX file";
        return Err(Failure::new(Exit::Usage, reason));
    }
    export_run(arguments)
}

/// Writes the bundle with its plans.
fn write(arguments: &ExportArguments, draft: Draft) -> Outcome {
    let draft = with_plans(draft, &arguments.out)?;
    let bundle = draft.write(&arguments.out)?;
    let report = Report { bundle: arguments.out.clone(), sha256: hex(bundle.id()) };
    if arguments.common.json {
        print_json(&report);
    } else {
        say!("{}: {}", report.bundle.display(), report.sha256);
    }
    Ok(())
}

/// Exports what a run has learned.
fn export_run(arguments: &ExportArguments) -> Outcome {
    let mut is_limited = arguments.team_max.is_none();
    let learned = LearnedMethod::open_with(&arguments.run, |entry, setup| {
        let team_max = arguments.team_max.map(|most| most.to_string());
        let set = team_max.map(|most| entry.set_flag(&setup, "--team-max", &most));
        let limited = set.and_then(Result::ok);
        is_limited |= limited.is_some();
        limited.unwrap_or(setup)
    })?;
    learned.method.deployed()?;
    if !is_limited {
        let what = if learned.method.subtasks().is_some() { "a team-value" } else { "an" };
        let reason =
            format!("`--team-max` limits {what} allocator, which this run has not learned");
        return Err(Failure::new(Exit::Usage, reason));
    }
    let seed = arguments.common.seed;
    let seeds = arguments.seeds.unwrap_or(SeedRange::only(seed));
    let (mut measured, mut sizes) = (Vec::new(), vec![learned.environment.spec().shape]);
    let choices = learned.choices(&arguments.env)?;
    let allocations = allocations(&learned);
    let evaluations = (choices.len() * allocations.len()).saturating_mul(seeds.iter().count());
    let all = u64::from(arguments.episodes).saturating_mul(evaluations as u64);
    let bar = terminal::bar(arguments.common, all, "episodes");
    let mut counted = CountedEpisodes { bar: &bar, next: &mut () };
    for choice in choices {
        if learned.method.subtasks().is_some() {
            ScenarioSetName::parse_with_subtasks(&choice.to_string())?;
        }
        let environment = learned.open_as(&choice)?;
        sizes.push(environment.spec().shape);
        for allocation in &allocations {
            let mut play = |seed| -> Result<Evaluation, Failure> {
                let mut team = team_under(&learned, allocation)?;
                let episodes = arguments.episodes as usize;
                let played =
                    evaluate_watched(&*environment, &mut *team, episodes, seed, &mut counted);
                Ok(played?)
            };
            let parts = seeds.iter().map(&mut play).collect::<Result<Vec<_>, _>>()?;
            let (set, allocation) = (choice.set.clone(), (*allocation).to_owned());
            measured.push(Measured { set, allocation, evaluation: Evaluation::pooled(&parts) });
        }
    }
    bar.finish_and_clear();
    let run = MethodRun {
        description: &learned.description,
        environment: &*learned.environment,
        method: &*learned.method,
        curve: &read_curve(&arguments.run)?,
    };
    write(arguments, draft_method(&run, &arguments.run, &sizes, &measured, seed)?)
}

/// Whom the agents are measured under: their own allocator, if they have one, and the rules.
fn allocations(learned: &LearnedMethod) -> Vec<&str> {
    let Some(subtasks) = learned.method.subtasks() else { return vec!["none"] };
    let own = subtasks.allocator.map(|_| LEARNED);
    let rules = learned.environment.spec().rules.iter().take(RULES);
    own.into_iter().chain(rules.map(|rule| &*rule.name)).collect()
}

/// The agents under one of these.
fn team_under<'a>(
    learned: &'a LearnedMethod,
    allocation: &str,
) -> Result<Box<dyn Act + 'a>, Failure> {
    let Some(mut subtasks) = learned.method.subtasks() else { return Ok(learned.method.team()) };
    let allocator: Box<dyn Allocate + 'a> = match subtasks.allocator.take() {
        Some(mut own) if allocation == LEARNED => {
            own.allocate.choose_among(None, learned.environment.spec());
            own.allocate
        }
        _ => Box::new(Allocation::named(allocation)?.measured()),
    };
    Ok(Box::new(subtasks.under(allocator)))
}

/// Refuses a place that a bundle cannot be written to, before anything is measured.
fn check_place(out: &Path) -> Outcome {
    if out.exists() {
        return Err(BundleError::Exists { path: out.to_owned() }.into());
    }
    let folder = out.parent().filter(|parent| parent.is_dir());
    folder.map_or(Ok(()), |folder| {
        check_folder(folder).map_err(|error| Failure::file(folder, &error))
    })
}

/// A policy, and the environments that it is to act in.
struct Exported {
    onnx: Vec<u8>,
    roles: PolicyOptions,
    facts: PolicyFacts,
    contract: ContractV1,
    /// Where it acts; the bundle names the first.
    first: Place,
    others: Vec<Place>,
}

/// A scenario set, opened.
struct Place {
    set: ScenarioSetName,
    environment: Box<dyn Environment>,
}

impl Place {
    fn open(name: &str) -> Result<Self, Failure> {
        let set = ScenarioSetName::parse(name)?;
        let environment = set.open(Split::Test)?;
        Ok(Self { set, environment })
    }

    fn spec(&self) -> &Spec {
        self.environment.spec()
    }
}

fn export_policy(arguments: &ExportArguments) -> Outcome {
    engines()?;
    let within = |error| Failure::from(error).within(arguments.run.display());
    let exported = Exported::open(arguments)?;
    let mut policy = exported.policy().map_err(within)?;
    let draft = exported.draft(arguments, &mut policy)?;
    write(arguments, draft)
}

impl Exported {
    fn open(arguments: &ExportArguments) -> Result<Self, Failure> {
        let file = &arguments.run;
        let roles = arguments.policy.options_for(file)?;
        if arguments.team_max.is_some() {
            let reason =
                "`--team-max` limits an allocator, which a policy of somebody else has not";
            return Err(Failure::new(Exit::Usage, reason));
        }
        let onnx = read_onnx(file).map_err(|error| Failure::file(file, &error))?;
        let facts = compiler().rehearse_policy(&onnx, &roles);
        let facts = facts.map_err(|error| Failure::from(error).within(file.display()))?;
        let Some((first, others)) = arguments.env.split_first() else {
            let reason = "`--env ENV/SET` says in which environment the policy acts";
            return Err(Failure::new(Exit::Usage, reason));
        };
        let first = Place::open(first)?;
        let others: Vec<Place> =
            others.iter().map(|name| Place::open(name)).collect::<Result<_, _>>()?;
        let spec = first.spec();
        let names = |spec: &Spec| (spec.features.clone(), spec.actions.clone());
        if let Some(other) = others.iter().find(|other| names(other.spec()) != names(spec)) {
            let (set, first) = (&other.set, &first.set);
            let reason = format!("`{set}` has other features or actions than `{first}`");
            return Err(Failure::new(Exit::Mismatch, reason));
        }
        let row = |input: &PolicyInput| match input.role {
            InputRole::Observation => Some(input.length()),
            InputRole::Entities { .. } => input.shape.last().copied(),
            _ => None,
        };
        let with_action = spec.shape.features + spec.shape.actions;
        let last_action = facts.given().find_map(row) == Some(with_action);
        let contract = contract(spec, last_action);
        Ok(Self { onnx, roles, facts, contract, first, others })
    }

    /// The policy as an agent, run by tract.
    fn policy(&self) -> Result<TeamPolicy, CompileError> {
        let team = TeamSizes::of_contract(&self.contract, self.limits().n_max);
        team.meanings(&self.facts)?;
        let engines = engines().map_err(|failure| CompileError::Run { reason: failure.message })?;
        let policy: Box<dyn FlatPolicy> = engines.tract().flat_policy(&self.onnx, &self.roles)?;
        TeamPolicy::new(policy, team)
    }

    fn places(&self) -> impl Iterator<Item = &Place> {
        std::iter::once(&self.first).chain(&self.others)
    }

    /// The largest domain that its bundle serves.
    fn limits(&self) -> Limits {
        let shapes: Vec<_> = self.places().map(|place| place.spec().shape).collect();
        limits(&shapes)
    }

    fn draft(
        &self,
        arguments: &ExportArguments,
        policy: &mut TeamPolicy,
    ) -> Result<Draft, Failure> {
        let seed = arguments.common.seed;
        let measured = self.measure(arguments, policy)?;
        let hidden = policy.hidden() as u32;
        let features = usize::from(self.contract.features);
        let Place { set, environment } = &self.first;
        let mut recorder = Recorder::new(features);
        recorder.fill(seed, |recorder, seed| {
            let mut team = PolicyTeam::new(recorder.of(&mut *policy));
            evaluate(&**environment, &mut team, EPISODES, seed).map(drop)
        })?;
        let golden = Golden { cases: recorder.cases, ..Golden::default() };
        let mut parts = BTreeMap::from([
            (AGENT.to_owned(), self.onnx.clone()),
            (CARD.to_owned(), card(set, &measured).into_bytes()),
        ]);
        let roles = PolicyRoles::from(self.roles.clone());
        if roles != PolicyRoles::default() {
            parts.insert(POLICY_ROLES.to_owned(), roles.to_toml().into_bytes());
        }
        Ok(Draft {
            environment: described(set.to_string(), environment.spec(), &golden.cases),
            limits: self.limits(),
            network: Network { agent: POLICY.to_owned(), hidden, ..Network::default() },
            golden,
            contract: self.contract.clone(),
            parts,
        })
    }

    /// Plays fresh episodes of every set.
    fn measure(
        &self,
        arguments: &ExportArguments,
        policy: &mut TeamPolicy,
    ) -> Result<Vec<Measured>, Failure> {
        let seeds = arguments.seeds.unwrap_or(SeedRange::only(arguments.common.seed));
        let evaluations = self.places().count().saturating_mul(seeds.iter().count());
        let all = u64::from(arguments.episodes).saturating_mul(evaluations as u64);
        let bar = terminal::bar(arguments.common, all, "episodes");
        let mut counted = CountedEpisodes { bar: &bar, next: &mut () };
        let mut measured = Vec::new();
        for Place { set, environment } in self.places() {
            let mut parts = Vec::new();
            for seed in seeds.iter() {
                let (mut team, episodes) =
                    (PolicyTeam::new(&mut *policy), arguments.episodes as usize);
                let played =
                    evaluate_watched(&**environment, &mut team, episodes, seed, &mut counted)?;
                parts.push(played);
            }
            let evaluation = Evaluation::pooled(&parts);
            let (set, allocation) = (set.set().to_owned(), "none".to_owned());
            measured.push(Measured { set, allocation, evaluation });
        }
        bar.finish_and_clear();
        Ok(measured)
    }
}

fn card(set: &ScenarioSetName, measured: &[Measured]) -> String {
    format!(
        "# A policy of somebody else for {set}\n\n\
         Every agent decides by `agent.onnx` alone, on its own row. It was not trained by Sortie.\n\n\
         ## How well it does\n\n\
         Greedy episodes. The interval is that of the episodes.\n\n\
         {}",
        measured_table(measured, None)
    )
}
