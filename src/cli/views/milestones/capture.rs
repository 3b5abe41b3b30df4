//! Plays an episode and writes down what goes on in an agent that runs options.

use sortie_bundle::{Bundle, OptionsContract};
use sortie_core::options::{OptionPolicy, PlanNetworks, Pursuit};
use sortie_core::plan::Profile;
use sortie_core::{DecideError, Decision, Observation, Policy};
use sortie_envs::Environment;
use sortie_learn::play::PolicyTeam;
use sortie_plans::{CompileError, option_arena, option_networks, option_policy};
use sortie_stage::{Pursued, Show, Thought, rounded};

use crate::compiler::plans;
use crate::failure::Failure;
use crate::views::captured::{self, Captured};

/// Plays an episode of the environment, and writes down what went on in the agent.
pub(super) fn capture<S: Show>(
    environment: &dyn Environment,
    episode: (u64, usize),
    (bundle, options): (&Bundle, &OptionsContract),
) -> Result<Captured<S>, Failure> {
    let found = plans().agents(bundle, Profile::Exact)?;
    let mut arena = option_arena(found.plans()).map_err(CompileError::from)?;
    let networks = option_networks(found.plans(), &mut arena);
    let networks = networks.map_err(CompileError::from)?;
    let policy = option_policy((options, environment.spec().shape.actions), networks)?;
    let mut diary = Diary { policy, thoughts: Vec::new() };
    let mut captured = captured::capture(environment, episode, &mut PolicyTeam::new(&mut diary))?;
    captured.give_thoughts(diary.thoughts);
    Ok(captured)
}

/// Decides, and writes down what it thinks.
struct Diary<'a> {
    policy: OptionPolicy<PlanNetworks<'a>, Vec<f32>>,
    thoughts: Vec<Thought>,
}

impl Policy for Diary<'_> {
    fn actions(&self) -> usize {
        self.policy.actions()
    }

    fn utilities(&mut self, seen: &Observation<'_>, to: &mut [f32]) -> Result<(), DecideError> {
        self.policy.utilities(seen, to)
    }

    fn decide(&mut self, seen: &Observation<'_>) -> Result<Decision, DecideError> {
        self.policy.decide(seen)
    }

    fn hidden(&self) -> usize {
        self.policy.hidden()
    }

    fn decide_with(
        &mut self,
        seen: &Observation<'_>,
        hidden: &mut [f32],
    ) -> Result<Decision, DecideError> {
        let mut utilities = vec![0.0; self.policy.actions()];
        self.policy.utilities_with(seen, &mut hidden.to_vec(), &mut utilities)?;
        let decision = self.policy.decide_with(seen, hidden)?;
        let mut likelihoods = vec![0.0; self.policy.rules().milestones().len()];
        self.policy.likelihoods(seen, &mut likelihoods)?;
        let option = Pursuit::of(hidden).map(|Pursuit { goal, steps }| Pursued {
            goal,
            step: steps,
            mask: self.policy.rules().mask(&likelihoods),
            likelihoods: likelihoods.into_iter().map(rounded).collect(),
        });
        let thought = Thought::new(&utilities, Vec::new());
        self.thoughts.push(Thought { option, ..thought });
        Ok(decision)
    }
}
