//! A world changes the bundle of its team, and turns back where the new one does badly.

use sortie_core::roles::{TickReport, WorldObserver, WorldRole};
use sortie_core::wire::{
    ActionMsg, AllocMsg, ControlReq, ControlStatus, StatMsg, SwapMoment, SwapOrder, TurnBack,
};

use crate::domain::{DomainFacts, Membership, TeamBundles};
use crate::error::Error;

/// Letters of an id in a request.
const ID_LETTERS: usize = 32;

/// What a world knows of its team's bundles. It alone writes them down, and always before a frame asks for one.
pub(super) struct Bundles {
    facts: DomainFacts,
    watch: Option<Watch>,
}

/// What makes the team turn back, and for how long.
#[derive(Clone, Copy, Debug)]
struct Watch {
    back: TurnBack,
    ticks: u32,
    is_tripped: bool,
}

impl Bundles {
    /// Those that the domain states.
    pub(super) fn new(facts: DomainFacts) -> Self {
        Self { facts, watch: None }
    }

    /// How often the team has changed its bundle, the change under way included.
    pub(super) fn generation(&self) -> u16 {
        self.facts.bundles().generation()
    }

    /// Notes the bundle that the team may change to.
    pub(super) fn prepare(
        &mut self,
        request: &ControlReq,
        role: &WorldRole,
        membership: &Membership,
    ) -> ControlStatus {
        let generation = self.generation();
        // A change that waits for its episode is to come first.
        if request.arg64 != u64::from(generation) || role.generation() != generation {
            return ControlStatus::Outdated;
        }
        // What would be turned back to makes room.
        self.watch = None;
        told(self.restate(membership, |bundles| bundles.prepare(request.text())))
    }

    /// Changes to the bundle that was prepared, whose id the request says.
    pub(super) fn change(
        &mut self,
        request: &ControlReq,
        role: &mut WorldRole,
        membership: &Membership,
    ) -> ControlStatus {
        let Some(order) = SwapOrder::from_number(request.arg64) else {
            return ControlStatus::BadArgument;
        };
        let model = request.text();
        let is_id = model.len() == ID_LETTERS && model.bytes().all(|byte| byte.is_ascii_hexdigit());
        if !is_id || self.facts.bundles().other().name.is_empty() {
            return ControlStatus::BadArgument;
        }
        let generation = self.generation();
        if order.generation != generation || role.generation() != generation {
            return ControlStatus::Outdated;
        }
        let status = told(self.restate(membership, |bundles| bundles.change(model)));
        if status == ControlStatus::Done {
            role.change_generation(self.generation(), order.moment);
            let SwapOrder { back, watched_ticks: ticks, .. } = order;
            self.watch = Some(Watch { back, ticks, is_tripped: false });
        }
        status
    }

    /// Before the next tick: turns back where the last one gave cause to.
    pub(super) fn look(&mut self, role: &mut WorldRole, membership: &Membership) {
        if !self.watch.is_some_and(|watch| watch.is_tripped) {
            return;
        }
        let before = self.facts.bundles().other().model.clone();
        // Where it cannot be written down now, the next tick tries again.
        if self.restate(membership, |bundles| bundles.change(&before)).is_ok() {
            self.watch = None;
            role.change_generation(self.generation(), SwapMoment::NextTick);
        }
    }

    /// Writes a change down, and only then holds by it.
    fn restate(
        &mut self,
        membership: &Membership,
        change: impl FnOnce(&mut TeamBundles),
    ) -> Result<(), Error> {
        let mut facts = self.facts.clone();
        change(facts.bundles_mut());
        membership.state(&facts)?;
        self.facts = facts;
        Ok(())
    }

    /// Looks at what `observer` is told, if there is something to turn back from.
    pub(super) fn watching<'a>(
        &'a mut self,
        role: &WorldRole,
        observer: &'a mut dyn WorldObserver,
    ) -> Watching<'a> {
        let is_changed = role.generation() == self.generation();
        Watching {
            watch: self.watch.as_mut().filter(|_| is_changed),
            joined: role.joined(),
            observer,
        }
    }
}

/// Where nothing can be written down, nothing changes.
fn told(written: Result<(), Error>) -> ControlStatus {
    written.map_or(ControlStatus::NotSupported, |()| ControlStatus::Done)
}

/// An observer, and before it the watch over a bundle that is new.
pub(super) struct Watching<'a> {
    watch: Option<&'a mut Watch>,
    /// Bit a: a process acts for agent a.
    joined: u64,
    observer: &'a mut dyn WorldObserver,
}

impl Watch {
    fn note(&mut self, report: &TickReport<'_>, joined: u64) {
        if self.ticks == 0 {
            return;
        }
        self.ticks -= 1;
        let says = |flag| report.answers().any(|answer| answer.has(flag));
        let acts = |agent: &usize| {
            report.actions.get(*agent).is_some_and(|&action| action != sortie_core::NO_ACTION)
        };
        let expected = (0..report.actions.len()).filter(acts);
        let is_silent = |agent| joined >> agent & 1 == 1 && report.answered >> agent & 1 == 0;
        let fell_back = self.back.on_fallback && says(ActionMsg::FALLBACK);
        let was_late =
            self.back.on_late && (says(ActionMsg::LATE) || expected.into_iter().any(is_silent));
        self.is_tripped |= fell_back || was_late;
    }
}

impl WorldObserver for Watching<'_> {
    fn status(&mut self, status: &StatMsg) {
        self.observer.status(status);
    }

    fn episode_started(&mut self, episode: u32) {
        self.observer.episode_started(episode);
    }

    fn allocated(&mut self, allocation: &AllocMsg) {
        self.observer.allocated(allocation);
    }

    fn tick(&mut self, report: &TickReport<'_>) {
        if let Some(watch) = self.watch.as_deref_mut() {
            watch.note(report, self.joined);
        }
        self.observer.tick(report);
    }

    fn episode_ended(&mut self, episode: u32, steps: u32) {
        self.observer.episode_ended(episode, steps);
    }
}
