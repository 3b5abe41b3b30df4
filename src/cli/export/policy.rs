//! A policy that was not trained here becomes a bundle: proved to fit an environment, and measured in it.

use std::collections::BTreeMap;
use std::path::Path;

use sortie_bundle::{
    AGENT, CARD, ContractV1, Draft, Golden, Limits, Network, POLICY, POLICY_ROLES, PolicyRoles,
};
use sortie_core::Policy;
use sortie_envs::{Environment, Spec, Split};
use sortie_learn::draft::{Measured, Recorder, contract, described, limits, measured_table};
use sortie_learn::evaluate::Evaluation;
use sortie_learn::play::{PolicyTeam, evaluate, evaluate_watched};
use sortie_plans::{
    CompileError, FlatPolicy, InputRole, PolicyFacts, PolicyInput, PolicyOptions, TeamPolicy,
    TeamSizes, read_onnx,
};

use super::{ExportArguments, write};
use crate::compiler::compiler;
use crate::environment::ScenarioSetName;
use crate::failure::{Exit, Failure, Outcome};
use crate::progress::{self, CountedEpisodes};
use crate::seeds::SeedRange;
use crate::tools::engines;

/// Golden observations are drawn from rounds of so many episodes, until there are enough.
const GOLDEN_EPISODES: usize = 20;
const GOLDEN_CASES: usize = 128;
const GOLDEN_ROUNDS: u64 = 100;

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

/// Whether a file is named, and no folder of a run.
pub(super) fn is_policy(path: &Path) -> bool {
    path.is_file()
}

pub(super) fn export(arguments: &ExportArguments) -> Outcome {
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
        let mut recorder = Recorder::new(policy, features);
        for round in 0..GOLDEN_ROUNDS {
            if recorder.cases.len() >= GOLDEN_CASES {
                break;
            }
            let mut team = PolicyTeam::new(&mut recorder);
            evaluate(&**environment, &mut team, GOLDEN_EPISODES, seed.wrapping_add(round))?;
        }
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
        let bar = progress::bar(arguments.common, all, "episodes");
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

/// The model card.
fn card(set: &ScenarioSetName, measured: &[Measured]) -> String {
    format!(
        "# A policy of somebody else for {set}\n\n\
         Every agent decides by `agent.onnx` alone, on its own row. It was not trained by Sortie.\n\n\
         ## How well it does\n\n\
         Greedy episodes. The interval is that of the episodes.\n\n\
         {}",
        measured_table(measured)
    )
}
