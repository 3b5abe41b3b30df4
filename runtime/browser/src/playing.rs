//! A player of any environment that pages show.

use alloc::boxed::Box;
use alloc::string::{String, ToString};

use serde::Serialize;
use sortie_envs::EnvironmentError;
use sortie_envs::crafting::Crafting;
use sortie_envs::treasure_rooms::TreasureRooms;
use sortie_stage::gridworld::Maze;
use sortie_stage::group_matching::Groups;
use sortie_stage::milestones::Board;
use sortie_stage::particle::Plane;
use sortie_stage::save_the_city::City;
use sortie_stage::{Cast, Player, Show, StageError, memory};

/// Begins an episode of a seed in the environment of a team.
///
/// # Errors
/// The team is for other worlds, or its environment has no page.
pub(crate) fn begin(cast: &Cast, seed: u64, episode: usize) -> Result<Box<dyn Playing>, StageError> {
    let players = [
        player::<City>,
        player::<Groups>,
        player::<Plane>,
        player::<Maze>,
        player::<Board<Crafting>>,
        player::<Board<TreasureRooms>>,
    ];
    let found = players.into_iter().find_map(|player| player(cast, seed, episode));
    let unknown = EnvironmentError::Set(cast.environment.clone());
    found.unwrap_or(Err(unknown.into()))
}

/// The player of an environment; none of a team for another one.
fn player<S: Show>(
    cast: &Cast,
    seed: u64,
    episode: usize,
) -> Option<Result<Box<dyn Playing>, StageError>> {
    (S::entry().name == cast.environment).then(|| {
        let memory = Box::leak(Box::new(memory::<S>(cast)?));
        let player: Player<'static, S> = Player::new(memory, cast, seed, episode)?;
        Ok(Box::new(player) as Box<dyn Playing>)
    })
}

/// A [`Player`] whose news are JSON.
pub(crate) trait Playing {
    fn open(&mut self) -> Result<String, String>;
    fn step(&mut self) -> Result<Option<String>, String>;
    fn place(&mut self, entity: usize, place: [f64; 2]) -> Result<String, String>;
    fn disturb(&mut self, thing: usize) -> Result<String, String>;
    fn kill_or_revive(&mut self, agent: usize) -> Result<String, String>;
    fn choose_allocator(&mut self, choice: usize) -> Result<String, String>;
    fn repeat_decision(&mut self, agent: usize) -> Result<bool, StageError>;
    fn rehearse(&mut self, most: u64) -> Result<u64, StageError>;
    fn rehearsed(&self) -> u64;
}

impl<S: Show> Playing for Player<'_, S> {
    fn open(&mut self) -> Result<String, String> {
        json(Player::open(self).map_err(|error| error.to_string()))
    }

    fn step(&mut self) -> Result<Option<String>, String> {
        let stepped = Player::step(self).map_err(|error| error.to_string())?;
        stepped.map(|news| json(Ok(news))).transpose()
    }

    fn place(&mut self, entity: usize, place: [f64; 2]) -> Result<String, String> {
        json(Player::place(self, entity, place))
    }

    fn disturb(&mut self, thing: usize) -> Result<String, String> {
        json(Player::disturb(self, thing))
    }

    fn kill_or_revive(&mut self, agent: usize) -> Result<String, String> {
        json(Player::kill_or_revive(self, agent))
    }

    fn choose_allocator(&mut self, choice: usize) -> Result<String, String> {
        json(Player::choose_allocator(self, choice))
    }

    fn repeat_decision(&mut self, agent: usize) -> Result<bool, StageError> {
        Player::repeat_decision(self, agent)
    }

    fn rehearse(&mut self, most: u64) -> Result<u64, StageError> {
        Player::rehearse(self, most)
    }

    fn rehearsed(&self) -> u64 {
        Player::rehearsed(self)
    }
}

fn json(told: Result<impl Serialize, String>) -> Result<String, String> {
    serde_json::to_string(&told?).map_err(|error| error.to_string())
}
