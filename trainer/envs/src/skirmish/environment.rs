//! Skirmishes as an [`Environment`]: many encounters at once, and what they say of themselves.

use alloc::boxed::Box;
use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;

use serde::Deserialize;

use super::VERSION;
use super::armies::{ARMIES, Fate};
use super::battle::{CAPACITY, NOBODY, Order};
use super::bytes::state_bytes;
use super::encounter::{Encounter, Outcome, VICTORY};
use super::frames::reader;
use super::observation::{Aim, Layout, ORDERS, turned_action};
use super::picture::picture;
use super::relations::RELATIONS;
use super::rules::{RULES, allocate, scripted};
use super::scenarios::{SETS, Scenario, in_order, name_of};
use super::units::{Book, Rules};
use crate::bytes::known;
use crate::entry::{Choice, Entry, EnvironmentError};
use crate::environment::{Environment, Episode, Split, StateError, Step, StepError};
use crate::observation::{EntitySet, Observation};
use crate::picture::Picture;
use crate::random::Random;
use crate::rows::SparseRows;
use crate::spec::{Metric, Rewards, Shape, Spec};

/// How `--env` finds it.
pub const ENTRY: Entry = Entry {
    name: "skirmish",
    about: "Teams of units fight in the manner of StarCraft II, in the open or around a base (dissertation chapters 5, 7)",
    version: VERSION,
    sets: || SETS.split(' ').map(String::from).collect(),
    open: |choice| Ok(Box::new(open(choice)?)),
    rules: RULES,
    reader: Some(reader),
    #[cfg(feature = "std")]
    recordings: None,
};

const METRICS: &[Metric] = &[
    Metric::reported("felled", "enemies", "enemies that died"),
    Metric::reported("alive", "allies", "allies that lived"),
    Metric::reported("defeated", "armies", "armies of which none lived"),
];

const CAUSES: &[&str] = &["killed", "infiltrated", "time"];

/// What can be set.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Settings {
    rules: Rules,
    /// How actions are aimed.
    aim: Aim,
    /// Whether agents are told whom enemies are after.
    intents: bool,
    /// What allies lose, as a share of what the same losses of enemies earn; while learning alone.
    own_losses: f64,
    /// Whether armies come from directions drawn anew, instead of evenly from all sides.
    spread: bool,
    /// Chooses the units that enemies have more where they are at an advantage.
    extra_seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            rules: Rules::Liberty,
            aim: Aim::Entities,
            intents: true,
            own_losses: 0.0,
            spread: false,
            extra_seed: 1,
        }
    }
}

/// Skirmishes, many instances in one object. A step allocates nothing.
#[derive(Clone, Debug)]
pub struct Skirmish {
    settings: Settings,
    book: Book,
    scenario: Scenario,
    layout: Layout,
    spec: Spec,
    /// What rewards are divided by, and the share of own losses in them.
    scale: f64,
    own_losses: f64,
    encounters: Vec<Encounter>,
    task_rewards: Vec<f64>,
}

impl Skirmish {
    /// Sets up so many instances, whose episodes are over.
    fn new(settings: Settings, scenario: Scenario, instances: usize, split: Split) -> Self {
        let book = settings.rules.book();
        let layout = Layout::of(&scenario, settings.aim, settings.intents);
        let mut over = Encounter::of(super::battle::Battle::of(
            &book,
            &scenario.teams[0][0],
            &scenario.teams[0][1],
        ));
        over.steps = scenario.limit;
        let spec = spec(&scenario, &layout);
        Self {
            scale: scenario.reward_scale(&book),
            own_losses: if split == Split::Train { settings.own_losses } else { 0.0 },
            encounters: (0..instances).map(|_| over.clone()).collect(),
            task_rewards: alloc::vec![0.0; instances * spec.shape.tasks],
            settings,
            book,
            scenario,
            layout,
            spec,
        }
    }

    fn read(&self, state: &[u8]) -> Result<Encounter, StateError> {
        Encounter::read(state, &self.book, self.layout.most)
    }

    fn is_over(&self, encounter: &Encounter) -> bool {
        encounter.outcome != Outcome::Open || encounter.steps >= self.scenario.limit
    }

    /// Gives agents the orders that their actions stand for, once all are available.
    fn command(&mut self, instance: usize, actions: &[u16]) -> Result<(), StepError> {
        let (layout, encounter) = (&self.layout, &mut self.encounters[instance]);
        let agents = encounter.battle.allies;
        let too_few = StepError::TooFewActions { agents, actions: actions.len() };
        let actions = actions.get(..agents).ok_or(too_few)?;
        let mut orders = [Order::Stop; CAPACITY];
        for (agent, action) in actions.iter().copied().enumerate() {
            let available = layout.available(encounter, &self.book, agent);
            if available.checked_shr(action.into()).is_none_or(|open| open & 1 == 0) {
                return Err(StepError::Unavailable { agent, action });
            }
            orders[agent] = layout.order(encounter, agent, action.into());
        }
        let allies = &mut encounter.battle.units[..agents];
        allies.iter_mut().zip(orders).for_each(|(ally, order)| ally.order = order);
        Ok(())
    }
}

