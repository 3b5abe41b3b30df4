//! Reading and writing bundle folders.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::{fs, io};

use sortie_core::allocate::PointingRules;

use crate::contract::{ContractV1, OptionsContract};
use crate::error::BundleError;
use crate::files::{self, MOST_BYTES, hex, sha256};
use crate::golden::{Golden, MIN_ALLOCATIONS, MIN_CASES};
use crate::guards::guards_from_toml;
use crate::manifest::{
    AGENT, AgentGraph, Contract, Environment, FORMAT, Limits, Manifest, Network, OPTION_GRAPHS,
    POINTING, POLICY, PROPOSALS, TEAM_VALUE,
};
use crate::policy_roles::PolicyRoles;
use crate::recording::Recording;

/// The file that vouches for all others.
pub const MANIFEST: &str = "bundle.toml";
/// The team-value network of a learned allocator.
pub const ALLOCATOR: &str = "allocator_team_value.onnx";
/// Trunk, step and critic of an allocator that proposes.
pub const PROPOSAL_PARTS: [&str; 3] =
    ["allocator_trunk.onnx", "allocator_step.onnx", "allocator_critic.onnx"];
/// Encoder and decoder of an allocator that points.
pub const POINTING_PARTS: [&str; 2] = ["allocator_encoder.onnx", "allocator_decoder.onnx"];
/// Their plans.
pub const POINTING_PLANS: [&str; 2] = ["allocator_encoder.plan", "allocator_decoder.plan"];
/// The plan of the allocator's network, or of its three networks.
pub const ALLOCATOR_PLAN: &str = "allocator.plan";
/// What is what in the agent's network, where that is a policy of somebody else and must be said.
pub const POLICY_ROLES: &str = "policy.toml";
/// Observations with expected answers.
pub const GOLDEN: &str = "golden.json";
/// The ranges that agents' observations must lie in.
pub const GUARDS: &str = "guards.toml";
/// The model card.
pub const CARD: &str = "card.md";
/// The learning curve, drawn.
pub const CURVE: &str = "curve.svg";
/// The learning curve, as numbers.
pub const CURVE_DATA: &str = "curve.json";
/// The resolved training configuration, with seed and version.
pub const TRAINING: &str = "train.toml";

/// A bundle that was read and checked: every part has the hash that the manifest states.
#[derive(Clone, Debug)]
pub struct Bundle {
    folder: PathBuf,
    id: [u8; 32],
    manifest: Manifest,
    parts: BTreeMap<String, Vec<u8>>,
    golden: Golden,
    guards: Vec<[f32; 2]>,
}

/// What a new bundle is made of.
#[derive(Clone, Debug)]
pub struct Draft {
    /// What the policy was trained for.
    pub contract: ContractV1,
    /// Where it was trained.
    pub environment: Environment,
    /// The largest domain that it serves.
    pub limits: Limits,
    /// What the networks are.
    pub network: Network,
    /// Observations with expected answers, at least [`MIN_CASES`].
    pub golden: Golden,
    /// The other files by name, [`AGENT`] among them.
    pub parts: BTreeMap<String, Vec<u8>>,
}

impl Bundle {
    /// Reads a bundle folder and checks versions, hashes, contract and golden observations.
    pub fn open(folder: &Path) -> Result<Self, BundleError> {
        let path = folder.join(MANIFEST);
        let bytes = read_file(&path).map_err(|error| match error {
            BundleError::Missing { .. } => BundleError::NotABundle { path: folder.to_owned() },
            error => error,
        })?;
        let manifest = Manifest::parse(&path, &bytes)?;
        let mut parts = BTreeMap::new();
        for (name, want) in &manifest.parts {
            parts.insert(name.clone(), read_part(folder, name, want)?);
        }
        let golden = golden_part(folder, &manifest, &parts)?;
        let allocator = allocator_parts(&manifest.network).iter().map(|name| (*name).to_owned());
        for name in agent_parts(&manifest.network).into_iter().chain(allocator) {
            if !parts.contains_key(&name) {
                return Err(BundleError::Missing { path: folder.join(name) });
            }
        }
        let guards = guards_part(folder, &manifest.contract.v1, &parts)?;
        let (folder, id) = (folder.to_owned(), sha256(&bytes));
        Ok(Self { folder, id, manifest, parts, golden, guards })
    }

