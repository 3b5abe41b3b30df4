use sortie_envs::random::generator;
use sortie_envs::{Environment, Split, TaskSet, UNASSIGNED};
use sortie_learn::play::Play;
use sortie_learn::run::EpisodeCounts;
use sortie_learn::session::Opening;
use sortie_learn::{Method, Now};
use sortie_nn::gradient_check::assert_gradient;
use sortie_nn::tape::Tape;

use super::proposer::{Lesson, Proposer, Situation, Teachers};
use super::*;
use crate::allocator::ALLOCATOR;
use crate::allocator::deciding::{Asked, Group, Seen};

const INSTANCES: usize = 4;
const NOW: Now = Now { env_steps: 0, of: 1_000 };

fn routes() -> Box<dyn Environment> {
    sortie_envs::open("routing/5-8", Split::Train, 1, &Default::default()).unwrap()
}

/// A small method that has played so many rounds of episodes, and learned from each.
fn played(environment: &dyn Environment, rounds: usize, critic: CriticConfig) -> Aql {
    let mut setup = ALLOCATOR.preset("paper").unwrap();
    setup.environment.instances = INSTANCES;
    let mut config: Config = setup.own().unwrap();
    config.network = NetworkConfig { width: 16, layers: 1 };
    config.replay = ReplayConfig { capacity: 12, batch: INSTANCES, updates: 2 };
    config.proposals.count = 8;
    config.critic = critic;
    let opening = Opening { setup: &setup, environment, seed: 1, threads: 2 };
    let mut method = Aql::new(config, &opening).unwrap();
    let random = (1..).map(generator).take(INSTANCES).collect();
    let mut play = Play::new(environment, &mut method, random);
    for _ in 0..rounds {
        play.round(&mut method, NOW, &mut EpisodeCounts::default()).unwrap();
        method.update(environment, NOW).unwrap();
    }
    method
}

fn critic(input: CriticInput, target: CriticTarget) -> CriticConfig {
    CriticConfig { input, target }
}

fn first_state(environment: &dyn Environment) -> Vec<u8> {
    let mut world = environment.open(1, Split::Train);
    let mut state = Vec::new();
    world.reset(0, &mut generator(5));
    world.save(0, &mut state);
    state
}

/// What is proposed comes as often as its chances say: of one agent's choices, by counting.
#[test]
fn different_allocations_are_proposed_and_every_decision_can_be_followed() {
    let environment = routes();
    let method = played(&*environment, 0, CriticConfig::default());
    let network = method.networks().proposing;
    let (state, before) = (first_state(&*environment), vec![UNASSIGNED; 4]);
    let states = [Asked { episode: 0, state: &state, before: &before }; 2];
    let seen = Seen { environment: &*environment, turn: 0, states: &states };
    let (mut group, mut random) = (Group::default(), generator(3));
    let proposals = group.propose(network, seen, (64, &mut random));
    assert_eq!(proposals.len(), 2);
    for of_state in &proposals {
        let mut different = of_state.clone();
        different.sort();
        different.dedup();
        assert!(different.len() == of_state.len() && (4..=64).contains(&of_state.len()));
    }
    let one_each = group.propose(network, seen, (1, &mut random));
    assert!(one_each.iter().all(|of_state| of_state.len() == 1));

    // What was decided is described as it was when it was decided.
    let mut decided = Group::default();
    let draw = |scores: &[f32], offered: TaskSet| {
        sortie_learn::networks::draw(scores, offered, &mut random)
    };
    let allocations = decided.allocate(network, Seen { states: &states[..1], ..seen }, draw);
    let mut followed = Group::default();
    followed.follow(Seen { states: &states[..1], ..seen }, &allocations);
    assert!(decided.made.len() > 0);
    assert_eq!(decided.made.contexts, followed.made.contexts);
    assert_eq!(decided.made.offered, followed.made.offered);
    assert_eq!(decided.made.chosen, followed.made.chosen);
    assert_eq!(decided.made.given, followed.made.given);
}

#[test]
fn the_critic_is_descended() {
    let environment = routes();
    let config = critic(CriticInput::AfterState, CriticTarget::Return);
    let method = played(&*environment, 2, config);
    let lesson = &method.lessons[0];
    let (critic, weights) = (&method.critic, &method.valuing.online);
    let tables = |pass: &mut sortie_nn::tape::Pass<'_>| {
        critic.network.encode(pass, &lesson.taken.subtasks.rows)
    };
    let loss = |weights: &[f32]| {
        let mut tape = Tape::default();
        let mut pass = tape.begin(weights);
        let tables = tables(&mut pass);
        let values = critic.values(&mut pass, tables, &lesson.taken.made);
        let lost = pass.squared_error(values, &lesson.targets, 1.0);
        f64::from(pass.values(lost)[0])
    };
    let mut tape = Tape::default();
    let mut pass = tape.begin(&weights.values);
    let known = tables(&mut pass);
    let values = critic.values(&mut pass, known, &lesson.taken.made);
    let total = pass.squared_error(values, &lesson.targets, 1.0);
    let mut gradient = vec![0.0; weights.values.len()];
    pass.backward(total, &mut gradient);
    assert_gradient("critic", &weights.values, &gradient, loss);
}

