//! The plans of a bundle: those that it ships, those that were compiled here before, and new ones.

use std::path::PathBuf;

use sortie_bundle::{
    ALLOCATOR_PLAN, AgentGraph, Bundle, GOLDEN, POINTING_PLANS, POLICY_ROLES, Recording, sha256,
};
use sortie_core::allocate::PointingMemory;
use sortie_core::limits;
use sortie_core::plan::{AlignedBytes, Network, Plan, PlanError, Profile};

use crate::cache::{PlanKey, keep, kept};
use crate::error::CompileError;
use crate::policy::{PolicyOptions, pointing_policies, roles_of};
use crate::policy_plan::CompiledPolicy;
use crate::proof::{AgentPlans, prove_agents, prove_allocator, prove_options, prove_pointing};
use crate::report::{CompileOptions, Compiled, ProposalFiles, VERSION};
use crate::team_policy::TeamSizes;

/// Makes plans of networks, here or in another process.
pub trait Compiler {
    /// Compiles one network and proves the plan against its graph.
    ///
    /// # Errors
    /// The file is no network that plans can express, or the plan differs from its graph.
    fn compile(&self, onnx: &[u8], options: &CompileOptions) -> Result<Compiled, CompileError>;

    /// The same, and the weights of a plan of profile int8 are rounded so that its products err little on `examples`.
    ///
    /// # Errors
    /// As [`Self::compile`].
    fn compile_rounded(
        &self,
        onnx: &[u8],
        options: &CompileOptions,
        examples: &Recording,
    ) -> Result<Compiled, CompileError>;

    /// The same for the three networks of an allocator that proposes.
    ///
    /// # Errors
    /// As [`Self::compile`].
    fn compile_proposals(
        &self,
        files: &ProposalFiles<'_>,
        options: &CompileOptions,
    ) -> Result<Compiled, CompileError>;

    /// The same for a policy over inputs of fixed sizes.
    ///
    /// # Errors
    /// As [`Self::compile`], or more must be said about the file.
    fn compile_policy(
        &self,
        onnx: &[u8],
        policy: &PolicyOptions,
        options: &CompileOptions,
    ) -> Result<CompiledPolicy, CompileError>;
}

/// Finds the plans of bundles, and asks each about the bundle's golden answers before anybody acts by it.
#[derive(Clone, Debug)]
pub struct BundlePlans<C> {
    compiler: C,
    cache: Option<PathBuf>,
    note: fn(&str),
    proves: bool,
}

/// A plan that is looked for.
struct Wanted<'a> {
    bundle: &'a Bundle,
    /// The file that a bundle ships it in.
    part: String,
    network: Network,
    /// What the plan is known by: the network, or three of them joined.
    onnx: &'a [u8],
    profile: Profile,
    n_max: usize,
    /// What is said of a policy over inputs of fixed sizes.
    policy: Option<PolicyOptions>,
    /// The graph and its place among the bundle's, where agents decide by it.
    graph: Option<(AgentGraph, usize)>,
}

impl<C: Compiler> BundlePlans<C> {
    /// Plans that are not shipped come from `compiler`, and are kept in the folder `cache`, see [`crate::user_cache`].
    /// `note` gets a line where a plan is passed over.
    pub fn new(compiler: C, cache: Option<PathBuf>, note: fn(&str)) -> Self {
        Self { compiler, cache, note, proves: true }
    }

    /// The same without asking for golden answers: for whoever compares all of them, and tells.
    pub fn without_proof(self) -> Self {
        Self { proves: false, ..self }
    }

    /// The plans of a bundle's agents.
    ///
    /// # Errors
    /// A shipped plan is not of this bundle's network, a new one cannot be compiled, or the golden observations
    /// get other answers than the recorded ones.
    pub fn agents(&self, bundle: &Bundle, profile: Profile) -> Result<AgentPlans, CompileError> {
        let wanted = Wanted::agents(bundle, profile)?;
        let plans = wanted.iter().map(|wanted| self.find(wanted));
        let plans = AgentPlans::new(bundle, plans.collect::<Result<_, _>>()?);
        if self.proves && bundle.options().is_some() {
            prove_options(&plans, bundle, profile)?;
        }
        Ok(plans)
    }

