//! What a record holds: the domain, its bundles, who was there, and all messages again and again.

use std::collections::BTreeSet;
use std::collections::btree_map::{BTreeMap, Entry};
use std::fs::{self, File};
use std::io::BufReader;
use std::path::{Path, PathBuf};

use sortie_bundle::Bundle;
use sortie_core::plan::AlignedBytes;
use sortie_core::wire::{ActionMsg, AllocMsg, FrameFormat, FrameHeader, FrameView, Role, StatMsg};
use sortie_ipc::{DomainFacts, Heard, ProcessInfo};
use sortie_record::{Reader, Record, RecordError};
use tempfile::TempDir;
use zerocopy::FromBytes;

use crate::allocator::ProposalArguments;
use crate::deployment::open_bundle;
use crate::failure::{Exit, Failure};

/// A frame as it was sent.
pub(super) struct Shown {
    pub(super) header: FrameHeader,
    /// At an address as views of it want.
    pub(super) payload: AlignedBytes,
}

impl Shown {
    fn new(header: &FrameHeader, payload: &[u8]) -> Self {
        Self { header: *header, payload: AlignedBytes::copy_of(payload) }
    }

    pub(super) fn view(&self, format: &FrameFormat) -> Result<FrameView<'_>, Failure> {
        FrameView::new(&self.header, self.payload.as_slice(), format)
            .map_err(|error| Failure::new(Exit::BadData, error.to_string()))
    }
}

/// What a record tells again.
pub(super) enum Told {
    Frame(Shown),
    Action(ActionMsg),
    Allocation(AllocMsg),
}

impl Told {
    /// What a running team said, where it is of a decision.
    pub(super) fn of(heard: Heard<'_>) -> Option<Self> {
        match heard {
            Heard::Frame(header, payload) => Some(Self::Frame(Shown::new(header, payload))),
            Heard::Action(action) => Some(Self::Action(*action)),
            Heard::Allocation(allocation) => Some(Self::Allocation(*allocation)),
            Heard::Status(_) => None,
        }
    }

    fn again(&self) -> Self {
        match self {
            Self::Frame(Shown { header, payload }) => {
                Self::Frame(Shown::new(header, payload.as_slice()))
            }
            Self::Action(action) => Self::Action(*action),
            Self::Allocation(allocation) => Self::Allocation(*allocation),
        }
    }
}

/// A record, read once to know what is in it.
pub(super) struct Contents {
    path: PathBuf,
    /// What was heard of a running team, in the place of a file.
    heard: Option<Vec<Told>>,
    pub(super) facts: DomainFacts,
    pub(super) format: FrameFormat,
    /// Processes that answered.
    pub(super) runners: BTreeSet<u32>,
    /// Those whose network runs in an engine.
    pub(super) engines: BTreeSet<u32>,
    pub(super) frames: u64,
    /// Where it was cut off, if it was.
    pub(super) torn_at: Option<u64>,
    /// The files of the team's bundles, as far as the record has them, by what it calls the bundles.
    attached: BTreeMap<String, TempDir>,
}

impl Contents {
    /// Reads all of it once.
    pub(super) fn read(path: &Path) -> Result<Self, Failure> {
        let (mut domain, mut attached) = (None, BTreeMap::new());
        let (mut runners, mut engines, mut frames) = (BTreeSet::new(), BTreeSet::new(), 0);
        let mut topics = Topics::default();
        let torn_at = each(path, &mut |record| {
            match record {
                Record::Attachment { name: "domain.toml", data } => {
                    domain = Some(String::from_utf8_lossy(data).into_owned());
                }
                Record::Attachment { name, data } => {
                    if let Some(name) = name.strip_prefix("bundle/") {
                        keep(&mut attached, name, data)?;
                    }
                }
                Record::Message(message, data) => match topics.of(message.channel) {
                    Some("/frame") => frames += 1,
                    Some("/action") => drop(runners.insert(read::<ActionMsg>(data)?.runner)),
                    Some("/status") => {
                        let status: StatMsg = read(data)?;
                        if status.has(StatMsg::GRAPH) {
                            engines.insert(status.pid);
                        }
                    }
                    _ => {}
                },
                other => topics.learn(&other),
            }
            Ok(())
        })?;
        let none = || bad(path, "it is no record of a team: it brings no `domain.toml`");
        let domain = domain.ok_or_else(none)?;
        let facts: DomainFacts = toml::from_str(&domain).map_err(|error| bad(path, error))?;
        // A record of others may state sizes that no domain has.
        let format = facts.format().map_err(|error| bad(path, error))?;
        let (path, heard) = (path.to_owned(), None);
        Ok(Self { path, heard, facts, format, runners, engines, frames, torn_at, attached })
    }

