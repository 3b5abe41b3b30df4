//! The models of a process: the one that it decides by, and the one that its team may change to.

use std::sync::mpsc::{Receiver, Sender, channel};

use sortie_core::Shape;
use sortie_core::roles::Identity;
use sortie_core::wire::ControlStatus;

use crate::domain::{Membership, TeamBundles, model_text};
use crate::error::Error;
use crate::process_info::Candidate;
use crate::stop::Waker;

/// A model that was opened and checked, and is ready to decide.
pub struct LoadedModel<M> {
    /// Hash of the contract that it was trained for.
    pub contract: u64,
    /// First 16 bytes of its id.
    pub id: [u8; 16],
    /// Most entities that it takes.
    pub entities_max: usize,
    /// Most subtasks that it takes.
    pub tasks_max: usize,
    /// What decides or allocates.
    pub model: M,
}

/// Why a model is not loaded: [`ControlStatus::BadArgument`] where there is none of this name, or it cannot be read.
pub type Loaded<M> = Result<LoadedModel<M>, ControlStatus>;

/// Opens models by name on a thread of its own, at the lowest priority: who decides goes on meanwhile.
pub struct Registry<M> {
    orders: Sender<(u64, String, Waker)>,
    loaded: Receiver<(u64, Loaded<M>)>,
    /// The number of the newest order.
    newest: u64,
}

impl<M: Send + 'static> Registry<M> {
    /// Models that `load` opens. One of another contract, or too small for the domain, is refused by the process as
    /// [`ControlStatus::Foreign`].
    ///
    /// # Errors
    /// The thread could not be started.
    pub fn start(mut load: impl FnMut(&str) -> Loaded<M> + Send + 'static) -> Result<Self, Error> {
        let (orders, ordered) = channel::<(u64, String, Waker)>();
        let (sender, loaded) = channel();
        let serve = move || {
            // Linux counts priorities by thread. Elsewhere this changes nothing, or is refused.
            let _ = rustix::process::setpriority_process(None, 19);
            for (number, name, waker) in ordered {
                if sender.send((number, load(&name))).is_err() {
                    return;
                }
                waker.wake();
            }
        };
        let builder = std::thread::Builder::new().name("models".into());
        builder.spawn(serve).map_err(Error::io("start", "models"))?;
        Ok(Self { orders, loaded, newest: 0 })
    }
}

impl<M> Registry<M> {
    /// Has a model opened; what was asked for before no longer counts.
    fn ask(&mut self, name: &str, waker: Waker) {
        self.newest += 1;
        // Without its thread, which only a panic ends, nothing ever comes.
        let _ = self.orders.send((self.newest, name.to_string(), waker));
    }

    /// What became of the newest order, once.
    fn take(&mut self) -> Option<Loaded<M>> {
        let newest = self.newest;
        let mut all = self.loaded.try_iter();
        all.find(|(number, _)| *number == newest).map(|(_, loaded)| loaded)
    }
}

/// A model and who it is.
pub(crate) struct Held<M> {
    pub(crate) id: [u8; 16],
    pub(crate) model: M,
}

/// The models of a process, by the generations of its team's bundles: even ones take the first place, odd ones the second.
pub(crate) struct Models<M, L> {
    places: [Option<Held<M>>; 2],
    generation: u16,
    candidate: Candidate,
    /// The generation that the newest candidate is for, and its name.
    candidate_for: u16,
    asked: String,
    registry: Option<Registry<L>>,
    /// What was loaded, as the process holds it.
    keep: fn(L) -> M,
    contract: u64,
    shape: Shape,
    waker: Waker,
}

impl<M, L> Models<M, L> {
    /// Decides by `own`; the rest is for those that `registry` opens.
    pub(crate) fn new(
        own: Held<M>,
        registry: Option<Registry<L>>,
        keep: fn(L) -> M,
        (contract, shape): (u64, Shape),
        waker: Waker,
    ) -> Self {
        let (places, candidate) = ([Some(own), None], Candidate::None);
        Self {
            places,
            generation: 0,
            candidate,
            candidate_for: 0,
            asked: String::new(),
            registry,
            keep,
            contract,
            shape,
            waker,
        }
    }

