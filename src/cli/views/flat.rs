//! Episodes of teams without subtasks, as their pages show them.

use sortie_envs::{Environment, Split};
use sortie_learn::Act;
use sortie_learn::play::PolicyTeam;
use sortie_stage::Show;

use super::Wanted;
use super::captured::{Captured, capture};
use super::mind::{DeployedMind, Diary};
use crate::environment::check_fits;
use crate::failure::{Exit, Failure};
use crate::policy::{Backend, DeployedPolicy};
use crate::scripted::Scripted;
use crate::subject::Subject;

/// Has the subject play an episode in which nobody is allocated, and keeps what agents of a bundle thought in it. Returns
/// what was played in as well.
pub(super) fn played<S: Show>(
    wanted: &Wanted<'_>,
    subject: &Subject,
) -> Result<(String, Captured<S>), Failure> {
    let set = wanted.set.clone().unwrap_or_default();
    if let Some(asked) = wanted.allocation {
        return Err(asked.of_no_use());
    }
    let (env, world) = (set.to_string(), set.open(Split::Test)?);
    let captured = match subject {
        Subject::Scripted => {
            acted(wanted, &*world, &mut Scripted::of(&set, &*world, wanted.seed)?)?
        }
        Subject::Bundle(bundle) => {
            check_fits(bundle, &set)?;
            let mut deployed = DeployedPolicy::open(bundle, Backend::Plan)?;
            let mut mind = DeployedMind::new(bundle, deployed.team()?)?;
            let mut diary = Diary::new(&mut mind);
            let mut captured = acted(wanted, &*world, &mut PolicyTeam::new(&mut diary))?;
            captured.give_thoughts(diary.thoughts);
            captured
        }
        Subject::Run(_) => {
            let subject = wanted.subject.display();
            let message = format!("`{subject}` has learned in another environment than `{set}`");
            return Err(Failure::new(Exit::Mismatch, message));
        }
    };
    Ok((env, captured))
}

/// Has a team play the episode.
pub(super) fn acted<S: Show>(
    wanted: &Wanted<'_>,
    world: &dyn Environment,
    team: &mut dyn Act,
) -> Result<Captured<S>, Failure> {
    // As evaluations number them.
    capture(world, (wanted.seed, wanted.episode), team)
}