    /// Whether what an answer was given to was heard of a running team: its frame, its allocation, and the frame of that, which
    /// whoever begins to listen may have missed.
    pub(super) fn has_what_it_saw(&self, answer: &ActionMsg) -> bool {
        let heard = || self.heard.iter().flatten();
        let has_frame = |tick: u64| {
            heard().any(|told| matches!(told, Told::Frame(it) if it.header.tick == tick))
        };
        let order = (answer.alloc_term, answer.alloc_epoch);
        let allocation = heard().find_map(|told| match told {
            Told::Allocation(it) if it.order() == order => Some(it),
            _ => None,
        });
        let has_allocation = allocation.is_some_and(|it| has_frame(it.tick));
        has_frame(answer.tick) && (order == (0, 0) || has_allocation)
    }

    /// What a running team is, which tells the rest itself.
    pub(super) fn of_team(facts: &DomainFacts, processes: &[ProcessInfo]) -> Result<Self, Failure> {
        let path = PathBuf::from("the running team");
        let format = facts.format()?;
        let runners = processes.iter().filter(|process| process.role == Role::Runner);
        let runners =
            runners.filter(|process| !process.serves).map(|process| process.pid).collect();
        Ok(Self {
            path,
            heard: Some(Vec::new()),
            facts: facts.clone(),
            format,
            runners,
            engines: BTreeSet::new(),
            frames: 0,
            torn_at: None,
            attached: BTreeMap::new(),
        })
    }

    /// Keeps what a running team said.
    pub(super) fn hear(&mut self, heard: Heard<'_>) {
        match heard {
            Heard::Action(action) => drop(self.runners.insert(action.runner)),
            Heard::Status(status) if status.has(StatMsg::GRAPH) => {
                self.engines.insert(status.pid);
            }
            Heard::Frame(..) | Heard::Allocation(_) | Heard::Status(_) => {}
        }
        self.heard.get_or_insert_default().extend(Told::of(heard));
    }

    /// Where it comes from.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Refuses a bundle that acts under another contract than the team did.
    pub(super) fn check(&self, bundle: &Bundle) -> Result<(), Failure> {
        let (ours, theirs) = (bundle.contract().hash(), self.facts.contract_hash());
        if ours == theirs {
            return Ok(());
        }
        let (path, folder) = (self.path.display(), bundle.folder().display());
        let message = format!("{path} is of contract {theirs:016x}, {folder} has {ours:016x}");
        Err(Failure::new(Exit::Mismatch, message))
    }

    /// From what its allocator drew.
    pub(super) fn draws(&self) -> (u64, ProposalArguments) {
        let draws = self.facts.draws().cloned().unwrap_or_default();
        (draws.seed(), ProposalArguments::of(&draws))
    }

    /// The bundle in this folder, else those that the record brings along: one at least.
    pub(super) fn bundles(&self, named: Option<&Path>) -> Result<Vec<Bundle>, Failure> {
        if let Some(folder) = named {
            return Ok(vec![open_bundle(folder)?]);
        }
        if self.attached.is_empty() {
            let advice = "name the team's by --bundle, or record with it: sortie record BUNDLE";
            return Err(bad(&self.path, format!("it brings no bundle along; {advice}")));
        }
        self.attached.values().map(|folder| open_bundle(folder.path())).collect()
    }

    /// Tells all frames, actions and allocations, in their order.
    pub(super) fn replay(&self, tell: &mut dyn FnMut(Told)) -> Result<(), Failure> {
        if let Some(heard) = &self.heard {
            heard.iter().for_each(|told| tell(told.again()));
            return Ok(());
        }
        let mut topics = Topics::default();
        each(&self.path, &mut |record| {
            let Record::Message(message, data) = record else {
                topics.learn(&record);
                return Ok(());
            };
            match topics.of(message.channel) {
                Some("/frame") => {
                    let (header, payload) = FrameHeader::read_from_prefix(data)
                        .map_err(|_| "a frame is shorter than its head".to_owned())?;
                    tell(Told::Frame(Shown::new(&header, payload)));
                }
                Some("/action") => tell(Told::Action(read(data)?)),
                Some("/allocation") => tell(Told::Allocation(read(data)?)),
                _ => {}
            }
            Ok(())
        })?;
        Ok(())
    }
}