    /// Takes its place in a team that may have changed its bundle before: what it was started with counts if it is the
    /// bundle in use, or if teams are mixed.
    pub(crate) fn join(&mut self, bundles: &TeamBundles, mixes_teams: bool) {
        let [own, other] = &mut self.places;
        let model = model_text(own.as_ref().map_or([0; 16], |own| own.id));
        let is_of_team = mixes_teams || model == bundles.in_use().model;
        self.generation = bundles.generation();
        if place(self.generation) == 1 {
            std::mem::swap(own, other);
        }
        let missing = if is_of_team { bundles.other() } else { bundles.in_use() };
        let generation = if is_of_team { bundles.next() } else { bundles.generation() };
        if !missing.name.is_empty() {
            self.load(&missing.name, generation);
        }
    }

    /// Has a model opened for the generation after `generation`, which is in use.
    pub(crate) fn prepare(&mut self, name: &str, generation: u16) -> ControlStatus {
        if place(generation) != place(self.generation) {
            return ControlStatus::Outdated;
        }
        self.load(name, generation.wrapping_add(1))
    }

    fn load(&mut self, name: &str, generation: u16) -> ControlStatus {
        let Some(registry) = &mut self.registry else { return ControlStatus::NotSupported };
        registry.ask(name, self.waker.clone());
        if let Some(place) = self.places.get_mut(place(generation)) {
            *place = None;
        }
        (self.candidate, self.candidate_for) = (Candidate::Loading, generation);
        self.asked = name.to_string();
        ControlStatus::Done
    }

    /// Takes what has been opened meanwhile.
    pub(crate) fn look(&mut self) {
        if self.candidate != Candidate::Loading {
            return;
        }
        let Some(loaded) = self.registry.as_mut().and_then(Registry::take) else { return };
        let fits = |loaded: &LoadedModel<L>| {
            loaded.contract == self.contract
                && self.shape.entities <= loaded.entities_max
                && self.shape.tasks <= loaded.tasks_max
        };
        self.candidate = match loaded {
            Ok(loaded) if fits(&loaded) => {
                let (id, model) = (loaded.id, (self.keep)(loaded.model));
                if let Some(place) = self.places.get_mut(place(self.candidate_for)) {
                    *place = Some(Held { id, model });
                }
                Candidate::ready(id)
            }
            Ok(_) => Candidate::Refused { status: ControlStatus::Foreign },
            Err(status) => Candidate::Refused { status },
        };
    }

    /// Takes what has been opened, and changes to the generation that a frame asks for. Returns the id of the model in use,
    /// if that is another one than `identity`'s, or another generation's: zeros while it is being opened.
    pub(crate) fn follow(
        &mut self,
        asked: Option<u16>,
        identity: &mut Identity,
    ) -> Option<[u8; 16]> {
        self.look();
        let generation = asked.unwrap_or(self.generation);
        let before = std::mem::replace(&mut self.generation, generation);
        let model = self.held().map_or([0; 16], |held| held.id);
        let is_changed = generation != before || model != identity.model;
        identity.model = model;
        is_changed.then_some(model)
    }

    /// Opens the bundle in use where an order to prepare it was not heard: a process may have stood still.
    pub(crate) fn catch_up(&mut self, membership: &Membership) -> Result<(), Error> {
        if self.held().is_some() || self.candidate == Candidate::Loading {
            return Ok(());
        }
        let Some(facts) = membership.facts()? else { return Ok(()) };
        let bundles = facts.bundles();
        if bundles.in_use().name != self.asked && bundles.generation() == self.generation {
            self.load(&bundles.in_use().name, self.generation);
        }
        Ok(())
    }

    /// The model in use; `None` while it is being opened.
    pub(crate) fn in_use(&mut self) -> Option<&mut M> {
        let place = self.places.get_mut(place(self.generation))?;
        place.as_mut().map(|held| &mut held.model)
    }

    fn held(&self) -> Option<&Held<M>> {
        self.places.get(place(self.generation))?.as_ref()
    }

    /// The generation that the newest frame asked for.
    pub(crate) fn generation(&self) -> u16 {
        self.generation
    }

    /// What became of the model that was prepared last.
    pub(crate) fn candidate(&self) -> Candidate {
        self.candidate
    }
}

/// The place of a generation.
fn place(generation: u16) -> usize {
    usize::from(generation % 2)
}