    /// What this bundle is made of, to make another of it.
    pub fn draft(&self) -> Draft {
        let mut parts = self.parts.clone();
        // Written anew from the cases.
        parts.remove(GOLDEN);
        Draft {
            contract: self.manifest.contract.v1.clone(),
            environment: self.manifest.contract.environment.clone(),
            limits: self.manifest.limits,
            network: self.manifest.network.clone(),
            golden: self.golden.clone(),
            parts,
        }
    }

    /// The folder that the bundle was read from.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The bundle's id: SHA-256 of `bundle.toml`.
    pub fn id(&self) -> &[u8; 32] {
        &self.id
    }

    /// The content of `bundle.toml`.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// What the policy was trained for.
    pub fn contract(&self) -> &ContractV1 {
        &self.manifest.contract.v1
    }

    /// Observations with expected answers.
    pub fn golden(&self) -> &Golden {
        &self.golden
    }

    /// The first golden observations, so many at most.
    pub fn golden_recording(&self, most: usize) -> Recording {
        let contract = self.contract();
        let (features, actions) = (contract.features.into(), contract.actions.into());
        let mut recording = Recording::new(contract.hash(), features, actions);
        let cases = self.golden.cases.iter().take(most);
        cases.for_each(|case| recording.add(&case.observation.view()));
        recording
    }

    /// A file of the bundle by name.
    pub fn part(&self, name: &str) -> Option<&[u8]> {
        self.parts.get(name).map(Vec::as_slice)
    }

    /// The network of all agents; nothing where they decide by several.
    pub fn agent_onnx(&self) -> &[u8] {
        self.part(AGENT).unwrap_or_default()
    }

    /// The graphs that agents decide by: one for all, or several.
    pub fn agent_graphs(&self) -> Vec<AgentGraph> {
        let graphs = &self.manifest.network.graphs;
        if self.options().is_some() {
            self.option_graphs().into()
        } else if graphs.is_empty() {
            vec![AgentGraph::of_all(self.contract())]
        } else {
            graphs.clone()
        }
    }

    /// Controller, meta-controller and affordances of an agent that goes from milestone to milestone.
    pub fn option_graphs(&self) -> [AgentGraph; 3] {
        AgentGraph::of_options(self.contract())
    }

    /// The network of one of them.
    pub fn graph_onnx(&self, graph: &AgentGraph) -> &[u8] {
        self.part(&graph.onnx_part()).unwrap_or_default()
    }

    /// The rules of an agent that goes from milestone to milestone.
    pub fn options(&self) -> Option<&OptionsContract> {
        self.manifest.network.options.as_ref()
    }

    /// What is said of the agent's network, where that is a policy over inputs of fixed sizes.
    ///
    /// # Errors
    /// `policy.toml` cannot be read.
    pub fn policy_roles(&self) -> Result<Option<PolicyRoles>, BundleError> {
        if self.manifest.network.agent != POLICY {
            return Ok(None);
        }
        let text = self.part(POLICY_ROLES).unwrap_or_default();
        let path = self.folder.join(POLICY_ROLES);
        let roles = PolicyRoles::from_toml(text);
        roles.map(Some).map_err(|reason| BundleError::Invalid { path, reason })
    }

    /// The ranges `[d, 2]` in which what its agents observe must lie; none where they are not guarded.
    pub fn guards(&self) -> &[[f32; 2]] {
        &self.guards
    }

    /// Whether an allocator was learned, of any kind.
    pub fn has_allocator(&self) -> bool {
        self.manifest.network.allocator.is_some()
    }

    /// The team-value network, where the allocator is of this kind.
    pub fn allocator_onnx(&self) -> Option<&[u8]> {
        let kind = self.manifest.network.allocator.as_deref();
        kind.filter(|kind| *kind == TEAM_VALUE).and_then(|_| self.part(ALLOCATOR))
    }

