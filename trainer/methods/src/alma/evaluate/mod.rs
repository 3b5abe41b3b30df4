//! Measures a team: greedy episodes on starts that training never sees.
//!
//! Any [`Team`] under any allocator can be measured. Episode e of a seed is the same whoever plays it, so that teams can
//! be compared pair by pair.

mod planner;
mod worlds;

use sortie_envs::{DecisionPoints, Environment, Split};

pub use planner::{Planner, PlannerReport};

use crate::alma::teams::{Allocate, AllocatedTeam, Team};
use sortie_learn::LearnError;
use sortie_learn::evaluate::Evaluation;
use sortie_learn::play::{Onlooker, WORLDS, watch};

/// Which episodes are played.
#[derive(Clone, Copy)]
pub struct EvaluationPlan<'a> {
    /// What is played in, on starts that training never draws.
    pub environment: &'a dyn Environment,
    /// Steps between decisions, unless the open tasks change.
    pub interval: u32,
    /// How many episodes.
    pub episodes: usize,
    /// Which episodes: the same seed gives the same starts.
    pub seed: u64,
}

impl<'a> EvaluationPlan<'a> {
    /// So many episodes of a seed, with the usual interval between decisions.
    pub fn new(environment: &'a dyn Environment, episodes: usize, seed: u64) -> Self {
        Self { environment, interval: DecisionPoints::ACTION_LENGTH, episodes, seed }
    }

    /// So many instances to play in.
    fn open(&self, instances: usize) -> Box<dyn Environment> {
        self.environment.open(instances, Split::Test)
    }
}

/// Plays the episodes of a plan with a team and an allocator.
pub fn evaluate(
    plan: &EvaluationPlan<'_>,
    team: &mut dyn Team,
    allocator: &mut dyn Allocate,
) -> Result<Evaluation, LearnError> {
    evaluate_watched(plan, team, allocator, &mut ())
}

/// Plays the episodes of a plan while `onlooker` watches.
pub fn evaluate_watched(
    plan: &EvaluationPlan<'_>,
    team: &mut dyn Team,
    allocator: &mut dyn Allocate,
    onlooker: &mut dyn Onlooker,
) -> Result<Evaluation, LearnError> {
    let mut worlds = plan.open(WORLDS.min(plan.episodes));
    let mut team = AllocatedTeam::new(Box::new(team), Box::new(allocator), plan.interval);
    let done = watch(&mut *worlds, &mut team, 0..plan.episodes, plan.seed, onlooker)?;
    Ok(Evaluation::of(worlds.spec(), &done))
}

/// Plays the last episode of a plan alone: the same one that [`evaluate`] plays last.
pub fn watch_last_episode(
    plan: &EvaluationPlan<'_>,
    team: &mut dyn Team,
    allocator: &mut dyn Allocate,
    onlooker: &mut dyn Onlooker,
) -> Result<(), LearnError> {
    let mut worlds = plan.open(1);
    let mut team = AllocatedTeam::new(Box::new(team), Box::new(allocator), plan.interval);
    let last = plan.episodes.saturating_sub(1)..plan.episodes;
    watch(&mut *worlds, &mut team, last, plan.seed, onlooker)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alma::agents::{NetworkPolicy, UtilityNetwork};
    use crate::alma::records::Config;
    use crate::alma::teams::{NetworkTeam, PolicyTeam, RuleAllocator, ScriptedActors};
    use sortie_learn::random::{Purpose, generator};

    fn measured(episodes: usize, team: &mut dyn Team, allocator: &mut dyn Allocate) -> Evaluation {
        let environment =
            sortie_envs::open("save-the-city/2-5a_2-5b", Split::Test, 1, &Default::default());
        let environment = environment.unwrap();
        let plan = EvaluationPlan::new(&*environment, episodes, 11);
        evaluate(&plan, team, allocator).unwrap()
    }

    #[test]
    fn the_scripted_team_reaches_its_known_level() {
        let mut team = ScriptedActors::new(1);
        let coordinated = measured(1000, &mut team, &mut RuleAllocator("coordinated"));
        assert!((0.68..0.82).contains(&coordinated.success), "{coordinated:?}");
        let heuristic = measured(1000, &mut team, &mut RuleAllocator("heuristic"));
        assert!((0.44..0.56).contains(&heuristic.success), "{heuristic:?}");
        assert_eq!(coordinated.by_team.len(), 13);
        assert_eq!(coordinated.by_team.values().map(|team| team.episodes).sum::<usize>(), 1000);
        let failed: usize = heuristic.failures.values().sum();
        assert_eq!(
            failed,
            heuristic.by_team.values().map(|t| t.episodes - t.solved).sum::<usize>()
        );
        let burned = heuristic.failures.iter().filter(|(cause, _)| cause.starts_with("burned"));
        let burned: usize = burned.map(|(_, count)| count).sum();
        assert_eq!(burned as f64, (1000.0 * (1.0 - heuristic.metrics["none_burned"])).round());
        let [low, high] = coordinated.success_ci95;
        assert!(low < coordinated.success && coordinated.success < high);
    }

    #[test]
    fn an_evaluation_repeats() {
        let run = || measured(100, &mut ScriptedActors::new(3), &mut RuleAllocator("random"));
        assert_eq!(run(), run());
    }

    #[test]
    fn a_policy_acts_as_the_network_that_it_is_made_of() {
        let config = Config::default();
        let mut weights = generator(4, Purpose::Weights, 0);
        let environment =
            sortie_envs::open("save-the-city", Split::Test, 1, &Default::default()).unwrap();
        let shape = config.network.shape(environment.spec());
        // So large weights that whatever is seen decides what is done.
        let network = UtilityNetwork::initialise(shape, 0.02, &mut weights);
        let play = |team: &mut dyn Team| measured(40, team, &mut RuleAllocator("heuristic"));
        let by_network = play(&mut NetworkTeam::new(&network));
        let by_policy = play(&mut PolicyTeam::new(NetworkPolicy::new(&network)));
        assert_eq!(by_network, by_policy);
        assert!(by_network.length_mean > 10.0);
    }
}