fn open(choice: &Choice<'_>) -> Result<Skirmish, EnvironmentError> {
    let set = choice.set.unwrap_or("3-8sz");
    let settings: Settings = choice.settings()?;
    if !(0.0..=10.0).contains(&settings.own_losses) {
        return Err(EnvironmentError::Setting("`own_losses` is from 0 to 10".to_string()));
    }
    let scenario = Scenario::named(set, settings.extra_seed).ok_or_else(|| {
        EnvironmentError::Set(format!(
            "no set `{set}`; there are {}, and teams such as `2s3z` or `5m_vs_6m` of c (colossi), M (marauders), m (marines), \
             d (medivacs), s (stalkers), z (zealots), together at most {CAPACITY}, in the open or with `-symmetric` or \
             `-disadvantage` around a base",
            SETS.replace(' ', ", ")
        ))
    })?;
    Ok(Skirmish::new(settings, scenario, choice.instances, choice.split))
}

fn spec(scenario: &Scenario, layout: &Layout) -> Spec {
    let [agents, enemies] = layout.most;
    let units = agents + enemies;
    let others = ["stop", "north", "east", "south", "west"].map(String::from);
    let aims = (0..layout.slots()).map(|slot| format!("target-{slot}"));
    let actions: Vec<String> = others.into_iter().chain(aims).collect();
    let features = layout.feature_names();
    let tasks = if scenario.is_defence { ARMIES } else { 0 };
    let shape =
        Shape { agents, entities: units, tasks, actions: actions.len(), features: features.len() };
    let is_aimed = layout.aim == Aim::Entities;
    let first = if layout.has_healers { 0 } else { agents };
    let pairs = if is_aimed { layout.first_slot()..features.len() } else { 0..0 };
    Spec {
        name: ENTRY.name.into(),
        version: VERSION,
        shape,
        row_entries: layout.row_entries(),
        targets: if is_aimed { first..units } else { 0..0 },
        pairs,
        features,
        actions,
        safe_action: Some(0),
        metrics: METRICS[..if scenario.is_defence { METRICS.len() } else { 2 }].to_vec(),
        causes: if scenario.is_defence { CAUSES } else { &["killed", "time"] },
        rewards: Rewards { tasks: scenario.is_defence, agents: false },
        solved_return: 20.0,
        turns: 8,
        rules: if scenario.is_defence { RULES.to_vec() } else { Vec::new() },
        relations: if scenario.is_defence { RELATIONS } else { 0 },
        state_bytes: state_bytes(units),
        episode_limit: scenario.limit,
        ..Spec::default()
    }
}

impl Environment for Skirmish {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn instances(&self) -> usize {
        self.encounters.len()
    }

    fn open(&self, instances: usize, split: Split) -> Box<dyn Environment> {
        Box::new(Self::new(self.settings.clone(), self.scenario.clone(), instances, split))
    }

    fn reset(&mut self, instance: usize, random: &mut Random) {
        let mut encounter = self.scenario.draw((&self.book, self.settings.spread), random);
        if self.layout.aim == Aim::Tags {
            encounter.tag(self.layout.most, random);
        }
        self.encounters[instance] = encounter;
    }

    fn step(
        &mut self,
        instance: usize,
        actions: &[u16],
        random: &mut Random,
    ) -> Result<Step, StepError> {
        if self.is_over(&self.encounters[instance]) {
            return Err(StepError::EpisodeOver);
        }
        self.command(instance, actions)?;
        let encounter = &mut self.encounters[instance];
        let gains = encounter.play(&self.book, random);
        let felled: f64 = gains.armies.iter().sum();
        // As published: in the open what shields regain is paid for as well.
        let felled = if self.scenario.is_defence { felled } else { felled.abs() };
        let victory = if encounter.outcome == Outcome::Won { VICTORY } else { 0.0 };
        let own = |lost: f64| self.own_losses * lost;
        let reward = (felled + victory - own(gains.own.iter().sum())) / self.scale;
        encounter.episode_return += reward;
        if self.scenario.is_defence {
            let rewards = &mut self.task_rewards[ARMIES * instance..][..ARMIES];
            for (army, earned) in rewards.iter_mut().enumerate() {
                let is_defeated = gains.changed >> army & 1 == 1
                    && encounter.armies.list[army].fate == Fate::Defeated;
                let victory = if is_defeated { VICTORY } else { 0.0 };
                *earned = (gains.armies[army] + victory - own(gains.own[army])) / self.scale;
            }
        }
        let terminated = encounter.outcome != Outcome::Open;
        let timed_out = !terminated && encounter.steps >= self.scenario.limit;
        Ok(Step { reward, terminated, timed_out, tasks_changed: gains.changed != 0 })
    }

