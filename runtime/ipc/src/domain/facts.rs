//! What a running domain is, in a file that every process reads before it joins.

use std::fs;
use std::io;
use std::path::Path;
use std::time::Duration;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use sortie_core::Shape;
use sortie_core::identity::schema_hash;
use sortie_core::wire::{ABI, FrameFormat, FrameLayout};

use super::bundles::{TeamBundle, TeamBundles, model_text};
use super::{BellKind, Domain};
use crate::error::Error;
use crate::stop::Stop;

const FILE: &str = "domain.toml";
/// Pause between two looks for the file.
const LOOK_EVERY: Duration = Duration::from_millis(10);

/// What a policy was trained for, as far as messaging goes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DomainContract {
    /// Hash of all fields.
    pub hash: u64,
    /// Ticks between two allocations.
    pub decision_interval: u32,
    /// Whether a policy attends only to its own subtask, and so needs allocations.
    pub subtasks: bool,
    /// Action of an agent without a subtask, and the fallback after the last action.
    pub safe_action: Option<u16>,
    /// First 16 bytes of the id of the team's bundle.
    pub model: [u8; 16],
    /// The name of the bundle's folder, by which a team that changes bundles finds it again; `None` where it cannot.
    pub bundle: Option<String>,
    /// Who allocates; `None` where it does not matter to this process.
    pub allocation: Option<String>,
    /// From what it draws.
    pub draws: Option<Draws>,
    /// Whether a team of another bundle, or one that allocates otherwise, is joined as well.
    pub mixes_teams: bool,
    /// All fields by name, so that a mismatch can name the first that differs.
    pub fields: toml::Table,
}

/// From what a team's allocator draws, if it does: whoever has it decides the same.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Draws {
    /// Decimal: TOML has no unsigned 64-bit numbers.
    seed: String,
    /// How many allocations are proposed, where somebody said how many.
    pub proposals: Option<u16>,
}

impl Draws {
    /// Those of this seed.
    pub fn new(seed: u64, proposals: Option<u16>) -> Self {
        Self { seed: seed.to_string(), proposals }
    }

    /// Of the generator.
    pub fn seed(&self) -> u64 {
        self.seed.parse().unwrap_or(0)
    }
}

/// What a running domain is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DomainFacts {
    abi: u16,
    /// Hexadecimal: TOML has no unsigned 64-bit numbers.
    contract_hash: String,
    agents: usize,
    entities: usize,
    tasks: usize,
    actions: usize,
    features: usize,
    bell: BellKind,
    /// Nanoseconds from frame to frame; 0 = as long as the team takes.
    period_ns: u64,
    /// Every agent gets its own frame, with what it sees.
    private: bool,
    allocation: Option<String>,
    bundles: TeamBundles,
    draws: Option<Draws>,
    contract: toml::Table,
}

impl DomainFacts {
    /// The facts of a world of this contract and shape.
    pub fn new(contract: &DomainContract, shape: Shape) -> Self {
        let Shape { agents, entities, tasks, actions, features } = shape;
        Self {
            abi: ABI,
            contract_hash: format!("{:016x}", contract.hash),
            agents,
            entities,
            tasks,
            actions,
            features,
            bell: BellKind::default(),
            period_ns: 0,
            private: false,
            allocation: contract.allocation.clone(),
            bundles: TeamBundles::new(TeamBundle {
                name: contract.bundle.clone().unwrap_or_default(),
                model: model_text(contract.model),
            }),
            draws: contract.draws.clone(),
            contract: contract.fields.clone(),
        }
    }

    /// The same with bells of this kind.
    pub fn with_bell(self, bell: BellKind) -> Self {
        Self { bell, ..self }
    }

    /// The same with this time from frame to frame; zero = as long as the team takes.
    pub fn with_period(self, period: Duration) -> Self {
        // TOML has no unsigned 64-bit numbers; its largest is 292 years.
        Self { period_ns: nanoseconds(period).min(i64::MAX as u64), ..self }
    }

