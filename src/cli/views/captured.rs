//! Episodes of teams without subtasks: plays one in which nobody is allocated, and keeps what its page shows; with what agents
//! think, utilities and attention of a run's network or of a bundle's.

use serde::Serialize;
use sortie_bundle::Bundle;
use sortie_core::Policy;
use sortie_core::choose::masked_argmax;
use sortie_envs::{Environment, Random, Split};
use sortie_learn::draft::DecoratedPolicy;
use sortie_learn::play::{Onlooker, PolicyTeam, Watched, watch};
use sortie_learn::{Act, LearnError, Scenes};
use sortie_plans::{AttentionLayers, AttentionProbe, roles_of};
use sortie_stage::{Glance, Head, Show, Shown, rounded};

use super::Wanted;
use crate::environment::{check_fits, scripted};
use crate::failure::{Exit, Failure};
use crate::policy::{Backend, DeployedPolicy};
use crate::subject::Subject;
use crate::tools::compiler;

pub(super) use sortie_stage::Thought;

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

/// A thought as pages have it.
pub(super) fn told(thought: sortie_learn::Thought) -> Thought {
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

/// Has the subject play an episode in which nobody is allocated, and keeps what agents of a bundle thought in it. Returns
/// what was played in as well.
pub(super) fn played<S: Show>(
    wanted: &Wanted<'_>,
    subject: &Subject,
) -> Result<(String, Captured<S>), Failure> {
    let set = wanted.set.clone().unwrap_or_default();
    if let Some(asked) = wanted.allocation {
        return Err(asked.of_no_use());
    }
    let (env, world) = (set.to_string(), set.open(Split::Test)?);
    let captured = match subject {
        Subject::Scripted => acted(wanted, &*world, &mut scripted(&set, &*world, wanted.seed)?)?,
        Subject::Bundle(bundle) => {
            check_fits(bundle, &set)?;
            let mut deployed = DeployedPolicy::open(bundle, Backend::Plan)?;
            let mut thoughts = Vec::new();
            let policy = noted(bundle, deployed.team()?, &mut thoughts)?;
            let mut captured = acted(wanted, &*world, &mut PolicyTeam::new(policy))?;
            captured.give_thoughts(thoughts);
            captured
        }
        Subject::Run(_) => {
            let subject = wanted.subject.display();
            let message = format!("`{subject}` has learned in another environment than `{set}`");
            return Err(Failure::new(Exit::Mismatch, message));
        }
    };
    Ok((env, captured))
}

/// Has a team play the episode.
pub(super) fn acted<S: Show>(
    wanted: &Wanted<'_>,
    world: &dyn Environment,
    team: &mut dyn Act,
) -> Result<Captured<S>, Failure> {
    // As evaluations number them.
    capture(world, (wanted.seed, wanted.episode), team)
}

/// What tells whom a bundle's agents attend to; none where they attend to nobody that is known.
pub(super) fn attention_of(bundle: &Bundle) -> Result<Option<AttentionLayers>, Failure> {
    let attends = bundle.options().is_none() && roles_of(bundle)?.is_none();
    Ok(attends.then(|| compiler().attention(bundle.agent_onnx())).transpose()?)
}

/// A bundle's policy as deployed, whose every thought is noted, in the order of the decisions; with the attention read from
/// its graph.
pub(super) fn noted<'a>(
    bundle: &Bundle,
    policy: Box<dyn Policy + 'a>,
    thoughts: &'a mut Vec<Thought>,
) -> Result<impl Policy + 'a, Failure> {
    let features = usize::from(bundle.contract().features);
    // None where the network attends to nothing that is known.
    let probe = attention_of(bundle)?.map(|layers| AttentionProbe::new(layers, features));
    Ok(DecoratedPolicy::new(policy, move |policy, observation, _| {
        let mut utilities = vec![0.0; policy.actions()];
        policy.utilities(observation, &mut utilities)?;
        let attention = probe.as_ref().map(|probe| probe.by_entity(observation));
        thoughts.push(Thought::new(&utilities, attention.transpose()?.unwrap_or_default()));
        masked_argmax(&utilities, observation.available)
    }))
}
