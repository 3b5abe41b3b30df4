//! What is shown of environments, a folder for each: a picture in the terminal, a page, words in a report.
//!
//! The rest of the command line knows environments by their names alone.

mod captured;
mod crafting;
mod gridworld;
mod group_matching;
mod live;
mod milestones;
mod page;
mod particle;
mod save_the_city;
mod treasure_rooms;

use std::path::Path;

pub use live::cast;
use serde::Serialize;
use serde_json::{Map, Value};
use sortie_bundle::Bundle;
use sortie_envs::{Environment, Episode, Spec};
use sortie_learn::Act;

use crate::allocation::AllocatorChoice;
use crate::environment::ScenarioSetName;
use crate::failure::{Exit, Failure};
use crate::subject::Subject;
use crate::worlds::tally::Tally;

/// Every environment that is shown by more than its numbers.
const VIEWS: &[(&str, &dyn View)] = &[
    save_the_city::VIEW,
    group_matching::VIEW,
    particle::VIEW,
    gridworld::VIEW,
    crafting::VIEW,
    treasure_rooms::VIEW,
];

/// What is shown of an environment of this name.
pub(crate) fn view_of(environment: &str) -> &'static dyn View {
    let found = VIEWS.iter().find(|(known, _)| *known == environment);
    found.map_or(&Plain, |(_, view)| *view)
}

/// What is shown of one environment. The defaults do for any.
pub(crate) trait View {
    /// What an episode came to, in a few words.
    fn outcome(&self, spec: &Spec, episode: &Episode) -> String {
        let values = spec.metrics.iter().zip(&episode.metrics);
        let told =
            values.filter_map(|(metric, value)| Some(format!("{} {}", metric.name, (*value)?)));
        told.collect::<Vec<_>>().join(", ")
    }

    /// What episodes came to, beside what is counted everywhere.
    fn figures(&self, spec: &Spec, tally: &Tally) -> Figures {
        let mean = |name| {
            let sum = tally.metric(spec, name);
            (sum.episodes > 0).then(|| sum.sum / sum.episodes as f64)
        };
        let means = || spec.metrics.iter().filter_map(|metric| Some((metric, mean(metric.name)?)));
        let text =
            means().map(|(metric, mean)| format!("{} {mean:.2} {}", metric.name, metric.unit));
        let fields: Map<String, Value> =
            means().map(|(metric, mean)| (metric.name.to_owned(), mean.into())).collect();
        Figures {
            text: text.collect::<Vec<_>>().join(", "),
            fields: vec![("metrics", fields.into())],
        }
    }

    /// A state as lines of text, and what explains its signs.
    fn draw(&self, scene: &Scene<'_>, canvas: Canvas) -> Drawing {
        let _ = canvas;
        let actions = scene.actions.iter().enumerate();
        let action = |(agent, action): (usize, &u16)| {
            let name = scene.spec.actions_of(agent).get(usize::from(*action));
            name.map(|name| format!("agent {agent:2}  {name}"))
        };
        Drawing { lines: actions.filter_map(action).collect(), legend: String::new() }
    }

    /// The page of an episode that the subject plays.
    fn played(&self, wanted: &Wanted<'_>, subject: &Subject) -> Result<Page, Failure> {
        let _ = subject;
        Err(no_page(wanted))
    }

    /// The page of an episode that a team of any method plays in `world`, which is called `env`.
    fn acted(
        &self,
        wanted: &Wanted<'_>,
        env: String,
        world: &dyn Environment,
        team: &mut dyn Act,
    ) -> Result<Page, Failure> {
        let _ = (world, team);
        let subject = wanted.subject.display();
        let message =
            format!("`{subject}` cannot be looked at in `{env}`; `sortie eval` measures it");
        Err(Failure::new(Exit::Usage, message))
    }

    /// The page in which a bundle's team plays, by another build of its program where one is given.
    fn live(
        &self,
        wanted: &Wanted<'_>,
        bundle: &Bundle,
        program: Option<&[u8]>,
    ) -> Result<Live, Failure> {
        let _ = (bundle, program);
        Err(not_live(wanted))
    }

    /// The page of a recorded episode, given as text.
    fn recorded(&self, wanted: &Wanted<'_>, text: &str) -> Result<Page, Failure> {
        let _ = text;
        let message = format!(
            "`{}` is a recording of an environment whose episodes can only be viewed as they are played",
            wanted.subject.display()
        );
        Err(Failure::new(Exit::Usage, message))
    }
}

/// An environment that nothing more is known of.
struct Plain;

impl View for Plain {}

