//! What a method adds to a run: how its agents act, what they remember, how they learn.

use std::path::Path;

use sortie_envs::{Environment, Random, Step};

use crate::act::{Act, Ask};
use crate::error::{LearnError, Result};
use crate::export::{DeployedAgents, Words};
use crate::run::checkpoint::OpenFor;
use crate::run::{Now, Rates, Reports, RunFolder};
use crate::state::State;
use crate::subtasks::Subtasks;

/// A step of an instance that was just taken.
#[derive(Clone, Copy)]
pub struct Transition<'a> {
    /// What observes its states.
    pub environment: &'a dyn Environment,
    /// Number of the instance.
    pub instance: usize,
    /// The state in which the team acted.
    pub state: &'a [u8],
    /// `[A]`: what it did.
    pub actions: &'a [u16],
    /// What the team earned, and whether the episode is over.
    pub step: Step,
    /// `[T]`: what each subtask earned, where the environment says so.
    pub task_rewards: &'a [f64],
    /// `[A]`: what each agent earned, where the environment says so.
    pub agent_rewards: &'a [f64],
    /// The state that followed, before an instance whose episode is over starts anew.
    pub next: &'a [u8],
}

/// A method at work in a run.
pub trait Method: Send {
    /// Whether instances whose episode is over wait until those of all are; otherwise they start anew at once.
    fn waits(&self) -> bool {
        false
    }

    /// Whether it makes its updates after every step all the same, not only when the episodes of all are over.
    fn learns_while_waiting(&self) -> bool {
        false
    }

    /// An instance is about to start an episode; `random` is its generator.
    fn begins(&mut self, _instance: usize, _random: &mut Random) {}

    /// Writes the actions that it is asked for, trying things out.
    ///
    /// # Errors
    /// The team cannot decide.
    fn act(&mut self, ask: Ask<'_>, now: Now) -> Result<()>;

    /// Remembers a step, of all instances in turn.
    ///
    /// # Errors
    /// It cannot be learned from.
    fn remember(&mut self, transition: &Transition<'_>) -> Result<()>;

    /// Makes the updates that are due; returns what each of them found and how many decisions were made. Methods that learn
    /// from every step as they remember it have none.
    ///
    /// # Errors
    /// Learning cannot go on.
    fn update(&mut self, _environment: &dyn Environment, _now: Now) -> Result<Reports> {
        Ok(Reports::default())
    }

    /// Exploration and learning rate.
    fn rates(&self, now: Now) -> Rates;

    /// The team as it is measured: greedy, and where the method averages weights, with the averaged ones.
    fn team(&self) -> Box<dyn Act + '_>;

    /// Its agents for whatever allocation, and what it has learned to allocate them with; none where agents have no
    /// subtasks.
    fn subtasks(&self) -> Option<Subtasks<'_>> {
        None
    }

    /// Who allocates its agents where it is measured; `none` where there are no subtasks.
    fn allocation(&self) -> &str {
        "none"
    }

    /// Environment steps from which an allocator that is learned learns, and from which it decides.
    fn allocator_steps(&self) -> Option<[u64; 2]> {
        None
    }

    /// Begins with the weights of the run in a folder, before the first step.
    ///
    /// # Errors
    /// There is no sound checkpoint, or its networks do not fit.
    fn take_over(&mut self, folder: &Path) -> Result<()> {
        let found = RunFolder::new(folder).checkpoints().newest(OpenFor::Use)?;
        self.state(&mut State::weights(&found.checkpoint))
    }

    /// Names everything that the run depends on from here on: what is written to checkpoints and read back.
    ///
    /// # Errors
    /// What is read does not fit.
    fn state(&mut self, state: &mut State<'_>) -> Result<()>;

    /// The agents as they are deployed.
    ///
    /// # Errors
    /// They cannot be deployed; the error says why.
    fn deployed(&self) -> Result<DeployedAgents<'_>> {
        Err(LearnError::Config("agents of this method are evaluated only".to_owned()))
    }

    /// What it says on the card of a bundle, beside what every card says.
    fn words(&self) -> Words {
        Words::default()
    }
}
