//! Who may assign agents to subtasks, by the names of the command line.

use std::sync::LazyLock;

use clap::ValueEnum;
use clap::builder::PossibleValue;
use sortie_bundle::{Bundle, SubtaskConditioning};
use sortie_envs::{ENVIRONMENTS, Entry, Rule};
use sortie_learn::subtasks::RuleAllocator;

use crate::environment::entry_of;
use crate::failure::{Exit, Failure};

/// A hand-written rule of an environment that assigns agents to subtasks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Allocation(&'static Rule);

/// Who assigns agents to subtasks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AllocatorChoice {
    /// What the team has learned.
    Learned,
    /// A rule.
    Rule(Allocation),
}

/// The rules of all environments, each name once.
static RULES: LazyLock<Vec<Allocation>> = LazyLock::new(|| {
    let mut rules: Vec<Allocation> = Vec::new();
    for rule in ENVIRONMENTS.iter().flat_map(|entry| entry.rules) {
        if !rules.iter().any(|known| known.name() == rule.name) {
            rules.push(Allocation(rule));
        }
    }
    rules
});

static CHOICES: LazyLock<Vec<AllocatorChoice>> = LazyLock::new(|| {
    let rules = RULES.iter().copied().map(AllocatorChoice::Rule);
    [AllocatorChoice::Learned].into_iter().chain(rules).collect()
});

impl ValueEnum for Allocation {
    fn value_variants<'a>() -> &'a [Self] {
        &RULES
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.name()).help(self.0.about))
    }
}

impl ValueEnum for AllocatorChoice {
    fn value_variants<'a>() -> &'a [Self] {
        &CHOICES
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        const LEARNED: &str =
            "What the team has learned: the best allocation by a network that values teams";
        match self {
            Self::Learned => Some(PossibleValue::new(self.name()).help(LEARNED)),
            Self::Rule(rule) => rule.to_possible_value(),
        }
    }
}

impl Allocation {
    /// The rule of this name, of any environment.
    pub fn named(name: &str) -> Result<Self, Failure> {
        RULES.iter().copied().find(|rule| rule.name() == name).ok_or_else(|| {
            let message = format!("no environment has a rule of allocation `{name}`");
            Failure::new(Exit::BadData, message)
        })
    }

    /// The rule as something that evaluations can ask.
    pub fn measured(self) -> RuleAllocator<'static> {
        RuleAllocator(self.name())
    }

    pub fn name(self) -> &'static str {
        &self.0.name
    }

    /// Its number among the rules of an environment.
    pub fn number(self, entry: &Entry) -> Result<usize, Failure> {
        let number = entry.rules.iter().position(|rule| rule.name == self.name());
        number.ok_or_else(|| {
            let known: Vec<&str> = entry.rules.iter().map(|rule| &*rule.name).collect();
            let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
            let message = format!(
                "`{}` is no rule of allocation of `{}`; there are: {known}",
                self.name(),
                entry.name
            );
            Failure::new(Exit::Usage, message)
        })
    }
}

impl AllocatorChoice {
    /// What was asked for, else the learned allocator where there is one, else the environment's usual rule.
    pub fn or_default(
        asked: Option<Self>,
        is_learned: bool,
        entry: &'static Entry,
    ) -> Result<Self, Failure> {
        if let Some(Self::Rule(rule)) = asked {
            rule.number(entry)?;
        }
        let usual = if is_learned { Some(Self::Learned) } else { usual_rule(entry) };
        asked.or(usual).ok_or_else(|| {
            let message = format!(
                "`{}` has no rule of allocation, and the team has learned none: nobody can allocate",
                entry.name
            );
            Failure::new(Exit::Usage, message)
        })
    }

    /// Who allocates for a bundle's team; nobody where it knows of no subtasks, and asking for somebody is a mistake.
    pub fn of_bundle(bundle: &Bundle, asked: Option<Self>) -> Result<Option<Self>, Failure> {
        if bundle.contract().subtask_conditioning == SubtaskConditioning::None {
            return asked.map_or(Ok(None), |asked| Err(asked.of_no_use()));
        }
        Self::or_default(asked, bundle.has_allocator(), entry_of(bundle)?).map(Some)
    }

    /// Refuses an allocator for a team that knows of no subtasks.
    pub fn of_no_use(self) -> Failure {
        let message = format!(
            "the team knows of no subtasks: nobody allocates, and `{}` would change nothing",
            self.name()
        );
        Failure::new(Exit::Usage, message)
    }

    /// The rule, if it is one.
    pub fn rule(self) -> Option<Allocation> {
        match self {
            Self::Learned => None,
            Self::Rule(rule) => Some(rule),
        }
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::Learned => "learned",
            Self::Rule(rule) => rule.name(),
        }
    }
}

/// The rule that an environment is played with where none is named.
pub fn usual_rule(entry: &'static Entry) -> Option<AllocatorChoice> {
    entry.rules.first().map(|rule| AllocatorChoice::Rule(Allocation(rule)))
}

/// What reports call whoever allocates.
pub fn name_of(allocation: Option<AllocatorChoice>) -> &'static str {
    allocation.map_or("none", AllocatorChoice::name)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(has_rules: bool) -> &'static Entry {
        let fits = |entry: &&Entry| entry.rules.is_empty() != has_rules;
        ENVIRONMENTS.iter().find(fits).expect("there are environments with rules and without")
    }

    #[test]
    fn choices_are_the_rules_of_the_environments_each_once() {
        let names: Vec<&str> =
            AllocatorChoice::value_variants().iter().map(|choice| choice.name()).collect();
        let all = [
            "learned",
            "coordinated",
            "heuristic",
            "random",
            "dynamic",
            "matching",
            "nearest",
            "greedy",
            "hungarian",
        ];
        assert_eq!(names, all);
        let rules: Vec<&str> =
            Allocation::value_variants().iter().map(|rule| rule.name()).collect();
        assert_eq!(rules, names[1..]);
    }

    #[test]
    fn who_allocates_is_who_was_asked_then_who_learned_then_the_usual_rule() {
        let of = |asked, is_learned| {
            let choice = AllocatorChoice::or_default(asked, is_learned, entry(true));
            choice.expect("somebody").name()
        };
        let random = AllocatorChoice::Rule(Allocation::named("random").expect("a rule"));
        assert_eq!(of(Some(random), true), "random");
        assert_eq!(of(None, true), "learned");
        assert_eq!(of(None, false), "coordinated");
    }

    #[test]
    fn rules_that_an_environment_has_not_are_refused() {
        let without = entry(false);
        let nobody = AllocatorChoice::or_default(None, false, without).expect_err("no rule");
        assert_eq!(nobody.exit, Exit::Usage);
        assert!(nobody.message.contains(without.name), "{}", nobody.message);
        let random = AllocatorChoice::Rule(Allocation::named("random").expect("a rule"));
        let refused = AllocatorChoice::or_default(Some(random), true, without);
        assert!(refused.expect_err("no such rule").message.contains("there are: none"));
        assert!(Allocation::named("farthest").is_err());
    }
}
