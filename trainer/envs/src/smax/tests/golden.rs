//! Episodes of the reference, each step of which is replayed from its recorded state.

use std::collections::HashMap;
use std::fs;
use std::path::PathBuf;

use serde_json::Value;

use super::super::battle::{Battle, NOBODY, Point, STOP, Unit};
use super::super::units::{AttackMode, RuleBook, Rules};

/// Most that places, and all other numbers, differ.
const PLACE: f64 = 2e-5;
const TOLD: f64 = 1e-5;
const REWARD: f64 = 1e-6;

/// A recorded episode.
struct Episode {
    name: String,
    file: Value,
    rules: Rules,
    allies: usize,
    kinds: Vec<u8>,
    steps: usize,
    /// By step, tick and shooter: the foe, and how much more its cooldown was.
    shots: HashMap<[usize; 3], (usize, f32)>,
    worst: Worst,
}

/// The largest deviations.
#[derive(Clone, Copy, Debug, Default)]
struct Worst {
    place: f64,
    cooldown: f64,
    seen: f64,
    reward: f64,
}

fn number(value: &Value) -> f32 {
    value.as_f64().unwrap() as f32
}

fn numbers(value: &Value) -> Vec<f32> {
    value.as_array().unwrap().iter().map(number).collect()
}

fn whole(value: &Value) -> Vec<i64> {
    value.as_array().unwrap().iter().map(|it| it.as_i64().unwrap()).collect()
}

fn points(value: &Value) -> Vec<Point> {
    value.as_array().unwrap().iter().map(|it| numbers(it).try_into().unwrap()).collect()
}

fn episodes() -> Vec<Episode> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/smax");
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<PathBuf> =
        entries.filter(|path| path.extension().is_some_and(|it| it == "json")).collect();
    files.sort();
    files.into_iter().filter(|path| !path.ends_with("index.json")).map(read).collect()
}

fn read(path: PathBuf) -> Episode {
    let file: Value = serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
    let options = &file["options"];
    let flag = |name: &str| options[name].as_bool().unwrap();
    let is_classic = file["jaxmarl"] != "0.2.0";
    let is_random = options["attack_mode"] == "random";
    let rules = Rules {
        rules: if is_classic { RuleBook::Classic } else { RuleBook::Current },
        max_steps: options["max_steps"].as_u64().unwrap() as u32,
        walls_cause_death: flag("walls_cause_death"),
        self_play_reward: flag("use_self_play_reward"),
        see_enemy_actions: flag("see_enemy_actions"),
        enemy_shoots: flag("enemy_shoots"),
        attack_mode: if is_random { AttackMode::Random } else { AttackMode::Closest },
        ..Rules::default()
    };
    let shot = |shot: &Value| {
        let [step, tick, unit, foe] = [0, 1, 2, 3].map(|at| shot[at].as_u64().unwrap() as usize);
        ([step, tick, unit], (foe, number(&shot[4])))
    };
    Episode {
        name: path.file_stem().unwrap().to_str().unwrap().to_owned(),
        allies: file["n_allies"].as_u64().unwrap() as usize,
        kinds: whole(&file["types"]).into_iter().map(|kind| kind as u8).collect(),
        steps: file["steps"].as_u64().unwrap() as usize,
        shots: file["shots"].as_array().unwrap().iter().map(shot).collect(),
        rules,
        file,
        worst: Worst::default(),
    }
}

impl Episode {
    /// The orders of all units in a step.
    fn orders(&self, step: usize) -> Vec<u8> {
        let actions = ["ally_actions", "enemy_actions"].map(|name| whole(&self.file[name][step]));
        actions.concat().into_iter().map(|action| action as u8).collect()
    }

    fn memory(&self, step: usize) -> Vec<u8> {
        let memory = whole(&self.file["enemy_sticky"][step]).into_iter();
        memory.map(|ally| u8::try_from(ally).unwrap_or(NOBODY)).collect()
    }

    /// Before it begins.
    fn unplaced(&self) -> Battle {
        let (allies, enemies) = self.kinds.split_at(self.allies);
        Battle::of(allies, enemies)
    }

