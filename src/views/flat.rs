//! Episodes of teams without subtasks, as their pages show them.

use sortie_envs::{Environment, Split};
use sortie_learn::Act;
use sortie_learn::play::PolicyTeam;

use super::Wanted;
use super::mind::{DeployedMind, Diary, Thought};
use crate::environment::check_fits;
use crate::failure::{Exit, Failure};
use crate::policy::{Backend, DeployedPolicy};
use crate::scripted::Scripted;
use crate::subject::Subject;

/// Has the subject play an episode in which nobody is allocated, and gives what was captured of it what agents of a
/// bundle thought, decision by decision. Returns what was played in as well.
pub(super) fn played<C>(
    wanted: &Wanted<'_>,
    subject: &Subject,
    capture: impl FnOnce(&dyn Environment, &mut dyn Act) -> Result<C, Failure>,
    give: impl FnOnce(&mut C, Vec<Thought>),
) -> Result<(String, C), Failure> {
    let set = wanted.set.clone().unwrap_or_default();
    if let Some(asked) = wanted.allocation {
        return Err(asked.of_no_use());
    }
    let (env, world) = (set.to_string(), set.open(Split::Test)?);
    let captured = match subject {
        Subject::Scripted => capture(&*world, &mut Scripted::of(&set, &*world, wanted.seed)?)?,
        Subject::Bundle(bundle) => {
            check_fits(bundle, &set)?;
            let mut deployed = DeployedPolicy::open(bundle, Backend::Plan)?;
            let mut mind = DeployedMind::new(bundle, deployed.team()?)?;
            let mut diary = Diary::new(&mut mind);
            let mut captured = capture(&*world, &mut PolicyTeam::new(&mut diary))?;
            give(&mut captured, diary.thoughts);
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
