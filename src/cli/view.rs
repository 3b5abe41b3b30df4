//! `sortie view`: one episode as a page to look at, step by step.

use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;
use sortie_bundle::files::{MOST_BYTES, read_file, read_text};

use crate::allocation::AllocatorChoice;
use crate::failure::{Exit, Failure, Outcome};
use crate::files::{Kind, try_output, write_output};
use crate::output::{Common, plural, print_json, say};
use crate::subject::Subject;
use crate::views::{self, Hashes, Live, Page, Wanted, not_live};

/// Look at one episode: where everybody is, who is assigned where, what each agent computes
///
/// SUBJECT is a training run, a bundle, `scripted`, or a recorded episode (`sortie eval
/// --episodes-out`). The page is one HTML file that needs nothing else and works offline.
///
/// With --live the team plays in the page itself, with the bits of this machine, and whoever looks at it can interfere.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie view models/save-the-city -o episode.html --episode 7
  sortie view episodes/00007.json --policy runs/first -o episode.html
  sortie view models/save-the-city --live -o team.html")]
pub(crate) struct ViewArguments {
    /// A training run, a bundle, `scripted`, or the file of a recorded episode
    subject: PathBuf,
    /// The page to write
    #[arg(short, long, value_name = "FILE.html", required_unless_present = "hash")]
    output: Option<PathBuf>,
    /// Number of the episode to play, as `sortie eval --episodes-out` counts them; default: 0
    #[arg(long, value_name = "N")]
    episode: Option<u32>,
    /// Environment and scenario set; default: those of the subject
    #[arg(long, value_name = "ENV[/SET]")]
    env: Option<String>,
    /// Who assigns agents to subtasks [default: learned where the subject has it, else coordinated;
    /// for a recording what its label says]
    #[arg(long, value_enum)]
    allocation: Option<AllocatorChoice>,
    /// Show what this run or bundle computes in a recorded episode
    #[arg(long, value_name = "RUN|BUNDLE", visible_aliases = ["run", "bundle"])]
    policy: Option<PathBuf>,
    /// A page in which the team of a bundle plays, without a server
    #[arg(long, conflicts_with_all = ["allocation", "policy"])]
    live: bool,
    /// Print the hashes that the page of --live shows, as this machine computes them
    #[arg(long, requires = "live")]
    hash: bool,
    /// Another build of the program that the page of --live runs, packed by gzip [default: the one in this program]
    #[arg(long, requires = "live", value_name = "FILE.wasm.gz")]
    program: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

#[derive(Serialize)]
struct Report<'a> {
    file: &'a Path,
    steps: usize,
}

#[derive(Serialize)]
struct LiveReport<'a> {
    file: Option<&'a Path>,
    hashes: &'a Hashes,
}

pub(crate) fn run(arguments: &ViewArguments) -> Outcome {
    if arguments.live {
        return live(arguments);
    }
    let Some(file) = &arguments.output else {
        return Err(usage("name the page to write: -o FILE.html"));
    };
    try_output(file, Kind::Page)?;
    let subject = arguments.subject.as_path();
    let page = if subject.is_file() {
        recorded_page(arguments, subject)?
    } else {
        played_page(arguments)?
    };
    write_output(file, page.html.as_bytes())?;
    let report = Report { file, steps: page.steps };
    if arguments.common.json {
        print_json(&report);
    } else {
        say!("{}: {}", file.display(), plural(report.steps, "step"));
    }
    Ok(())
}

/// Writes the page in which a team plays, and says what bits it is to have.
fn live(arguments: &ViewArguments) -> Outcome {
    if let Some(file) = &arguments.output {
        try_output(file, Kind::Page)?;
    }
    let subject = Subject::find(&arguments.subject)?;
    let wanted = wanted(arguments);
    let Subject::Bundle(bundle) = &subject else { return Err(not_live(&wanted)) };
    let set = subject.scenario_set(arguments.env.as_deref())?;
    let program = arguments.program.as_deref().map(read).transpose()?;
    let Live { html, hashes } = views::live(&wanted, bundle, &set, program.as_deref())?;
    if let Some(file) = &arguments.output {
        write_output(file, html.as_bytes())?;
    }
    if arguments.common.json {
        print_json(&LiveReport { file: arguments.output.as_deref(), hashes: &hashes });
    } else if arguments.hash {
        let Hashes { golden, played, decisions, seed } = &hashes;
        say!("golden utilities: {golden}");
        say!("{decisions} decisions of seed {seed}: {played}");
    } else if let Some(file) = &arguments.output {
        say!("{}: {} KB", file.display(), html.len() / 1000);
    }
    Ok(())
}

fn read(file: &Path) -> Result<Vec<u8>, Failure> {
    read_file(file, MOST_BYTES).map_err(|error| Failure::file(file, &error))
}

fn played_page(arguments: &ViewArguments) -> Result<Page, Failure> {
    if arguments.policy.is_some() {
        return Err(usage("--policy is for recorded episodes; name the run or bundle itself"));
    }
    views::played(&wanted(arguments))
}

fn recorded_page(arguments: &ViewArguments, file: &Path) -> Result<Page, Failure> {
    if arguments.episode.is_some() || arguments.env.is_some() {
        return Err(usage("--episode and --env choose what is played, but this is a recording"));
    }
    let text = read_text(file, MOST_BYTES).map_err(|error| Failure::file(file, &error))?;
    views::recorded(&wanted(arguments), &text)
}

fn wanted(arguments: &ViewArguments) -> Wanted<'_> {
    Wanted {
        subject: &arguments.subject,
        env: arguments.env.as_deref(),
        episode: arguments.episode.unwrap_or(0) as usize,
        seed: arguments.common.seed,
        allocation: arguments.allocation,
        policy: arguments.policy.as_deref(),
    }
}

fn usage(message: &str) -> Failure {
    Failure::new(Exit::Usage, message)
}
