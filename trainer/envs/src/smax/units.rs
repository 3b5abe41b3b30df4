//! The types of units, and what can be set.

use serde::Deserialize;

/// Types of units.
pub(super) const TYPES: usize = 6;
/// Their names.
pub(super) const TYPE_NAMES: &str = "marine marauder stalker zealot zergling hydralisk";
/// Units of the map in a second.
pub(super) const SPEED: [f32; TYPES] = [3.15, 2.25, 4.13, 3.15, 4.13, 3.15];
/// Health that a hit takes.
pub(super) const DAMAGE: [u16; TYPES] = [9, 10, 13, 8, 5, 12];
/// How far they shoot, from centre to centre.
pub(super) const RANGE: [f32; TYPES] = [5.0, 6.0, 6.0, 2.0, 2.0, 5.0];
/// How far they see, from centre to centre.
pub(super) const SIGHT: [f32; TYPES] = [9.0, 10.0, 10.0, 9.0, 8.0, 9.0];
/// Two that are nearer than both together push each other away.
pub(super) const RADIUS: [f32; TYPES] = [0.375, 0.5625, 0.625, 0.5, 0.375, 0.625];
pub(super) const HEALTH: [u8; TYPES] = [45, 125, 160, 150, 35, 80];
/// Seconds from one shot to the next, before chance.
pub(super) const PERIOD: [f32; TYPES] = [0.61, 1.07, 1.87, 0.86, 0.5, 0.59];

/// Which version of the published rules is played.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub(super) enum RuleBook {
    #[serde(rename = "0.2.0")]
    Current,
    /// The dead walk and push, and published vectors tell raw numbers of actions and cooldowns.
    #[serde(rename = "classic")]
    Classic,
}

/// Whom an enemy shoots at that shot at nobody within reach before.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum AttackMode {
    Closest,
    Random,
}

/// What can be set, by the published names where there are such.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Rules {
    pub(super) rules: RuleBook,
    /// An episode has at most one step more.
    pub(super) max_steps: u32,
    pub(super) walls_cause_death: bool,
    /// Whether a battle won or lost is rewarded alone, and no damage.
    pub(super) self_play_reward: bool,
    /// Whether agents see what their foes did last.
    pub(super) see_enemy_actions: bool,
    pub(super) enemy_shoots: bool,
    pub(super) attack_mode: AttackMode,
    /// Whether each agent sees one vector, as published, instead of a row for each unit.
    pub(super) vectors: bool,
    /// Whether an agent's own row says besides how it stands to the enemies that it sees.
    pub(super) pairs: bool,
}

impl Default for Rules {
    fn default() -> Self {
        Self {
            rules: RuleBook::Current,
            max_steps: 100,
            walls_cause_death: true,
            self_play_reward: false,
            see_enemy_actions: true,
            enemy_shoots: true,
            attack_mode: AttackMode::Closest,
            vectors: false,
            pairs: true,
        }
    }
}