    fn task_rewards(&self, instance: usize) -> &[f64] {
        let tasks = self.spec.shape.tasks;
        &self.task_rewards[tasks * instance..][..tasks]
    }

    fn save(&self, instance: usize, state: &mut Vec<u8>) {
        self.encounters[instance].write(state);
    }

    fn load(&mut self, instance: usize, state: &[u8]) -> Result<(), StateError> {
        let encounter = self.read(state)?;
        let teams = in_order(encounter.teams());
        let has_armies = encounter.armies.count > 0;
        let is_known =
            has_armies == self.scenario.is_defence && self.scenario.teams.contains(&teams);
        if !is_known || encounter.steps > self.scenario.limit {
            let reason = format!("`{}` after {} steps", name_of(teams), encounter.steps);
            return Err(StateError::Impossible(reason));
        }
        self.encounters[instance] = encounter;
        Ok(())
    }

    fn observe(&self, state: &[u8], turn: usize, wanted: EntitySet, seen: &mut Observation) {
        let encounter = &known(self.read(state));
        self.layout.observe((encounter, &self.book), turn, wanted, seen);
    }

    fn relate(
        &self,
        state: &[u8],
        turn: usize,
        task: usize,
        wanted: EntitySet,
        rows: &mut SparseRows,
    ) {
        let encounter = &known(self.read(state));
        self.layout.relate((encounter, &self.book), (turn, task), wanted, rows);
    }

    fn picture(&self, state: &[u8]) -> Picture {
        picture(&known(self.read(state)), &self.book)
    }

    fn place(&mut self, instance: usize, entity: usize, place: [f64; 2]) -> Result<(), StateError> {
        let encounter = &mut self.encounters[instance];
        // Things are counted without gaps behind the agents that there are.
        let battle = &mut encounter.battle;
        let is_inside = place.iter().all(|part| (0.0..=f64::from(self.book.side)).contains(part));
        match battle.units[..battle.count].get_mut(entity) {
            Some(unit) if unit.is_alive() && is_inside => {
                unit.place = place.map(|part| part as f32);
                Ok(())
            }
            _ => Err(StateError::Impossible(format!("unit {entity} cannot be at {place:?}"))),
        }
    }

    fn episode(&self, instance: usize) -> Episode {
        let encounter = &self.encounters[instance];
        let Encounter { battle, armies, steps, episode_return, outcome, .. } = encounter;
        let [alive, left] = battle.living().map(u64::count_ones);
        let done = self.is_over(encounter);
        let timed_out = done && *outcome == Outcome::Open;
        let felled = (battle.count - battle.allies) as f64 - f64::from(left);
        let lost = armies.list.iter().filter(|army| army.fate == Fate::Defeated).count();
        let metrics = [felled, f64::from(alive), lost as f64];
        Episode {
            steps: *steps,
            done,
            solved: *outcome == Outcome::Won,
            timed_out,
            episode_return: *episode_return,
            group: name_of(encounter.teams()),
            metrics: metrics[..self.spec.metrics.len()].iter().copied().map(Some).collect(),
            cause: match outcome {
                Outcome::Killed => Some("killed"),
                Outcome::Infiltrated => Some("infiltrated"),
                Outcome::Open if done => Some("time"),
                Outcome::Open | Outcome::Won => None,
            },
        }
    }

    fn turned_action(&self, turn: usize, action: u16) -> u16 {
        turned_action(turn, action.into()) as u16
    }

    /// The army of whom the action is aimed at.
    fn subtask_of(&self, state: &[u8], agent: usize, action: u16) -> Option<usize> {
        let encounter = &known(self.read(state));
        let slot = usize::from(action).checked_sub(ORDERS)?;
        let target = self.layout.target(encounter, agent, slot);
        let army = encounter.battle.units.get(usize::from(target))?.army;
        (army != NOBODY).then_some(army.into())
    }

    fn allocate(&self, rule: usize, state: &[u8], random: &mut Random, allocation: &mut [u8]) {
        allocate(rule, &known(self.read(state)), random, allocation);
    }

    fn scripted(
        &self,
        state: &[u8],
        allocation: &[u8],
        _: &mut Random,
        actions: &mut [u16],
    ) -> bool {
        let encounter = &known(self.read(state));
        scripted((encounter, &self.layout, &self.book), allocation, actions);
        true
    }
}