/// A message of a fixed layout.
fn read<T: FromBytes>(data: &[u8]) -> Result<T, String> {
    T::read_from_bytes(data).map_err(|_| format!("a message has {} bytes", data.len()))
}

/// Keeps a file of a bundle, `BUNDLE/FILE`. What it is called has no folder in it: a record of others could put files anywhere.
fn keep(folders: &mut BTreeMap<String, TempDir>, name: &str, data: &[u8]) -> Result<(), String> {
    let is_plain = |name: &&str| Path::new(name).file_name().is_some_and(|plain| plain == *name);
    let parts = name.split_once('/').filter(|(_, file)| is_plain(file));
    let (bundle, file) = parts.ok_or_else(|| format!("`{name}` is no file of a bundle"))?;
    let folder = match folders.entry(bundle.to_owned()) {
        Entry::Occupied(there) => there.into_mut(),
        Entry::Vacant(place) => {
            place.insert(tempfile::tempdir().map_err(|error| error.to_string())?)
        }
    };
    fs::write(folder.path().join(file), data).map_err(|error| error.to_string())
}

/// The names of channels.
#[derive(Default)]
struct Topics(Vec<(u16, String)>);

impl Topics {
    fn learn(&mut self, record: &Record<'_>) {
        if let Record::Channel { id, topic, .. } = record {
            self.0.push((*id, (*topic).to_owned()));
        }
    }

    fn of(&self, channel: u16) -> Option<&str> {
        self.0.iter().find(|(id, _)| *id == channel).map(|(_, topic)| &**topic)
    }
}

/// Shows every part of a record to `take`, up to where it was cut off: returns where, if it was.
fn each(
    path: &Path,
    take: &mut dyn FnMut(Record<'_>) -> Result<(), String>,
) -> Result<Option<u64>, Failure> {
    let file = File::open(path).map_err(|error| Failure::file(path, &error))?;
    let mut reader = Reader::new(BufReader::new(file)).map_err(|error| bad(path, error))?;
    loop {
        match reader.next() {
            Ok(Some(record)) => take(record).map_err(|reason| bad(path, reason))?,
            Ok(None) => return Ok(None),
            Err(RecordError::Torn { at }) => return Ok(Some(at)),
            Err(error) => return Err(bad(path, error)),
        }
    }
}

fn bad(path: &Path, reason: impl std::fmt::Display) -> Failure {
    Failure::new(Exit::BadData, format!("{}: {reason}", path.display()))
}

#[cfg(test)]
mod tests {
    use sortie_core::Shape;
    use sortie_ipc::DomainContract;
    use sortie_record::Writer;

    use super::*;

    #[test]
    fn records_of_others_are_refused_by_what_is_wrong() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("run.mcap");
        let shape = Shape { agents: 0, entities: 3, tasks: 1, actions: 4, features: 5 };
        let nobody = toml::to_string(&DomainFacts::new(&DomainContract::default(), shape));
        let nobody = nobody.expect("plain values");
        for (name, text, reason) in [
            ("notes.txt", "", "brings no `domain.toml`"),
            ("domain.toml", "agents = ", "run.mcap"),
            ("domain.toml", &nobody, "agents"),
            ("bundle/a/../../elsewhere", "", "is no file of a bundle"),
            ("bundle/contract.toml", "", "is no file of a bundle"),
        ] {
            let (mut writer, mut bytes) = (Writer::new("sortie", "a test"), Vec::new());
            writer.add_attachment([name, "text/plain"], 0, text.as_bytes());
            writer.flush(&mut bytes).expect("memory");
            fs::write(&path, bytes).expect("there is room");
            let Err(refused) = Contents::read(&path) else { panic!("{name} is taken") };
            assert!(refused.message.contains(reason), "{}", refused.message);
            assert!(matches!(refused.exit, Exit::BadData), "{}", refused.message);
        }
    }
}
