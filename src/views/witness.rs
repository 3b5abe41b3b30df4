//! Plays an episode in which nobody is allocated, and keeps what there is to show of it.

use sortie_envs::{Environment, Random, Spec, Split, StateError};
use sortie_learn::play::{Onlooker, Watched, watch};
use sortie_learn::{Act, LearnError, Scenes, Thought};

use crate::failure::Failure;

/// An episode as it was played.
pub(super) struct Witnessed<P> {
    /// What there is to draw of each state: one more than steps.
    pub(super) pictures: Vec<P>,
    pub(super) steps: Vec<Taken>,
    /// `[steps, agents]`: none where the team does not tell.
    pub(super) thoughts: Vec<Thought>,
    /// Whether it was solved.
    pub(super) solved: bool,
}

/// What happened between two states.
#[derive(Clone, Debug, Default)]
pub(super) struct Taken {
    pub(super) actions: Vec<u16>,
    /// The team's reward.
    pub(super) reward: f64,
    /// The agents' own, where they have some.
    pub(super) rewards: Vec<f64>,
}

/// Has the team play an episode, given by its seed and number, and keeps a picture of every state.
pub(super) fn witness<P>(
    environment: &dyn Environment,
    (seed, episode): (u64, usize),
    team: &mut dyn Act,
    picture_of: fn(&Spec, &[u8]) -> Result<P, StateError>,
) -> Result<Witnessed<P>, Failure> {
    let mut world = environment.open(1, Split::Test);
    let mut team = Telling { team, thoughts: Vec::new() };
    let (pictures, steps) = (Vec::new(), Vec::new());
    let mut recorder = Recorder { picture_of, pictures, steps, solved: false };
    watch(&mut *world, &mut team, episode..episode + 1, seed, &mut recorder)?;
    let Recorder { pictures, steps, solved, .. } = recorder;
    Ok(Witnessed { pictures, steps, thoughts: team.thoughts, solved })
}

/// Keeps what is played.
struct Recorder<P> {
    picture_of: fn(&Spec, &[u8]) -> Result<P, StateError>,
    pictures: Vec<P>,
    steps: Vec<Taken>,
    solved: bool,
}

impl<P> Recorder<P> {
    fn look(&mut self, watched: Watched<'_>) -> Result<(), LearnError> {
        let mut state = Vec::new();
        watched.worlds.save(watched.instance, &mut state);
        let picture = (self.picture_of)(watched.worlds.spec(), &state);
        self.pictures.push(picture.map_err(|error| LearnError::Team(error.to_string()))?);
        Ok(())
    }
}

impl<P> Onlooker for Recorder<P> {
    fn started(&mut self, watched: Watched<'_>) -> Result<(), LearnError> {
        self.look(watched)
    }

    fn stepped(
        &mut self,
        watched: Watched<'_>,
        actions: &[u16],
        step: &sortie_envs::Step,
    ) -> Result<(), LearnError> {
        self.steps.push(Taken {
            actions: actions.to_vec(),
            reward: step.reward,
            rewards: watched.worlds.agent_rewards(watched.instance).to_vec(),
        });
        self.solved = step.terminated;
        self.look(watched)
    }
}

/// A team that is asked what it thinks whenever it acts.
struct Telling<'a> {
    team: &'a mut dyn Act,
    thoughts: Vec<Thought>,
}

impl Act for Telling<'_> {
    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        random: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        self.team.act(scenes, random, actions)?;
        self.thoughts.extend(self.team.thoughts(scenes, actions));
        Ok(())
    }
}
