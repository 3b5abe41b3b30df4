//! Runs that differ in nothing but their seeds, each in a process of its own.

use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, ChildStdout, Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::{fs, thread};

use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal};
use serde::Serialize;
use serde_json::Value;
use sortie_bundle::files::{Durability, MOST_TEXT_BYTES, read_text, replace_file};
use sortie_ipc::Stop;
use sortie_learn::evaluate::Score;
use sortie_learn::report::Spread;
use sortie_learn::run::{Difference, Setup, method_of, read_description};

use super::cores;
use crate::failure::{Exit, Failure, Outcome};
use crate::output::{Common, Table, plural, print_json, tell};
use crate::seeds::SeedRange;

/// How one seed's run ended.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Finished {
    pub(super) seed: u64,
    pub(super) run: PathBuf,
    pub(super) success: f64,
    pub(super) return_mean: f64,
}

/// Runs seeds of sweeps, as many at a time as there are cores for; those that are finished already are only read. A seed
/// that fails stops no other. `done` is called after each.
///
/// # Errors
/// The first failure, or that all were stopped.
pub(crate) fn learn_all(
    jobs: &[(&Sweep<'_>, u64)],
    threads: usize,
    stop: &Stop,
    done: impl Fn() + Sync,
) -> Result<Vec<Finished>, Failure> {
    let next = AtomicUsize::new(0);
    let worker = || {
        let mut ended = Vec::new();
        loop {
            let place = next.fetch_add(1, Ordering::Relaxed);
            let Some((sweep, seed)) = jobs.get(place) else { return ended };
            if stop.flag().load(Ordering::Relaxed) {
                return ended;
            }
            ended.push((place, sweep.run(*seed, stop)));
            done();
        }
    };
    let ended = thread::scope(|scope| {
        let workers = (0..(cores() / threads).max(1)).map(|_| scope.spawn(worker));
        let workers: Vec<_> = workers.collect();
        let join = |worker: thread::ScopedJoinHandle<'_, _>| worker.join().map_err(|_| died());
        workers.into_iter().map(join).collect::<Result<Vec<Vec<_>>, Failure>>()
    })?;
    let mut ended: Vec<_> = ended.into_iter().flatten().collect();
    ended.sort_by_key(|(place, _)| *place);
    check_stop(stop)?;
    successes(ended)
}

/// Ends a command that was stopped and goes on when it is given again.
pub(crate) fn check_stop(stop: &Stop) -> Outcome {
    if stop.flag().load(Ordering::Relaxed) {
        let again = "stopped; the same command again goes on with what is unfinished";
        return Err(Failure::new(Exit::Interrupted, again));
    }
    Ok(())
}

/// All runs, or the first failure of a seed and how many others failed.
fn successes(ended: Vec<(usize, Result<Finished, Failure>)>) -> Result<Vec<Finished>, Failure> {
    let failures = ended.iter().filter(|(_, run)| run.is_err()).count();
    let runs = ended.into_iter().map(|(_, run)| run).collect::<Result<Vec<_>, _>>();
    runs.map_err(|failure| match failures {
        1 => failure,
        _ => {
            let message =
                format!("{}; {} more failed", failure.message, plural(failures - 1, "seed"));
            Failure { message, ..failure }
        }
    })
}

fn died() -> Failure {
    Failure::new(Exit::Bug, "a thread of the sweep died; please report this")
}

/// What the runs of all seeds have in common.
pub(crate) struct Sweep<'a> {
    out: &'a Path,
    /// The file with what all runs have in common.
    configuration: &'a Path,
    setup: &'a Setup,
    threads: usize,
    common: Common,
    bars: MultiProgress,
    /// What says how good the runs are.
    score: Score,
}

impl<'a> Sweep<'a> {
    /// Runs of a setup, whose products are settled, in folders `OUT-sSEED`.
    pub(crate) fn new(
        setup: &'a Setup,
        threads: usize,
        [out, configuration]: [&'a Path; 2],
        common: Common,
    ) -> Self {
        let hidden = common.json || common.quiet;
        let target =
            if hidden { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr() };
        let score = Score::of_environment(&setup.environment.to_string());
        let bars = MultiProgress::with_draw_target(target);
        Self { out, configuration, setup, threads, common, score, bars }
    }

    /// Refuses a seed whose folder holds a run of another configuration, finished or not.
    pub(crate) fn check(&self, seed: u64) -> Outcome {
        let folder = self.folder(seed);
        if !folder.join("train.toml").exists() {
            return Ok(());
        }
        let found_method = method_of(&folder)?;
        let (method, place) = (&self.setup.method, folder.display());
        let other = |key: &str, there: &str, here: &str| {
            let reason = format!(
                "{place} has `{key}` = {there}, this sweep {here}: repeat what began it, or choose another --out"
            );
            Err(Failure::new(Exit::Usage, reason))
        };
        if found_method != *method {
            return other("method", &found_method, method);
        }
        let found = read_description(&folder)?;
        if found.seed != seed {
            return other("seed", &found.seed.to_string(), &seed.to_string());
        }
        match &Difference::between(self.setup, &found.config)?[..] {
            [Difference { key, ours, theirs }, ..] => other(key, theirs, ours),
            [] => Ok(()),
        }
    }

    /// Writes the configuration beside the runs, for all of them to read.
    pub(crate) fn write_configuration(&self) -> Outcome {
        let path = self.configuration;
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent).map_err(|error| Failure::file(parent, &error))?;
        }
        if !path.exists() {
            let text = self.setup.to_toml()?;
            return replace_file(path, text.as_bytes(), Durability::Forced)
                .map_err(|error| Failure::file(path, &error));
        }
        let text = read_text(path, MOST_TEXT_BYTES).map_err(|error| Failure::file(path, &error))?;
        let found = Setup::from_text(&self.setup.method, &text)
            .map_err(|error| Failure::from(error).within(path.display()))?;
        let differences = Difference::between(self.setup, &found)?;
        let Some(Difference { key, ours, theirs }) = differences.first() else { return Ok(()) };
        let reason = format!(
            "{} has `{key}` = {theirs}, this sweep {ours}: remove it, or choose another --out",
            path.display()
        );
        Err(Failure::new(Exit::Usage, reason))
    }

    /// The folder of a seed's run.
    pub(crate) fn folder(&self, seed: u64) -> PathBuf {
        run_folder(self.out, seed)
    }

    /// Runs one seed, or goes on with it, or reads how it ended.
    fn run(&self, seed: u64, stop: &Stop) -> Result<Finished, Failure> {
        let folder = self.folder(seed);
        if !folder.join("result.json").exists() {
            self.learn(seed, &folder, stop)?;
        }
        let [success, return_mean] = figures(&folder, ["success", "return_mean"])?;
        Ok(Finished { seed, success, return_mean, run: folder })
    }

    fn learn(&self, seed: u64, folder: &Path, stop: &Stop) -> Outcome {
        let failed = |error: std::io::Error| Failure::new(Exit::InputOutput, error.to_string());
        let mut child = self.command(seed, folder).spawn().map_err(failed)?;
        let (output, words) = (child.stdout.take(), child.stderr.take());
        let bar = self.bars.add(bar(self.setup.run.steps, seed));
        let error = thread::scope(|scope| {
            scope.spawn(|| forward_stop(&child, stop));
            let error = scope.spawn(|| words.map_or(String::new(), |words| self.listen(words)));
            if let Some(output) = output {
                self.follow(seed, output, &bar);
            }
            error.join().unwrap_or_default()
        });
        bar.finish_and_clear();
        let status = child.wait().map_err(failed)?;
        match status.code() {
            Some(0) => Ok(()),
            Some(code) => {
                Err(Failure::new(Exit::from_code(code as u8), format!("seed {seed}: {error}")))
            }
            None => {
                let reason =
                    format!("seed {seed}: {status}; the same command again goes on with it");
                Err(Failure::new(Exit::NotRunning, reason))
            }
        }
    }

    /// Passes on what a run tells a person, and returns why it failed.
    fn listen(&self, words: ChildStderr) -> String {
        let mut error = String::new();
        for line in BufReader::new(words).lines().map_while(Result::ok) {
            match line.strip_prefix("error: ") {
                Some(reason) => error = reason.to_owned(),
                None => self.bars.suspend(|| tell!("{line}")),
            }
        }
        error
    }

    fn command(&self, seed: u64, folder: &Path) -> Command {
        // A program that was replaced while it runs is still itself under this name.
        let mut command = Command::new("/proc/self/exe");
        command.args(["train", &self.setup.method, "--json"]);
        command.args(["--threads", &self.threads.to_string()]);
        command.args(["--sweep", &std::process::id().to_string()]);
        if folder.join("train.toml").exists() {
            command.arg("--resume").arg(folder);
        } else {
            command.arg("--config").arg(self.configuration).arg("--out").arg(folder);
            command.args(["--seed", &seed.to_string()]);
        }
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        // Its own group, so that Ctrl-C reaches it once: by this process.
        command.process_group(0);
        command
    }

    /// Shows what a run tells, a JSON object a line.
    fn follow(&self, seed: u64, output: ChildStdout, bar: &ProgressBar) {
        for line in BufReader::new(output).lines().map_while(Result::ok) {
            let Ok(Value::Object(mut point)) = serde_json::from_str(&line) else { continue };
            let score = point.get(self.score.key()).and_then(Value::as_f64).unwrap_or(0.0);
            if let Some(steps) = point.get("env_steps").and_then(Value::as_u64) {
                bar.set_position(steps);
                let score = format!("{} {}", self.score.name(), self.score.text(score));
                let is_over = bar.length().is_some_and(|all| steps >= all);
                bar.set_message(if is_over { format!("{score}; last evaluation") } else { score });
            }
            if self.common.json {
                point.insert("run_seed".to_owned(), seed.into());
                print_json(&point);
            }
        }
    }
}

