//! What an environment says of itself.

use alloc::borrow::Cow;
use alloc::string::String;
use alloc::vec::Vec;
use core::fmt;
use core::ops::Range;

/// Padded sizes of an environment, constant for its life.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Agents A; at most [`Shape::AGENTS`].
    pub agents: usize,
    /// Entities N, agents included; at most [`Shape::ENTITIES`].
    pub entities: usize,
    /// Subtasks T; at most [`Shape::TASKS`].
    pub tasks: usize,
    /// Actions U of one agent; at most [`Shape::ACTIONS`].
    pub actions: usize,
    /// Features d of one entity, without its last action; at most [`Shape::FEATURES`].
    pub features: usize,
}

impl Shape {
    /// Most agents.
    pub const AGENTS: usize = 64;
    /// Most entities.
    pub const ENTITIES: usize = 128;
    /// Most subtasks.
    pub const TASKS: usize = 127;
    /// Most actions.
    pub const ACTIONS: usize = 127;
    /// Most features.
    pub const FEATURES: usize = 1 << 15;
}

/// What one row of an observation stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum View {
    /// One entity: an agent or a thing. Agents look at those that they can observe.
    Entities,
    /// All that one agent sees; a row behind those of the agents is what a critic sees of the state.
    Vectors,
    /// A picture of so many channels, rows and columns, the only row: cell by cell its channels, numbers behind them.
    Pictures([usize; 3]),
}

/// A name: of an environment's own text, or made when one with such a name is made.
pub type Name = Cow<'static, str>;

/// A number that every episode of an environment comes to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Metric {
    /// Its name in files and tables.
    pub name: Name,
    /// Its unit.
    pub unit: &'static str,
    /// What it says, in a few words.
    pub about: &'static str,
    /// Whether evaluations tell its mean; recordings of episodes have all.
    pub is_reported: bool,
}

impl Metric {
    /// A metric that evaluations tell.
    pub const fn reported(name: &'static str, unit: &'static str, about: &'static str) -> Self {
        Self { name: Cow::Borrowed(name), unit, about, is_reported: true }
    }

    /// A metric that only recordings of episodes have.
    pub const fn recorded(name: &'static str, unit: &'static str, about: &'static str) -> Self {
        Self { name: Cow::Borrowed(name), unit, about, is_reported: false }
    }
}

/// A rule that assigns agents to subtasks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rule {
    /// Its name, as `--allocation` takes it.
    pub name: Name,
    /// What it does, in one sentence.
    pub about: &'static str,
}

impl Rule {
    /// A rule by its name.
    pub const fn new(name: &'static str, about: &'static str) -> Self {
        Self { name: Cow::Borrowed(name), about }
    }
}

/// Agents that see and do the same kinds of things, where not all do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Role {
    /// Its name.
    pub name: &'static str,
    /// Its agents.
    pub agents: Range<usize>,
    /// Names of what they see; further columns of their rows are zeros.
    pub features: Vec<String>,
    /// Units of the features; none where they have none.
    pub units: Vec<&'static str>,
    /// Names of their actions; further ones are never available.
    pub actions: Vec<String>,
}

/// How a milestone shows from one observation to the next: a feature that changes by so much, or more, in this direction.
///
/// Where several do, what rises tells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sign {
    /// The feature.
    pub feature: usize,
    /// Its change.
    pub change: i16,
}

/// Who earns rewards besides the team.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rewards {
    /// Every subtask has a reward of its own.
    pub tasks: bool,
    /// Every agent has a reward of its own.
    pub agents: bool,
}