    /// Trunk, step and critic, where the allocator proposes.
    pub fn proposal_graphs(&self) -> Option<[&[u8]; 3]> {
        let kind = self.manifest.network.allocator.as_deref();
        let [trunk, step, critic] = PROPOSAL_PARTS.map(|name| self.part(name));
        kind.filter(|kind| *kind == PROPOSALS).and(Some([trunk?, step?, critic?]))
    }

    /// Encoder and decoder, where the allocator points, and what it can give.
    pub fn pointing_graphs(&self) -> Option<([&[u8]; 2], PointingRules)> {
        let rules = self.manifest.network.pointing.as_ref()?.rules();
        let [encoder, decoder] = POINTING_PARTS.map(|name| self.part(name));
        Some(([encoder?, decoder?], rules))
    }
}

impl Draft {
    /// Writes the bundle to a new folder, all or nothing, and returns what was written.
    ///
    /// The files are written beside the folder and moved into place by one rename.
    pub fn write(&self, folder: &Path) -> Result<Bundle, BundleError> {
        if folder.exists() {
            return Err(BundleError::Exists { path: folder.to_owned() });
        }
        let parts = self.all_parts(folder)?;
        let text = self.manifest_text(folder, &parts)?;
        let name = folder.file_name().unwrap_or_default().to_string_lossy();
        let draft = folder.with_file_name(format!(".{name}.{}", std::process::id()));
        let written = write_files(&draft, &parts, &text).and_then(|()| {
            fs::rename(&draft, folder)
                .map_err(|source| BundleError::Io { path: folder.to_owned(), source })
        });
        if let Err(error) = written {
            // The first error matters; a draft that cannot be removed either changes nothing.
            let _ = fs::remove_dir_all(&draft);
            return Err(error);
        }
        Bundle::open(folder)
    }

    /// The bundle as it will be in `folder`, without writing it: what compiles its plans looks at it.
    ///
    /// # Errors
    /// A part is missing, or does not fit.
    pub fn unwritten(&self, folder: &Path) -> Result<Bundle, BundleError> {
        let parts = self.all_parts(folder)?;
        let text = self.manifest_text(folder, &parts)?;
        Ok(Bundle {
            folder: folder.to_owned(),
            id: sha256(text.as_bytes()),
            manifest: self.manifest(&parts),
            guards: guards_part(folder, &self.contract, &parts)?,
            parts,
            golden: self.golden.clone(),
        })
    }

    fn manifest_text(
        &self,
        folder: &Path,
        parts: &BTreeMap<String, Vec<u8>>,
    ) -> Result<String, BundleError> {
        toml::to_string_pretty(&self.manifest(parts)).map_err(|error| BundleError::Invalid {
            path: folder.join(MANIFEST),
            reason: error.to_string(),
        })
    }

    fn all_parts(&self, folder: &Path) -> Result<BTreeMap<String, Vec<u8>>, BundleError> {
        let invalid = |name: &str, reason: String| {
            Err(BundleError::Invalid { path: folder.join(name), reason })
        };
        if let Some(flaw) = self.contract.flaw().or_else(|| self.limits.flaw()) {
            return invalid(MANIFEST, flaw);
        }
        if let Some(flaw) = self.network.graphs_flaw(&self.contract) {
            return invalid(MANIFEST, flaw);
        }
        let agents = agent_parts(&self.network);
        if let Some(name) = agents.iter().find(|name| !self.parts.contains_key(*name)) {
            return invalid(name, "a bundle needs the agents' networks".to_owned());
        }
        if let Some(name) = self.parts.keys().find(|name| !is_plain(name)) {
            return invalid(name, "not a plain file name, or one that the bundle uses".to_owned());
        }
        let needed = allocator_parts(&self.network);
        for name in [ALLOCATOR].iter().chain(&PROPOSAL_PARTS).chain(&POINTING_PARTS) {
            if needed.contains(name) != self.parts.contains_key(*name) {
                return invalid(name, "an allocator needs its kind and its network".to_owned());
            }
        }
        if let Some(flaw) = golden_flaw(&self.golden, &self.network) {
            return invalid(GOLDEN, flaw);
        }
        let mut parts = self.parts.clone();
        match self.golden.to_json(&self.contract) {
            Ok(json) => parts.insert(GOLDEN.to_owned(), json),
            Err(error) => return invalid(GOLDEN, error.to_string()),
        };
        Ok(parts)
    }