/// Passes a stop on to a run until the run has ended.
fn forward_stop(child: &Child, stop: &Stop) -> rustix::io::Result<()> {
    let pause = Timespec { tv_sec: 0, tv_nsec: 100_000_000 };
    let process = pidfd_open(Pid::from_child(child), PidfdFlags::empty())?;
    let mut ended = [PollFd::new(&process, PollFlags::IN)];
    while poll(&mut ended, Some(&pause))? == 0 {
        if stop.flag().load(Ordering::Relaxed) {
            return pidfd_send_signal(&process, Signal::INT);
        }
    }
    Ok(())
}

fn bar(steps: u64, seed: u64) -> ProgressBar {
    let template = format!("seed {seed:<4} {{bar:30}} {{percent:>3}} %, {{eta}} left, {{msg}}");
    let style = ProgressStyle::with_template(&template).expect("the template is sound");
    ProgressBar::new(steps).with_style(style).with_message("not measured yet")
}

/// The folder of a seed's run, of runs that differ in their seeds.
pub(crate) fn run_folder(out: &Path, seed: u64) -> PathBuf {
    suffixed(out, &format!("-s{seed}"))
}

/// `path` with more at its end.
pub(crate) fn suffixed(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}

/// Figures that a finished run reports.
fn figures<const N: usize>(folder: &Path, keys: [&str; N]) -> Result<[f64; N], Failure> {
    let path = folder.join("result.json");
    let text = read_text(&path, MOST_TEXT_BYTES).map_err(|error| Failure::file(&path, &error))?;
    let result: Option<Value> = serde_json::from_str(&text).ok();
    let mut found = [0.0; N];
    for (to, key) in found.iter_mut().zip(keys) {
        let figure = result.as_ref().and_then(|result| result.get(key)?.as_f64());
        let missing = || format!("{}: no `{key}` in it", path.display());
        *to = figure.ok_or_else(|| Failure::new(Exit::BadData, missing()))?;
    }
    Ok(found)
}