    /// The plan of a bundle's team-value network, if it has one.
    ///
    /// # Errors
    /// As [`Self::agents`], with golden allocations.
    pub fn allocator(
        &self,
        bundle: &Bundle,
        profile: Profile,
    ) -> Result<Option<AlignedBytes>, CompileError> {
        Wanted::allocator(bundle, profile).map(|wanted| self.find(&wanted)).transpose()
    }

    /// The plan of a bundle's proposing allocator, if it has one. Bundles record no allocations of such an allocator.
    ///
    /// # Errors
    /// As [`Self::agents`].
    pub fn proposals(
        &self,
        bundle: &Bundle,
        profile: Profile,
    ) -> Result<Option<AlignedBytes>, CompileError> {
        let Some(files) = proposal_files(bundle) else { return Ok(None) };
        self.find(&Wanted::proposals(bundle, &files.joined(), profile)).map(Some)
    }

    /// The allocator of a bundle that points, if it has one.
    ///
    /// # Errors
    /// As [`Self::agents`], with golden allocations.
    pub fn pointing(&self, bundle: &Bundle) -> Result<Option<PointingMemory>, CompileError> {
        let Some(wanted) = Wanted::pointing(bundle) else { return Ok(None) };
        let (_, rules) = bundle.pointing_graphs().ok_or(PlanError::WrongNetwork)?;
        let [encoder, decoder] = wanted.map(|wanted| self.find(&wanted));
        let mut memory = PointingMemory::new([encoder?, decoder?], rules)?;
        if self.proves {
            prove_pointing(&mut memory.bind()?, bundle)?;
        }
        Ok(Some(memory))
    }

    /// Compiles the plans that a bundle ships, by the names of their parts.
    ///
    /// # Errors
    /// As [`Self::agents`].
    pub fn shipped(&self, bundle: &Bundle) -> Result<Vec<(String, Vec<u8>)>, CompileError> {
        let joined = proposal_files(bundle).map(|files| files.joined());
        let proposals =
            joined.as_ref().map(|joined| Wanted::proposals(bundle, joined, Profile::Exact));
        let agents = Wanted::agents(bundle, Profile::Exact)?;
        let ship = |wanted: Wanted<'_>| {
            let plan = self.compiled_for_golden(&wanted)?;
            self.checked(&wanted, &plan)?;
            Ok((wanted.part, plan.as_slice().to_vec()))
        };
        let pointing = Wanted::pointing(bundle).into_iter().flatten();
        let values = Wanted::allocator(bundle, Profile::Exact).into_iter();
        agents.into_iter().chain(values).chain(proposals).chain(pointing).map(ship).collect()
    }

    /// Compiles the one network that all agents of a bundle decide by. Of profile int8 it is rounded for `examples`. The
    /// plan is not kept.
    ///
    /// # Errors
    /// As [`Self::agents`], or the agents decide by several networks.
    pub fn agent(
        &self,
        bundle: &Bundle,
        profile: Profile,
        examples: &Recording,
    ) -> Result<Compiled, CompileError> {
        let wanted = Wanted::agents(bundle, profile)?;
        let [wanted] = wanted.as_slice() else {
            let reason = "the agents of this bundle decide by several networks, a plan is of one";
            return Err(CompileError::NoAgent { reason: reason.to_owned() });
        };
        let compiled = self.compiled(wanted, examples)?;
        self.checked(wanted, &AlignedBytes::copy_of(&compiled.bytes))?;
        Ok(compiled)
    }

    fn find(&self, wanted: &Wanted<'_>) -> Result<AlignedBytes, CompileError> {
        if let Some(plan) = self.of_bundle(wanted)? {
            return Ok(plan);
        }
        if let Some(plan) = self.of_cache(wanted) {
            return Ok(plan);
        }
        let plan = self.compiled_for_golden(wanted)?;
        self.checked(wanted, &plan)?;
        // Nowhere is fine too: the next start compiles again.
        let _ = self.cache.as_ref().map(|cache| keep(cache, &wanted.key(), plan.as_slice()));
        Ok(plan)
    }

    /// The plan that the bundle ships, unless it is of another version. What else is wrong with it is an error: its
    /// hash stands in the bundle, so that it was meant to be this.
    fn of_bundle(&self, wanted: &Wanted<'_>) -> Result<Option<AlignedBytes>, CompileError> {
        let shipped = wanted.bundle.part(&wanted.part).filter(|_| wanted.profile == Profile::Exact);
        let Some(plan) = shipped.map(AlignedBytes::copy_of) else { return Ok(None) };
        match Plan::load(plan.as_slice()) {
            Err(PlanError::Version { .. }) => {
                let (name, part) = (wanted.bundle.folder().display(), &wanted.part);
                (self.note)(&format!("{name}: `{part}` is of another version, a plan is compiled"));
                return Ok(None);
            }
            loaded => wanted.check_header(&loaded?)?,
        }
        self.checked(wanted, &plan)?;
        Ok(Some(plan))
    }

    fn of_cache(&self, wanted: &Wanted<'_>) -> Option<AlignedBytes> {
        let plan = kept(self.cache.as_ref()?, &wanted.key())?;
        match self.checked(wanted, &plan) {
            Ok(()) => Some(plan),
            Err(error) => {
                let name = wanted.bundle.folder().display();
                (self.note)(&format!("{name}: a kept plan is passed over: {error}"));
                None
            }
        }
    }

    /// As everybody who has the bundle compiles it, with the same bits.
    fn compiled_for_golden(&self, wanted: &Wanted<'_>) -> Result<AlignedBytes, CompileError> {
        let compiled = self.compiled(wanted, &wanted.bundle.golden_recording(usize::MAX))?;
        Ok(AlignedBytes::copy_of(&compiled.bytes))
    }

    fn compiled(
        &self,
        wanted: &Wanted<'_>,
        examples: &Recording,
    ) -> Result<Compiled, CompileError> {
        let options = wanted.options();
        match (wanted.network, proposal_files(wanted.bundle)) {
            (Network::Policy, _) => {
                let policy = wanted.policy.clone().unwrap_or_default();
                Ok(self.compiler.compile_policy(wanted.onnx, &policy, &options)?.compiled)
            }
            (Network::Proposals, Some(files)) => self.compiler.compile_proposals(&files, &options),
            _ if wanted.is_rounded() => {
                self.compiler.compile_rounded(wanted.onnx, &options, examples)
            }
            _ => self.compiler.compile(wanted.onnx, &options),
        }
    }

    /// Whether the plan is of the bundle's sizes, and gives its golden answers.
    fn checked(&self, wanted: &Wanted<'_>, plan: &AlignedBytes) -> Result<(), CompileError> {
        let loaded = Plan::load(plan.as_slice())?;
        wanted.check_sizes(&loaded)?;
        match (wanted.network, &wanted.graph) {
            _ if !self.proves => Ok(()),
            (_, Some((_, graph))) => prove_agents(loaded, wanted.bundle, *graph),
            (Network::TeamValue, _) => prove_allocator(loaded, wanted.bundle),
            _ => Ok(()),
        }
    }
}

