//! Networks of this trainer: plans beside their graphs in other engines, and beside the truth.

use sortie_bundle::Bundle;
use sortie_cli::failure::Failure;
use sortie_cli::output::tell;
use sortie_cli::tools::{compiler, engines};
use sortie_core::plan::{AlignedBytes, Network, Profile};
use sortie_plans::{
    Answer, Comparison, CompileError, CompileOptions, Compiler, Family, GraphAnswers, NetworkFiles,
    NetworkInput, ObservationSizes, PlanFacts, ProposalFiles, Standard, TeamQuerySizes, True,
    TrueAnswers, compare, compare_with_truth, inspect_plan, needs_truth, observation_families,
    plan_answers, random_allocation_states, random_entities, team_query_families,
};

use super::DOUBLE;
use super::{Compared, Judges, VerifyArguments, unproved, within};

/// Multiply-adds of all inputs together, which the reference evaluator does nine times over in some seconds.
pub(super) const MOST_MULTIPLY_ADDS: u64 = 200_000_000;

/// Inputs of every family whose truth is found however large the network is.
const LEAST: usize = 8;

/// A plan that is judged, and the network that it was made from.
struct Judged<'a> {
    /// Whose plan it is, in front of names.
    whose: &'static str,
    files: NetworkFiles<'a>,
    plan: AlignedBytes,
    n_max: usize,
}

/// The plans that act for a bundle's agents.
pub(super) fn agents(
    arguments: &VerifyArguments,
    bundle: &Bundle,
    profile: Profile,
    judges: &Judges,
) -> Result<Vec<Compared>, Failure> {
    let plans = unproved().agents(bundle, profile).map_err(within(bundle.folder()))?;
    let (files, n_max) =
        (NetworkFiles::One(bundle.agent_onnx()), bundle.manifest().limits.n_max.into());
    let mut compared = Vec::new();
    for plan in plans.into_plans() {
        compared.extend(judged(arguments, Judged { whose: "", files, plan, n_max }, judges)?);
    }
    Ok(compared)
}

/// The plan by which a bundle's allocator values teams, or proposes.
pub(super) fn allocators(
    arguments: &VerifyArguments,
    bundle: &Bundle,
    judges: &Judges,
) -> Result<Vec<Compared>, Failure> {
    let n_max = bundle.manifest().limits.n_max.into();
    let (failed, whose) = (within(bundle.folder()), "allocator ");
    let mut compared = Vec::new();
    let values = unproved().allocator(bundle, Profile::Exact).map_err(&failed)?;
    if let (Some(onnx), Some(plan)) = (bundle.allocator_onnx(), values) {
        let files = NetworkFiles::One(onnx);
        compared.extend(judged(arguments, Judged { whose, files, plan, n_max }, judges)?);
    }
    let proposes = unproved().proposals(bundle, Profile::Exact).map_err(failed)?;
    if let (Some([trunk, step, critic]), Some(plan)) = (bundle.proposal_graphs(), proposes) {
        let files = NetworkFiles::Proposals(ProposalFiles { trunk, step, critic });
        compared.extend(judged(arguments, Judged { whose, files, plan, n_max }, judges)?);
    }
    Ok(compared)
}

/// The plan of a file.
pub(super) fn file(
    arguments: &VerifyArguments,
    onnx: &[u8],
    judges: &Judges,
) -> Result<Vec<Compared>, Failure> {
    let (profile, seed) = (arguments.profile.profile(), arguments.common.seed);
    let options = CompileOptions { profile, seed, ..CompileOptions::default() };
    let compiled = compiler().compile(onnx, &options).map_err(within(&arguments.subject))?;
    let plan = AlignedBytes::copy_of(&compiled.bytes);
    let whose = match inspect_plan(plan.as_slice())?.network {
        Network::TeamValue => "allocator ",
        _ => "",
    };
    let (files, n_max) = (NetworkFiles::One(onnx), options.n_max);
    judged(arguments, Judged { whose, files, plan, n_max }, judges)
}

/// The plan of a network before its judges, on all families.
fn judged(
    arguments: &VerifyArguments,
    network: Judged<'_>,
    judges: &Judges,
) -> Result<Vec<Compared>, Failure> {
    let engines = engines()?;
    let compare = || -> Result<Vec<Compared>, CompileError> {
        let Judged { whose, files, plan, n_max } = &network;
        let facts = inspect_plan(plan.as_slice())?;
        // The graphs that this process reads have then been read and run elsewhere.
        let features = (facts.network == Network::Agent).then_some(facts.features);
        let rehearse = |onnx: &[u8]| compiler().rehearse(onnx, *n_max, features);
        match files {
            NetworkFiles::One(onnx) => rehearse(onnx)?,
            NetworkFiles::Proposals(ProposalFiles { trunk, step, critic }) => {
                [trunk, step, critic].into_iter().try_for_each(|onnx| rehearse(onnx))?;
            }
        }
        let columns = match (files, facts.network) {
            (NetworkFiles::One(onnx), Network::TeamValue) => engines.team_value_columns(onnx)?,
            _ => (facts.features, 0),
        };
        let families = families(arguments, (&facts, *n_max), columns);
        let mut peers = Vec::new();
        for judge in &judges.engines {
            peers.push((judge.name(), judge.network(files, facts.features)?));
        }
        let truth = engines.true_network(files, facts.features, arguments.common.seed);
        let inputs = families.iter().map(|family| family.inputs.len()).sum::<usize>();
        let affordable = MOST_MULTIPLY_ADDS as f64 / (facts.macs as f64 * inputs as f64);
        let judging = Judging {
            plan: plan.as_slice(),
            peers,
            truth: known(truth),
            share: affordable.min(1.0),
            seed: arguments.common.seed,
        };
        judging.compared(whose, families)
    };
    compare().map_err(within(&arguments.subject))
}