/// What all seeds together came to.
#[derive(Clone, Debug, Serialize)]
struct Summary {
    seeds: usize,
    success_mean: f64,
    success_sd: f64,
    success_min: f64,
    success_max: f64,
    return_mean: f64,
    return_sd: f64,
    runs: Vec<Finished>,
}

/// Runs all seeds; those that are finished already are only read. A seed that fails stops no other.
pub(super) fn run(
    seeds: SeedRange,
    setup: &Setup,
    threads: usize,
    out: &Path,
    common: Common,
    stop: &Stop,
) -> Outcome {
    if setup.run.final_episodes == 0 {
        let reason = "`run.final_episodes` is 0: a sweep compares what its seeds report in the end";
        return Err(Failure::new(Exit::Usage, reason));
    }
    let configuration = suffixed(out, ".toml");
    let sweep = Sweep::new(setup, threads, [out, &configuration], common);
    for seed in seeds.iter() {
        sweep.check(seed)?;
    }
    sweep.write_configuration()?;
    let jobs: Vec<_> = seeds.iter().map(|seed| (&sweep, seed)).collect();
    let runs = learn_all(&jobs, threads, stop, || ())?;
    print(&Summary::new(runs), Score::of_environment(&setup.environment.to_string()), common);
    Ok(())
}