    fn manifest(&self, parts: &BTreeMap<String, Vec<u8>>) -> Manifest {
        let hashed = |(name, bytes): (&String, &Vec<u8>)| (name.clone(), hex(&sha256(bytes)));
        Manifest {
            format: self.network.format(parts.contains_key(GUARDS)),
            contract: Contract {
                hash: format!("{:016x}", self.contract.hash()),
                environment: self.environment.clone(),
                v1: self.contract.clone(),
            },
            limits: self.limits,
            network: self.network.clone(),
            parts: parts.iter().map(hashed).collect(),
        }
    }
}

impl Manifest {
    /// Reads the bytes of a `bundle.toml` and checks version, contract and the names of the parts.
    ///
    /// `path` is what errors name.
    pub fn parse(path: &Path, bytes: &[u8]) -> Result<Self, BundleError> {
        let invalid = |reason: String| BundleError::Invalid { path: path.to_owned(), reason };
        let text = str::from_utf8(bytes).map_err(|error| invalid(error.to_string()))?;
        let unreadable =
            |source| BundleError::Manifest { path: path.to_owned(), source: Box::new(source) };
        // The version first: a newer file may have fields that this program does not know.
        let table: toml::Table = text.parse().map_err(unreadable)?;
        let format = table.get("format").and_then(toml::Value::as_integer).unwrap_or(0);
        if format > i64::from(FORMAT) {
            let got = u32::try_from(format).unwrap_or(u32::MAX);
            return Err(BundleError::Version { path: path.to_owned(), got, max: FORMAT });
        }
        let manifest: Manifest = toml::from_str(text).map_err(unreadable)?;
        let flaw = manifest.contract.v1.flaw().or_else(|| manifest.limits.flaw());
        if let Some(flaw) = flaw {
            return Err(invalid(flaw));
        }
        let (want, got) =
            (&manifest.contract.hash, format!("{:016x}", manifest.contract.v1.hash()));
        if *want != got {
            return Err(BundleError::Contract { path: path.to_owned(), want: want.clone(), got });
        }
        if let Some(flaw) = manifest.network.graphs_flaw(&manifest.contract.v1) {
            return Err(invalid(format!("{flaw}, in [network]")));
        }
        let known = |kind: &String| [TEAM_VALUE, PROPOSALS, POINTING].contains(&kind.as_str());
        if let Some(kind) = manifest.network.allocator.as_ref().filter(|kind| !known(kind)) {
            return Err(invalid(format!("allocator `{kind}` is not known: update sortie")));
        }
        if let Some(name) = manifest.parts.keys().find(|name| *name != GOLDEN && !is_plain(name)) {
            return Err(invalid(format!("`{name}` in [parts] is not a plain file name")));
        }
        Ok(manifest)
    }
}

/// The networks that agents decide by.
fn agent_parts(network: &Network) -> Vec<String> {
    if network.options.is_some() {
        return OPTION_GRAPHS.map(|name| AgentGraph::part_of(name, AGENT)).into();
    }
    match network.graphs.as_slice() {
        [] => vec![AGENT.to_owned()],
        graphs => graphs.iter().map(AgentGraph::onnx_part).collect(),
    }
}

/// The networks that an allocator of this kind consists of.
fn allocator_parts(network: &Network) -> &'static [&'static str] {
    match network.allocator.as_deref() {
        Some(TEAM_VALUE) => &[ALLOCATOR],
        Some(PROPOSALS) => &PROPOSAL_PARTS,
        Some(POINTING) => &POINTING_PARTS,
        _ => &[],
    }
}

