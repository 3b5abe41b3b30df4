//! A method of one's own: independent Q-learning from a table (Watkins 1989), in any environment whose states are few.

use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use sortie_envs::random::{chance, member};
use sortie_envs::{EntitySet, Environment, Observation, Random, Split, members};
use sortie_learn::run::{Rates, RunConfig, RunDescription, prolong};
use sortie_learn::session::{EnvironmentChoice, Session, Setup};
use sortie_learn::state::Tensor;
use sortie_learn::{Act, LearnError, Method, Now, Scenes, State, Transition, play};

const PLACES: usize = 1 << 16;
const ACTIONS: usize = 3;
const DISCOUNT: f32 = 0.9;
const RATES: Rates = Rates { epsilon: 0.2, learning_rate: 0.2 };

/// What each agent expects of each action, by what it is shown: `[PLACES, ACTIONS]`.
#[derive(Clone)]
struct QLearning(Vec<f32>);

/// Where a state stands in the table: the agent, and every number of every row, hashed (FNV-1a).
fn place(seen: &Observation, agent: usize) -> usize {
    let numbers = (0..seen.rows.len()).flat_map(|row| seen.rows.row(row));
    let numbers = numbers.flat_map(|(column, value)| [column as u64, value.to_bits().into()]);
    let mix = |hash: u64, number: u64| (hash ^ number).wrapping_mul(0x0000_0100_0000_01b3);
    (numbers.fold(mix(0xcbf2_9ce4_8422_2325, agent as u64), mix) >> 20) as usize % PLACES
}

impl QLearning {
    /// The best available action of an agent, and what it is worth.
    fn best(&self, seen: &Observation, agent: usize) -> (usize, f32) {
        let values = &self.0[place(seen, agent) * ACTIONS..][..ACTIONS];
        let open = members(seen.available[agent].into()).map(|action| (action, values[action]));
        open.reduce(|a, b| if b.1 > a.1 { b } else { a }).unwrap_or_default()
    }

    /// Writes the best action of every agent, or what `instead` gives for it.
    fn choose(
        &self,
        scenes: &Scenes<'_>,
        actions: &mut [u16],
        mut instead: impl FnMut(usize, u64) -> Option<usize>,
    ) {
        let agents = scenes.environment.spec().shape.agents;
        let mut seen = Observation::default();
        for (scene, actions) in scenes.scenes.iter().zip(actions.chunks_exact_mut(agents)) {
            scenes.environment.observe(scene.state, 0, EntitySet::MAX, &mut seen);
            for (agent, action) in actions.iter_mut().enumerate().take(seen.agents()) {
                let other = instead(scene.instance, seen.available[agent]);
                *action = other.unwrap_or_else(|| self.best(&seen, agent).0) as u16;
            }
        }
    }
}

impl Act for QLearning {
    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        _: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        self.choose(scenes, actions, |_, _| None);
        Ok(())
    }
}

impl Method for QLearning {
    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        _: Now,
        random: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        self.choose(scenes, actions, |instance, open| {
            let random = &mut random[instance];
            chance(random, RATES.epsilon.into()).then(|| member(random, open.into())).flatten()
        });
        Ok(())
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        let (mut before, mut after) = (Observation::default(), Observation::default());
        transition.environment.observe(transition.state, 0, EntitySet::MAX, &mut before);
        transition.environment.observe(transition.next, 0, EntitySet::MAX, &mut after);
        let continues = f32::from(u8::from(!transition.step.terminated));
        for agent in 0..before.agents() {
            let target =
                transition.step.reward as f32 + continues * DISCOUNT * self.best(&after, agent).1;
            let own = place(&before, agent) * ACTIONS + usize::from(transition.actions[agent]);
            self.0[own] += RATES.learning_rate * (target - self.0[own]);
        }
        Ok(())
    }

    fn rates(&self, _: Now) -> Rates {
        RATES
    }

    fn team(&self) -> Box<dyn Act + '_> {
        Box::new(self.clone())
    }

    fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        let (shape, range) = (vec![PLACES, ACTIONS], 0..PLACES * ACTIONS);
        state.tensors("table", &[Tensor { name: "values".into(), shape, range }], &mut self.0)
    }
}

type Parts = (Box<dyn Environment>, Box<dyn Method>);

fn parts() -> Result<Parts, LearnError> {
    let ring = sortie_envs::open("group-matching/3x6x1", Split::Train, 1, &BTreeMap::new())?;
    Ok((ring, Box::new(QLearning(vec![0.0; PLACES * ACTIONS]))))
}

fn begin(folder: &Path, steps: u64) -> Result<Session, LearnError> {
    let (environment, method) = parts()?;
    let usual = RunConfig::default();
    let run = RunConfig { steps, evaluate_every: 20_000, final_episodes: 0, ..usual };
    let choice = EnvironmentChoice::of(&*environment, 8);
    let setup = Setup { method: "table".into(), environment: choice, run, ..Setup::default() };
    Session::begin(RunDescription::new(setup, 1, 1), environment, method, folder)
}

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::temp_dir().join(format!("own-method-{}", std::process::id()));
    let mut whole = begin(&folder.join("whole"), 100_000)?;
    whole.run(&mut (), &AtomicBool::new(false))?;
    let (ring, _) = parts()?;
    let chance = play::evaluate(&*ring, &mut play::RandomTeam::new(1), 500, 1)?.return_mean;
    let learned = play::evaluate(&*ring, &mut *whole.method().team(), 500, 1)?.return_mean;
    println!("return: {chance:.2} at random, {learned:.2} learned");

    let parted = folder.join("parted");
    begin(&parted, 40_000)?.run(&mut (), &AtomicBool::new(false))?;
    prolong(&parted, 100_000)?;
    Session::resume(&parted, |_| parts())?.run(&mut (), &AtomicBool::new(false))?;
    let end = "checkpoints/000000100000/tensors.safetensors";
    let weights = |run: &str| std::fs::read(folder.join(run).join(end));
    let is_same = weights("whole")? == weights("parted")?;
    println!("resumed at 40,000 steps: {}", if is_same { "the same bytes" } else { "others" });
    Ok(())
}
