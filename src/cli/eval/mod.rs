//! `sortie eval`: how good is a team, over fresh greedy episodes?

mod attention;
mod plain;

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::Args;
use indicatif::ProgressBar;
use serde::Serialize;
use sortie_envs::{Environment, Spec};
use sortie_learn::Act;
use sortie_learn::evaluate::Evaluation;
use sortie_learn::play::{Onlooker, Planner, PlannerReport, evaluate_watched};
use sortie_learn::subtasks::{Agents, Allocate, AllocatedTeam, PolicyAgents, ScriptedAgents};

use self::attention::Attention;
use crate::allocation::AllocatorChoice;
use crate::allocator::ProposalArguments;
use crate::deployment::open_bundle;
use crate::environment::{ScenarioSetName, check_fits};
use crate::failure::{Exit, Failure, Outcome};
use crate::files::{EpisodeWriter, Kind, recording_of, recording_policy, try_output, write_output};
use crate::output::{Common, Table, plural, print_json, say};
use crate::policy::{Backend, DeployedPolicy, PlanProfile};
use crate::remake::shadow;
use crate::seeds::SeedRange;
use crate::subject::{self, Subject};
use crate::terminal::{self, CountedEpisodes};

/// Evaluate a team over fresh greedy episodes
///
/// SUBJECT is a bundle, the folder of a training run, or `scripted` for the environment's own
/// hand-written low level. Episodes are drawn from the seed and never seen in training; the same seed
/// gives the same episodes whoever plays them.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie eval models/save-the-city --episodes 2000
  sortie eval models/save-the-city --episodes 2000 --seeds 1001..1016
  sortie eval models/save-the-city --allocator runs/other
  sortie eval models/save-the-city --plan 24
  sortie eval models/save-the-city --profile int8
  sortie eval models/save-the-city --episodes 100 --dump observations.bin
  sortie eval models/better --on run.mcap     # what it would have done where another team was recorded
  sortie eval scripted --env save-the-city/2-8a_2-8b --allocation heuristic")]
pub(crate) struct EvalArguments {
    /// A bundle, a training run, or `scripted`
    subject: PathBuf,
    /// Environment and scenario set; default: those of the subject
    #[arg(long, value_name = "ENV[/SET]")]
    env: Option<String>,
    /// Episodes to play, with --seeds of each seed
    #[arg(long, default_value_t = 500, value_parser = clap::value_parser!(u32).range(1..))]
    episodes: u32,
    /// The episodes of several seeds, A and B included, taken together
    #[arg(long, value_name = "A..B", conflicts_with_all = ["seed", "plan", "episodes_out", "dump"])]
    seeds: Option<SeedRange>,
    /// Who assigns agents to subtasks [default: learned where the subject has it, else coordinated]
    #[arg(long, value_enum)]
    allocation: Option<AllocatorChoice>,
    #[command(flatten)]
    proposals: ProposalArguments,
    /// Bundle or training run whose learned allocator takes the place of the subject's
    #[arg(long, value_name = "BUNDLE|RUN", conflicts_with = "allocation")]
    allocator: Option<PathBuf>,
    /// Yardstick: look ahead with the exact simulator and try up to K changed allocations a decision
    ///
    /// The allocator's choice is played to the end in a copy of the world; where that does not solve
    /// the episode, K randomly changed allocations are played as well and the best is taken. It shows
    /// what allocation could still gain with this team; it is not a learned policy.
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u16).range(1..))]
    plan: Option<u16>,
    /// Record every episode into this folder, for `sortie replay`
    #[arg(long, value_name = "DIR")]
    episodes_out: Option<PathBuf>,
    /// Record what the agents of a bundle see into this file, for `sortie bench decision` and `sortie compile`
    #[arg(long, value_name = "FILE", conflicts_with = "plan")]
    dump: Option<PathBuf>,
    /// Do not play: decide in every state of a record of a team at work, and tell where the bundle does otherwise
    ///
    /// Its agents act on what the recorded team was allocated. The decisions that count are the half in which it sets its
    /// best action furthest apart from its second.
    #[arg(long, value_name = "RECORD", conflicts_with_all = ["env", "episodes", "seeds", "allocation", "allocator", "plan",
        "episodes_out", "dump", "attention", "backend", "profile"])]
    on: Option<PathBuf>,
    /// Also tell whom the critic of a run looks at, agent by agent, means over all steps: of `maac`
    #[arg(long)]
    attention: bool,
    /// What executes a bundle's network
    #[arg(long, value_enum, default_value_t = Backend::Plan)]
    backend: Backend,
    /// How a bundle's plan computes
    #[arg(long, value_enum, default_value_t = PlanProfile::Exact, conflicts_with = "backend")]
    profile: PlanProfile,
    #[command(flatten)]
    common: Common,
}

