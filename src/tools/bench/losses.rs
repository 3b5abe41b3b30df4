//! `sortie bench losses`: what a team is worth that loses agents for good.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;
use sortie_bundle::Bundle;
use sortie_cli::cast;
use sortie_cli::deployment::open_bundle;
use sortie_cli::environment::ScenarioSetName;
use sortie_cli::failure::{Exit, Failure, Outcome};
use sortie_cli::output::{Common, Table, print_json, say};
use sortie_core::wire::FrameMut;
use sortie_core::{Shape, StepOutcome, UNASSIGNED, UnavailableAction, World};
use sortie_envs::random::{episode, generator};
use sortie_envs::{Observation, Split, deployed_tasks};
use sortie_learn::evaluate::wilson_interval;
use sortie_stage::world::EnvironmentWorld;
use sortie_stage::{Cast, Memory, Moment, Stage, StageError};

/// Starts that are looked through for a team of the size that is wanted.
const TRIES: usize = 1_000;

/// Lose agents of a team in mid-episode, and play the same episodes without them
///
/// Plays every episode three times by the roles of a deployed team: with all agents; with some whose processes end at a step and
/// are not started again; and with these absent from the start. Tells the success of each, and whether others were given what
/// the lost ones worked on.
#[derive(Debug, Args)]
pub(super) struct LossesArguments {
    /// Folder of the bundle
    #[arg(default_value = "models/save-the-city")]
    bundle: PathBuf,
    /// Agents that are lost; default: the last one
    #[arg(long, value_delimiter = ',', value_name = "AGENTS")]
    lose: Vec<u16>,
    /// Step of the episode after which they are lost
    #[arg(long, default_value_t = 10, value_name = "STEP")]
    at: u32,
    /// Agents of the teams that play; default: as many as there may be
    #[arg(long, value_name = "AGENTS", value_parser = clap::value_parser!(u16).range(1..=64))]
    team: Option<u16>,
    /// Episodes to play
    #[arg(long, default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..))]
    episodes: u32,
    #[command(flatten)]
    common: Common,
}

/// What was found, for scripts.
#[derive(Debug, Serialize)]
struct Found {
    team: usize,
    lost: Vec<u16>,
    at: u32,
    whole: Success,
    lost_in_mid_episode: Success,
    absent_from_the_start: Success,
    handed_over: HandedOver,
}

/// How many of the episodes were solved.
#[derive(Debug, Serialize)]
struct Success {
    episodes: usize,
    solved: usize,
    success: f64,
    success_ci95: [f64; 2],
}

/// What became of the subtasks that lost agents worked on, within one decision interval after they became absent.
#[derive(Clone, Copy, Debug, Default, Serialize)]
struct HandedOver {
    /// Agents that worked on an open subtask when they were lost.
    at_work: usize,
    /// Another agent was given it.
    to_another: usize,
    /// Another had it already, and kept it.
    kept_by_another: usize,
    /// It was finished or lost meanwhile, or its episode over.
    closed: usize,
    /// It was left to nobody, as every other agent worked alone on another open one: to hold it is to leave that one.
    to_nobody_as_each_has_another: usize,
    /// It was left to nobody, though some were together or without work: others were worth more.
    to_nobody: usize,
    /// The lost agent still had it, or anything else.
    to_the_lost: usize,
    /// Ticks from a lost agent's last action, that one included, to the first in which it was absent, at most.
    ticks_until_absent: u32,
}

pub(super) fn run(arguments: &LossesArguments) -> Outcome {
    let bundle = open_bundle(&arguments.bundle)?;
    let set = ScenarioSetName::parse(&bundle.manifest().contract.environment.name)?;
    let cast = cast(&bundle, &set)?;
    let slots = World::shape(&Episodes::of(&set, 0, 0)?).agents;
    let team = arguments.team.map_or(slots, usize::from);
    let lost = match &arguments.lose[..] {
        [] => vec![team as u16 - 1],
        lost => lost.to_vec(),
    };
    if let Some(agent) = lost.iter().find(|agent| usize::from(**agent) >= team) {
        let message = format!("agent {agent} is not of a team of {team}");
        return Err(Failure::new(Exit::Usage, message));
    }
    let playing = Playing { arguments, set, cast, team, lost };
    let found = playing.measure().map_err(|failure| failure.within(bundle_name(&bundle)))?;
    if arguments.common.json {
        print_json(&found);
    } else {
        found.print();
    }
    Ok(())
}

fn bundle_name(bundle: &Bundle) -> String {
    bundle.folder().display().to_string()
}

/// What is played, whoever is lost.
struct Playing<'a> {
    arguments: &'a LossesArguments,
    set: ScenarioSetName,
    cast: Cast,
    team: usize,
    lost: Vec<u16>,
}