impl<'a> Wanted<'a> {
    fn agents(bundle: &'a Bundle, profile: Profile) -> Result<Vec<Self>, CompileError> {
        let policy = match bundle.options() {
            Some(_) => Some(PolicyOptions::default()),
            None => roles_of(bundle)?,
        };
        let network = if policy.is_some() { Network::Policy } else { Network::Agent };
        let n_max = bundle.manifest().limits.n_max.into();
        let wanted = |(graph, place): (AgentGraph, usize)| {
            let (part, onnx, policy) =
                (graph.plan_part(), bundle.graph_onnx(&graph), policy.clone());
            // No graph of an option's agent acts alone.
            let graph = bundle.options().is_none().then_some((graph, place));
            Self { bundle, part, network, onnx, profile, n_max, policy, graph }
        };
        Ok(bundle.agent_graphs().into_iter().zip(0..).map(wanted).collect())
    }

    fn allocator(bundle: &'a Bundle, profile: Profile) -> Option<Self> {
        let (part, network) = (ALLOCATOR_PLAN.to_owned(), Network::TeamValue);
        // Several teams are valued together, and every agent is a member of some and a stranger to others: two rows.
        let n_max = (2 * usize::from(bundle.manifest().limits.n_max)).min(limits::ENTITIES);
        let onnx = bundle.allocator_onnx()?;
        Some(Self { bundle, part, network, onnx, profile, n_max, policy: None, graph: None })
    }