    /// The same with a frame for all, or a private one for each agent.
    pub fn with_private_frames(self, private: bool) -> Self {
        Self { private, ..self }
    }

    /// Whether every agent gets its own frame, with what it sees.
    pub fn has_private_frames(&self) -> bool {
        self.private
    }

    /// Whether the world says who allocates.
    pub fn has_allocation(&self) -> bool {
        self.allocation.is_some()
    }

    /// Who allocates, where the world says so.
    pub fn allocation(&self) -> Option<&str> {
        self.allocation.as_deref()
    }

    /// From what they draw, where the world says so.
    pub fn draws(&self) -> Option<&Draws> {
        self.draws.as_ref()
    }

    /// Nanoseconds from frame to frame; 0 = as long as the team takes.
    pub fn period_ns(&self) -> u64 {
        self.period_ns
    }

    /// The first 16 bytes of the id of the bundle that the team decides by, hexadecimal.
    pub fn model(&self) -> &str {
        &self.bundles.in_use().model
    }

    /// The bundle that the team decides by, and the one that it may change to.
    pub fn bundles(&self) -> &TeamBundles {
        &self.bundles
    }

    /// The same, to change them.
    pub(crate) fn bundles_mut(&mut self) -> &mut TeamBundles {
        &mut self.bundles
    }

    /// All fields of the contract by name.
    pub fn contract(&self) -> &toml::Table {
        &self.contract
    }

    /// How the domain's processes wake each other.
    pub fn bell(&self) -> BellKind {
        self.bell
    }

    /// The padded sizes.
    pub fn shape(&self) -> Shape {
        Shape {
            agents: self.agents,
            entities: self.entities,
            tasks: self.tasks,
            actions: self.actions,
            features: self.features,
        }
    }

    /// Hash of the contract that the team acts under.
    pub fn contract_hash(&self) -> u64 {
        u64::from_str_radix(&self.contract_hash, 16).unwrap_or(0)
    }

    /// The frames of the domain as a whole.
    ///
    /// # Errors
    /// The shape is over the limits of frames.
    pub fn format(&self) -> Result<FrameFormat, Error> {
        let layout = FrameLayout::new(self.shape())?;
        // The limits of a layout fit 16 bits.
        let [agents, entities, tasks] = [self.agents, self.entities, self.tasks].map(|n| n as u16);
        let schema = schema_hash(self.contract_hash(), agents, entities, tasks);
        Ok(FrameFormat { schema, layout })
    }

    /// The private frames of `agent`, where the domain's are private.
    ///
    /// # Errors
    /// As [`Self::format`]; there is no such agent, or no row for it.
    pub fn private_format(&self, agent: usize) -> Result<FrameFormat, Error> {
        Ok(FrameFormat { layout: FrameLayout::private(self.shape(), agent)?, ..self.format()? })
    }

    /// Checks that a runner reads the frames that this domain has.
    ///
    /// # Errors
    /// [`Error::Frames`].
    pub(crate) fn check_frames(&self, domain: &Domain, private: bool) -> Result<(), Error> {
        if self.private == private {
            return Ok(());
        }
        Err(Error::Frames { domain: domain.id().to_string(), are_private: self.private })
    }

    /// Checks that a process of `contract` fits this domain.
    ///
    /// # Errors
    /// [`Error::Contract`], which names both ABIs or the first field that differs; or [`Error::OtherTeam`].
    pub(crate) fn check(&self, domain: &Domain, contract: &DomainContract) -> Result<(), Error> {
        let detail = if self.abi != ABI {
            format!("messages are of ABI {ABI} here, {} there", self.abi)
        } else if self.contract_hash() != contract.hash || self.contract != contract.fields {
            first_difference(&contract.fields, &self.contract)
        } else {
            return self.check_team(domain, contract);
        };
        Err(self.other_contract(domain, contract, detail))
    }

    fn other_contract(&self, domain: &Domain, contract: &DomainContract, detail: String) -> Error {
        let (ours, theirs) = (contract.hash, self.contract_hash());
        Error::Contract { domain: domain.id().to_string(), ours, theirs, detail }
    }

