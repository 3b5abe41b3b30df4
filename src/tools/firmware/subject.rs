//! What a board decides by, and on what: an agent of a bundle, or a plan without one.

use std::path::{Path, PathBuf};

use sortie_bundle::{Bundle, OptionsContract, Recording};
use sortie_cli::deployment::open_bundle;
use sortie_cli::failure::{Exit, Failure};
use sortie_cli::tools::plans;
use sortie_core::internal::kernels::build::Build;
use sortie_core::options::Pursuit;
use sortie_core::plan::{AlignedBytes, Header, Network, Plan, Profile};
use sortie_core::{DecideError, EntityMask, Observation, PlanPolicy};
use sortie_plans::{
    AgentPlans, Annex, CompileError, random_observations, random_policy_inputs, random_states,
    read_plan_or_onnx,
};
use sortie_stage::{Cast, GoldenObservation, UtilityHash, hash_of};

use super::numbers::{Cases, rules, words};

/// Random cases of a plan: nobody recorded any.
const RANDOM_CASES: usize = 256;

/// The programs for agents that see entities, for policies over inputs of fixed sizes, and for agents that run options.
const AGENT: &str = "sortie-firmware";
const POLICY: &str = "sortie-policy";
const OPTIONS: &str = "sortie-options";

/// Bytes of the largest plan and arena that `runtime/firmware/src/any.rs` has room for.
const READ_PLAN: usize = 512 * 1024;
const READ_ARENA: usize = 64 * 1024;

/// What is named on the command line.
pub(crate) enum Named {
    Bundle(Box<Bundle>),
    Plan(PathBuf, AlignedBytes),
}

/// What a board decides by, and on what.
#[derive(Clone)]
pub(crate) struct Subject {
    /// As the table names it.
    pub(crate) name: String,
    pub(crate) profile: Profile,
    /// The program that decides so.
    pub(crate) program: &'static str,
    /// What the program is built around, by the variables that name such files.
    pub(super) files: Vec<(&'static str, Vec<u8>)>,
    /// What it reads when it starts, by name.
    pub(super) read: Vec<(&'static str, Vec<u8>)>,
    /// Cases that are decided on.
    pub(crate) decisions: usize,
    /// What streams in.
    pub(crate) cases: Vec<u8>,
    /// FNV-1a over the bits of what comes out on this machine.
    pub(crate) hash: u64,
}

impl Named {
    /// Opens what is named; a plan has to be one that a board runs, and of the profile that is asked for.
    pub(crate) fn open(path: &Path, asked: Option<Profile>) -> Result<Self, Failure> {
        if asked == Some(Profile::Fused) {
            return Err(fused());
        }
        if !path.is_file() {
            return Ok(Self::Bundle(Box::new(open_bundle(path)?)));
        }
        let bytes = read_plan_or_onnx(path).map_err(|error| Failure::file(path, &error))?;
        let refused =
            |message: String| Err(Failure::new(Exit::Usage, message).within(path.display()));
        if path.extension().is_some_and(|end| end == "onnx") {
            let name = path.display();
            return refused(format!("a board takes a plan: `sortie compile {name} -o FILE.plan`"));
        }
        let (Header { network, profile, .. }, _) = Header::read(&bytes)
            .map_err(|error| Failure::from(CompileError::from(error)).within(path.display()))?;
        if !matches!(network, Network::Agent | Network::Policy) {
            return refused("an allocator's plan: a board decides for an agent".to_owned());
        }
        if profile == Profile::Fused {
            return Err(fused().within(path.display()));
        }
        if asked.is_some_and(|asked| asked != profile) {
            return refused(format!("this plan is of profile `{}`", profile.name()));
        }
        Ok(Self::Plan(path.to_owned(), AlignedBytes::copy_of(&bytes)))
    }

    /// The bundle, for what a plan alone cannot do.
    pub(super) fn bundle(&self) -> Result<&Bundle, Failure> {
        match self {
            Self::Bundle(bundle) => Ok(bundle),
            Self::Plan(path, _) => {
                let message = "a team plays by a bundle, and this is a plan";
                Err(Failure::new(Exit::Usage, message).within(path.display()))
            }
        }
    }
}

/// The plan by which an agent of a bundle decides, and which of them it is.
pub(super) fn plan_of_agent<'p>(
    bundle: &Bundle,
    plans: &'p AgentPlans,
    agent: usize,
) -> Result<(usize, &'p AlignedBytes), Failure> {
    let graph_of = &bundle.manifest().network.graph_of;
    let graph = if graph_of.is_empty() { Some(&0) } else { graph_of.get(agent) };
    let graph = graph.map(|graph| usize::from(*graph));
    let found = graph.and_then(|graph| Some((graph, plans.plans().get(graph)?)));
    found.ok_or_else(|| {
        let message = format!(
            "there is no agent {agent}: the team has agents 0 to {}",
            graph_of.len().saturating_sub(1)
        );
        Failure::new(Exit::Usage, message).within(bundle.folder().display())
    })
}

/// The plans of a bundle's agents.
pub(super) fn agent_plans(bundle: &Bundle, profile: Profile) -> Result<AgentPlans, Failure> {
    let within = |error: CompileError| Failure::from(error).within(bundle.folder().display());
    plans().agents(bundle, profile).map_err(within)
}

impl Subject {
    /// An agent of a bundle on the first golden cases, `most` of them at most; where `sees_all`, with all their entities visible.
    pub(crate) fn of_bundle(
        bundle: &Bundle,
        profile: Profile,
        agent: usize,
        (most, sees_all): (usize, bool),
    ) -> Result<Self, Failure> {
        let plans = agent_plans(bundle, profile)?;
        match bundle.options() {
            Some(options) => Self::of_options(bundle, (options, profile), &plans, most),
            None => Self::acting((bundle, &plans), agent, None, (most, sees_all)),
        }
    }

