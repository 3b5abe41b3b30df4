//! Plays an episode in which nobody is allocated, and keeps what its page shows.

use serde::Serialize;
use sortie_envs::{Environment, Random, Split};
use sortie_learn::play::{Onlooker, Watched, watch};
use sortie_learn::{Act, LearnError, Scenes};
use sortie_stage::{Glance, Head, Show, Shown, Thought, rounded};

use crate::failure::Failure;

/// An episode as it went.
#[derive(Serialize)]
#[serde(bound = "")]
pub(super) struct Captured<S: Show> {
    #[serde(flatten)]
    pub(super) facts: S::Facts,
    /// One more than steps: the last one is final.
    states: Vec<Thoughtful<S>>,
    pub(super) steps: Vec<S::Step>,
    events: Vec<S::Event>,
    result: &'static str,
    /// `[agents, cells]`: how often each agent was where while it learned; empty where that is not known.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    visits: Vec<Vec<u32>>,
}

/// A state, and what is thought in it.
#[derive(Serialize)]
#[serde(bound = "")]
struct Thoughtful<S: Show> {
    #[serde(flatten)]
    state: S::State,
    /// Agent by agent; none where nothing is known of it, as in the last state.
    #[serde(skip_serializing_if = "Option::is_none")]
    thoughts: Option<Vec<Thought>>,
}

/// Has the team play an episode, given by its seed and number, and keeps it; with what the team thinks, if it tells.
pub(super) fn capture<S: Show>(
    environment: &dyn Environment,
    (seed, episode): (u64, usize),
    team: &mut dyn Act,
) -> Result<Captured<S>, Failure> {
    let mut world = environment.open(1, Split::Test);
    let mut telling = Telling { team, thoughts: Vec::new() };
    let mut recorder = Recorder::<S> { facts: None, shown: Vec::new() };
    let played = watch(&mut *world, &mut telling, episode..episode + 1, seed, &mut recorder)?;
    let Telling { team, thoughts } = telling;
    let Recorder { facts, shown } = recorder;
    let facts = facts.expect("an episode begins before it ends");
    let before = |at: usize| at.checked_sub(1).and_then(|before| shown.get(before));
    let events = shown.iter().enumerate();
    let events = events.flat_map(|(at, now)| S::events(&facts, at, before(at), now)).collect();
    let mut captured = Captured {
        facts,
        steps: shown.iter().filter_map(|shown| shown.step.clone()).collect(),
        states: shown
            .into_iter()
            .map(|it| Thoughtful { state: it.state, thoughts: None })
            .collect(),
        events,
        result: S::result(&played[0]),
        visits: team.visits(),
    };
    captured.give_thoughts(thoughts);
    Ok(captured)
}

impl<S: Show> Captured<S> {
    /// Gives the states what was thought in them: agent by agent, state by state; none in the last.
    pub(super) fn give_thoughts(&mut self, thoughts: Vec<Thought>) {
        let of_states = thoughts.chunks(S::agents(&self.facts).max(1));
        for (state, own) in self.states.iter_mut().zip(of_states) {
            state.thoughts = Some(own.to_vec());
        }
    }
}

/// Keeps what is played.
struct Recorder<S: Show> {
    facts: Option<S::Facts>,
    shown: Vec<Shown<S>>,
}

impl<S: Show> Onlooker for Recorder<S> {
    fn started(&mut self, watched: Watched<'_>) -> Result<(), LearnError> {
        let mut state = Vec::new();
        let first = Glance::at(watched.worlds, watched.instance, &mut state);
        self.facts = Some(S::facts(first));
        self.shown.push(Shown { step: None, state: S::state(first) });
        Ok(())
    }

    fn stepped(
        &mut self,
        watched: Watched<'_>,
        actions: &[u16],
        outcome: &sortie_envs::Step,
    ) -> Result<(), LearnError> {
        let mut state = Vec::new();
        let seen = Glance::at(watched.worlds, watched.instance, &mut state);
        let state = S::state(seen);
        let step = self
            .shown
            .last()
            .map(|before| S::step(seen, actions, outcome.reward, [&before.state, &state]));
        self.shown.push(Shown { step, state });
        Ok(())
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
        self.thoughts.extend(self.team.thoughts(scenes, actions).into_iter().map(told));
        Ok(())
    }
}

fn told(thought: sortie_learn::Thought) -> Thought {
    let head = |sortie_learn::Head { name, pays, likes, acts }| Head {
        name,
        pays: rounded(pays),
        likes,
        acts,
    };
    Thought {
        heads: thought.heads.into_iter().map(head).collect(),
        ..Thought::new(&thought.scores, thought.attention)
    }
}