/// What an evaluation came to.
#[derive(Serialize)]
pub(crate) struct Report {
    env: String,
    subject: String,
    /// Absent where agents have no subtasks.
    #[serde(skip_serializing_if = "Option::is_none")]
    allocation: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    allocator: Option<String>,
    /// Absent where there are several.
    #[serde(skip_serializing_if = "Option::is_none")]
    seed: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    seeds: Option<BySeed>,
    #[serde(flatten)]
    evaluation: Evaluation,
    #[serde(skip_serializing_if = "Option::is_none")]
    planner: Option<PlannerReport>,
    #[serde(skip_serializing_if = "Option::is_none")]
    attention: Option<Attention>,
}

/// How far seeds lie apart.
#[derive(Serialize)]
struct BySeed {
    success: BTreeMap<u64, f64>,
    success_sd: f64,
    returns: BTreeMap<u64, f64>,
    returns_sd: f64,
}

/// What was measured, seed by seed, and whatever else is told of it.
#[derive(Default)]
struct Played {
    evaluations: Vec<(u64, Evaluation)>,
    /// Who allocated; nothing where agents have no subtasks.
    allocation: Option<&'static str>,
    /// What the planner did with the last seed, if there was one.
    planner: Option<PlannerReport>,
    attention: Option<Attention>,
}

/// What plays, whatever the seed.
struct Match<'a> {
    arguments: &'a EvalArguments,
    subject: Subject,
    set: ScenarioSetName,
    environment: Box<dyn Environment>,
    bar: ProgressBar,
}

pub(crate) fn run(arguments: &EvalArguments) -> Outcome {
    if let Some(record) = &arguments.on {
        let bundle = open_bundle(&arguments.subject)?;
        let draws = (arguments.common.seed, arguments.proposals);
        shadow(record, &bundle, draws)?.print(arguments.common);
        return Ok(());
    }
    let (spec, report) = evaluated(arguments)?;
    if arguments.common.json {
        print_json(&report);
    } else {
        report.print(&spec);
    }
    Ok(())
}

/// Plays the episodes.
///
/// # Errors
/// What is to be played is not there, or does not go together.
pub(crate) fn evaluated(arguments: &EvalArguments) -> Result<(Spec, Report), Failure> {
    arguments.backend.prepare()?;
    let subject = Subject::find(&arguments.subject)?;
    let set = subject.scenario_set(arguments.env.as_deref())?;
    let is_allocated = match &subject {
        // Agents that see no subtasks may play where there are none.
        Subject::Run(run) => {
            let has_subtasks = set.has_subtasks()?;
            run.method.subtasks().is_some_and(|subtasks| subtasks.are_seen || has_subtasks)
        }
        Subject::Bundle(_) => subject.has_subtasks(),
        Subject::Scripted => set.has_subtasks()?,
    };
    if arguments.attention && (is_allocated || !matches!(subject, Subject::Run(_))) {
        let reason = "`--attention` tells of critics, which are not deployed; name a run of `maac`";
        return Err(Failure::new(Exit::Usage, reason));
    }
    if is_allocated {
        set.check_subtasks()?;
    } else {
        plain::check(arguments)?;
    }
    check(arguments, &subject)?;
    if let Some(file) = &arguments.dump {
        try_output(file, Kind::Observations)?;
    }
    let environment = subject.open(&set)?;
    let seeds = arguments.seeds.unwrap_or(SeedRange::only(arguments.common.seed));
    let episodes = u64::from(arguments.episodes).saturating_mul(seeds.iter().count() as u64);
    let bar = terminal::bar(arguments.common, episodes, "episodes");
    let playing = Match { arguments, subject, set, environment, bar };
    let played = if is_allocated { playing.play_allocated(seeds) } else { playing.play(seeds) }?;
    playing.bar.finish_and_clear();
    Ok((playing.environment.spec().clone(), playing.report(played)))
}

/// Refuses flags that would do nothing.
fn check(arguments: &EvalArguments, subject: &Subject) -> Outcome {
    if matches!(subject, Subject::Bundle(_)) {
        return Ok(());
    }
    let is_tract = arguments.backend == Backend::Tract && arguments.allocator.is_none();
    let refused = [
        ("--dump", arguments.dump.is_some(), "records what the agents of a bundle see"),
        ("--backend tract", is_tract, "executes the networks of a bundle"),
        (
            "--profile",
            arguments.profile != PlanProfile::Exact,
            "says how the plan of a bundle computes",
        ),
    ];
    match refused.into_iter().find(|(_, is_given, _)| *is_given) {
        None => Ok(()),
        Some((flag, _, what)) => {
            Err(Failure::new(Exit::Usage, format!("`{flag}` {what}; name a bundle's folder")))
        }
    }
}

