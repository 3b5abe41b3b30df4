//! Environments by name, and whether a bundle fits one.

use std::collections::BTreeMap;
use std::fmt;

use sortie_bundle::{Bundle, Environment as BundleEnvironment};
use sortie_envs::{Choice, ENVIRONMENTS, Entry, Environment, EnvironmentError, Shape, Spec, Split};
use sortie_learn::subtasks::{AllocatedTeam, NoSubtasks, ScriptedAgents};

use crate::failure::{Exit, Failure, Outcome};
use crate::output::plural;

/// An environment and one of its sets of starts, written `ENV/SET`.
#[derive(Clone, Debug)]
pub struct ScenarioSetName {
    entry: &'static Entry,
    set: String,
}

impl ScenarioSetName {
    /// Reads `ENV` or `ENV/SET`, and checks that they exist.
    pub fn parse(text: &str) -> Result<Self, Failure> {
        let (name, set) = match text.split_once('/') {
            Some((name, set)) => (name, Some(set)),
            None => (text, None),
        };
        let name = Self { entry: entry(name)?, set: set.unwrap_or_default().to_owned() };
        let name = if set.is_none() { Self::usual(name.entry) } else { name };
        match name.choose(Split::Train, 0) {
            // With settings that are still to come it may be another world.
            Ok(_) | Err(EnvironmentError::Setting(_)) => Ok(name),
            Err(error) => Err(Failure::new(Exit::Usage, error.to_string())),
        }
    }

    /// The set that an environment is played in where none is named.
    fn usual(entry: &'static Entry) -> Self {
        Self { entry, set: (entry.sets)().swap_remove(0) }
    }

    /// As [`parse`](Self::parse), for teams that are allocated to subtasks.
    pub fn parse_with_subtasks(text: &str) -> Result<Self, Failure> {
        let name = Self::parse(text)?;
        name.check_subtasks()?;
        Ok(name)
    }

    /// Whether it has subtasks that agents are allocated to.
    pub fn has_subtasks(&self) -> Result<bool, Failure> {
        Ok(self.open(Split::Test)?.spec().shape.tasks > 0)
    }

    /// Refuses environments without subtasks.
    pub fn check_subtasks(&self) -> Outcome {
        if self.has_subtasks()? {
            return Ok(());
        }
        let has = |entry: &&'static Entry| Self::usual(entry).has_subtasks().unwrap_or(false);
        let fit: Vec<&str> = ENVIRONMENTS.iter().filter(has).map(|entry| entry.name).collect();
        let (name, fit) = (self.entry.name, fit.join("`, `"));
        let reason = format!(
            "`{name}` has no subtasks that agents could be allocated to, as `{fit}` has; `sortie view scripted \
             --env {name}` plays in it, `sortie bench env --env {name}` steps it"
        );
        Err(Failure::new(Exit::Usage, reason))
    }

    pub fn entry(&self) -> &'static Entry {
        self.entry
    }

    /// The set's own name.
    pub fn set(&self) -> &str {
        &self.set
    }

    /// The environment with one instance, whose episode is over.
    pub fn open(&self, split: Split) -> Result<Box<dyn Environment>, Failure> {
        self.choose(split, 1).map_err(Failure::bug)
    }

    fn choose(
        &self,
        split: Split,
        instances: usize,
    ) -> Result<Box<dyn Environment>, EnvironmentError> {
        let settings = BTreeMap::new();
        (self.entry.open)(&Choice { set: Some(&self.set), split, instances, settings: &settings })
    }
}

/// What is played where nothing is named.
impl Default for ScenarioSetName {
    fn default() -> Self {
        Self::usual(&ENVIRONMENTS[0])
    }
}

impl fmt::Display for ScenarioSetName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.entry.name, self.set)
    }
}

/// The environment of this name.
fn entry(name: &str) -> Result<&'static Entry, Failure> {
    ENVIRONMENTS.iter().find(|entry| entry.name == name).ok_or_else(|| {
        let known: Vec<&str> = ENVIRONMENTS.iter().map(|entry| entry.name).collect();
        let known = known.join(", ");
        Failure::new(Exit::Usage, format!("unknown environment `{name}`; known: {known}"))
    })
}