    /// The battle before a step, as recorded.
    fn battle(&self, step: usize) -> Battle {
        let mut battle = self.unplaced();
        battle.steps = step as u32;
        let [x, y, health, cooldown] = ["position_x", "position_y", "health", "cooldown"]
            .map(|name| numbers(&self.file[name][step]));
        let orders = if step == 0 { vec![STOP; x.len()] } else { self.orders(step - 1) };
        for (number, unit) in battle.units[..x.len()].iter_mut().enumerate() {
            assert_eq!(health[number], health[number].round());
            let place = [x[number], y[number]];
            let (order, cooldown) = (orders[number], cooldown[number]);
            *unit = Unit { place, cooldown, order, health: health[number] as u8, ..*unit };
        }
        if step > 0 {
            let goals = points(&self.file["enemy_default_target"]);
            let enemies = battle.units[self.allies..].iter_mut();
            for ((enemy, target), goal) in enemies.zip(self.memory(step - 1)).zip(goals) {
                (enemy.target, enemy.goal) = (target, goal);
            }
        }
        battle
    }

    /// Keeps the largest deviation, of which at most `most` is allowed.
    fn near(name: &str, got: f32, want: f32, most: f64, worst: &mut f64) {
        let error = (f64::from(got) - f64::from(want)).abs();
        assert!(error <= most, "{name}: {got} instead of {want}");
        *worst = worst.max(error);
    }

    /// Compares units with a recorded state.
    fn assert_units(&mut self, label: &str, battle: &Battle, want: &Battle) {
        for (number, (got, want)) in
            battle.units[..battle.count].iter().zip(&want.units).enumerate()
        {
            let label = format!("{} {label} unit {number}", self.name);
            assert_eq!(got.health, want.health, "{label}");
            for (got, want) in got.place.into_iter().zip(want.place) {
                Self::near(&label, got, want, PLACE, &mut self.worst.place);
            }
            Self::near(&label, got.cooldown, want.cooldown, TOLD, &mut self.worst.cooldown);
        }
    }

    /// What is available, against a string of digits for each unit.
    fn assert_available(&self, step: usize, battle: &Battle) {
        for unit in 0..battle.count {
            let digits = self.file["avail"][step][unit].as_str().unwrap().bytes().enumerate();
            let want = digits.fold(0, |set, (at, digit)| set | u64::from(digit - b'0') << at);
            assert_eq!(
                battle.available(unit),
                want.into(),
                "{} step {step} unit {unit}",
                self.name
            );
        }
    }

    /// The enemies decide by the recorded draws as they did.
    fn assert_commands(&self, step: usize, battle: &mut Battle) {
        let drawn = |name: &str, enemy: usize| {
            let picks = self.file.get(name)?[step][enemy - self.allies].as_i64()?;
            usize::try_from(picks).ok()
        };
        battle.command(&self.rules, |enemy, among| {
            let ally = drawn("enemy_shot_pick", enemy).or_else(|| drawn("enemy_pick", enemy));
            let ally = ally.expect("somebody was drawn");
            assert!(among >> ally & 1 == 1, "{} step {step}: {ally} of {among:b}", self.name);
            ally
        });
        let goals = points(&self.file["enemy_default_target"]);
        let (orders, memory) = (self.orders(step), self.memory(step));
        for (number, enemy) in (self.allies..battle.count).enumerate() {
            let unit = &battle.units[enemy];
            let label = format!("{} step {step} enemy {number}", self.name);
            if unit.is_alive() {
                assert_eq!((unit.target, unit.goal), (memory[number], goals[number]), "{label}");
            }
            if unit.is_alive() || self.rules.rules == RuleBook::Classic {
                assert_eq!(unit.order, orders[enemy], "{label}");
            }
        }
    }

    /// Plays the recorded actions and returns the reward; every recorded shot is fired, and no other.
    fn fight(&self, step: usize, battle: &mut Battle) -> f32 {
        let units = battle.units.iter_mut().zip(self.orders(step));
        units.for_each(|(unit, order)| unit.order = order);
        let mut fired = 0;
        let reward = battle.fight(&self.rules, |tick, [unit, foe]| {
            let shot = self.shots.get(&[step, tick, unit]);
            let (want, jitter) = shot.unwrap_or_else(|| {
                panic!("{} step {step} tick {tick}: unit {unit} shot", self.name)
            });
            assert_eq!(foe, *want, "{} step {step} tick {tick} unit {unit}", self.name);
            fired += 1;
            *jitter
        });
        let recorded = self.shots.keys().filter(|[at, ..]| *at == step).count();
        assert_eq!(fired, recorded, "{} step {step}", self.name);
        reward
    }

