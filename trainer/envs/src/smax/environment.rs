//! SMAX as an [`Environment`]: many battles at once, and what they say of themselves.

use alloc::boxed::Box;
use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;

use super::VERSION;
use super::battle::{ATTACK, Battle, CAPACITY, STOP, TICK, length, state_bytes};
use super::observation::{OTHER, PAIR, ROW_ENTRIES, row_names, vector_names};
use super::scenarios::{LETTERS, Roster, SETS};
use super::units::Rules;
use crate::battles::{heading, meeting_name};
use crate::bytes::known;
use crate::entry::{Choice, Entry, EnvironmentError};
use crate::environment::{Environment, Episode, Split, StateError, Step, StepError};
use crate::observation::{EntitySet, Observation, members};
use crate::random::{Random, member, unit};
use crate::spec::{Metric, Shape, Spec, View};

/// How `--env` finds it.
pub const ENTRY: Entry = Entry {
    name: "smax",
    about: "Two teams of units fight on an open square, one of them led by a fixed rule (JaxMARL)",
    version: VERSION,
    sets: || SETS.split(' ').map(String::from).collect(),
    open: |choice| Ok(Box::new(open(choice)?)),
    rules: &[],
    reader: None,
    #[cfg(feature = "std")]
    recordings: None,
};

const METRICS: &[Metric] = &[
    Metric::reported("felled", "enemies", "enemies that died"),
    Metric::reported("alive", "allies", "allies that lived"),
];

/// SMAX, many instances in one object. A step allocates nothing.
#[derive(Clone, Debug)]
pub struct Smax {
    pub(super) rules: Rules,
    pub(super) roster: Roster,
    spec: Spec,
    pub(super) battles: Vec<Battle>,
}

impl Smax {
    /// Sets up so many instances, whose episodes are over.
    pub(super) fn new(rules: Rules, roster: Roster, instances: usize) -> Self {
        let [allies, enemies] = &roster.teams[0];
        let mut battle = Battle::of(allies, enemies);
        battle.steps = rules.max_steps + 1;
        let battles = (0..instances).map(|_| battle.clone()).collect();
        Self { battles, spec: spec(&rules, &roster), rules, roster }
    }

    fn read(&self, state: &[u8]) -> Result<Battle, StateError> {
        Battle::read(state, self.roster.most())
    }
}

fn open(choice: &Choice<'_>) -> Result<Smax, EnvironmentError> {
    let set = choice.set.unwrap_or("2s3z");
    let rules: Rules = choice.settings()?;
    let roster = Roster::named(set).ok_or_else(|| {
        EnvironmentError::Set(format!(
            "no set `{set}`; there are `3-8sz` and `3-8sz+1`, `smacv2_N_units`, and teams such as `2s3z` or `5m_vs_6m` of \
             m (marines), M (marauders), s (stalkers), z (zealots), l (zerglings), h (hydralisks), together at most \
             {CAPACITY}"
        ))
    })?;
    let refused = |reason: &str| Err(EnvironmentError::Setting(reason.to_string()));
    if rules.max_steps > 1_000_000 {
        return refused("`max_steps` is at most 1000000");
    }
    if rules.vectors && roster.teams.len() > 1 {
        return refused("`vectors` have one length, but teams of this set have several sizes");
    }
    Ok(Smax::new(rules, roster, choice.instances))
}

fn spec(rules: &Rules, roster: &Roster) -> Spec {
    let [agents, enemies] = roster.most();
    let units = agents + enemies;
    let attacks = (0..enemies).map(|enemy| format!("attack-{enemy}"));
    let others = ["north", "east", "south", "west", "stop"].map(String::from);
    let actions: Vec<String> = others.into_iter().chain(attacks).collect();
    let general = Spec {
        name: ENTRY.name.into(),
        version: VERSION,
        shape: Shape { agents, entities: units, tasks: 0, actions: actions.len(), features: 0 },
        actions,
        safe_action: Some(STOP.into()),
        metrics: METRICS.to_vec(),
        state_bytes: state_bytes(units),
        solved_return: 2.0,
        episode_limit: rules.max_steps + 1,
        ..Spec::default()
    };
    if rules.vectors {
        let features = vector_names(units);
        let (row_entries, entities) = (features.len(), agents + 1);
        let shape = Shape { entities, features: row_entries, ..general.shape };
        return Spec { view: View::Vectors, shape, features, row_entries, ..general };
    }
    let features = row_names([agents, enemies], rules);
    let pairs = if rules.pairs { PAIR * enemies } else { 0 };
    Spec {
        shape: Shape { features: features.len(), ..general.shape },
        targets: agents..units,
        pairs: features.len() - pairs..features.len(),
        row_entries: ROW_ENTRIES + pairs,
        features,
        ..general
    }
}

impl Environment for Smax {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn instances(&self) -> usize {
        self.battles.len()
    }

    fn open(&self, instances: usize, _: Split) -> Box<dyn Environment> {
        Box::new(Self::new(self.rules.clone(), self.roster.clone(), instances))
    }

    fn reset(&mut self, instance: usize, random: &mut Random) {
        let battle = &mut self.battles[instance];
        *battle = self.roster.draw(random);
        battle.push_apart(&self.rules);
    }