/// What a report says of an environment's own numbers.
pub(crate) struct Figures {
    /// For people, without line ends.
    pub(crate) text: String,
    /// For scripts, by their names and in this order.
    pub(crate) fields: Vec<(&'static str, Value)>,
}

impl Figures {
    /// The means of an environment's own numbers, in these words.
    fn of_means(
        spec: &Spec,
        tally: &Tally,
        told: impl Fn(&[(&'static str, f64)]) -> String,
    ) -> Self {
        let means = spec.metrics.iter().filter_map(|metric| {
            let sum = tally.metric(spec, metric.name);
            (sum.episodes > 0).then(|| (metric.name, sum.sum / sum.episodes as f64))
        });
        let means: Vec<(&str, f64)> = means.collect();
        let fields: Map<String, Value> =
            means.iter().map(|(name, mean)| ((*name).to_owned(), (*mean).into())).collect();
        Self { text: told(&means), fields: vec![("metrics", fields.into())] }
    }
}

/// One state that is drawn.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scene<'a> {
    pub(crate) spec: &'a Spec,
    /// As the environment saves it.
    pub(crate) state: &'a [u8],
    /// Subtask of every agent, [`UNASSIGNED`](sortie_core::UNASSIGNED) for none.
    pub(crate) allocation: &'a [u8],
    /// Last action of every agent, by index.
    pub(crate) actions: &'a [u16],
}

/// Where it is drawn.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Canvas {
    /// Characters of a line.
    pub(crate) width: usize,
    pub(crate) lines: usize,
    /// Whether there is more than ASCII.
    pub(crate) is_unicode: bool,
}

/// A picture of characters.
pub(crate) struct Drawing {
    pub(crate) lines: Vec<String>,
    /// What signs mean, at the foot.
    pub(crate) legend: String,
}

/// Which episode is wanted as a page.
#[derive(Debug)]
pub(crate) struct Wanted<'a> {
    /// Where the page goes by the command line's words: a run, a bundle, `scripted` or a recording.
    pub(crate) subject: &'a Path,
    /// What is played; none for recordings.
    pub(crate) set: Option<ScenarioSetName>,
    pub(crate) episode: usize,
    pub(crate) seed: u64,
    pub(crate) allocation: Option<AllocatorChoice>,
    /// Whose thoughts are shown in a recording.
    pub(crate) policy: Option<&'a Path>,
}

impl Wanted<'_> {
    /// What a page calls its subject: who gets the page sent need not know the folders above.
    pub(crate) fn name(&self) -> String {
        let whole = self.subject.as_os_str();
        self.subject.file_name().unwrap_or(whole).to_string_lossy().into_owned()
    }
}

pub(crate) struct Page {
    pub(crate) html: String,
    /// Steps of its episode.
    pub(crate) steps: usize,
}

/// A page in which a team plays.
pub(crate) struct Live {
    pub(crate) html: String,
    pub(crate) hashes: Hashes,
}

/// What a page computes if it has the bits of this machine.
#[derive(Debug, Serialize)]
pub(crate) struct Hashes {
    /// FNV-1a over the utilities of the bundle's golden observations.
    pub(crate) golden: String,
    /// The same over those of the first decisions in the episodes of a seed.
    pub(crate) played: String,
    pub(crate) decisions: u64,
    pub(crate) seed: String,
}

/// A line that is no longer than this.
fn fitting(text: String, width: usize) -> String {
    console::truncate_str(&text, width, "+").into_owned()
}

/// Why a team does not play in a page.
pub(crate) fn not_live(wanted: &Wanted<'_>) -> Failure {
    let message = format!(
        "`{}` cannot play in a page: --live takes bundles of {}, such as models/{}",
        wanted.subject.display(),
        known_names(),
        VIEWS.first().map_or("", |(name, _)| name)
    );
    Failure::new(Exit::Usage, message)
}

fn no_page(wanted: &Wanted<'_>) -> Failure {
    let message = format!(
        "`{}` cannot be looked at: there are pages of {} only",
        wanted.subject.display(),
        known_names()
    );
    Failure::new(Exit::Usage, message)
}

/// The environments that are shown, as text.
fn known_names() -> String {
    VIEWS.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use sortie_envs::{ENVIRONMENTS, Split};

    use super::*;

    /// What an environment says of itself, and an episode with these of its metrics.
    pub(super) fn episode(environment: &str, values: &[(&str, f64)]) -> (Spec, Episode) {
        let name = ScenarioSetName::parse(environment).expect("a set");
        let spec = name.open(Split::Train).expect("it opens").spec().clone();
        let value = |name| values.iter().find(|(known, _)| *known == name).map(|(_, value)| *value);
        let metrics = spec.metrics.iter().map(|metric| value(metric.name)).collect();
        (spec, Episode { steps: 7, episode_return: 1.5, metrics, ..Episode::default() })
    }

    #[test]
    fn an_environment_without_a_view_is_told_by_its_numbers() {
        let entry = ENVIRONMENTS.last().expect("an environment");
        let metric = episode(entry.name, &[]).0.metrics[0];
        let (spec, played) = episode(entry.name, &[(metric.name, 1.0)]);
        let view = view_of("no such environment");
        assert_eq!(view.outcome(&spec, &played), format!("{} 1", metric.name));
        let mut tally = Tally::default();
        tally.add(played);
        tally.add(episode(entry.name, &[(metric.name, 2.0)]).1);
        tally.add(episode(entry.name, &[]).1);
        let figures = view.figures(&spec, &tally);
        assert_eq!(figures.text, format!("{} 1.50 {}", metric.name, metric.unit));
        assert_eq!(figures.fields[0].1[metric.name], 1.5);
        let scene = Scene { spec: &spec, state: &[], allocation: &[], actions: &[1, u16::MAX] };
        let canvas = Canvas { width: 79, lines: 21, is_unicode: true };
        assert_eq!(view.draw(&scene, canvas).lines, [format!("agent  0  {}", spec.actions[1])]);
        let wanted = Wanted {
            subject: Path::new("scripted"),
            set: None,
            episode: 0,
            seed: 1,
            allocation: None,
            policy: None,
        };
        let refused = view.played(&wanted, &Subject::Scripted).err().expect("no page");
        assert!(refused.message.contains("there are pages of"), "{}", refused.message);
    }
}
