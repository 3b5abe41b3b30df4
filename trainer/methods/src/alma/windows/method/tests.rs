use super::*;
use crate::alma::agents::{Conditioning, NO_ACTION, TaskOrder, UtilityShape};
use crate::alma::windows::low_level::tests::agent_utilities;
use sortie_envs::{EntitySet, Observation, Split, Step};
use sortie_learn::Scene;
use sortie_learn::play::{self, Play};
use sortie_learn::run::EpisodeCounts;
use sortie_learn::session::EnvironmentChoice;
use sortie_learn::subtasks::AllocatedScene;
use sortie_learn::trajectory::{End, Place};

/// Small networks that learn from four windows.
fn small() -> Config {
    let mut config = Config::default();
    config.environment.instances = 4;
    (config.low_level.width, config.low_level.base) = (8, 8);
    config.low_level.hypernetwork_width = 8;
    (config.learning.windows, config.learning.steps) = (4, 16);
    config
}

#[test]
fn flat_agents_and_players_learn_where_there_are_no_subtasks() {
    let ring = sortie_envs::open("group-matching/4x3x2", Split::Train, 1, &Default::default());
    let ring = ring.unwrap();
    for with_coach in [false, true] {
        let mut config = small();
        config.low_level.conditioning = Conditioning::None;
        config.coach.enabled = with_coach;
        let mut method = WindowLearner::new(&config, ring.spec(), 1, 1);
        let random = (0..4).map(|index| generator(1, Purpose::Rollout, index)).collect();
        let mut play = Play::new(&*ring, &mut method, random);
        let (now, mut reports) = (Now { env_steps: 0, of: 1_000 }, Reports::default());
        let before = method.low_level.online.clone();
        for _ in 0..2 {
            play.round(&mut method, now, &mut EpisodeCounts::default()).unwrap();
            reports.agents.extend(method.update(&*ring, now).unwrap().agents);
        }
        assert_eq!(method.replay.episodes().len(), 8);
        assert_ne!(method.low_level.online, before);
        assert!(reports.agents.iter().all(|report| report.loss > 0.0), "{reports:?}");
        let measured = play::evaluate(&*ring, &mut *method.team(), 8, 3).unwrap();
        assert_eq!(measured, play::evaluate(&*ring, &mut *method.team(), 8, 3).unwrap());
    }
}

const CITY: &str = "save-the-city/2-5a_2-5b";

/// Small networks, and agents that act at random half of the time.
fn config(by: &str, instances: usize, episode_limit: i64) -> Config {
    let mut config = Config::default();
    config.allocation.by = by.to_owned();
    config.environment.name = CITY.to_owned();
    config.environment.instances = instances;
    config.environment.settings.insert("episode_limit".into(), episode_limit.into());
    (config.low_level.width, config.low_level.base) = (8, 8);
    (config.exploration.actions.start, config.exploration.actions.end) = (0.5, 0.5);
    config
}

/// Where a run learns.
fn city(config: &Config) -> Box<dyn Environment> {
    let EnvironmentChoice { name, settings, .. } = &config.environment;
    sortie_envs::open(name, Split::Train, 1, settings).unwrap()
}

/// What there is to see in a state.
fn seen(environment: &dyn Environment, replay: &Replay, place: Place) -> Observation {
    let mut seen = Observation::new(&environment.spec().shape);
    environment.observe(replay.state(place), 0, EntitySet::MAX, &mut seen);
    seen
}

/// Plays a round.
fn play(config: &Config, counts: &mut EpisodeCounts) -> WindowLearner {
    let city = city(config);
    let mut method = WindowLearner::new(config, city.spec(), 5, 1);
    let stream = |index| generator(5, Purpose::Rollout, index as u64);
    let random = (0..config.environment.instances).map(stream).collect();
    let mut play = Play::new(&*city, &mut method, random);
    play.round(&mut method, Now { env_steps: 7, of: 100 }, counts).unwrap();
    method
}

#[test]
fn a_round_plays_whole_episodes_and_decides_by_the_rules() {
    let mut counts = EpisodeCounts::default();
    let config = config("heuristic", 3, 30);
    let (WindowLearner { replay, .. }, city) = (play(&config, &mut counts), city(&config));
    let episodes = replay.episodes();
    assert_eq!((episodes.len(), counts.episodes), (3, 3));
    for Episode { first, steps } in episodes {
        let over = replay.steps.end(first.after(steps - 1)) == End::Over;
        assert!(over || steps == 30);
        let mut since = 0;
        for state in 0..steps {
            let open = |state| seen(&*city, &replay, first.after(state)).open_tasks;
            let changed = state > 0 && open(state) != open(state - 1);
            let decision = state == 0 || since >= 5 || changed;
            let note = Note { decision, added: 7 };
            assert_eq!(*replay.steps.note(first.after(state)), note, "state {state}");
            since = if decision { 1 } else { since + 1 };
        }
        let last = first.after(steps);
        assert!(!replay.steps.note(last).decision, "the final state decides nothing");
    }
}

