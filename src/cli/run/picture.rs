//! The live picture of a run: where it is, how fast the team ticks, and the state as its environment draws it, in a block of
//! lines that changes in place.

use sortie_pages::{Canvas, Scene, draw};

use crate::latency::Percentiles;
use crate::worlds::tally::Tally;

/// All that one picture shows.
pub(super) struct Picture<'a> {
    pub(super) scene: Scene<'a>,
    pub(super) episode: usize,
    /// `None` = without end.
    pub(super) episodes: Option<usize>,
    /// Of the finished episodes.
    pub(super) tally: &'a Tally,
    pub(super) step: u32,
    pub(super) tick: Percentiles,
    /// What a person may do.
    pub(super) hint: &'a str,
}

/// The picture as lines of text, without line ends.
pub(super) fn lines(picture: &Picture<'_>, canvas: Canvas) -> Vec<String> {
    // Above and below: headline and hint.
    let room = Canvas { lines: canvas.lines.saturating_sub(2), ..canvas };
    let drawing = draw(&picture.scene, room);
    let gap = if drawing.legend.is_empty() { "" } else { "    " };
    let mut lines = vec![headline(picture)];
    lines.extend(drawing.lines);
    lines.push(format!("{}{gap}{}", drawing.legend, picture.hint));
    lines
}

fn headline(picture: &Picture<'_>) -> String {
    let of = picture.episodes.map_or(String::new(), |episodes| format!(" of {episodes}"));
    let Tally { episodes, solved, returns, .. } = picture.tally;
    let came = match picture.scene.spec.has_success {
        true => format!("solved {solved} of {episodes}"),
        false if *episodes == 0 => "no return yet".to_owned(),
        false => format!("mean return {:.1} of {episodes}", returns / *episodes as f64),
    };
    format!(
        "episode {}{of}, step {:3}   {came}   tick p50 {:.0} us, p99 {:.0} us",
        picture.episode, picture.step, picture.tick.p50, picture.tick.p99,
    )
}

#[cfg(test)]
mod tests {
    use sortie_envs::random::generator;
    use sortie_envs::{ENVIRONMENTS, Split};

    use super::*;
    use crate::environment::ScenarioSetName;

    #[test]
    fn every_environment_is_drawn_between_the_headline_and_the_hint() {
        console::set_colors_enabled(false);
        for entry in ENVIRONMENTS {
            let name = ScenarioSetName::parse(entry.name).expect("its usual set");
            let mut world = name.open(Split::Train).expect("it opens");
            world.reset(0, &mut generator(1));
            let mut state = Vec::new();
            world.save(0, &mut state);
            let agents = world.spec().shape.agents;
            let (allocation, actions) = (vec![0; agents], vec![0; agents]);
            let spec = world.spec();
            let picture = world.picture(&state);
            let scene =
                Scene { spec, picture: &picture, allocation: &allocation, actions: &actions };
            let mut tally = Tally::default();
            (tally.episodes, tally.solved, tally.returns) = (1, 1, 2.5);
            let picture = Picture {
                scene,
                episode: 2,
                episodes: Some(20),
                tally: &tally,
                step: 7,
                tick: Percentiles { p50: 20.4, p99: 80.0, p999: None, max: 90.0 },
                hint: "q quits",
            };
            let canvas = Canvas { width: 79, lines: 23, is_unicode: false };
            let shown = lines(&picture, canvas);
            let came = if spec.has_success { "solved 1 of 1" } else { "mean return 2.5 of 1" };
            let headline =
                format!("episode 2 of 20, step   7   {came}   tick p50 20 us, p99 80 us");
            assert_eq!(shown[0], headline);
            let text = shown.join("\n");
            assert!(text.ends_with("q quits"), "{text}");
            // Whoever is drawn by actions alone takes a line for each agent.
            assert!((2 + agents.min(3)..=23).contains(&shown.len()), "{text}");
            assert!(shown.iter().all(|line| line.is_ascii() && line.len() <= 79), "{text}");
        }
    }
}