/// Mean and spread of what finished runs report.
fn spread(runs: &[Finished], figure: fn(&Finished) -> f64) -> Spread {
    let nothing = Spread { mean: f64::NAN, sd: None, min: f64::NAN, max: f64::NAN };
    Spread::of(runs.iter().map(figure)).unwrap_or(nothing)
}

impl Summary {
    fn new(runs: Vec<Finished>) -> Self {
        let success = spread(&runs, |run| run.success);
        let returned = spread(&runs, |run| run.return_mean);
        Self {
            seeds: runs.len(),
            success_mean: success.mean,
            success_sd: success.sd.unwrap_or(0.0),
            success_min: success.min,
            success_max: success.max,
            return_mean: returned.mean,
            return_sd: returned.sd.unwrap_or(0.0),
            runs,
        }
    }
}

fn print(summary: &Summary, score: Score, common: Common) {
    if common.json {
        print_json(summary);
        return;
    }
    let figure: fn(&Finished) -> f64 = match score {
        Score::Success => |run| run.success,
        Score::Return => |run| run.return_mean,
    };
    let mut table = Table::new(&["run", score.name()]);
    for run in &summary.runs {
        table.row([run.run.display().to_string(), score.text(figure(run))]);
    }
    let Spread { mean, sd, min, max } = spread(&summary.runs, figure);
    let [mean, sd, min, max] = [mean, sd.unwrap_or(0.0), min, max].map(|value| score.text(value));
    table.row(["mean".to_owned(), mean]);
    table.row(["standard deviation".to_owned(), sd]);
    table.row(["range".to_owned(), format!("{min} to {max}")]);
    table.print();
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;

    #[test]
    fn a_summary_tells_mean_and_spread() {
        let run = |seed, success| {
            let return_mean = 10.0 * success;
            Finished { seed, run: PathBuf::new(), success, return_mean }
        };
        let summary = Summary::new(vec![run(1, 0.5), run(2, 0.7), run(3, 0.9)]);
        assert!((summary.success_mean - 0.7).abs() < 1e-12);
        assert!((summary.success_sd - 0.2).abs() < 1e-12);
        assert_eq!((summary.success_min, summary.success_max), (0.5, 0.9));
        assert!((summary.return_mean - 7.0).abs() < 1e-12);
        assert!((summary.return_sd - 2.0).abs() < 1e-12);
    }
}