/// When agents are lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Loss {
    Never,
    After(u32),
    FromTheStart,
}

impl Playing<'_> {
    fn measure(&self) -> Result<Found, Failure> {
        let (whole, _) = self.play(Loss::Never)?;
        let (lost_in_mid_episode, handed_over) = self.play(Loss::After(self.arguments.at))?;
        let (absent_from_the_start, _) = self.play(Loss::FromTheStart)?;
        Ok(Found {
            team: self.team,
            lost: self.lost.clone(),
            at: self.arguments.at,
            whole,
            lost_in_mid_episode,
            absent_from_the_start,
            handed_over,
        })
    }

    fn play(&self, loss: Loss) -> Result<(Success, HandedOver), Failure> {
        let (arguments, seed) = (self.arguments, self.arguments.common.seed);
        let world = Episodes::of(&self.set, seed, self.team)?;
        let shape = World::shape(&world);
        let stage_error = |error: StageError| Failure::new(Exit::BadData, error.to_string());
        let mut memory = Memory::new(&self.cast, self.set.entry(), shape).map_err(stage_error)?;
        let absent = match loss {
            Loss::FromTheStart => self.lost.iter().fold(0, |set, agent| set | 1 << agent),
            Loss::Never | Loss::After(_) => 0,
        };
        let mut stage =
            Stage::without(absent, &mut memory, &self.cast, world, seed).map_err(stage_error)?;
        let (mut solved, mut handed_over) = (0, HandedOver::default());
        for _ in 0..arguments.episodes {
            self.play_one(&mut stage, loss, &mut handed_over).map_err(stage_error)?;
            solved += usize::from(stage.world.is_solved());
        }
        let episodes = arguments.episodes as usize;
        let success = Success {
            episodes,
            solved,
            success: solved as f64 / episodes as f64,
            success_ci95: wilson_interval(solved, episodes),
        };
        Ok((success, handed_over))
    }

    fn play_one(
        &self,
        stage: &mut Stage<'_, Episodes>,
        loss: Loss,
        handed_over: &mut HandedOver,
    ) -> Result<(), StageError> {
        let mut step = 0;
        let mut jobs: Vec<Job> = Vec::new();
        while stage.go_on()? != Moment::Over {
            if loss == Loss::After(step) {
                let lost = self.lost.iter().map(|agent| usize::from(*agent));
                jobs = lost.map(|agent| Job::of(agent, stage)).collect();
                jobs.iter().for_each(|job| stage.kill(job.agent));
            }
            step += 1;
            for job in &mut jobs {
                job.follow(stage, self.team, self.cast.decision_interval);
            }
        }
        for job in jobs {
            job.count(handed_over);
            stage.revive(job.agent)?;
        }
        Ok(())
    }
}

/// What an agent that is lost worked on.
struct Job {
    agent: usize,
    task: Option<u8>,
    had_company: bool,
    /// States since it was lost, and since it is absent.
    since_lost: u32,
    since_absent: Option<u32>,
    is_closed: bool,
    has_another: bool,
    still_has: bool,
    others_have_one_each: bool,
}

impl Job {
    fn of(agent: usize, stage: &Stage<'_, Episodes>) -> Self {
        let task = stage.allocation().get(agent).copied().filter(|task| *task != UNASSIGNED);
        let task = task.filter(|task| stage.world.open_tasks() >> task & 1 == 1);
        let mut job = Self {
            agent,
            task,
            had_company: false,
            since_lost: 0,
            since_absent: None,
            is_closed: false,
            has_another: false,
            still_has: false,
            others_have_one_each: false,
        };
        job.had_company = job.is_anothers(stage);
        job
    }

    fn is_anothers(&self, stage: &Stage<'_, Episodes>) -> bool {
        let mut given = stage.allocation().iter().enumerate();
        given.any(|(agent, task)| {
            agent != self.agent && Some(*task) == self.task && stage.lives(agent)
        })
    }

    /// Whether every other agent of the team works on an open subtask that is nobody else's.
    fn have_one_each(&self, stage: &Stage<'_, Episodes>, team: usize) -> bool {
        let mut free = stage.world.open_tasks();
        let given = stage.allocation().iter().enumerate().take(team);
        let mut others = given.filter(|(agent, _)| *agent != self.agent && stage.lives(*agent));
        others.all(|(_, task)| {
            let own = free & 1u32.checked_shl((*task).into()).unwrap_or(0);
            free &= !own;
            own != 0
        })
    }

