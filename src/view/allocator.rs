//! Who assigns agents in the episode that is viewed.

use sortie_learn::evaluate::Allocate;
use sortie_learn::methods::alma::UtilityNetwork;
use sortie_learn::methods::alma::team_value::TeamValueAllocator;

use crate::arguments::Allocation;
use crate::subject::Subject;

/// A team-value network, as the run that learned it uses it.
#[derive(Clone, Copy)]
pub(super) struct LearnedAllocator<'a> {
    pub(super) network: &'a UtilityNetwork,
    /// Largest team that it sends to one building.
    pub(super) team_max: usize,
}

impl<'a> LearnedAllocator<'a> {
    /// The allocator of a run that learned one.
    pub(super) fn of(subject: Option<&'a Subject>) -> Option<Self> {
        let Some(Subject::Run(run)) = subject else { return None };
        let team_max = run.description.config.allocation.team_max;
        run.allocator.as_ref().map(|network| Self { network, team_max })
    }
}

/// A rule, or what was learned.
#[derive(Clone, Copy)]
pub(super) enum Assigner<'a> {
    Rule(Allocation),
    Learned(LearnedAllocator<'a>),
}

impl<'a> Assigner<'a> {
    /// Who allocates unless the command line says otherwise: what was learned, else the best rule.
    pub(super) fn of_subject(subject: &'a Subject) -> Self {
        LearnedAllocator::of(Some(subject))
            .map_or(Self::Rule(Allocation::Coordinated), Self::Learned)
    }

    /// Who allocated in a recording of `sortie eval --episodes-out`, by its label, where that can be
    /// computed again: random choices are lost, and a learned allocator must be at hand.
    pub(super) fn of_label(policy: &str, learned: Option<LearnedAllocator<'a>>) -> Option<Self> {
        let (_, allocation) = policy.rsplit_once(", ")?;
        match allocation.strip_suffix(" allocation")? {
            "coordinated" => Some(Self::Rule(Allocation::Coordinated)),
            "heuristic" => Some(Self::Rule(Allocation::Heuristic)),
            "learned" => learned.map(Self::Learned),
            _ => None,
        }
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Rule(allocation) => allocation.name(),
            Self::Learned(_) => "learned",
        }
    }

    pub(super) fn allocator(self) -> Box<dyn Allocate + 'a> {
        match self {
            Self::Rule(allocation) => Box::new(allocation.rule()),
            Self::Learned(LearnedAllocator { network, team_max }) => {
                Box::new(TeamValueAllocator::new(network, team_max))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_of_own_recordings_name_their_rule() {
        let name = |label| Assigner::of_label(label, None).map(Assigner::name);
        assert_eq!(name("runs/a, b, heuristic allocation"), Some("heuristic"));
        assert_eq!(name("scripted, coordinated allocation"), Some("coordinated"));
        for unknown in ["scripted, random allocation", "runs/a, learned allocation", "scripted"] {
            assert_eq!(name(unknown), None);
        }
    }
}