impl BySeed {
    fn of(evaluations: &[(u64, Evaluation)]) -> Self {
        let figures =
            |(seed, one): &(u64, Evaluation)| ((*seed, one.success), (*seed, one.return_mean));
        let (success, returns): (BTreeMap<_, _>, BTreeMap<_, _>) =
            evaluations.iter().map(figures).unzip();
        Self { success_sd: sd(&success), returns_sd: sd(&returns), success, returns }
    }
}

/// How far seeds lie apart.
fn sd(by_seed: &BTreeMap<u64, f64>) -> f64 {
    let mean = by_seed.values().sum::<f64>() / by_seed.len().max(1) as f64;
    let squares: f64 = by_seed.values().map(|value| (value - mean).powi(2)).sum();
    (squares / by_seed.len().saturating_sub(1).max(1) as f64).sqrt()
}

impl Match<'_> {
    /// Plays the episodes of these seeds, with agents that are allocated.
    fn play_allocated(&self, seeds: SeedRange) -> Result<Played, Failure> {
        // Whose allocator takes the place of the subject's.
        let other = self.arguments.allocator.as_deref().map(Subject::find).transpose()?;
        let mut played = Played::default();
        for seed in seeds.iter() {
            let evaluation = self.play_seed(seed, other.as_ref(), &mut played)?;
            played.evaluations.push((seed, evaluation));
        }
        Ok(played)
    }

    /// Opens agents and allocator, and plays the episodes of one seed.
    fn play_seed(
        &self,
        seed: u64,
        other: Option<&Subject>,
        played: &mut Played,
    ) -> Result<Evaluation, Failure> {
        let Self { arguments, subject, set, .. } = self;
        let asked = other.map(|_| AllocatorChoice::Learned).or(arguments.allocation);
        let owner = other.unwrap_or(subject);
        let name = arguments.allocator.as_ref().unwrap_or(&arguments.subject).to_string_lossy();
        let draws = (arguments.proposals, seed);
        let (allocation, mut allocator) = subject::open_for(
            (subject, set.entry()),
            asked,
            owner,
            &name,
            arguments.backend,
            draws,
        )?;
        played.allocation = Some(allocation);
        if let (Subject::Bundle(bundle), true) = (owner, allocator.is_deployed()) {
            check_fits(bundle, set)?;
        }
        let allocator = allocator.allocator()?;
        match subject {
            Subject::Scripted => {
                self.watch(Box::new(ScriptedAgents::new(seed)), allocator, seed, played)
            }
            Subject::Run(run) => {
                let subtasks = run.method.subtasks();
                let agents = subtasks.expect("its agents are allocated").agents;
                self.watch(agents, allocator, seed, played)
            }
            Subject::Bundle(bundle) => {
                let profile = arguments.profile.profile();
                let mut policy = DeployedPolicy::open_as(bundle, arguments.backend, profile)?;
                let mut policy = policy.policy()?;
                let Some(file) = &arguments.dump else {
                    let agents = Box::new(PolicyAgents::new(policy.as_mut()));
                    return self.watch(agents, allocator, seed, played);
                };
                let mut recording = recording_of(bundle);
                let recorder = recording_policy(policy.as_mut(), &mut recording);
                let agents = Box::new(PolicyAgents::new(recorder));
                let evaluation = self.watch(agents, allocator, seed, played)?;
                write_output(file, &recording.to_bytes())?;
                Ok(evaluation)
            }
        }
    }

    /// Has a planner look ahead where that is wanted.
    fn watch(
        &self,
        agents: Box<dyn Agents + '_>,
        allocator: Box<dyn Allocate + '_>,
        seed: u64,
        played: &mut Played,
    ) -> Result<Evaluation, Failure> {
        let allocation = played.allocation.unwrap_or("none");
        let mut team = AllocatedTeam::new(agents, allocator, self.subject.interval());
        let Some(candidates) = self.arguments.plan else {
            return self.record(&mut team, allocation, seed);
        };
        let mut planner = Planner::new(team, &*self.environment, candidates.into(), seed);
        let evaluation = self.record(&mut planner, &format!("planned from {allocation}"), seed)?;
        played.planner = Some(planner.report());
        Ok(evaluation)
    }

    /// Plays, and writes the episodes to files where that is wanted.
    fn record(
        &self,
        team: &mut dyn Act,
        allocation: &str,
        seed: u64,
    ) -> Result<Evaluation, Failure> {
        let Some(folder) = &self.arguments.episodes_out else {
            return self.evaluate(team, seed, &mut ());
        };
        let labels = (&*self.arguments.subject.to_string_lossy(), allocation);
        let mut writer = EpisodeWriter::new(folder, self.set.entry(), labels, seed)?;
        self.evaluate(team, seed, &mut writer)
    }

    /// Plays the episodes of a seed.
    fn evaluate(
        &self,
        team: &mut dyn Act,
        seed: u64,
        onlooker: &mut dyn Onlooker,
    ) -> Result<Evaluation, Failure> {
        let mut counted = CountedEpisodes { bar: &self.bar, next: onlooker };
        let episodes = self.arguments.episodes as usize;
        Ok(evaluate_watched(&*self.environment, team, episodes, seed, &mut counted)?)
    }

    /// What all seeds come to.
    fn report(&self, played: Played) -> Report {
        let Self { arguments, set, .. } = self;
        let Played { evaluations, allocation, planner, attention } = played;
        let seeds = arguments.seeds.map(|_| BySeed::of(&evaluations));
        let mut parts: Vec<Evaluation> = evaluations.into_iter().map(|(_, one)| one).collect();
        let evaluation =
            if parts.len() == 1 { parts.remove(0) } else { Evaluation::pooled(&parts) };
        Report {
            env: set.to_string(),
            subject: arguments.subject.to_string_lossy().into_owned(),
            allocation,
            allocator: arguments.allocator.as_ref().map(|path| path.display().to_string()),
            seed: seeds.is_none().then_some(arguments.common.seed),
            seeds,
            evaluation,
            planner,
            attention,
        }
    }
}