    /// Each network of a bundle's agents, on the golden cases or on recorded ones of those that decide by it.
    pub(crate) fn all_of_bundle(
        bundle: &Bundle,
        profile: Profile,
        recorded: Option<&Recording>,
        most: usize,
    ) -> Result<Vec<Self>, Failure> {
        let plans = agent_plans(bundle, profile)?;
        if let Some(options) = bundle.options() {
            if recorded.is_some() {
                let message = "an agent that runs options goes on from tick to tick, which single observations do not tell";
                return Err(Failure::new(Exit::Usage, message).within(bundle.folder().display()));
            }
            return Ok(vec![Self::of_options(bundle, (options, profile), &plans, most)?]);
        }
        let graph_of = &bundle.manifest().network.graph_of;
        let first = |graph: usize| graph_of.iter().position(|of| usize::from(*of) == graph);
        // A network that no agent decides by decides nothing.
        let agents: Vec<usize> = match graph_of.is_empty() {
            true => vec![0],
            false => (0..plans.plans().len()).filter_map(first).collect(),
        };
        let part = |agent| Self::acting((bundle, &plans), agent, recorded, (most, false));
        agents.into_iter().map(part).collect()
    }

    /// An agent of a bundle that sees entities or inputs of fixed sizes.
    fn acting(
        (bundle, plans): (&Bundle, &AgentPlans),
        agent: usize,
        recorded: Option<&Recording>,
        (most, sees_all): (usize, bool),
    ) -> Result<Self, Failure> {
        let (network, contract) = (&bundle.manifest().network, bundle.contract());
        let (index, plan) = plan_of_agent(bundle, plans, agent)?;
        let (name, sizes) = match network.graphs.get(index) {
            Some(graph) => {
                (format!("{}/{}", name_of(bundle), graph.name), [graph.features, graph.actions])
            }
            None => (name_of(bundle), [contract.features, contract.actions]),
        };
        let [features, actions] = sizes.map(usize::from);
        let decides = |seen: &Observation<'_>| {
            let graph = network.graph_of.get(seen.self_index);
            graph.is_none_or(|graph| usize::from(*graph) == index)
        };
        let observed: Box<dyn Iterator<Item = Observation<'_>>> = match recorded {
            Some(recorded) => Box::new(recorded.observations()),
            None => Box::new(bundle.golden().cases.iter().map(|case| case.observation.view())),
        };
        let mut recording = Recording::new(contract.hash(), features, actions);
        for seen in observed.filter(decides).take(most) {
            let available = seen.available.get(..actions).unwrap_or_default();
            let all = EntityMask::first(seen.rows.len() / seen.stride.max(1));
            let visible = if sees_all { all } else { seen.visible };
            recording.add(&Observation { available, visible, ..seen });
        }
        let name = if sees_all { format!("{name}, all visible") } else { name };
        Self::observing(name, plan, &recording)
    }

    /// A plan on random cases, `most` of them at most.
    pub(crate) fn of_plan(
        path: &Path,
        plan: &AlignedBytes,
        seed: u64,
        most: usize,
    ) -> Result<Self, Failure> {
        let within = |error: CompileError| Failure::from(error).within(path.display());
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let loaded = Plan::load(plan.as_slice()).map_err(CompileError::from).map_err(within)?;
        let (header, count) = (loaded.header(), most.min(RANDOM_CASES));
        if header.network == Network::Policy {
            let annex = Annex::of_plan(plan.as_slice()).map_err(within)?;
            let given = match annex {
                Some(Annex { facts, .. }) => random_policy_inputs(count, &facts, seed),
                None => random_inputs(count, &loaded, seed),
            };
            return Self::responding(name, plan, &loaded, &given);
        }
        let [n_max, features, actions] =
            [header.n_max, header.features, header.actions].map(|size| size as usize);
        let mut recording = Recording::new(header.contract, features, actions);
        random_observations(count, n_max, features, actions, seed)
            .iter()
            .for_each(|case| recording.add(&case.view()));
        Self::observing(name, plan, &recording)
    }

    /// An agent that sees entities.
    fn observing(name: String, plan: &AlignedBytes, cases: &Recording) -> Result<Self, Failure> {
        let loaded = Plan::load(plan.as_slice()).map_err(CompileError::from)?;
        let (profile, mut arena) =
            (loaded.header().profile, AlignedBytes::zeroed(loaded.arena_bytes()));
        let policy = PlanPolicy::new(loaded, arena.as_mut_slice());
        let mut policy = policy.map_err(CompileError::from)?;
        Ok(Self {
            name,
            profile,
            program: AGENT,
            files: vec![("SORTIE_PLAN", plan.as_slice().to_vec())],
            read: Vec::new(),
            decisions: cases.observations().count(),
            cases: cases.to_bytes(),
            hash: hash_of(&mut policy, cases.observations()).map_err(cannot_decide)?,
        })
    }

    /// A policy over inputs of fixed sizes. What it remembers goes on from case to case.
    fn responding(
        name: String,
        plan: &AlignedBytes,
        loaded: &Plan<'_>,
        given: &[Vec<Vec<f32>>],
    ) -> Result<Self, Failure> {
        let mut cases = Cases::default();
        for (index, given) in given.iter().enumerate() {
            cases.add(index == 0, given.iter().flatten());
        }
        let numbers: Vec<Vec<f32>> = given.iter().map(|case| case.concat()).collect();
        let (inputs, wanted) = (loaded.inputs().count(), loaded.outputs().count());
        let sizes = [inputs, wanted, loaded.inputs().sum(), loaded.outputs().sum()];
        Ok(Self {
            name,
            profile: loaded.header().profile,
            program: POLICY,
            files: vec![
                ("SORTIE_PLAN", plan.as_slice().to_vec()),
                ("SORTIE_SIZES", words(sizes.map(|size: usize| size as u32))),
            ],
            read: Vec::new(),
            decisions: given.len(),
            cases: cases.to_bytes(),
            hash: responses(loaded, &numbers)?,
        })
    }

    /// An agent that goes from milestone to milestone, through the bundle's golden episodes.
    fn of_options(
        bundle: &Bundle,
        (options, profile): (&OptionsContract, Profile),
        plans: &AgentPlans,
        most: usize,
    ) -> Result<Self, Failure> {
        let (features, actions) =
            (usize::from(bundle.contract().features), usize::from(bundle.contract().actions));
        let mut arenas = plans.arenas(1).map_err(CompileError::from)?;
        let mut policy = plans.policy(&mut arenas).map_err(CompileError::from)?;
        let (available, mut memory) = (vec![1; actions], vec![0.0; policy.hidden()]);
        let (mut cases, mut hash) = (Cases::default(), UtilityHash::default());
        let ticks = bundle.golden().episodes.iter().flat_map(|it| it.ticks.iter().enumerate());
        for (tick, seen) in ticks.take(most) {
            let row = seen.row(features).map_err(|said| Failure::new(Exit::BadData, said))?;
            cases.add(tick == 0, &row);
            if tick == 0 {
                memory.fill(0.0);
            }
            let seen = Observation {
                rows: &row,
                stride: features,
                last_actions: &[],
                visible: EntityMask::first(1),
                self_index: 0,
                available: &available,
            };
            let decision = policy.decide_with(&seen, &mut memory).map_err(cannot_decide)?;
            let Pursuit { goal, steps } =
                Pursuit::of(&memory).unwrap_or(Pursuit { goal: 0, steps: 0 });
            let action = f32::from(decision.action);
            hash.add(&[decision.utility, action, goal as f32, steps as f32]);
        }
        let columns = options.shown().map_err(|said| Failure::new(Exit::BadData, said))?.columns();
        let variables = ["SORTIE_PLAN", "SORTIE_META", "SORTIE_AFFORDANCE"];
        let plan = |plan: &AlignedBytes| plan.as_slice().to_vec();
        let mut files: Vec<_> = variables.into_iter().zip(plans.plans().iter().map(plan)).collect();
        files.push(("SORTIE_RULES", rules(options, [columns, policy.hidden(), actions])));
        Ok(Self {
            name: name_of(bundle),
            profile,
            program: OPTIONS,
            files,
            read: Vec::new(),
            decisions: cases.count(),
            cases: cases.to_bytes(),
            hash: hash.value(),
        })
    }

    /// The hash by another build of this machine's kernels; none of an agent that runs options, whose three plans are loaded
    /// together.
    pub(crate) fn hash_on(&self, build: Build) -> Result<Option<u64>, Failure> {
        let Some(plan) = self.plan().filter(|_| self.program != OPTIONS) else { return Ok(None) };
        let plan = AlignedBytes::copy_of(plan);
        let loaded = Plan::load(plan.as_slice()).map_err(CompileError::from)?.on(build);
        if self.program == POLICY {
            let words = self.cases.as_chunks().0.iter().map(|word| f32::from_le_bytes(*word));
            let words: Vec<f32> = words.skip(1).collect();
            // A word in front of each case says whether an episode begins.
            let cases = words.chunks_exact(1 + loaded.inputs().sum::<usize>());
            let numbers: Vec<Vec<f32>> =
                cases.map(|case| case.iter().skip(1).copied().collect()).collect();
            return responses(&loaded, &numbers).map(Some);
        }
        let cases = Recording::from_bytes(&self.cases)
            .map_err(|error| Failure::new(Exit::BadData, error.to_string()))?;
        let mut arena = AlignedBytes::zeroed(loaded.arena_bytes());
        let mut policy =
            PlanPolicy::new(loaded, arena.as_mut_slice()).map_err(CompileError::from)?;
        hash_of(&mut policy, cases.observations()).map(Some).map_err(cannot_decide)
    }

    /// As a page's program takes it; none of a policy over inputs and of an agent that runs options, which need more than single
    /// observations.
    pub(crate) fn cast(&self) -> Result<Option<Cast>, Failure> {
        let Some(plan) = self.plan().filter(|_| self.program == AGENT) else { return Ok(None) };
        let seen = Recording::from_bytes(&self.cases)
            .map_err(|error| Failure::new(Exit::BadData, error.to_string()))?;
        let golden = |seen: Observation<'_>| GoldenObservation::new(&seen, seen.stride);
        Ok(Some(Cast {
            environment: String::new(),
            set: String::new(),
            contract: 0,
            decision_interval: 1,
            safe_action: None,
            plans: vec![plan.to_vec()],
            plan_of: Vec::new(),
            options: None,
            allocator: None,
            attention: None,
            golden: seen.observations().map(golden).collect(),
        }))
    }

    /// Whether the program that reads its plan takes this one.
    pub(crate) fn can_be_read(&self) -> bool {
        let arena =
            |plan: &[u8]| Header::read(plan).map_or(usize::MAX, |it| it.0.arena_bytes as usize);
        let fits = |plan: &[u8]| plan.len() <= READ_PLAN && arena(plan) <= READ_ARENA;
        self.program != OPTIONS && self.plan().is_some_and(fits)
    }

    /// The first plan.
    fn plan(&self) -> Option<&[u8]> {
        let mut files = self.files.iter().chain(&self.read);
        files.find(|file| file.0 == "SORTIE_PLAN").map(|file| file.1.as_slice())
    }

    /// The same by the program that reads its plan when it starts.
    pub(crate) fn read(self) -> Result<Self, Failure> {
        if self.program == OPTIONS {
            let message =
                "an agent that runs options has its three networks inside: leave `--read` out";
            return Err(Failure::new(Exit::Usage, message).within(self.name));
        }
        let name = format!("{}, read", self.name);
        let read = self.files.into_iter().filter(|file| file.0 == "SORTIE_PLAN").collect();
        Ok(Self { name, program: "sortie-any", files: Vec::new(), read, ..self })
    }
}