/// Reads a file of a bundle: nothing that waits, as a pipe would, and nothing that no bundle holds.
fn read_file(path: &Path) -> Result<Vec<u8>, BundleError> {
    let failed = |source: io::Error| match source.kind() {
        io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => {
            BundleError::Missing { path: path.to_owned() }
        }
        _ => BundleError::Io { path: path.to_owned(), source },
    };
    let found = fs::metadata(path).map_err(failed)?;
    if !found.is_file() {
        return Err(BundleError::NotAFile { path: path.to_owned() });
    }
    if found.len() > MOST_BYTES {
        let (path, bytes) = (path.to_owned(), found.len());
        return Err(BundleError::TooLarge { path, bytes, max: MOST_BYTES });
    }
    files::read_file(path, MOST_BYTES).map_err(failed)
}

fn read_part(folder: &Path, name: &str, want: &str) -> Result<Vec<u8>, BundleError> {
    let path = folder.join(name);
    let bytes = read_file(&path)?;
    let got = hex(&sha256(&bytes));
    if got != want {
        return Err(BundleError::Hash { path, want: want.to_owned(), got });
    }
    Ok(bytes)
}

fn golden_part(
    folder: &Path,
    manifest: &Manifest,
    parts: &BTreeMap<String, Vec<u8>>,
) -> Result<Golden, BundleError> {
    let path = folder.join(GOLDEN);
    let Some(json) = parts.get(GOLDEN) else { return Err(BundleError::Missing { path }) };
    let invalid = |reason| BundleError::Invalid { path: path.clone(), reason };
    let golden = Golden::from_json(json, &manifest.contract.v1).map_err(invalid)?;
    match golden_flaw(&golden, &manifest.network) {
        Some(flaw) => Err(invalid(flaw)),
        None => Ok(golden),
    }
}

fn guards_part(
    folder: &Path,
    contract: &ContractV1,
    parts: &BTreeMap<String, Vec<u8>>,
) -> Result<Vec<[f32; 2]>, BundleError> {
    let Some(text) = parts.get(GUARDS) else { return Ok(Vec::new()) };
    guards_from_toml(text, contract)
        .map_err(|reason| BundleError::Invalid { path: folder.join(GUARDS), reason })
}

/// What is missing among the golden cases.
fn golden_flaw(golden: &Golden, network: &Network) -> Option<String> {
    let (cases, allocations) = (golden.cases.len(), golden.allocations.len());
    if cases < MIN_CASES {
        return Some(format!("{cases} cases, at least {MIN_CASES} are needed"));
    }
    if network.options.is_some() == golden.episodes.is_empty() {
        return Some(
            "golden episodes belong to agents that run options, and they need some".to_owned(),
        );
    }
    let deciding: BTreeSet<Option<u16>> = golden
        .cases
        .iter()
        .map(|case| network.graph_of.get(case.observation.self_index).copied())
        .collect();
    if !network.graphs.is_empty() && deciding.contains(&None) {
        return Some(format!("a case is of an agent that is none of {}", network.graph_of.len()));
    }
    let mut graphs = network.graphs.iter().zip(0..);
    if let Some((graph, _)) = graphs.find(|(_, index)| !deciding.contains(&Some(*index))) {
        return Some(format!("no case is of an agent that decides by the graph `{}`", graph.name));
    }
    let records = [Some(TEAM_VALUE), Some(POINTING)].contains(&network.allocator.as_deref());
    let few = records && allocations < MIN_ALLOCATIONS;
    few.then(|| format!("{allocations} allocations, at least {MIN_ALLOCATIONS} are needed"))
}

fn write_files(
    folder: &Path,
    parts: &BTreeMap<String, Vec<u8>>,
    manifest: &str,
) -> Result<(), BundleError> {
    let put = |path: PathBuf, bytes: &[u8]| {
        fs::write(&path, bytes).map_err(|source| BundleError::Io { path, source })
    };
    fs::create_dir_all(folder)
        .map_err(|source| BundleError::Io { path: folder.to_owned(), source })?;
    for (name, bytes) in parts {
        put(folder.join(name), bytes)?;
    }
    put(folder.join(MANIFEST), manifest.as_bytes())
}

/// Whether a name stays inside the folder and is not one that the bundle writes itself.
fn is_plain(name: &str) -> bool {
    let simple = Path::new(name).file_name().is_some_and(|last| last == name);
    simple && !name.starts_with('.') && name != MANIFEST && name != GOLDEN
}