impl Report {
    fn print(&self, spec: &Spec) {
        let Self { env, subject, allocation, allocator, evaluation, .. } = self;
        let under = match allocation {
            None => String::new(),
            Some("none") => " without allocation".to_owned(),
            Some(name) => format!(" under {name} allocation"),
        };
        let of = allocator.as_ref().map(|path| format!(" of {path}")).unwrap_or_default();
        say!("{env}: {subject}{under}{of}, {}", plural(evaluation.episodes, "episode"));
        if let Some(PlannerReport { candidates, decisions, changed, .. }) = self.planner {
            say!(
                "planned with the exact simulator, {candidates} candidates: no learned policy, but a yardstick \
                 ({changed} of {decisions} decisions changed)"
            );
        }
        print_tables(evaluation, spec, self.seeds.as_ref());
        self.attention.iter().for_each(Attention::print);
    }
}

fn print_tables(evaluation: &Evaluation, spec: &Spec, by_seed: Option<&BySeed>) {
    let Evaluation { success, success_ci95: [low, high], return_mean, return_sd, .. } = evaluation;
    let mut table = Table::new(&["figure", "value"]);
    let mut row = |name: &str, value: String| table.row([name.to_string(), value]);
    let success = ("success", format!("{success:.3} ({low:.3} to {high:.3})"));
    let returned = ("return", format!("{return_mean:.2} (sd {return_sd:.2})"));
    let (first, by_seed) = match spec.has_success {
        true => (&success, by_seed.map(|by_seed| (&by_seed.success, by_seed.success_sd, 3))),
        false => (&returned, by_seed.map(|by_seed| (&by_seed.returns, by_seed.returns_sd, 2))),
    };
    row(first.0, first.1.clone());
    if let Some((of_seeds, sd, digits)) = by_seed {
        let least = of_seeds.values().copied().fold(f64::INFINITY, f64::min);
        let most = of_seeds.values().copied().fold(f64::NEG_INFINITY, f64::max);
        let name = format!("of {}", plural(of_seeds.len(), "seed"));
        row(&name, format!("sd {sd:.digits$} ({least:.digits$} to {most:.digits$})"));
    }
    for metric in &spec.metrics {
        if let Some(value) = evaluation.metrics.get(&*metric.name) {
            row(metric.about, format!("{value:.3}"));
        }
    }
    if spec.has_success {
        row("time-outs", format!("{:.3}", evaluation.timeouts));
        row(returned.0, returned.1);
    }
    row("steps", format!("{:.1}", evaluation.length_mean));
    table.print();
    if !evaluation.failures.is_empty() {
        say!();
        print_failures(evaluation);
    }
    if spec.has_success {
        say!();
        print_teams(evaluation);
    }
}

fn print_teams(evaluation: &Evaluation) {
    let mut teams = Table::new(&["team", "episodes", "success"]);
    for (team, success) in &evaluation.by_team {
        let share = success.solved as f64 / success.episodes.max(1) as f64;
        teams.row([team.clone(), success.episodes.to_string(), format!("{share:.3}")]);
    }
    teams.print();
}

fn print_failures(evaluation: &Evaluation) {
    let mut causes = Table::new(&["cause of failure", "episodes", "share"]);
    for (cause, count) in &evaluation.failures {
        let share = *count as f64 / evaluation.episodes.max(1) as f64;
        causes.row([cause.clone(), count.to_string(), format!("{share:.3}")]);
    }
    causes.print();
}
