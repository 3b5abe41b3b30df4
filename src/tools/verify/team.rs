//! Policies over inputs of fixed sizes, acting for a team's agents.

use sortie_bundle::{AgentGraph, Bundle};
use sortie_cli::failure::Failure;
use sortie_cli::policy::graph_policy;
use sortie_cli::tools::{compiler, engines};
use sortie_core::plan::Profile;
use sortie_core::{Observation, Policy};
use sortie_plans::{
    AgentPlans, Annex, Answer, CompileError, Family, NetworkInput, ObservationSizes, PolicyFacts,
    PolicyOptions, Standard, TeamSizes, True, TrueFlatPolicy, TrueNumber, compare,
    compare_with_truth, observation_families, pointing_policies, roles_of,
};

use super::networks::{MOST_MULTIPLY_ADDS, known};
use super::{Compared, Judges, VerifyArguments, unproved, within};
use super::{DOUBLE, recorded};

/// The plans that act for a bundle's agents before their judges. Which network an agent of options asks depends on what
/// others answer: each of its networks is judged by itself.
pub(super) fn judged(
    arguments: &VerifyArguments,
    bundle: &Bundle,
    profile: Profile,
    judges: &Judges,
) -> Result<Vec<Compared>, Failure> {
    let failed = within(bundle.folder());
    let plans = unproved().agents(bundle, profile).map_err(&failed)?;
    let mut compared = acting(arguments, bundle, &plans, judges).map_err(&failed)?;
    if bundle.options().is_some() {
        let graphs = bundle.agent_graphs();
        for (graph, plan) in graphs.iter().zip(plans.plans()) {
            let found = recorded::judged_plan(
                (arguments, judges),
                bundle.graph_onnx(graph),
                &PolicyOptions::default(),
                plan.as_slice(),
            );
            let named = |found: Compared| Compared {
                name: format!("{}: {}", graph.plan_part(), found.name),
                ..found
            };
            compared.extend(found?.into_iter().map(named));
        }
    }
    Ok(compared)
}

/// The plans of an allocator that points before their judges, each by itself.
pub(super) fn pointing(
    arguments: &VerifyArguments,
    bundle: &Bundle,
    judges: &Judges,
) -> Result<Vec<Compared>, Failure> {
    let memory = unproved().pointing(bundle).map_err(within(bundle.folder()))?;
    let mut compared = Vec::new();
    let Some(((graphs, _), memory)) = bundle.pointing_graphs().zip(memory) else {
        return Ok(compared);
    };
    let networks = graphs.into_iter().zip(memory.plans()).zip(pointing_policies());
    for (((onnx, plan), policy), name) in networks.zip(["encoder", "decoder"]) {
        let found = recorded::judged_plan((arguments, judges), onnx, &policy, plan.as_slice())?;
        let named = |it: Compared| Compared { name: format!("{name} {}", it.name), ..it };
        compared.extend(found.into_iter().map(named));
    }
    Ok(compared)
}

/// The agents' policy beside that of their graphs.
fn acting(
    arguments: &VerifyArguments,
    bundle: &Bundle,
    plans: &AgentPlans,
    judges: &Judges,
) -> Result<Vec<Compared>, CompileError> {
    let families = families(arguments, bundle, plans)?;
    let mut arenas = plans.arenas(1)?;
    let mut policy = plans.policy(&mut arenas)?;
    let answers = |policy: &mut dyn Policy, family: &Family<NetworkInput>| {
        let answer = |input: &NetworkInput| match input {
            NetworkInput::Agent { seen, memory } => Answer::of_policy(policy, &seen.view(), memory),
            _ => None,
        };
        family.inputs.iter().map(answer).collect::<Vec<_>>()
    };
    let got: Vec<_> = families.iter().map(|family| answers(policy.as_mut(), family)).collect();
    let inputs = families.iter().map(|family| family.inputs.len()).sum();
    let mut truth = TrueTeam::of(bundle)?;
    let mut truths: Vec<Vec<Option<True>>> = vec![Vec::new(); families.len()];
    if let Some(truth) = &mut truth {
        for (truths, family) in truths.iter_mut().zip(&families) {
            if family.standard == Standard::Same {
                let share = (truth.affordable(inputs) * family.inputs.len()).div_ceil(inputs);
                *truths = truth.answers(family.inputs.iter().take(share.max(1)));
                truths.resize(family.inputs.len(), None);
            }
        }
    }
    let mut compared = Vec::new();
    for judge in &judges.engines {
        let mut graph = graph_policy(bundle, *judge)?;
        let of_family = families.iter().zip(got.iter().zip(&truths));
        let found = of_family.map(|(family, (got, truths))| {
            compare(family, got, &answers(graph.as_mut(), family), truths)
        });
        let found = found.collect();
        compared.push(Compared::new(format!("plan against {}", judge.name()), found));
    }
    if truth.is_some() {
        let of_family = families.iter().zip(got.iter().zip(&truths));
        let judged = of_family.filter(|(family, _)| family.standard != Standard::Nothing);
        let found = judged.map(|(family, (got, truths))| compare_with_truth(family, got, truths));
        compared.push(Compared::new(format!("plan against {DOUBLE}"), found.collect()));
    }
    Ok(compared)
}