/// The hash of what a policy over inputs of fixed sizes answers. What it remembers goes on from case to case.
fn responses(loaded: &Plan<'_>, cases: &[Vec<f32>]) -> Result<u64, Failure> {
    let mut arena = AlignedBytes::zeroed(loaded.arena_bytes());
    let mut states = vec![0.0; loaded.hidden()];
    let mut outputs: Vec<_> = loaded.outputs().map(|length| vec![0.0; length]).collect();
    let mut hash = UtilityHash::default();
    for case in cases {
        let mut rest = case.as_slice();
        let inputs: Vec<&[f32]> =
            loaded.inputs().map_while(|length| rest.split_off(..length)).collect();
        let mut places: Vec<&mut [f32]> = outputs.iter_mut().map(Vec::as_mut_slice).collect();
        loaded
            .respond(arena.as_mut_slice(), &inputs, &mut states, &mut places)
            .map_err(cannot_decide)?;
        outputs.iter().for_each(|output| hash.add(output));
    }
    Ok(hash.value())
}

/// Random numbers for a policy of which nothing is said but how many it takes.
fn random_inputs(count: usize, plan: &Plan<'_>, seed: u64) -> Vec<Vec<Vec<f32>>> {
    let mut numbers = random_states(plan.inputs().sum(), seed);
    let mut case = |_| {
        let mut rest = numbers();
        plan.inputs().map(|length| rest.drain(..length).collect()).collect()
    };
    (0..count).map(&mut case).collect()
}

