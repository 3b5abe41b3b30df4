//! One run per seed, as many at a time as there are cores, each in a process of its own.

use std::fs;
use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::str::FromStr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;

use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal};
use serde::Serialize;
use serde_json::Value;
use sortie_ipc::Stop;
use sortie_learn::run::{Configuration, Settings};

use super::cores;
use crate::arguments::Common;
use crate::failure::{Exit, Failure, Outcome};
use crate::output::{Table, print_json};

/// Seeds from the first to the last, both included.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SeedRange {
    first: u64,
    last: u64,
}

impl FromStr for SeedRange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || format!("`{text}` is no range of seeds such as 1..5");
        let (first, last) = text.split_once("..").ok_or_else(expected)?;
        let number = |text: &str| text.parse().map_err(|_| expected());
        let (first, last) = (number(first)?, number(last)?);
        if first <= last { Ok(Self { first, last }) } else { Err(expected()) }
    }
}

/// How one seed's run ended.
#[derive(Clone, Debug, Serialize)]
struct Finished {
    seed: u64,
    run: PathBuf,
    success: f64,
}

/// What all seeds together came to.
#[derive(Clone, Debug, Serialize)]
struct Summary {
    seeds: usize,
    success_mean: f64,
    success_sd: f64,
    success_min: f64,
    success_max: f64,
    runs: Vec<Finished>,
}

/// Runs all seeds; those that are finished already are only read.
pub(super) fn run(
    seeds: SeedRange,
    config: &Settings,
    threads: usize,
    out: &Path,
    common: Common,
    stop: &Stop,
) -> Outcome {
    let sweep = Sweep::new(config, threads, out, common)?;
    let next = AtomicU64::new(seeds.first);
    let worker = || {
        let mut finished = Vec::new();
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed > seeds.last || stop.flag().load(Ordering::Relaxed) {
                return Ok(finished);
            }
            finished.push(sweep.run(seed, stop)?);
        }
    };
    let results: Vec<Result<Vec<Finished>, Failure>> = thread::scope(|scope| {
        let workers = (0..(cores() / threads).max(1)).map(|_| scope.spawn(worker));
        let workers: Vec<_> = workers.collect();
        workers.into_iter().map(|worker| worker.join().unwrap_or_else(|_| Err(died()))).collect()
    });
    let mut runs = Vec::new();
    for result in results {
        runs.extend(result?);
    }
    runs.sort_by_key(|run| run.seed);
    if stop.flag().load(Ordering::Relaxed) {
        let again = "stopped; the same command again goes on with what is unfinished";
        return Err(Failure::new(Exit::Interrupted, again));
    }
    print(&Summary::new(runs), common);
    Ok(())
}

fn died() -> Failure {
    Failure::new(Exit::Bug, "a thread of the sweep died; please report this")
}

/// What the runs of all seeds have in common.
struct Sweep {
    out: PathBuf,
    config: PathBuf,
    threads: usize,
    steps: u64,
    common: Common,
    bars: MultiProgress,
}

impl Sweep {
    /// Writes the configuration beside the runs, for all of them to read.
    fn new(config: &Settings, threads: usize, out: &Path, common: Common) -> Result<Self, Failure> {
        let path = suffixed(out, ".toml");
        if let Some(parent) = out.parent() {
            fs::create_dir_all(parent).map_err(|error| Failure::file(parent, &error))?;
        }
        fs::write(&path, config.to_toml()?).map_err(|error| Failure::file(&path, &error))?;
        let hidden = common.json || common.quiet;
        let target =
            if hidden { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr() };
        Ok(Self {
            out: out.to_owned(),
            config: path,
            threads,
            steps: config.run().steps,
            common,
            bars: MultiProgress::with_draw_target(target),
        })
    }

    /// Runs one seed, or goes on with it, or reads how it ended.
    fn run(&self, seed: u64, stop: &Stop) -> Result<Finished, Failure> {
        let folder = suffixed(&self.out, &format!("-s{seed}"));
        if !folder.join("result.json").exists() {
            self.learn(seed, &folder, stop)?;
        }
        let success = success(&folder)?;
        Ok(Finished { seed, run: folder, success })
    }

