//! Watches the world of a run: collects latencies, shows what is played.

use std::fs;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use sortie_core::roles::{TickReport, WorldObserver};
use sortie_core::wire::{AllocMsg, StatMsg};
use sortie_core::{NO_ACTION, UNASSIGNED, limits};
use sortie_envs::Episode;
use sortie_ipc::{Domain, Stop};
use sortie_pages::Scene;

use super::figures::Figures;
use super::picture::{self, Picture};
use crate::failure::Failure;
use crate::output::tell;
use crate::screen::{Keyboard, Screen};
use crate::views::outcome;
use crate::worlds::tally::Tally;
use crate::worlds::world::{EnvironmentWorld, SharedEnvironment, SharedTally};

/// How a run is shown while it goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Display {
    /// A picture that changes in place.
    Live,
    /// A line per episode.
    Lines,
    /// Nothing.
    Silent,
}

/// The onlooker of a run.
pub(super) struct Onlooker {
    display: Display,
    /// `None` = without end.
    episodes: Option<usize>,
    environment: SharedEnvironment,
    /// The state that is drawn.
    state: Vec<u8>,
    tally: SharedTally,
    /// Episodes of worlds before this one.
    pub(super) earlier: usize,
    ledger: Option<Ledger>,
    allocation: [u8; limits::AGENTS],
    actions: [u16; limits::AGENTS],
    screen: Screen,
    keyboard: Option<Keyboard>,
    pub(super) figures: Figures,
}

impl Onlooker {
    pub(super) fn new(
        display: Display,
        episodes: Option<usize>,
        world: &EnvironmentWorld,
        ledger: Option<Ledger>,
    ) -> Self {
        let mut figures = Figures::default();
        figures.processes.insert(std::process::id());
        Self {
            display,
            episodes,
            environment: world.environment.clone(),
            state: Vec::new(),
            tally: world.tally.clone(),
            earlier: world.tally.borrow().episodes,
            ledger,
            allocation: [UNASSIGNED; limits::AGENTS],
            actions: [NO_ACTION; limits::AGENTS],
            screen: Screen::new(),
            keyboard: None,
            figures,
        }
    }

    /// Has keys pause the run and end it, where it is shown live.
    pub(super) fn listen(&mut self, stop: &Stop) {
        if self.display == Display::Live {
            self.keyboard = Keyboard::open(stop);
        }
    }

    /// Whether the person who looks on has ended the run by a key.
    pub(super) fn has_quit(&self) -> bool {
        self.keyboard.as_ref().is_some_and(Keyboard::has_quit)
    }

    /// Leaves the terminal as it was.
    pub(super) fn restore_terminal(&mut self) {
        self.keyboard = None;
    }

    /// What a person may do.
    fn hint(&self) -> &'static str {
        match &self.keyboard {
            None => "Ctrl-C ends the run",
            Some(keyboard) if keyboard.is_paused() => "PAUSED: space goes on, q quits",
            Some(_) => "space pauses, q quits",
        }
    }

    fn draw(&mut self, step: u32) {
        let hint = self.hint();
        let tally = self.tally.borrow();
        let environment = self.environment.borrow();
        self.state.clear();
        environment.save(0, &mut self.state);
        let spec = environment.spec();
        let agents = spec.shape.agents;
        let picture = Picture {
            scene: Scene {
                spec,
                picture: &environment.picture(&self.state),
                allocation: &self.allocation[..agents],
                actions: &self.actions[..agents],
            },
            episode: (tally.episodes + 1).min(self.episodes.unwrap_or(usize::MAX)),
            episodes: self.episodes,
            tally: &tally,
            step,
            tick: self.figures.tick.percentiles(),
            hint,
        };
        self.screen.show(|canvas| picture::lines(&picture, canvas));
    }

    /// Forgets what is kept for a next world.
    pub(super) fn close(self) {
        if let Some(ledger) = self.ledger {
            ledger.close();
        }
    }
}