/// The same critic values each situation as all of them together, and what is known of the way there is added.
#[test]
fn what_follows_is_valued_with_what_is_earned_on_the_way() {
    let environment = routes();
    let method = played(&*environment, 3, critic(CriticInput::AfterState, CriticTarget::Return));
    let (state, before) = (first_state(&*environment), vec![UNASSIGNED; 4]);
    let asked = Asked { episode: 0, state: &state, before: &before };
    let mut proposer = Proposer::new(&*environment);
    let seen = Seen { environment: &*environment, turn: 0, states: &[asked] };
    let proposals =
        proposer.proposing.propose(method.networks().proposing, seen, (16, &mut generator(1)));
    let situations: Vec<Situation> = proposals[0]
        .iter()
        .map(|allocation| proposer.situation(CriticInput::AfterState, &asked, allocation).unwrap())
        .collect();
    let all = proposer.values(method.networks().critic, &situations.iter().collect::<Vec<_>>());
    for (situation, value) in situations.iter().zip(&all) {
        let mut world = environment.open(1, Split::Train);
        world.load(0, &state).unwrap();
        let mut actions = vec![0; 4];
        world.scripted(&state, &situation.before, &mut generator(0), &mut actions);
        let step = world.step(0, &actions, &mut generator(0)).unwrap();
        assert!(situation.earned == step.reward as f32 && situation.earned < 0.0);
        let alone = proposer.values(method.networks().critic, &[situation]);
        assert!((alone[0] - value).abs() < 1e-4, "{alone:?} {value}");
        let over = Situation { over: true, ..situation.clone() };
        assert_eq!(proposer.values(method.networks().critic, &[&over]), [situation.earned]);
    }
    let best = proposer.best(method.networks(), &[asked], 16, &mut generator(1)).unwrap();
    let place = proposals[0].iter().position(|it| *it == best[0].allocation).unwrap();
    assert!(all.iter().all(|value| *value <= all[place] + 1e-4), "{all:?} {place}");
}

/// Of an episode that was played: what its steps earned is added up from behind, or to what the best proposal of the next
/// state is worth.
#[test]
fn targets_are_what_was_earned_or_what_the_next_proposal_is_worth() {
    let environment = routes();
    for input in [CriticInput::AfterState, CriticInput::Allocation] {
        let method = played(&*environment, 3, critic(input, CriticTarget::Return));
        let episode = method.replay.latest(1).next().unwrap();
        let rewards: Vec<f32> = (0..episode.steps)
            .map(|step| method.replay.rewards(episode.first.after(step)).team)
            .collect();
        let teachers = |learns| Teachers {
            networks: method.networks(),
            target: &method.valuing.online.values,
            learns,
            count: 8,
        };
        let mut lesson = Lesson::new(&*environment, generator(7));
        let mut prepared = |learns| {
            lesson.random = generator(7);
            lesson.prepare(&*environment, teachers(learns), (&method.replay, episode)).unwrap();
            assert!(lesson.taken.made.len() == lesson.targets.len() && lesson.best.made.len() > 0);
            lesson.targets.clone()
        };
        let [returns, bootstrapped] =
            [CriticTarget::Return, CriticTarget::Bootstrap].map(&mut prepared);
        let known = usize::from(input == CriticInput::AfterState);
        assert_eq!(returns.len(), episode.steps - known);
        for (step, target) in returns.iter().enumerate() {
            let rest: f32 = rewards[step + known..].iter().sum();
            assert!((target - rest).abs() < 1e-4, "{target} {rest}");
        }
        let last = rewards[episode.steps - 1];
        // Of the last allocation nothing but its own reward is left to bootstrap from.
        if input == CriticInput::Allocation {
            assert_eq!(bootstrapped[episode.steps - 1], last);
        }
        assert!(bootstrapped.iter().zip(&returns).any(|(one, other)| (one - other).abs() > 1e-3));
    }
}

#[test]
fn a_run_goes_on_bit_for_bit_and_comes_to_shorter_routes() {
    let environment = routes();
    let config = || critic(CriticInput::AfterState, CriticTarget::Return);
    let measured = |method: &Aql| {
        let mut team = method.team();
        sortie_learn::play::evaluate(&*environment, &mut *team, 40, 1).unwrap().return_mean
    };
    let (first, later) = (played(&*environment, 1, config()), played(&*environment, 60, config()));
    let again = played(&*environment, 60, config());
    assert!(measured(&later) > measured(&first), "{} {}", measured(&later), measured(&first));
    assert_eq!(later.valuing.online.values, again.valuing.online.values);
}
