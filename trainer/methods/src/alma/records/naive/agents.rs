//! The agents' loss against the rules: `y = reward + discount * sum of Q_target(s', best action of Q_online)`.

use sortie_envs::save_the_city::FEATURES;

use super::{Map, Row, agent_row, assert_near, building_row, outputs};
use crate::alma::records::conditioning::Conditioning;
use crate::alma::records::fixed::{Fixed, begin, fixed, play};
use crate::alma::records::{
    AgentStep, Chunk, Config, Loss, MixedNetwork, Mixer, NO_ACTION, Networks, Pick, Replay, Sample,
    UtilityNetwork,
};
use sortie_learn::random::{Purpose, generator};

fn config(subtask: Conditioning) -> Config {
    let mut config = Config::default();
    config.allocation.heuristic = 1.0;
    config.network.subtask = subtask;
    (config.network.width, config.network.base) = (8, 6);
    config
}

fn network(config: &Config, seed: u64) -> MixedNetwork {
    let mut weights = generator(seed, Purpose::Weights, 0);
    let shape = config.agent_shape().unwrap();
    MixedNetwork {
        utility: UtilityNetwork::initialise(shape, 8.0, &mut weights),
        mixer: Mixer::initialise(config.mixer.shape(shape.input), 8.0, &mut weights),
    }
}

/// Records of agents that act at random.
fn replay(config: &Config) -> Replay {
    let mut method =
        Fixed { epsilon: 1.0, decides_from: u64::MAX, segments: None, ..fixed(config, 1) };
    play(&mut begin(config, 4, &mut method), &mut method, 40);
    method.records
}

/// What the team of a record sees, turned: when it acted, or in the state to bootstrap from.
fn rows(sample: &Sample<'_>, map: Map, columns: usize, next: bool) -> Vec<Row> {
    let marked = columns > FEATURES + 12;
    let agent = |step: &AgentStep| {
        let (state, last) = match next {
            true => (&step.next, step.next_last_action),
            false => (&step.agent, step.last_action),
        };
        let mut row = agent_row(&map.agent(state), columns);
        if last != NO_ACTION {
            row[FEATURES + usize::from(map.action(last))] = 1.0;
        }
        if marked {
            row[FEATURES + 12 + usize::from(step.task)] = 1.0;
        }
        row
    };
    let agents = sample.agents.iter().map(agent);
    let buildings = sample.buildings.iter().enumerate().map(|(task, step)| {
        let state = if next { &step.next } else { &step.building };
        let mut row = building_row(&map.building(state), columns);
        if marked {
            row[FEATURES + 12 + task] = 1.0;
        }
        row
    });
    agents.chain(buildings).collect()
}

/// The squared difference between the value of what a team did and its target.
fn squared_error(
    online: &UtilityNetwork,
    target: &UtilityNetwork,
    sample: &Sample<'_>,
    map: Map,
) -> f64 {
    let columns = online.shape().input;
    let team = &sample.agents[..usize::from(sample.record.size)];
    let (now, next) = (rows(sample, map, columns, false), rows(sample, map, columns, true));
    let mut value = 0.0;
    let mut wanted = f64::from(sample.record.reward);
    for (step, (now_row, next_row)) in team.iter().zip(now.iter().zip(&next)) {
        value += outputs(online, now_row, &now)[usize::from(map.action(step.action))];
        let liked = outputs(online, next_row, &next);
        let is_available = |action: &usize| map.agent(&step.next).available >> action & 1 == 1;
        let best = (0..12).filter(is_available).max_by(|a, b| liked[*a].total_cmp(&liked[*b]));
        let valued = outputs(target, next_row, &next)[best.unwrap()];
        wanted += f64::from(sample.record.discount) * valued;
    }
    (value - wanted) * (value - wanted)
}

#[test]
fn the_loss_of_every_record_is_that_of_the_rules() {
    for (subtask, skip) in [
        (Conditioning::Mask, false),
        (Conditioning::Input, false),
        (Conditioning::None, false),
        (Conditioning::Mask, true),
        (Conditioning::None, true),
    ] {
        let mut config = config(subtask);
        config.network.skip = skip;
        let (replay, online, target) = (replay(&config), network(&config, 1), network(&config, 2));
        let mut chunk = Chunk::new(&online, subtask, config.mixer.reward_factor());
        for sample in (0..replay.len()).step_by(7) {
            let symmetry = (sample % 8) as u8;
            let networks = Networks { online: &online, target: &target };
            let pick = Pick { sample: sample as u32, symmetry, draw: 0 };
            chunk.learn(networks, &replay, &[pick]);
            let want =
                squared_error(&online.utility, &target.utility, &replay.get(sample), Map(symmetry));
            let what = format!("{subtask:?}, skip {skip}, record {sample}, map {symmetry}");
            assert_near(&what, chunk.squared_error(), want);
            // The mean is taken over so many.
            let networks = Networks { online: &online, target: &target };
            chunk.learn(networks, &replay, &[pick; 3]);
            assert_eq!(chunk.terms(), 3, "{what}");
            assert_near(&what, chunk.squared_error(), 3.0 * want);
        }
    }
}
