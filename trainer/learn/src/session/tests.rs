//! When a run measures, and on which episodes, told by a method that learns nothing.

use super::*;
use crate::act::{Act, Ask};
use crate::method::Transition;
use crate::play::{RandomTeam, evaluate};
use sortie_envs::Split;

/// Stays while it plays, and is measured by what it draws. It needs a number to be used, and others to go on.
#[derive(Default)]
struct Idle {
    kept: u8,
    replay: Vec<u8>,
}

impl Method for Idle {
    fn act(&mut self, Ask { actions, .. }: Ask<'_>, _: Now) -> Result<()> {
        actions.fill(1);
        Ok(())
    }

    fn remember(&mut self, _: &Transition<'_>) -> Result<()> {
        Ok(())
    }

    fn rates(&self, _: Now) -> Rates {
        Rates { epsilon: 0.0, learning_rate: 0.0 }
    }

    fn team(&self) -> Box<dyn Act + '_> {
        Box::new(RandomTeam::new(1))
    }

    fn state(&mut self, state: &mut State<'_>) -> Result<()> {
        state.kept("kept", &mut self.kept)?;
        state.value("replay", &mut self.replay)
    }
}

/// What a run tells.
#[derive(Default)]
struct Told {
    curve: Vec<CurvePoint>,
    result: Option<RunResult>,
}

impl Observer for Told {
    fn evaluated(&mut self, point: &CurvePoint) {
        self.curve.push(point.clone());
    }

    fn finished(&mut self, result: &RunResult) {
        self.result = Some(result.clone());
    }
}

fn ring() -> Box<dyn Environment> {
    sortie_envs::open("group-matching/4x3x2", Split::Train, 1, &Default::default()).unwrap()
}

const SEED: u64 = 7;

/// How a run of seven steps a round is described.
fn description(run: RunConfig) -> RunDescription {
    let environment = EnvironmentChoice::of(&*ring(), 7);
    RunDescription::new(
        Setup { method: "idle".to_owned(), environment, run, ..Setup::default() },
        SEED,
        1,
    )
}

fn told(run: RunConfig) -> Told {
    let (folder, ring) = (tempfile::tempdir().unwrap(), ring());
    let description = description(run);
    let run =
        Session::begin(description, ring, Box::new(Idle::default()), &folder.path().join("run"));
    let mut told = Told::default();
    let outcome = run.unwrap().run(&mut told, &AtomicBool::new(false)).unwrap();
    assert_eq!(outcome, Outcome::Finished);
    told
}

/// An evaluation that is late, since a round had to end first, does not put off those behind it.
#[test]
fn evaluations_keep_to_their_steps() {
    let run = RunConfig {
        steps: 126,
        evaluate_every: 30,
        evaluate_episodes: 1,
        final_episodes: 0,
        ..RunConfig::default()
    };
    let Told { curve, result } = told(run);
    let steps: Vec<u64> = curve.iter().map(|point| point.env_steps).collect();
    assert_eq!((&steps[..], result), (&[35, 63, 91, 126][..], None));
}

/// The curve's episodes are the seed's own; those of the result are the same for all runs and play no part before.
#[test]
fn the_result_is_measured_on_episodes_that_no_evaluation_uses() {
    let (evaluate_episodes, final_episodes) = (20, 30);
    let run = RunConfig {
        steps: 14,
        evaluate_every: 14,
        evaluate_episodes,
        final_episodes,
        ..RunConfig::default()
    };
    let Told { curve, result } = told(run);
    let result = result.expect("a result");
    let of = |episodes, seed| evaluate(&*ring(), &mut RandomTeam::new(1), episodes, seed).unwrap();
    let own = of(evaluate_episodes, u64::MAX - SEED);
    assert_eq!((curve.len(), curve[0].return_mean), (1, own.return_mean));
    assert_eq!((result.seed, result.evaluation), (2_000_000, of(final_episodes, 2_000_000)));
    assert_ne!(own.return_mean, of(evaluate_episodes, 2_000_000).return_mean);
}

/// What was learned can be used; going on would be another run.
#[test]
fn checkpoints_without_replay_are_used_and_not_resumed() {
    let folder = tempfile::tempdir().unwrap();
    let run = RunConfig { steps: 7, evaluate_episodes: 1, final_episodes: 0, ..Default::default() };
    for checkpoint_replay in [true, false] {
        let place = folder.path().join(checkpoint_replay.to_string());
        let description = description(RunConfig { checkpoint_replay, ..run.clone() });
        let learned = Idle { kept: 9, replay: vec![1; 5_000] };
        let mut session = Session::begin(description, ring(), Box::new(learned), &place).unwrap();
        session.run(&mut (), &AtomicBool::new(false)).unwrap();
        drop(session);

        let mut used = Idle::default();
        load_weights(&place, &mut used).unwrap();
        assert_eq!((used.kept, used.replay.len()), (9, 0));
        let checkpoint = RunFolder::new(&place).checkpoints().newest(OpenFor::Use).unwrap();
        let state = checkpoint.checkpoint.place().join("state.postcard");
        assert_eq!(std::fs::metadata(state).unwrap().len() > 5_000, checkpoint_replay);
        let resumed = Session::resume(&place, |_| Ok((ring(), Box::new(Idle::default()))));
        let refused = resumed.map(|session| session.env_steps()).map_err(|error| error.to_string());
        match checkpoint_replay {
            true => assert_eq!(refused, Ok(7)),
            false => assert!(refused.unwrap_err().contains("`run.checkpoint_replay=false`")),
        }
    }
}