    fn proposals(bundle: &'a Bundle, onnx: &'a [u8], profile: Profile) -> Self {
        let (part, network) = (ALLOCATOR_PLAN.to_owned(), Network::Proposals);
        let n_max = bundle.manifest().limits.n_max.into();
        Self { bundle, part, network, onnx, profile, n_max, policy: None, graph: None }
    }

    fn pointing(bundle: &'a Bundle) -> Option<[Self; 2]> {
        let ([encoder, decoder], _) = bundle.pointing_graphs()?;
        let wanted = |part: &str, onnx, policy| {
            let (part, policy) = (part.to_owned(), Some(policy));
            let (network, profile) = (Network::Policy, Profile::Exact);
            Self { bundle, part, network, onnx, profile, n_max: 1, policy, graph: None }
        };
        let [of_encoder, of_decoder] = POINTING_PLANS;
        let [encodes, decodes] = pointing_policies();
        Some([wanted(of_encoder, encoder, encodes), wanted(of_decoder, decoder, decodes)])
    }

    fn key(&self) -> PlanKey<'_> {
        PlanKey {
            onnx: self.onnx,
            profile: self.profile.name(),
            compiler: VERSION,
            contract: self.bundle.contract().hash(),
            n_max: self.n_max,
            t_max: self.bundle.manifest().limits.t_max,
            roles: self.bundle.part(POLICY_ROLES).unwrap_or_default(),
            golden: self.bundle.part(GOLDEN).filter(|_| self.is_rounded()).unwrap_or_default(),
        }
    }

    /// Whether its weights are rounded for observations.
    fn is_rounded(&self) -> bool {
        self.network == Network::Agent && self.profile == Profile::Int8
    }

    fn options(&self) -> CompileOptions {
        let contract = self.bundle.contract();
        let graph = self.graph.as_ref().map(|(graph, _)| graph);
        CompileOptions {
            n_max: self.n_max,
            profile: self.profile,
            t_max: self.bundle.manifest().limits.t_max,
            features: Some(graph.map_or(contract.features, |graph| graph.features).into()),
            contract: Some(contract.hash()),
            team: graph.map(|graph| TeamSizes::of(self.bundle, graph)),
            ..CompileOptions::default()
        }
    }

    /// Whether a shipped plan was made from this network, under this contract, for so many entities.
    fn check_header(&self, plan: &Plan<'_>) -> Result<(), CompileError> {
        let header = plan.header();
        let reason = if header.source != sha256(self.onnx) {
            "it was made from another network".to_owned()
        } else if header.contract != self.bundle.contract().hash() {
            "it was made for another contract".to_owned()
        } else if header.profile != Profile::Exact {
            format!("its profile is {}", header.profile.name())
        } else if (header.n_max as usize) < self.n_max {
            format!("it takes {} entities, {} are needed", header.n_max, self.n_max)
        } else {
            return Ok(());
        };
        Err(CompileError::ForeignPlan { part: self.part.clone().into(), reason })
    }

    fn check_sizes(&self, plan: &Plan<'_>) -> Result<(), CompileError> {
        plan.check_network(self.network)?;
        let (contract, header) = (self.bundle.contract(), plan.header());
        match (self.network, &self.graph) {
            (_, Some((graph, _))) => {
                let hidden = self.bundle.manifest().network.hidden as usize;
                same_size("the recurrent state", plan.hidden(), hidden)?;
                let (features, actions) = (graph.features.into(), graph.actions.into());
                same_size("the number of features", header.features as usize, features)?;
                same_size("the number of utilities", plan.actions(), actions)
            }
            (Network::Proposals, _) => {
                let (features, wanted) = (header.features as usize, contract.features.into());
                same_size("the allocator's number of features", features, wanted)?;
                let (got, want) = (header.t_max, self.bundle.manifest().limits.t_max);
                let tasks = "the allocator's number of subtasks";
                if got < want { same_size(tasks, got.into(), want.into()) } else { Ok(()) }
            }
            _ => Ok(()),
        }
    }
}

fn same_size(what: &'static str, got: usize, want: usize) -> Result<(), CompileError> {
    if got == want { Ok(()) } else { Err(CompileError::Size { what: what.into(), got, want }) }
}

fn proposal_files(bundle: &Bundle) -> Option<ProposalFiles<'_>> {
    let [trunk, step, critic] = bundle.proposal_graphs()?;
    Some(ProposalFiles { trunk, step, critic })
}