/// The environment that a bundle was learned in.
pub fn entry_of(bundle: &Bundle) -> Result<&'static Entry, Failure> {
    let name = &bundle.manifest().contract.environment.name;
    entry(name.split('/').next().unwrap_or_default())
}

/// Whether a bundle's environment is built in, in this version; the reason if not.
pub fn check_known(environment: &BundleEnvironment) -> Result<(), String> {
    let BundleEnvironment { name, version, .. } = environment;
    let known = ScenarioSetName::parse(name).map_err(|failure| failure.message)?;
    if version == known.entry.version {
        return Ok(());
    }
    Err(format!(
        "it was learned in version {version} of `{name}`, this program has version {}",
        known.entry.version
    ))
}

/// Refuses a bundle that was trained for other features or actions, or for smaller teams.
pub fn check_fits(bundle: &Bundle, name: &ScenarioSetName) -> Outcome {
    let environment = name.choose(Split::Train, 0).map_err(Failure::bug)?;
    check_spec(bundle, environment.spec(), &name.set)
}

/// Refuses an allocator that was taught by other relations of entities to subtasks than this version tells.
pub(crate) fn check_relations(bundle: &Bundle) -> Outcome {
    let known = bundle.golden().allocations.first().map(|case| case.relations);
    let checked = known.map(|known| entry_of(bundle).and_then(|entry| tells(entry, known)));
    checked.unwrap_or(Ok(())).map_err(|failure| failure.within(bundle.folder().display()))
}

/// Whether rows of an environment tell so many numbers of how an entity stands to a subtask.
fn tells(entry: &Entry, known: usize) -> Outcome {
    let told = entry.reader.map_or(0, |reader| reader().relations());
    if known == told {
        return Ok(());
    }
    let message = format!(
        "the allocator knows {} of how an entity of `{}` stands to a subtask, this version tells {told}: learn it anew, or choose \
         a rule with --allocation",
        plural(known, "number"),
        entry.name
    );
    Err(Failure::new(Exit::Mismatch, message))
}

/// As [`check_fits`], for a set that need not be known.
pub fn check_spec(bundle: &Bundle, spec: &Spec, set: &str) -> Outcome {
    let mismatch = |reason: String| {
        Err(Failure::new(Exit::Mismatch, format!("{}: {reason}", bundle.folder().display())))
    };
    let contract = bundle.contract();
    if contract.feature_names != spec.features || contract.action_names != spec.actions {
        return mismatch("the bundle was trained for other features or actions".to_string());
    }
    let limits = &bundle.manifest().limits;
    let Shape { agents, entities, tasks, .. } = spec.shape;
    let known = bundle.manifest().network.graph_of.len();
    if known > 0 && known != agents {
        return mismatch(format!(
            "`{set}` has {agents} agents, the bundle says of {known} which graph each decides by"
        ));
    }
    if entities > usize::from(limits.n_max) || tasks > usize::from(limits.t_max) {
        return mismatch(format!(
            "`{set}` has {entities} entities and {tasks} subtasks, the bundle takes at most {} and {}; \
             choose a smaller set with --env or train on this one",
            limits.n_max, limits.t_max
        ));
    }
    Ok(())
}

/// The script of an environment in which nobody is allocated; ties are broken by the seed.
pub(crate) fn scripted(
    name: &ScenarioSetName,
    environment: &dyn Environment,
    seed: u64,
) -> Result<AllocatedTeam<'static>, Failure> {
    if environment.spec().shape.tasks > 0 {
        let message = format!("the scripted team of `{name}` needs somebody who allocates");
        return Err(Failure::new(Exit::Usage, message));
    }
    let agents = Box::new(ScriptedAgents::new(seed));
    Ok(AllocatedTeam::new(agents, Box::new(NoSubtasks), u32::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Before armies' strength was told an allocator of a base knew nothing beside rows.
    #[test]
    fn an_allocator_of_other_relations_is_refused_by_their_number() {
        let skirmish = entry("skirmish").expect("an environment");
        let refusal = tells(skirmish, 0).expect_err("five are told");
        assert_eq!(refusal.exit, Exit::Mismatch);
        assert!(refusal.message.contains("knows 0 numbers") && refusal.message.contains("tells 5"));
        assert!(tells(skirmish, 5).is_ok());
        assert!(tells(entry("routing").expect("an environment"), 0).is_ok());
    }
}