    /// Looks at the allocation in force in a state after the loss.
    fn follow(&mut self, stage: &Stage<'_, Episodes>, team: usize, interval: u32) {
        if self.since_absent.is_none() && !stage.is_absent(self.agent) {
            self.since_lost += 1;
            return;
        }
        let since = self.since_absent.map_or(0, |since| since + 1);
        self.since_absent = Some(since);
        if since > interval {
            return;
        }
        self.still_has = stage.allocation().get(self.agent).is_some_and(|task| *task != UNASSIGNED);
        self.has_another |= self.is_anothers(stage);
        self.others_have_one_each = self.have_one_each(stage, team);
        self.is_closed |= self.task.is_some_and(|task| stage.world.open_tasks() >> task & 1 == 0);
    }

    fn count(&self, sum: &mut HandedOver) {
        sum.ticks_until_absent = sum.ticks_until_absent.max(self.since_lost);
        if self.task.is_none() {
            return;
        }
        sum.at_work += 1;
        *match self {
            Self { still_has: true, .. } => &mut sum.to_the_lost,
            Self { has_another: true, had_company: false, .. } => &mut sum.to_another,
            Self { has_another: true, .. } => &mut sum.kept_by_another,
            Self { is_closed: true, .. } | Self { since_absent: None, .. } => &mut sum.closed,
            Self { others_have_one_each: true, .. } => &mut sum.to_nobody_as_each_has_another,
            _ => &mut sum.to_nobody,
        } += 1;
    }
}

/// The episodes of a seed in which a team of one size plays.
struct Episodes {
    world: EnvironmentWorld,
    seed: u64,
    next: usize,
    team: usize,
}

impl Episodes {
    /// Those of teams of this size; of any, where it is 0.
    fn of(set: &ScenarioSetName, seed: u64, team: usize) -> Result<Self, Failure> {
        let world = EnvironmentWorld::not_begun(set.open(Split::Test)?, generator(seed));
        let mut episodes = Self { world, seed, next: 0, team };
        let found = (0..TRIES).any(|_| episodes.begin_next());
        episodes.next = 0;
        if found {
            return Ok(episodes);
        }
        let message = format!("no team of {team} plays in {TRIES} episodes of `{set}`");
        Err(Failure::new(Exit::Usage, message))
    }

    /// Begins the next episode; whether its team is of the size that is wanted.
    fn begin_next(&mut self) -> bool {
        self.world.draw_from(episode(self.seed, self.next).0);
        self.next += 1;
        self.world.reset();
        self.team == 0 || self.seen().agents() == self.team
    }

    fn seen(&self) -> Observation {
        let environment = self.world.environment.borrow();
        let (mut state, mut seen) = (Vec::new(), Observation::default());
        environment.save(0, &mut state);
        environment.observe(&state, 0, 0, &mut seen);
        seen
    }

    fn open_tasks(&self) -> u32 {
        deployed_tasks(self.seen().open_tasks)
    }

    /// Whether the newest episode that is over was solved.
    fn is_solved(&self) -> bool {
        self.world.tally.borrow().last.as_ref().is_some_and(|last| last.solved)
    }
}

impl World for Episodes {
    fn shape(&self) -> Shape {
        self.world.shape()
    }

    fn reset(&mut self) {
        while !self.begin_next() {}
    }

    fn observe(&self, frame: &mut FrameMut<'_>) {
        self.world.observe(frame);
    }

    fn step(&mut self, actions: &[u16]) -> Result<StepOutcome, UnavailableAction> {
        self.world.step(actions)
    }
}

impl Found {
    fn print(&self) {
        let Self { team, lost, at, handed_over, .. } = self;
        let lost = lost.iter().map(u16::to_string).collect::<Vec<_>>().join(", ");
        say!("teams of {team}, agents lost: {lost}\n");
        let mut table = Table::new(&["agents", "episodes", "solved", "success", "95 % interval"]);
        for (what, success) in [
            ("all".to_owned(), &self.whole),
            (format!("lost for good after step {at}"), &self.lost_in_mid_episode),
            ("absent from the start".to_owned(), &self.absent_from_the_start),
        ] {
            let Success { episodes, solved, success, success_ci95: [low, high] } = success;
            table.row([
                what,
                episodes.to_string(),
                solved.to_string(),
                format!("{success:.3}"),
                format!("{low:.3} to {high:.3}"),
            ]);
        }
        table.print();
        let HandedOver {
            at_work,
            to_another,
            kept_by_another,
            closed,
            to_nobody_as_each_has_another,
            to_nobody,
            to_the_lost,
            ..
        } = handed_over;
        say!(
            "\nof {at_work} subtasks of lost agents, within one interval: {to_another} to another agent, {kept_by_another} kept by \
             another, {closed} closed, {to_nobody_as_each_has_another} left as every other agent has one of its own, {to_nobody} left \
             otherwise, {to_the_lost} still with the lost; absent after {} ticks at most",
            handed_over.ticks_until_absent
        );
    }
}