/// What an environment says of itself, constant for its life.
#[derive(Clone, Debug, PartialEq)]
pub struct Spec {
    /// Its name, as `--env` takes it.
    pub name: Name,
    /// The version of its rules: another one where a trained policy would notice the difference.
    pub version: &'static str,
    /// The padded sizes.
    pub shape: Shape,
    /// What a row of an observation stands for.
    pub view: View,
    /// `[d]`: names of the features; with roles those of a role that sees as many.
    pub features: Vec<String>,
    /// `[d]`: units of the features; none where they have none.
    pub units: Vec<&'static str>,
    /// `[U]`: names of the actions; with roles those of a role that has as many.
    pub actions: Vec<String>,
    /// Who sees and does what, in the order of the agents; empty where all agents are alike.
    pub roles: Vec<Role>,
    /// The entities at which the last actions aim, one each and in this order; empty where none aims. An agent may take such
    /// an action only where it observes the entity.
    pub targets: Range<usize>,
    /// The columns of an agent's own row that say how it stands to what it may aim at (how far away, within reach, after it):
    /// as many for each target, in the order of `targets`; empty where nothing is said. Those of what it does not observe
    /// are zeros.
    pub pairs: Range<usize>,
    /// So many columns, the first ones, keep what they hold through an episode in the rows of all that is no agent.
    pub fixed: usize,
    /// The action of an agent that nobody decides for: always available, and as harmless as any.
    pub safe_action: Option<u16>,
    /// Whether episodes can be solved; where none can, returns alone say how good a team is.
    pub has_success: bool,
    /// What an episode comes to, besides its return, its length and whether it was solved.
    pub metrics: Vec<Metric>,
    /// Why episodes fail, by names; none where causes are not told apart.
    pub causes: &'static [&'static str],
    /// Names of what can be reached on the way to the task, which is the last; none where no such thing is told.
    pub milestones: Vec<String>,
    /// How each of them shows in what is observed; empty where that is not told.
    pub signs: Vec<Sign>,
    /// Who earns rewards besides the team.
    pub rewards: Rewards,
    /// About what an episode returns that is solved, by which learners may scale rewards; 0: not known.
    pub solved_return: f32,
    /// What can be [done to things](crate::Environment::disturb), in words; nothing where nothing can.
    pub disturbance: &'static str,
    /// Symmetries of the rules, the one that changes nothing included.
    pub turns: usize,
    /// The rules that assign agents to subtasks, the usual one first.
    pub rules: Vec<Rule>,
    /// Columns of the relation between an entity and a subtask.
    pub relations: usize,
    /// Most features of one row that differ from zero.
    pub row_entries: usize,
    /// Most bytes of a state.
    pub state_bytes: usize,
    /// Steps after which an episode is over, however it stands.
    pub episode_limit: u32,
}

/// Entities, no subtasks, nothing but the team's reward; name, sizes and lists of names are still missing.
impl Default for Spec {
    fn default() -> Self {
        Self {
            name: Name::default(),
            version: "1",
            shape: Shape { agents: 0, entities: 0, tasks: 0, actions: 0, features: 0 },
            view: View::Entities,
            features: Vec::new(),
            units: Vec::new(),
            actions: Vec::new(),
            roles: Vec::new(),
            targets: 0..0,
            pairs: 0..0,
            fixed: 0,
            safe_action: None,
            has_success: true,
            metrics: Vec::new(),
            causes: &[],
            milestones: Vec::new(),
            signs: Vec::new(),
            rewards: Rewards::default(),
            solved_return: 0.0,
            disturbance: "",
            turns: 1,
            rules: Vec::new(),
            relations: 0,
            row_entries: 0,
            state_bytes: 0,
            episode_limit: u32::MAX,
        }
    }
}

impl Spec {
    /// The role of an agent, where not all are alike.
    pub fn role_of(&self, agent: usize) -> Option<&Role> {
        self.roles.iter().find(|role| role.agents.contains(&agent))
    }

    /// Names of what is seen of an agent, or by it: of the first columns of its row.
    pub fn features_of(&self, agent: usize) -> &[String] {
        self.role_of(agent).map_or(&self.features, |role| &role.features)
    }

    /// Names of the actions of an agent.
    pub fn actions_of(&self, agent: usize) -> &[String] {
        self.role_of(agent).map_or(&self.actions, |role| &role.actions)
    }