/// The truth, or why it is not known.
pub(super) fn known<T: ?Sized>(truth: Result<Box<T>, CompileError>) -> Option<Box<T>> {
    truth.inspect_err(|error| tell!("note: {DOUBLE} is not compared: {error}")).ok()
}

/// The inputs of a network's kind.
fn families(
    arguments: &VerifyArguments,
    (facts, n_max): (&PlanFacts, usize),
    (features, relations): (usize, usize),
) -> Vec<Family<NetworkInput>> {
    let (count, seed, groups) = (arguments.inputs as usize, arguments.common.seed, facts.t_max);
    match facts.network {
        Network::TeamValue => {
            let sizes = TeamQuerySizes { n_max, features, relations };
            let families = team_query_families(count, sizes, seed).into_iter();
            families.map(|family| family.map(NetworkInput::from)).collect()
        }
        Network::Entities => {
            let steps = random_entities(count, n_max, features, groups.into(), seed);
            vec![Family::of("random", steps).map(NetworkInput::Entities)]
        }
        Network::Proposals => {
            let most = n_max.min(facts.n_max);
            let states = random_allocation_states(count, most, features, groups.into(), seed);
            vec![Family::of("random", states).map(NetworkInput::from)]
        }
        _ => {
            let sizes = ObservationSizes { n_max, features, actions: facts.actions };
            let families = observation_families(count, sizes, seed).into_iter();
            families.map(|family| family.map(NetworkInput::from)).collect()
        }
    }
}

/// A plan, the engines beside it, and the truth.
struct Judging<'a> {
    plan: &'a [u8],
    peers: Vec<(&'static str, Box<dyn GraphAnswers>)>,
    truth: Option<Box<dyn TrueAnswers>>,
    /// For so many of the inputs the truth is found; for others where an engine differs.
    share: f64,
    seed: u64,
}

impl Judging<'_> {
    fn compared(
        mut self,
        whose: &str,
        families: Vec<Family<NetworkInput>>,
    ) -> Result<Vec<Compared>, CompileError> {
        let mut beside_peers: Vec<Vec<Comparison>> = vec![Vec::new(); self.peers.len()];
        let mut beside_truth = Vec::new();
        for mut family in families {
            let got = plan_answers(self.plan, &mut family.inputs, self.seed)?;
            let mut given = Vec::new();
            for (_, peer) in &mut self.peers {
                let answer = |input: &NetworkInput| peer.answer(input, family.rows).ok();
                given.push(family.inputs.iter().map(answer).collect::<Vec<_>>());
            }
            let truths = self.truths(&family, &got, &given);
            for (found, want) in beside_peers.iter_mut().zip(&given) {
                found.push(compare(&family, &got, want, &truths));
            }
            if self.truth.is_some() && family.standard != Standard::Nothing {
                beside_truth.push(compare_with_truth(&family, &got, &truths));
            }
        }
        let names = self.peers.iter().map(|(name, _)| *name);
        let mut compared: Vec<(&str, Vec<Comparison>)> = names.zip(beside_peers).collect();
        compared.push((DOUBLE, beside_truth));
        compared.retain(|(_, families)| !families.is_empty());
        let named =
            |(engine, families)| Compared::new(format!("{whose}plan against {engine}"), families);
        Ok(compared.into_iter().map(named).collect())
    }

    /// The truth of some inputs, and of all for which engines differ.
    fn truths(
        &mut self,
        family: &Family<NetworkInput>,
        got: &[Option<Answer>],
        given: &[Vec<Option<Answer>>],
    ) -> Vec<Option<True>> {
        let Some(truth) = self.truth.as_mut().filter(|_| family.standard == Standard::Same) else {
            return Vec::new();
        };
        let some = ((self.share * family.inputs.len() as f64) as usize).max(LEAST);
        let found = family.inputs.iter().zip(got).enumerate().map(|(index, (input, got))| {
            let mut wanted = given.iter().filter_map(|given| given.get(index));
            let is_wanted = index < some || wanted.any(|want| needs_truth(got, want));
            is_wanted.then(|| truth.answer(input, family.rows).ok()).flatten()
        });
        found.collect()
    }
}