impl WorldObserver for Onlooker {
    fn status(&mut self, status: &StatMsg) {
        self.figures.processes.insert(status.pid);
    }

    fn episode_started(&mut self, _episode: u32) {
        self.allocation = [UNASSIGNED; limits::AGENTS];
        self.actions = [NO_ACTION; limits::AGENTS];
    }

    fn allocated(&mut self, allocation: &AllocMsg) {
        self.allocation = allocation.task;
    }

    fn tick(&mut self, report: &TickReport<'_>) {
        self.figures.record(report);
        if self.display == Display::Live {
            for (to, from) in self.actions.iter_mut().zip(report.actions) {
                *to = *from;
            }
            self.draw(report.step + 1);
            if self.keyboard.as_ref().is_some_and(Keyboard::is_paused) {
                // Once more, for it says so.
                self.draw(report.step + 1);
                self.keyboard.iter().for_each(Keyboard::wait_while_paused);
                self.figures.stand_still();
            }
        }
    }

    fn episode_ended(&mut self, episode: u32, _steps: u32) {
        let tally = self.tally.borrow();
        if let Some(ledger) = &self.ledger {
            ledger.write(&tally);
        }
        if self.display == Display::Lines
            && let Some(finished) = &tally.last
        {
            let number = self.earlier + episode as usize + 1;
            let environment = self.environment.borrow();
            let (spec, of) = (environment.spec(), self.episodes);
            let what = outcome(spec, finished);
            tell!("{}", episode_line((number, of), finished, spec.has_success, &what));
        }
    }
}

fn episode_line(
    (number, episodes): (usize, Option<usize>),
    episode: &Episode,
    has_success: bool,
    what: &str,
) -> String {
    let end = match (episode.solved, episode.timed_out) {
        _ if !has_success => format!("return {:.1}", episode.episode_return),
        (true, _) => "solved".to_owned(),
        (false, true) => "timed out".to_owned(),
        (false, false) => "lost".to_owned(),
    };
    let of = episodes.map_or(String::new(), |episodes| format!(" of {episodes}"));
    format!("episode {number:3}{of}: {:8}  {end:9}  {what}", episode.group)
}

/// The file's name. It goes with the domain.
const FILE: &str = "played.json";

/// The played episodes of a domain.
pub(super) struct Ledger {
    path: PathBuf,
    playing: String,
}

#[derive(Serialize, Deserialize)]
struct Page<T> {
    /// What was played: episodes of anything else do not count.
    playing: String,
    tally: T,
}

impl Ledger {
    /// That of `domain` for what is to be played.
    pub(super) fn new(domain: &Domain, playing: String) -> Self {
        Self { path: domain.base().join(FILE), playing }
    }

    /// What a world of a team that is still there had played when it died.
    pub(super) fn read(&self, domain: &Domain) -> Result<Tally, Failure> {
        // Where nobody is left, the file is of a team that is dead as well.
        if !domain.is_alive()? {
            return Ok(Tally::default());
        }
        let text = fs::read(&self.path).unwrap_or_default();
        let page: Option<Page<Tally>> = serde_json::from_slice(&text).ok();
        let page = page.filter(|page| page.playing == self.playing);
        Ok(page.map(|page| page.tally).unwrap_or_default())
    }

    /// Writes what is played. Where that fails, the next world counts from an earlier episode.
    pub(super) fn write(&self, tally: &Tally) {
        let page = Page { playing: self.playing.clone(), tally };
        let unfinished = self.path.with_extension("new");
        let text = serde_json::to_vec(&page).unwrap_or_default();
        let _ = fs::write(&unfinished, text).and_then(|()| fs::rename(&unfinished, &self.path));
    }

    /// Forgets it all, once it is reported.
    pub(super) fn close(self) {
        // It may be gone with its domain.
        let _ = fs::remove_file(self.path);
    }
}