    fn learn(&self, seed: u64, folder: &Path, stop: &Stop) -> Outcome {
        let bug = |error: std::io::Error| Failure::new(Exit::InputOutput, error.to_string());
        let mut child = self.command(seed, folder).spawn().map_err(bug)?;
        let output = child.stdout.take();
        let bar = self.bars.add(bar(self.steps, seed));
        thread::scope(|scope| {
            scope.spawn(|| forward_stop(&child, stop));
            if let Some(output) = output {
                self.follow(seed, output, &bar);
            }
        });
        bar.finish_and_clear();
        let status = child.wait().map_err(bug)?;
        match status.code() {
            Some(0) => Ok(()),
            Some(code) if code == Exit::Interrupted as i32 => {
                Err(Failure::new(Exit::Interrupted, "stopped; the same command again goes on"))
            }
            _ => Err(Failure::new(Exit::NotRunning, format!("the run of seed {seed}: {status}"))),
        }
    }

    fn command(&self, seed: u64, folder: &Path) -> Command {
        // A program that was replaced while it runs is still itself under this name.
        let mut command = Command::new("/proc/self/exe");
        command.args(["train", "alma", "--json", "--threads", &self.threads.to_string()]);
        if folder.join("train.toml").exists() {
            command.arg("--resume").arg(folder);
        } else {
            command.arg("--config").arg(&self.config).arg("--out").arg(folder);
            command.args(["--seed", &seed.to_string()]);
        }
        // Its own group, so that Ctrl-C reaches it once: by this process.
        command.stdin(Stdio::null()).stdout(Stdio::piped()).process_group(0);
        command
    }

    /// Shows what a run tells, a JSON object a line.
    fn follow(&self, seed: u64, output: ChildStdout, bar: &ProgressBar) {
        for line in BufReader::new(output).lines().map_while(Result::ok) {
            let Ok(Value::Object(mut point)) = serde_json::from_str(&line) else { continue };
            let success = point.get("success").and_then(Value::as_f64).unwrap_or(0.0);
            if let Some(steps) = point.get("env_steps").and_then(Value::as_u64) {
                bar.set_position(steps);
                bar.set_message(format!("success {success:.3}"));
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
    ProgressBar::new(steps).with_style(style).with_message("success not measured yet")
}

/// `path` with more at its end.
fn suffixed(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}

/// The success that a finished run reports.
fn success(folder: &Path) -> Result<f64, Failure> {
    let path = folder.join("result.json");
    let text = fs::read_to_string(&path).map_err(|error| Failure::file(&path, &error))?;
    let result: Option<Value> = serde_json::from_str(&text).ok();
    result.and_then(|result| result.get("success")?.as_f64()).ok_or_else(|| {
        Failure::new(Exit::BadData, format!("{}: no `success` in it", path.display()))
    })
}

impl Summary {
    fn new(runs: Vec<Finished>) -> Self {
        let count = runs.len() as f64;
        let mean = runs.iter().map(|run| run.success).sum::<f64>() / count;
        let squares = runs.iter().map(|run| (run.success - mean).powi(2)).sum::<f64>();
        let fold = |pick: fn(f64, f64) -> f64| runs.iter().map(|run| run.success).reduce(pick);
        Self {
            seeds: runs.len(),
            success_mean: mean,
            success_sd: (squares / (count - 1.0).max(1.0)).sqrt(),
            success_min: fold(f64::min).unwrap_or(f64::NAN),
            success_max: fold(f64::max).unwrap_or(f64::NAN),
            runs,
        }
    }
}

fn print(summary: &Summary, common: Common) {
    if common.json {
        print_json(summary);
        return;
    }
    if common.quiet {
        return;
    }
    let mut table = Table::new(&["run", "success"]);
    for run in &summary.runs {
        table.row([run.run.display().to_string(), format!("{:.3}", run.success)]);
    }
    let Summary { success_mean, success_sd, success_min, success_max, .. } = summary;
    table.row(["mean".to_owned(), format!("{success_mean:.3}")]);
    table.row(["standard deviation".to_owned(), format!("{success_sd:.3}")]);
    table.row(["range".to_owned(), format!("{success_min:.3} to {success_max:.3}")]);
    table.print();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_range_includes_both_ends() {
        assert_eq!("1..5".parse(), Ok(SeedRange { first: 1, last: 5 }));
        assert_eq!("3..3".parse(), Ok(SeedRange { first: 3, last: 3 }));
        for wrong in ["5..1", "1", "a..b", "1..", "-1..2"] {
            assert!(SeedRange::from_str(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_summary_tells_mean_and_spread() {
        let run = |seed, success| Finished { seed, run: PathBuf::new(), success };
        let summary = Summary::new(vec![run(1, 0.5), run(2, 0.7), run(3, 0.9)]);
        assert!((summary.success_mean - 0.7).abs() < 1e-12);
        assert!((summary.success_sd - 0.2).abs() < 1e-12);
        assert_eq!((summary.success_min, summary.success_max), (0.5, 0.9));
    }
}
