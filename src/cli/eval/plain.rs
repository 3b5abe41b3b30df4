//! Measures teams whose agents have no subtasks, in any environment.

use sortie_learn::Act;
use sortie_learn::evaluate::Evaluation;
use sortie_learn::play::PolicyTeam;

use super::attention::Watching;
use super::{EvalArguments, Match, Played};
use crate::environment::scripted;
use crate::failure::{Exit, Failure, Outcome};
use crate::policy::DeployedPolicy;
use crate::seeds::SeedRange;
use crate::subject::Subject;

impl Match<'_> {
    /// Plays the episodes of these seeds, with one team.
    pub(super) fn play(&self, seeds: SeedRange) -> Result<Played, Failure> {
        let Self { arguments, subject, set, environment, .. } = self;
        match subject {
            Subject::Scripted => {
                let mut team = scripted(set, &**environment, arguments.common.seed)?;
                self.play_team(seeds, &mut team)
            }
            Subject::Run(run) => self.play_team(seeds, &mut *run.method.team()),
            Subject::Bundle(bundle) => {
                let profile = arguments.profile.profile();
                let mut policy = DeployedPolicy::open_as(bundle, arguments.backend, profile)?;
                let mut policy = policy.policy()?;
                self.play_team(seeds, &mut PolicyTeam::new(policy.as_mut()))
            }
        }
    }

    fn play_team(&self, seeds: SeedRange, team: &mut dyn Act) -> Result<Played, Failure> {
        let asked = self.arguments.attention;
        let mut watching = Watching::new(team);
        let mut play = |seed| {
            let team: &mut dyn Act = if asked { &mut watching } else { watching.team() };
            Ok((seed, self.evaluate(team, seed, &mut ())?))
        };
        let evaluations: Vec<(u64, Evaluation)> =
            seeds.iter().map(&mut play).collect::<Result<_, Failure>>()?;
        let attention = watching.attention(self.environment.spec());
        if asked && attention.is_none() {
            let subject = self.arguments.subject.to_string_lossy();
            let reason = format!("the critic of `{subject}` looks at nobody in particular");
            return Err(Failure::new(Exit::Usage, reason));
        }
        Ok(Played { evaluations, attention, ..Played::default() })
    }
}

/// Refuses flags that would do nothing.
pub(super) fn check(arguments: &EvalArguments) -> Outcome {
    let refused = [
        ("--allocation", arguments.allocation.is_some()),
        ("--allocator", arguments.allocator.is_some()),
        ("--plan", arguments.plan.is_some()),
        ("--episodes-out", arguments.episodes_out.is_some()),
        ("--dump", arguments.dump.is_some()),
    ];
    match refused.into_iter().find(|(_, is_given)| *is_given) {
        None => Ok(()),
        Some((flag, _)) => {
            let reason = format!("`{flag}` is for teams that are allocated to subtasks");
            Err(Failure::new(Exit::Usage, reason))
        }
    }
}
