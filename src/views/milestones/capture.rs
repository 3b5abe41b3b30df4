//! Plays an episode and writes it down.

use sortie_bundle::{Bundle, OptionsContract};
use sortie_core::options::{OptionPolicy, PlanNetworks, Pursuit};
use sortie_core::plan::Profile;
use sortie_core::{DecideError, Decision, Observation, Policy};
use sortie_envs::milestones::World;
use sortie_envs::{Environment, Split};
use sortie_learn::LearnError;
use sortie_learn::play::{Onlooker, PolicyTeam, Watched, watch};
use sortie_plans::{CompileError, option_arena, option_networks, option_policy};

use super::data::{AgentFacts, Captured, Event, State, Step, Thought};
use crate::compiler::plans;
use crate::failure::Failure;
use crate::views::page::rounded;

/// How a game's grid is found, and the names of its objects.
#[derive(Clone, Copy)]
pub(super) struct Board {
    pub(super) grid: fn(&dyn Environment, usize) -> Option<World>,
    pub(super) objects: &'static [&'static str],
}

/// Plays an episode of the environment, and writes down what went on in the agent.
pub(super) fn capture(
    environment: &dyn Environment,
    (seed, episode): (u64, usize),
    (bundle, options): (&Bundle, &OptionsContract),
    board: Board,
) -> Result<Captured, Failure> {
    let found = plans().agents(bundle, Profile::Exact)?;
    let mut arena = option_arena(found.plans()).map_err(CompileError::from)?;
    let networks = option_networks(found.plans(), &mut arena);
    let networks = networks.map_err(CompileError::from)?;
    let policy = option_policy((options, environment.spec().shape.actions), networks)?;
    let mut diary = Diary { policy, thoughts: Vec::new() };
    let mut world = environment.open(1, Split::Test);
    let spec = world.spec().clone();
    let mut recorder = Recorder { board, captured: Captured::default() };
    let mut team = PolicyTeam::new(&mut diary);
    watch(&mut *world, &mut team, episode..episode + 1, seed, &mut recorder)?;
    let Recorder { mut captured, board } = recorder;
    for (state, thought) in captured.states.iter_mut().zip(diary.thoughts) {
        state.thought = Some(thought);
    }
    let reached =
        captured.steps.iter().enumerate().filter_map(|(step, it)| Some((step, it.reached?)));
    let named = |(step, milestone): (usize, usize)| Event {
        at: step + 1,
        text: spec.milestones.get(milestone).cloned().unwrap_or_default(),
    };
    captured.events = reached.map(named).collect();
    let last = captured.steps.last().and_then(|step| step.reached);
    captured.result =
        if last == spec.milestones.len().checked_sub(1) { "solved" } else { "timed-out" };
    captured.team = "1 agent";
    captured.agents = vec![AgentFacts { name: "agent", actions: spec.actions.clone() }];
    captured.objects = board.objects;
    captured.items = spec
        .features
        .iter()
        .filter_map(|it| it.strip_prefix("items."))
        .map(str::to_owned)
        .collect();
    captured.milestones = spec.milestones;
    captured.threshold = options.threshold;
    Ok(captured)
}

/// Writes down what is played.
struct Recorder {
    board: Board,
    captured: Captured,
}

impl Recorder {
    fn look(&mut self, watched: Watched<'_>) -> Result<(), LearnError> {
        let found = (self.board.grid)(watched.worlds, watched.instance);
        let world =
            found.ok_or_else(|| LearnError::Team("this is no game of milestones".to_owned()))?;
        let mut state = Vec::new();
        watched.worlds.save(watched.instance, &mut state);
        let cells = usize::from(world.size) * usize::from(world.size);
        self.captured.size = world.size;
        self.captured.states.push(State {
            cells: world.cells[..cells].to_vec(),
            open: world.open,
            at: world.position,
            direction: world.direction,
            carried: world.inventory.to_vec(),
            truth: watched.worlds.affordances(&state).unwrap_or(0),
            thought: None,
        });
        Ok(())
    }
}

impl Onlooker for Recorder {
    fn started(&mut self, watched: Watched<'_>) -> Result<(), LearnError> {
        self.look(watched)
    }

    fn stepped(
        &mut self,
        watched: Watched<'_>,
        actions: &[u16],
        step: &sortie_envs::Step,
    ) -> Result<(), LearnError> {
        self.captured.steps.push(Step {
            actions: actions.to_vec(),
            reward: rounded(step.reward),
            reached: watched.worlds.milestone(watched.instance),
        });
        self.look(watched)
    }
}

/// Decides, and writes down what it thinks.
struct Diary<'a> {
    policy: OptionPolicy<PlanNetworks<'a>, Vec<f32>>,
    thoughts: Vec<Thought>,
}

impl Policy for Diary<'_> {
    fn actions(&self) -> usize {
        self.policy.actions()
    }

    fn utilities(&mut self, seen: &Observation<'_>, to: &mut [f32]) -> Result<(), DecideError> {
        self.policy.utilities(seen, to)
    }

    fn decide(&mut self, seen: &Observation<'_>) -> Result<Decision, DecideError> {
        self.policy.decide(seen)
    }

    fn hidden(&self) -> usize {
        self.policy.hidden()
    }

    fn decide_with(
        &mut self,
        seen: &Observation<'_>,
        hidden: &mut [f32],
    ) -> Result<Decision, DecideError> {
        let decision = self.policy.decide_with(seen, hidden)?;
        let mut likelihoods = vec![0.0; self.policy.rules().milestones().len()];
        self.policy.likelihoods(seen, &mut likelihoods)?;
        if let Some(Pursuit { goal, steps }) = Pursuit::of(hidden) {
            let mask = self.policy.rules().mask(&likelihoods);
            let likelihoods = likelihoods.into_iter().map(rounded).collect();
            self.thoughts.push(Thought { goal, step: steps, likelihoods, mask });
        }
        Ok(decision)
    }
}