    /// Refuses sizes beyond what learners and executors hold, lists of names that do not fit the sizes, and roles
    /// that do not share out the agents.
    ///
    /// # Errors
    /// The first size or list that is wrong.
    pub fn check(&self) -> Result<(), SpecError> {
        let Shape { agents, entities, tasks, actions, features } = self.shape;
        let limits = [
            ("agents", agents, 1, Shape::AGENTS),
            ("entities", entities, 1, Shape::ENTITIES),
            ("subtasks", tasks, 0, Shape::TASKS),
            ("actions", actions, 1, Shape::ACTIONS),
            ("features", features, 1, Shape::FEATURES),
            ("symmetries", self.turns, 1, 255),
        ];
        for (what, found, least, most) in limits {
            if !(least..=most).contains(&found) {
                return Err(SpecError::Size { what, found, least, most });
            }
        }
        let names =
            [("features", self.features.len(), features), ("actions", self.actions.len(), actions)];
        let units = self.units.len();
        let units = (units > 0).then_some(("units", units, features));
        for (what, found, wanted) in names.into_iter().chain(units) {
            if found != wanted {
                return Err(SpecError::Names { what, found, wanted });
            }
        }
        self.check_targets()?;
        self.check_roles()
    }

    /// Aimed actions are some of the actions, their targets are entities, and pairs have features of the own row.
    fn check_targets(&self) -> Result<(), SpecError> {
        let Shape { entities, actions, features, .. } = self.shape;
        let sizes = [
            ("entities up to the last target", self.targets.end, entities),
            ("aimed actions", self.targets.len(), actions - 1),
            ("features up to the last pair's", self.pairs.end, features),
            ("features that stay as they are", self.fixed, features),
        ];
        let wrong = sizes.into_iter().find(|(_, found, most)| found > most);
        if let Some((what, found, most)) = wrong {
            return Err(SpecError::Size { what, found, least: 0, most });
        }
        let wanted = self.pair_features() * self.targets.len();
        let (what, found) = ("features of pairs, as many for each target", self.pairs.len());
        if found == wanted { Ok(()) } else { Err(SpecError::Names { what, found, wanted }) }
    }

    /// Features of an agent and one of its targets.
    pub fn pair_features(&self) -> usize {
        self.pairs.len() / self.targets.len().max(1)
    }

    /// Where those of the target at this place among the targets stand in the agent's own row.
    pub fn pair_columns(&self, target: usize) -> Range<usize> {
        let features = self.pair_features();
        let start = self.pairs.start + target * features;
        start..start + features
    }

    /// The entity that an action aims at.
    pub fn target_of(&self, action: usize) -> Option<usize> {
        let first = self.shape.actions - self.targets.len();
        self.targets.clone().nth(action.checked_sub(first)?)
    }

    fn check_roles(&self) -> Result<(), SpecError> {
        let Shape { agents, actions, features, .. } = self.shape;
        let mut shared = 0;
        for role in &self.roles {
            let own = [
                ("agents of a role", role.agents.len(), agents),
                ("features of a role", role.features.len(), features),
                ("actions of a role", role.actions.len(), actions),
            ];
            for (what, found, most) in own {
                if !(1..=most).contains(&found) {
                    return Err(SpecError::Size { what, found, least: 1, most });
                }
            }
            let (found, wanted) = (role.units.len(), role.features.len());
            if found > 0 && found != wanted {
                return Err(SpecError::Names { what: "units of a role", found, wanted });
            }
            if role.agents.start != shared {
                return Err(SpecError::Roles { agent: shared });
            }
            shared = role.agents.end;
        }
        if shared < agents && !self.roles.is_empty() {
            return Err(SpecError::Roles { agent: shared });
        }
        Ok(())
    }
}

/// What an environment says of itself does not hold together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum SpecError {
    /// A size is out of range.
    Size {
        /// Of what.
        what: &'static str,
        /// The size.
        found: usize,
        /// The smallest possible.
        least: usize,
        /// The largest possible.
        most: usize,
    },
    /// There are more or fewer names than things.
    Names {
        /// Of what.
        what: &'static str,
        /// The names.
        found: usize,
        /// The things.
        wanted: usize,
    },
    /// The roles, in their order, do not share out the agents in theirs.
    Roles {
        /// The first agent whose role is not the next one.
        agent: usize,
    },
}

impl fmt::Display for SpecError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Size { what, found, least, most } => {
                write!(f, "{found} {what}; from {least} to {most} are possible")
            }
            Self::Names { what, found, wanted } => {
                write!(f, "{found} names were given for {wanted} {what}")
            }
            Self::Roles { agent } => write!(f, "agent {agent} has no role, or one out of order"),
        }
    }
}

impl core::error::Error for SpecError {}