    fn step(
        &mut self,
        instance: usize,
        actions: &[u16],
        random: &mut Random,
    ) -> Result<Step, StepError> {
        let (rules, battle) = (&self.rules, &mut self.battles[instance]);
        if battle.is_over(rules) {
            return Err(StepError::EpisodeOver);
        }
        let agents = battle.allies;
        let too_few = StepError::TooFewActions { agents, actions: actions.len() };
        let actions = actions.get(..agents).ok_or(too_few)?;
        for (agent, action) in actions.iter().copied().enumerate() {
            let available = battle.available(agent).checked_shr(action.into());
            if available.is_none_or(|available| available & 1 == 0) {
                return Err(StepError::Unavailable { agent, action });
            }
        }
        let allies = battle.units.iter_mut().zip(actions);
        allies.for_each(|(ally, action)| ally.order = *action as u8);
        battle.command(rules, |_, allies| member(random, allies.into()).unwrap_or(0));
        let reward = battle.fight(rules, |_, _| jitter(random)).into();
        let terminated = battle.alive().contains(&0);
        let timed_out = !terminated && battle.is_over(rules);
        Ok(Step { reward, terminated, timed_out, tasks_changed: false })
    }

    fn save(&self, instance: usize, state: &mut Vec<u8>) {
        self.battles[instance].write(state);
    }

    fn load(&mut self, instance: usize, state: &[u8]) -> Result<(), StateError> {
        let battle = self.read(state)?;
        let teams = battle.teams();
        if !self.roster.has(&teams) || battle.steps > self.spec.episode_limit {
            let reason =
                format!("`{}` after {} steps", meeting_name(&teams, &LETTERS), battle.steps);
            return Err(StateError::Impossible(reason));
        }
        self.battles[instance] = battle;
        Ok(())
    }

    fn observe(&self, state: &[u8], _: usize, wanted: EntitySet, seen: &mut Observation) {
        let battle = &known(self.read(state));
        let (Shape { agents, entities, .. }, is_vectors) = (self.spec.shape, self.rules.vectors);
        // Of all enemies together a vector tells, and behind the agents the one of the whole state.
        let shown = if is_vectors { battle.allies + 1 } else { battle.count };
        let set = |holds: &dyn Fn(usize) -> bool| {
            let shown = (0..shown).filter(|unit| holds(*unit));
            shown.fold(0, |set: EntitySet, unit| {
                set | 1 << if unit < battle.allies { unit } else { agents + unit - battle.allies }
            })
        };
        seen.present = set(&|_| true);
        seen.absent = set(&|unit| unit < battle.allies && !battle.units[unit].is_alive()) as u64;
        seen.entities = wanted & seen.present;
        seen.observable.clear();
        seen.observable.extend((0..battle.allies).map(|agent| {
            // Whoever deploys a team asks for the dead too: they see themselves at least.
            set(&|other| other == agent || !is_vectors && battle.sees(agent, other))
        }));
        seen.observable.resize(agents, 0);
        seen.available.clear();
        seen.available.extend((0..battle.allies).map(|agent| battle.available(agent)));
        seen.available.resize(agents, 1);
        seen.entity_task.clear();
        seen.entity_task.resize(entities, 0);
        seen.open_tasks = 0;
        seen.rows.clear();
        for entity in members(seen.entities) {
            let unit = if entity < agents { entity } else { battle.allies + entity - agents };
            if is_vectors {
                let mut vector = [0.0; VECTOR];
                let vector = &mut vector[..self.spec.shape.features];
                if entity < agents {
                    battle.write_vector(&self.rules, unit, vector);
                } else {
                    battle.write_state(vector);
                }
                seen.rows.push_dense(vector);
            } else {
                battle.write_row((&self.rules, &self.roster), unit, entity, &mut seen.rows);
            }
        }
    }

    fn episode(&self, instance: usize) -> Episode {
        let battle = &self.battles[instance];
        let [alive, left] = battle.alive();
        let done = battle.is_over(&self.rules);
        let felled = (battle.count - battle.allies) as f64 - f64::from(left);
        Episode {
            steps: battle.steps,
            done,
            solved: alive > 0 && left == 0,
            timed_out: done && alive > 0 && left > 0,
            episode_return: battle.episode_return,
            group: meeting_name(&battle.teams(), &LETTERS),
            metrics: [Some(felled), Some(alive.into())].to_vec(),
            cause: None,
        }
    }

    /// All shoot at the weakest enemy within reach, and else go to the nearest.
    fn scripted(&self, state: &[u8], _: &[u8], _: &mut Random, actions: &mut [u16]) -> bool {
        let battle = &known(self.read(state));
        let enemies = (battle.allies..battle.count).zip(u16::from(ATTACK)..);
        let enemies = enemies.filter(|(enemy, _)| battle.units[*enemy].is_alive());
        for (agent, action) in actions.iter_mut().enumerate().take(battle.allies) {
            let available = battle.available(agent);
            let is_available = |action: &u16| available >> action & 1 == 1;
            let within = enemies.clone().filter(|(_, attack)| is_available(attack));
            let weakest = within.min_by_key(|(enemy, _)| battle.units[*enemy].health);
            let ways = enemies.clone().map(|(enemy, _)| battle.way(agent, enemy));
            let nearest = ways.min_by(|one, other| length(*one).total_cmp(&length(*other)));
            let wish = weakest.map(|(_, attack)| attack);
            let wish = wish.or_else(|| nearest.map(|way| heading(way) as u16));
            *action = wish.filter(is_available).unwrap_or(STOP.into());
        }
        true
    }
}

/// Draws how many seconds more a cooldown lasts: from a tick less to two ticks more.
pub(super) fn jitter(random: &mut Random) -> f32 {
    TICK * (3.0 * unit(random) as f32 - 1.0)
}

/// Most numbers of a vector: of all other units, and its own.
const VECTOR: usize = OTHER * CAPACITY;