/// What agents of the bundle observe.
fn families(
    arguments: &VerifyArguments,
    bundle: &Bundle,
    plans: &AgentPlans,
) -> Result<Vec<Family<NetworkInput>>, CompileError> {
    let (contract, manifest) = (bundle.contract(), bundle.manifest());
    let sizes = ObservationSizes {
        n_max: manifest.limits.n_max.into(),
        features: contract.features.into(),
        actions: contract.actions.into(),
    };
    let (inputs, seed) = (arguments.inputs as usize, arguments.common.seed);
    let mut families = observation_families(inputs, sizes, seed);
    // What is no number stands in any row that is visible; many policies observe only their own.
    let mut observes_all = false;
    for plan in plans.plans() {
        let annex = Annex::of_plan(plan.as_slice())?;
        observes_all |= annex.is_some_and(|annex| annex.facts.entities().is_some());
    }
    families.retain(|family| observes_all || family.standard != Standard::Refusal);
    // Others than these agents are refused by all, and other actions than an agent's own never chosen.
    let (graph_of, graphs) = (&manifest.network.graph_of, bundle.agent_graphs());
    let observations = families.iter_mut().flat_map(|family| &mut family.inputs);
    for seen in observations.filter(|_| !graph_of.is_empty()) {
        seen.self_index %= graph_of.len();
        let graph = graph_of.get(seen.self_index).and_then(|of| graphs.get(usize::from(*of)));
        let own = graph.map_or(seen.available.len(), |graph| graph.actions.into());
        seen.available.iter_mut().skip(own).for_each(|code| *code = 0);
    }
    Ok(families.into_iter().map(|family| family.map(NetworkInput::from)).collect())
}

/// The true utilities of agents that decide by policies over inputs of fixed sizes.
pub(super) struct TrueTeam {
    graphs: Vec<TrueGraph>,
    graph_of: Vec<u16>,
    actions: usize,
}

struct TrueGraph {
    facts: PolicyFacts,
    sizes: TeamSizes,
    policy: Box<dyn TrueFlatPolicy>,
}

impl TrueTeam {
    /// None where the bundle's agents decide otherwise, or the truth is not known.
    pub(super) fn of(bundle: &Bundle) -> Result<Option<Self>, CompileError> {
        let Some(roles) = roles_of(bundle)?.filter(|_| bundle.options().is_none()) else {
            return Ok(None);
        };
        let engines = engines().map_err(|failure| CompileError::Run { reason: failure.message })?;
        let graph = |graph: &AgentGraph| {
            let onnx = bundle.graph_onnx(graph);
            let facts = compiler().rehearse_policy(onnx, &roles)?;
            let sizes = TeamSizes::of(bundle, graph);
            let policy = known(engines.truth(onnx, &roles));
            Ok(policy.map(|policy| TrueGraph { facts, sizes, policy }))
        };
        let graphs = bundle.agent_graphs();
        let graphs: Option<Vec<TrueGraph>> =
            graphs.iter().map(graph).collect::<Result<_, CompileError>>()?;
        let graph_of = bundle.manifest().network.graph_of.clone();
        let actions = bundle.contract().actions.into();
        Ok(graphs.map(|graphs| Self { graphs, graph_of, actions }))
    }

    /// Of so many inputs as many as take some seconds.
    fn affordable(&self, inputs: usize) -> usize {
        let affordable = |graph: &TrueGraph| graph.facts.affordable(inputs, MOST_MULTIPLY_ADDS);
        self.graphs.iter().map(affordable).min().unwrap_or(inputs)
    }

    /// The truth of every input, as far as there is one.
    pub(super) fn answers<'a>(
        &mut self,
        inputs: impl IntoIterator<Item = &'a NetworkInput>,
    ) -> Vec<Option<True>> {
        let answer = |input: &NetworkInput| match input {
            NetworkInput::Agent { seen, .. } => self.answer(&seen.view()),
            _ => None,
        };
        inputs.into_iter().map(answer).collect()
    }

    fn answer(&mut self, seen: &Observation<'_>) -> Option<True> {
        let graph = self.graph_of.get(seen.self_index).map_or(0, |graph| usize::from(*graph));
        let TrueGraph { facts, sizes, policy } = self.graphs.get_mut(graph)?;
        let available = seen.available.get(..sizes.actions)?;
        let shown = sizes.shown(facts, &Observation { available, ..*seen }).ok()?;
        let shown: Vec<&[f32]> = shown.iter().map(Vec::as_slice).collect();
        policy.begin();
        let mut scores = policy.run(&shown, None).ok()?.into_iter().next()?;
        // What must not be chosen has the lowest score there is, and actions of others have none.
        let (lowest, scatter) = (f64::from(f32::MIN), f64::from(f32::MIN_POSITIVE));
        for score in scores.iter_mut().filter(|score| score.value == f64::NEG_INFINITY) {
            *score = TrueNumber { value: lowest, scatter };
        }
        scores.resize(self.actions, TrueNumber { value: 0.0, scatter });
        Some(vec![scores])
    }
}