#[test]
fn an_episode_keeps_its_states_in_order_and_the_last_behind_its_end() {
    let config = config("heuristic", 2, 30);
    let mut city = city(&config);
    let mut method = WindowLearner::new(&config, city.spec(), 1, 1);
    let mut state = Vec::new();
    city.reset(0, &mut generator(1, Purpose::Rollout, 0));
    city.save(0, &mut state);
    let scene = Scene { instance: 1, state: &state, begins: true, tasks_changed: false };
    method.began = 9;
    method.places.look(&*city, &scene).allocation.fill(3);
    for (state, timed_out) in [(10, false), (11, false), (12, true)] {
        let step = Step { reward: f64::from(state), timed_out, ..Step::default() };
        let transition = Transition {
            environment: &*city,
            instance: 1,
            state: &[state],
            actions: &[u16::from(state); 5],
            step,
            task_rewards: &[1.0; 6],
            agent_rewards: &[],
            next: &[state + 1],
        };
        method.remember(&transition).unwrap();
    }
    let WindowLearner { replay, .. } = method;
    let [Episode { first, steps: 3 }] = replay.episodes()[..] else { panic!() };
    let states: Vec<u8> = (0..4).map(|state| replay.state(first.after(state))[0]).collect();
    assert_eq!(states, [10, 11, 12, 13]);
    assert_eq!(replay.steps.end(first.after(2)), End::TimedOut);
    for step in 0..3 {
        let (place, action) = (first.after(step), 10 + step as u16);
        assert_eq!(replay.steps.actions(place), [action; 5]);
        assert_eq!(replay.allocation(place), [3; 5]);
        let rewards = replay.steps.rewards(place);
        assert_eq!((rewards.team, rewards.tasks), (f32::from(action), &[1.0; 6][..]));
        assert_eq!(replay.steps.note(place).added, 9);
    }
}

/// In a battle heads point, and know of pairs what rows do not show.
#[test]
fn agents_see_in_windows_what_they_saw_when_they_acted() {
    const BATTLE: &str = "skirmish/6-8sz-symmetric";
    for (name, conditioning, recurrent) in [
        (CITY, Conditioning::Mask, false),
        (CITY, Conditioning::Input, false),
        (CITY, Conditioning::None, false),
        (CITY, Conditioning::Mask, true),
        (BATTLE, Conditioning::Mask, false),
        (BATTLE, Conditioning::Input, true),
    ] {
        let mut config = config("random", 2, 20);
        if name == BATTLE {
            config.environment.settings.clear();
            config.allocation.by = "matching".to_owned();
        }
        config.environment.name = name.to_owned();
        config.low_level.recurrent = recurrent;
        config.low_level.conditioning = conditioning;
        let WindowLearner { low_level: mut level, replay, .. } =
            play(&config, &mut EpisodeCounts::default());
        // Were pairs told in rows, embeddings would differ now.
        let UtilityShape { width, targets, .. } = level.shape();
        let Range { start, end } = targets.pairs();
        level.online.values[start * width..end * width].fill(0.3);
        let mut weights = generator(1, Purpose::Weights, 0);

        let sample = SampleShape { windows: 2, steps: 160, ..SampleShape::default() };
        let city = city(&config);
        let windows = cut_windows(&*city, &replay, &replay.episodes(), sample, &mut weights);
        let (order, slots) = (TaskOrder::identity(6), windows.shape.agents);
        assert_eq!(targets.count > 0, name == BATTLE);
        let in_windows = agent_utilities(level.players(), &windows, conditioning, &order);
        let mut players = Players::new(conditioning);
        let mut compared = 0;
        for (world, episode) in replay.episodes().into_iter().enumerate() {
            let mut last_actions = vec![NO_ACTION; slots];
            for state in 0..episode.steps {
                let place = episode.first.after(state);
                let act = |_: usize, agent: usize, utilities: &[f32]| {
                    let WindowShape { steps, actions, .. } = windows.shape;
                    let at = ((world * steps + state) * slots + agent) * actions;
                    for (acted, learned) in utilities.iter().zip(&in_windows[at..]) {
                        assert!((acted - learned).abs() < 1e-5, "{acted} {learned}");
                    }
                    compared += 1;
                };
                let scene = AllocatedScene {
                    world,
                    environment: &*city,
                    state: replay.state(place),
                    seen: &seen(&*city, &replay, place),
                    allocation: replay.allocation(place),
                    last_actions: &last_actions,
                    strategies: &[],
                };
                players.act(level.players(), &[scene], slots, act).unwrap();
                let did = replay.steps.actions(place).iter().map(|action| *action as u8);
                last_actions = did.collect();
            }
        }
        assert!(compared > 50, "{compared}");
    }
}
