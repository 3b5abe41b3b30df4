//! Measures teams without subtasks, in any environment.

use std::path::Path;

use serde::Serialize;
use sortie_bundle::{Bundle, MANIFEST, SubtaskConditioning};
use sortie_envs::{Environment, Split};
use sortie_learn::Act;
use sortie_learn::evaluate::Evaluation;
use sortie_learn::play::{PolicyTeam, evaluate_watched};

use super::attention::{Attention, Watching};
use super::{BySeed, EvalArguments, print_tables};
use crate::deployment::open_bundle;
use crate::environment::{ScenarioSetName, Scripted, check_fits};
use crate::failure::{Exit, Failure, Outcome};
use crate::methods::{LearnedMethod, choose};
use crate::output::{plural, print_json, say};
use crate::policy::{DeployedPolicy, PlanProfile};
use crate::seeds::SeedRange;
use crate::terminal::{self, CountedEpisodes};

#[derive(Serialize)]
struct Report<'a> {
    env: &'a str,
    subject: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    seed: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    seeds: Option<&'a BySeed>,
    #[serde(flatten)]
    evaluation: &'a Evaluation,
    #[serde(skip_serializing_if = "Option::is_none")]
    attention: Option<&'a Attention>,
}

/// The bundle in a folder, if its agents know of no subtasks.
pub(super) fn flat_bundle(folder: &Path) -> Result<Option<Bundle>, Failure> {
    if !folder.join(MANIFEST).exists() {
        return Ok(None);
    }
    let bundle = open_bundle(folder)?;
    let is_flat = bundle.contract().subtask_conditioning == SubtaskConditioning::None;
    Ok(is_flat.then_some(bundle))
}

pub(super) fn play_bundle(arguments: &EvalArguments, bundle: &Bundle) -> Outcome {
    check(arguments)?;
    let trained_on = &bundle.manifest().contract.environment.name;
    let name = ScenarioSetName::parse(arguments.env.as_deref().unwrap_or(trained_on))?;
    check_fits(bundle, &name)?;
    let environment = name.open(Split::Test)?;
    let profile = arguments.profile.profile();
    let mut policy = DeployedPolicy::open_as(bundle, arguments.backend, profile)?;
    let mut policy = policy.policy()?;
    let mut team = PolicyTeam::new(policy.as_mut());
    play_team(arguments, &name.to_string(), &*environment, &mut team)
}

/// Measures what a run has learned.
pub(super) fn play_method(arguments: &EvalArguments, learned: &LearnedMethod) -> Outcome {
    check(arguments)?;
    if arguments.profile != PlanProfile::Exact {
        let reason = "`--profile` says how the plan of a bundle computes; name a bundle's folder";
        return Err(Failure::new(Exit::Usage, reason));
    }
    let mut choice = learned.description.config.environment.clone();
    if let Some(name) = &arguments.env {
        choose(&mut choice, name)?;
    }
    let environment = learned.open_as(&choice)?;
    play_team(arguments, &choice.to_string(), &*environment, &mut *learned.method.team())
}

/// Measures the script of an environment in which nobody is allocated.
pub(super) fn play_script(arguments: &EvalArguments, name: &ScenarioSetName) -> Outcome {
    check(arguments)?;
    let environment = name.open(Split::Test)?;
    let mut team = Scripted::of(name, &*environment, arguments.common.seed)?;
    play_team(arguments, &name.to_string(), &*environment, &mut team)
}

/// Plays the episodes that are asked for, and prints what they come to.
fn play_team(
    arguments: &EvalArguments,
    env: &str,
    environment: &dyn Environment,
    team: &mut dyn Act,
) -> Outcome {
    let seeds = arguments.seeds.unwrap_or(SeedRange::only(arguments.common.seed));
    let episodes = arguments.episodes as usize;
    let all = (episodes as u64).saturating_mul(seeds.iter().count() as u64);
    let bar = terminal::bar(arguments.common, all, "episodes");
    let mut counted = CountedEpisodes { bar: &bar, next: &mut () };
    let mut watching = Watching::new(team);
    let mut play = |seed| {
        let team: &mut dyn Act = if arguments.attention { &mut watching } else { watching.team() };
        Ok((seed, evaluate_watched(environment, team, episodes, seed, &mut counted)?))
    };
    let played: Vec<(u64, Evaluation)> =
        seeds.iter().map(&mut play).collect::<Result<_, Failure>>()?;
    bar.finish_and_clear();
    let attention = watching.attention(environment.spec());
    let subject = arguments.subject.to_string_lossy();
    if arguments.attention && attention.is_none() {
        let reason = format!("the critic of `{subject}` looks at nobody in particular");
        return Err(Failure::new(Exit::Usage, reason));
    }
    let by_seed =
        arguments.seeds.map(|_| BySeed::of(played.iter().map(|(seed, one)| (*seed, one))));
    let parts: Vec<Evaluation> = played.into_iter().map(|(_, one)| one).collect();
    let evaluation = match &parts[..] {
        [one] => one.clone(),
        parts => Evaluation::pooled(parts),
    };
    if arguments.common.json {
        print_json(&Report {
            env,
            subject: &subject,
            seed: by_seed.is_none().then_some(arguments.common.seed),
            seeds: by_seed.as_ref(),
            evaluation: &evaluation,
            attention: attention.as_ref(),
        });
        return Ok(());
    }
    say!("{env}: {subject}, {}", plural(evaluation.episodes, "episode"));
    print_tables(&evaluation, environment.spec(), by_seed.as_ref());
    attention.iter().for_each(Attention::print);
    Ok(())
}

/// Refuses flags that would do nothing.
fn check(arguments: &EvalArguments) -> Outcome {
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