fn fused() -> Failure {
    let message = "microcontrollers run plans of profile `exact` and `int8`: those have the same bits everywhere";
    Failure::new(Exit::Usage, message)
}

fn name_of(bundle: &Bundle) -> String {
    bundle.folder().file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn cannot_decide(error: DecideError) -> Failure {
    Failure::new(Exit::BadData, error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bundle(name: &str) -> Bundle {
        open_bundle(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models").join(name)).unwrap()
    }

    /// What is in a file of words.
    fn words_of(bytes: &[u8]) -> Vec<u32> {
        bytes.as_chunks().0.iter().map(|word| u32::from_le_bytes(*word)).collect()
    }

    #[test]
    fn an_agent_sees_what_those_of_its_network_see() {
        let bundle = bundle("rover-tower-8");
        let of = |agent| Subject::of_bundle(&bundle, Profile::Exact, agent, (usize::MAX, false));
        let (rover, tower) = (of(0).unwrap(), of(7).unwrap());
        let names = [&rover, &tower].map(|subject| subject.name.as_str());
        assert_eq!(names, ["rover-tower-8/rover", "rover-tower-8/tower"]);
        assert_ne!(rover.files, tower.files);
        let graph_of = &bundle.manifest().network.graph_of;
        let mut seen = 0;
        for (subject, features, graph) in [(&rover, 13, 0), (&tower, 8, 1)] {
            let recording = Recording::from_bytes(&subject.cases).unwrap();
            assert_eq!(recording.features, features);
            assert!(recording.observations().all(|case| graph_of[case.self_index] == graph));
            seen += recording.observations().count();
        }
        assert_eq!(seen, bundle.golden().cases.len());
        let refused = of(8).err().unwrap();
        assert_eq!(refused.exit, Exit::Usage);
        assert!(refused.message.contains("agents 0 to 7"), "{}", refused.message);
    }

    #[test]
    fn an_agent_that_sees_all_sees_every_entity_of_a_case() {
        let bundle = bundle("save-the-city");
        let of = |sees_all| Subject::of_bundle(&bundle, Profile::Exact, 0, (64, sees_all)).unwrap();
        let (seen, all) = (of(false), of(true));
        let visible = |subject: &Subject| -> Vec<usize> {
            let recording = Recording::from_bytes(&subject.cases).unwrap();
            recording.observations().map(|case| case.visible.len()).collect()
        };
        let entities = bundle.golden().cases.iter().map(|case| case.observation.entities());
        assert_eq!(visible(&all), entities.take(64).collect::<Vec<_>>());
        assert!(visible(&seen).iter().sum::<usize>() < visible(&all).iter().sum());
        assert_eq!(
            (seen.name.as_str(), all.name.as_str()),
            ("save-the-city", "save-the-city, all visible")
        );
        assert_ne!(seen.hash, all.hash);
    }

    #[test]
    fn an_agent_that_runs_options_plays_its_golden_episodes() {
        let bundle = bundle("crafting-iron");
        let of = |most| Subject::of_bundle(&bundle, Profile::Exact, 0, (most, false)).unwrap();
        let (all, first) = (of(usize::MAX), of(60));
        let ticks: usize = bundle.golden().episodes.iter().map(|it| it.ticks.len()).sum();
        let case = 1 + usize::from(bundle.contract().features);
        let cases = words_of(&all.cases);
        assert_eq!((cases[0] as usize, cases.len()), (ticks, 1 + ticks * case));
        let begins = cases[1..].iter().step_by(case).filter(|begins| **begins == 1).count();
        assert_eq!(begins, bundle.golden().episodes.len());
        assert_eq!(words_of(&first.cases)[1..], cases[1..=60 * case]);
        assert_ne!(first.hash, all.hash);
        let variables: Vec<&str> = all.files.iter().map(|file| file.0).collect();
        assert_eq!(variables, ["SORTIE_PLAN", "SORTIE_META", "SORTIE_AFFORDANCE", "SORTIE_RULES"]);
    }

    #[test]
    fn one_program_reads_whatever_single_plan_it_is_given() {
        let of = |name| Subject::of_bundle(&bundle(name), Profile::Exact, 0, (8, false)).unwrap();
        let (inside, read) = (of("save-the-city"), of("save-the-city").read().unwrap());
        assert_eq!((read.name.as_str(), read.program), ("save-the-city, read", "sortie-any"));
        assert_eq!(
            (&read.read, &read.cases, read.hash),
            (&inside.files, &inside.cases, inside.hash)
        );
        assert!(read.files.is_empty() && inside.read.is_empty());
        let refused = of("crafting-iron").read().err().unwrap();
        assert_eq!(refused.exit, Exit::Usage);
        assert!(refused.message.contains("--read"), "{}", refused.message);
    }

    #[test]
    fn a_plan_remembers_from_case_to_case() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/embed_c/cart.plan");
        let Named::Plan(path, plan) = Named::open(&path, None).unwrap() else { panic!("a plan") };
        let of = |most| Subject::of_plan(&path, &plan, 1, most).unwrap();
        let (two, all) = (of(2), of(usize::MAX));
        assert_eq!(all.name, "cart.plan");
        assert_eq!(words_of(&all.files[1].1), [1, 1, 1, 1]);
        assert_eq!(words_of(&all.cases)[0] as usize, RANDOM_CASES);
        let loaded = Plan::load(plan.as_slice()).unwrap();
        let (mut arena, mut states) = (AlignedBytes::zeroed(loaded.arena_bytes()), [0.0; 16]);
        let mut hash = UtilityHash::default();
        for case in words_of(&two.cases)[1..].as_chunks::<2>().0 {
            let (position, mut force) = ([f32::from_bits(case[1])], [0.0]);
            let arena = arena.as_mut_slice();
            loaded.respond(arena, &[&position], &mut states, &mut [&mut force]).unwrap();
            hash.add(&force);
        }
        assert_eq!(two.hash, hash.value());
    }
}