    /// Checks that a process of `contract` is of this domain's team, or joins any.
    fn check_team(&self, domain: &Domain, contract: &DomainContract) -> Result<(), Error> {
        let other = |what, ours: &str, theirs: &str| Error::OtherTeam {
            domain: domain.id().to_string(),
            what,
            ours: ours.to_string(),
            theirs: theirs.to_string(),
        };
        let ours = model_text(contract.model);
        if contract.mixes_teams {
            return Ok(());
        }
        if ours != self.model() {
            let short = |model: &str| model.chars().take(8).collect::<String>();
            return Err(other("bundle", &short(&ours), &short(self.model())));
        }
        match (&contract.allocation, &self.allocation) {
            (Some(ours), Some(theirs)) if ours != theirs => {
                Err(other("allocation rule", ours, theirs))
            }
            _ => Ok(()),
        }
    }

    /// Checks that a world of `ours` fits this domain.
    ///
    /// # Errors
    /// [`Error::OtherRate`], or [`Error::OtherWorld`], which names both shapes, kinds of bells, or kinds of frames.
    pub(crate) fn check_world(&self, domain: &Domain, ours: &DomainFacts) -> Result<(), Error> {
        let domain = domain.id().to_string();
        let detail = if self.shape() != ours.shape() {
            format!("the world is {:?} here, {:?} there", ours.shape(), self.shape())
        } else if self.bell != ours.bell {
            format!("bells are {:?} here, {:?} there", ours.bell, self.bell)
        } else if self.private != ours.private {
            let name = |private| if private { "private" } else { "shared" };
            format!("frames are {} here, {} there", name(ours.private), name(self.private))
        } else if self.period_ns != ours.period_ns {
            return Err(Error::OtherRate { domain, ours: ours.period_ns, theirs: self.period_ns });
        } else {
            return Ok(());
        };
        Err(Error::OtherWorld { domain, detail })
    }
}

pub(crate) fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

fn first_difference(ours: &toml::Table, theirs: &toml::Table) -> String {
    let names = ours.keys().chain(theirs.keys().filter(|name| !ours.contains_key(*name)));
    for name in names {
        let (here, there) = (ours.get(name), theirs.get(name));
        if here != there {
            let show = |value: Option<&toml::Value>| value.map_or("none".into(), short);
            return format!("`{name}` is {} here, {} there", show(here), show(there));
        }
    }
    "all named fields are equal".to_string()
}

/// A value in at most 60 characters.
fn short(value: &toml::Value) -> String {
    let text = value.to_string();
    match text.char_indices().nth(60) {
        Some((end, _)) => format!("{} …", text.get(..end).unwrap_or_default()),
        None => text,
    }
}

pub(super) fn write(domain: &Domain, facts: &DomainFacts) -> Result<(), Error> {
    write_file(domain, FILE, facts)
}

/// Writes what is stated in a file of the domain. Readers see the whole file or none.
pub(crate) fn write_file(domain: &Domain, name: &str, facts: &impl Serialize) -> Result<(), Error> {
    let path = domain.path(name);
    let text = toml::to_string(facts)
        .map_err(|error| Error::BadFile { path: path.clone(), problem: error.to_string() })?;
    let unfinished = path.with_extension("toml.new");
    fs::write(&unfinished, text).map_err(Error::io("write", &unfinished))?;
    fs::rename(&unfinished, &path).map_err(Error::io("write", &path))
}

/// The facts, if the domain has a world.
pub(super) fn read(domain: &Domain) -> Result<Option<DomainFacts>, Error> {
    read_file(domain, FILE)
}

/// What a file of the domain states, if there is one.
pub(crate) fn read_file<T: DeserializeOwned>(
    domain: &Domain,
    name: &str,
) -> Result<Option<T>, Error> {
    let path = domain.path(name);
    let text = match fs::read_to_string(&path) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(Error::io("read", &path)(error)),
    };
    parse(&path, &text).map(Some)
}