    /// Plays the recorded actions tick by tick, where ticks were recorded.
    fn assert_ticks(&mut self, step: usize) {
        let Some(ticks) = self.file.get("world_steps").map(|steps| steps[step].clone()) else {
            return;
        };
        let mut battle = self.battle(step);
        let units = battle.units.iter_mut().zip(self.orders(step));
        units.for_each(|(unit, order)| unit.order = order);
        for tick in 0..8 {
            battle.shoot_and_move(&self.rules, |[unit, _]| self.shots[&[step, tick, unit]].1);
            battle.push_apart(&self.rules);
            let mut want = battle.clone();
            let [x, y, health, cooldown] =
                ["x", "y", "health", "cooldown"].map(|name| numbers(&ticks[name][tick]));
            for (number, unit) in want.units[..x.len()].iter_mut().enumerate() {
                unit.place = [x[number], y[number]];
                (unit.health, unit.cooldown) = (health[number] as u8, cooldown[number]);
            }
            self.assert_units(&format!("step {step} tick {tick}"), &battle, &want);
        }
    }

    /// What was seen, where that was recorded.
    fn assert_seen(&mut self, step: usize, battle: &Battle) -> usize {
        let observations = self.file["observations"].as_array().unwrap();
        let Some(seen) = observations.iter().find(|seen| seen["step"] == step).cloned() else {
            return 0;
        };
        let want = numbers(&seen["world_state"]);
        let mut got = vec![0.0; want.len()];
        battle.write_state(&mut got);
        let label = format!("{} step {step}", self.name);
        for (got, want) in got.into_iter().zip(want) {
            Self::near(&label, got, want, PLACE, &mut self.worst.place);
        }
        if self.file["options"]["observation_type"] != "unit_list" {
            return 1;
        }
        for (unit, want) in seen["units"].as_object().unwrap() {
            let want = numbers(want);
            let mut got = vec![0.0; want.len()];
            battle.write_vector(&self.rules, unit.parse().unwrap(), &mut got);
            for (column, (got, want)) in got.into_iter().zip(want).enumerate() {
                let label = format!("{label} unit {unit} column {column}");
                Self::near(&label, got, want, TOLD, &mut self.worst.seen);
            }
        }
        1
    }

    /// Replays all, and counts the states in which something was seen.
    fn replay(&mut self) -> usize {
        let mut start = self.unplaced();
        let spawn = points(&self.file["spawn"]);
        start.units.iter_mut().zip(spawn).for_each(|(unit, place)| unit.place = place);
        start.push_apart(&self.rules);
        let first = self.battle(0);
        self.assert_units("start", &start, &first);
        let mut seen = 0;
        for step in 0..self.steps {
            let mut battle = self.battle(step);
            assert!(!battle.is_over(&self.rules));
            self.assert_available(step, &battle);
            seen += self.assert_seen(step, &battle);
            self.assert_commands(step, &mut battle);
            let reward = self.fight(step, &mut battle);
            let next = self.battle(step + 1);
            self.assert_units(&format!("step {step}"), &battle, &next);
            let (label, want) = (format!("{} step {step}", self.name), &self.file["reward"][step]);
            Self::near(&label, reward, number(want), REWARD, &mut self.worst.reward);
            let done = i64::from(battle.is_over(&self.rules));
            assert_eq!(self.file["done"][step].as_i64(), Some(done), "{label}");
            self.assert_ticks(step);
        }
        let last = self.battle(self.steps);
        seen + self.assert_seen(self.steps, &last)
    }
}

#[test]
fn recorded_episodes_replay() {
    let (mut kinds, mut outcomes, mut books) = (0, Vec::new(), Vec::new());
    let mut worst = Worst::default();
    for mut episode in episodes() {
        let seen = episode.replay();
        assert!(seen >= 2, "{}: {seen} states were seen", episode.name);
        episode.kinds.iter().for_each(|kind| kinds |= 1 << kind);
        outcomes.push(episode.file["outcome"].as_str().unwrap().to_owned());
        books.push(episode.rules.rules);
        worst.place = worst.place.max(episode.worst.place);
        worst.cooldown = worst.cooldown.max(episode.worst.cooldown);
        worst.seen = worst.seen.max(episode.worst.seen);
        worst.reward = worst.reward.max(episode.worst.reward);
    }
    // As near as the rule book's own second implementation came.
    assert!(worst.place < 6e-6 && worst.cooldown < 1e-6 && worst.seen < 1e-6, "{worst:?}");
    assert_eq!(kinds, 0b11_1111);
    for outcome in ["win", "loss", "draw", "timeout"] {
        assert!(outcomes.iter().any(|known| known == outcome), "no {outcome}");
    }
    assert!(books.contains(&RuleBook::Classic) && books.contains(&RuleBook::Current));
}