fn parse<T: DeserializeOwned>(path: &Path, text: &str) -> Result<T, Error> {
    toml::from_str(text)
        .map_err(|error| Error::BadFile { path: path.to_path_buf(), problem: error.to_string() })
}

/// Waits for a world to write the facts.
pub(super) fn wait_for(
    domain: &Domain,
    patience: Duration,
    stop: &Stop,
) -> Result<DomainFacts, Error> {
    let started = std::time::Instant::now();
    loop {
        if let Some(facts) = read(domain)? {
            return Ok(facts);
        }
        if stop.is_set() {
            return Err(Error::Interrupted);
        }
        if started.elapsed() >= patience {
            return Err(Error::NoWorld { domain: domain.id().to_string() });
        }
        std::thread::sleep(LOOK_EVERY);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn contract(hash: u64, actions: i64) -> DomainContract {
        let mut fields = toml::Table::new();
        fields.insert("environment".into(), "city".into());
        fields.insert("actions".into(), actions.into());
        DomainContract { hash, fields, ..DomainContract::default() }
    }

    #[test]
    fn a_mismatch_names_the_first_field_that_differs() {
        let shape = Shape { agents: 2, entities: 3, tasks: 1, actions: 4, features: 5 };
        let domain = Domain::under(Path::new("/dev/shm"), "facts").unwrap();
        let facts = DomainFacts::new(&contract(7, 4), shape);
        assert!(facts.check(&domain, &contract(7, 4)).is_ok());
        let error = facts.check(&domain, &contract(8, 5)).unwrap_err();
        assert_eq!(
            error.to_string(),
            "domain `facts` runs another contract: here 0000000000000008, there \
             0000000000000007; `actions` is 5 here, 4 there"
        );
        assert_eq!(error.exit_code(), 78);
        // What a network takes may be the same where the world is another.
        let mut elsewhere = contract(7, 4);
        elsewhere.fields.insert("environment".into(), "harbour".into());
        let error = facts.check(&domain, &elsewhere).unwrap_err().to_string();
        assert!(error.ends_with("`environment` is \"harbour\" here, \"city\" there"), "{error}");
    }

    #[test]
    fn worlds_differ_by_rate_or_in_kind() {
        let shape = Shape { agents: 2, entities: 3, tasks: 1, actions: 4, features: 5 };
        let domain = Domain::under(Path::new("/dev/shm"), "facts").unwrap();
        let world = |hz: f64| {
            let period = if hz == 0.0 { 0.0 } else { 1.0 / hz };
            let facts = DomainFacts::new(&contract(7, 4), shape);
            facts.with_period(Duration::from_secs_f64(period))
        };
        let refused = |ours: &DomainFacts, theirs: &DomainFacts| {
            let error = theirs.check_world(&domain, ours).unwrap_err();
            (error.to_string(), error.exit_code())
        };
        assert!(world(30.0).check_world(&domain, &world(30.0)).is_ok());
        let told = |theirs: &str, ours: &str| {
            (format!("domain `facts` has a team that runs {theirs}, this one would {ours}"), 75)
        };
        assert_eq!(refused(&world(0.0), &world(200.0)), told("at 200 Hz", "as fast as it acts"));
        assert_eq!(refused(&world(30.0), &world(0.025)), told("at 0.025 Hz", "at 30 Hz"));
        let private = world(30.0).with_private_frames(true);
        let other = "domain `facts` has another world: frames are private here, shared there";
        assert_eq!(refused(&private, &world(30.0)), (other.to_string(), 78));
    }

    #[test]
    fn comes_back_from_its_file() {
        let shape = Shape { agents: 2, entities: 3, tasks: 1, actions: 4, features: 5 };
        let facts = DomainFacts::new(&contract(u64::MAX, 4), shape);
        let text = toml::to_string(&facts).unwrap();
        assert_eq!(parse::<DomainFacts>(Path::new(FILE), &text).unwrap(), facts);
        assert_eq!(facts.shape(), shape);
    }
}
