//! The agents' loss against the rules: `y = reward + discount * sum of Q_target(s', best action of Q_online)`.

use sortie_envs::members;
use sortie_envs::save_the_city::{AgentState, BuildingState, FEATURES, with_city};

use super::{Map, Row, agent_row, assert_near, building_row, outputs};
use crate::alma::agents::{Conditioning, NO_ACTION, UtilityNetwork};
use crate::alma::records::fixed::{Fixed, begin, fixed, observer, play, usual};
use crate::alma::records::{
    Chunk, Config, Experience, Loss, MixedNetwork, Mixer, Networks, Pick, Replay, Sample,
};
use sortie_learn::random::{Purpose, generator};

fn config(subtask: Conditioning) -> Config {
    let mut config = usual();
    config.allocation.heuristic = 1.0;
    config.network.subtask = subtask;
    (config.network.width, config.network.base) = (8, 6);
    config
}

fn network(config: &Config, seed: u64) -> MixedNetwork {
    let mut weights = generator(seed, Purpose::Weights, 0);
    let shape = config.network.shape(observer(config).spec());
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

/// What a team sees of a state.
struct Sight {
    /// The row of every agent and its available actions, agents of the team or not.
    agents: Vec<(Row, u16)>,
    buildings: Vec<Row>,
}

/// What there is to see of a record's state, turned: when its team acted, or to bootstrap from.
fn sight(sample: &Sample<'_>, map: Map, columns: usize, next: bool) -> Sight {
    let moment = if next { sample.next } else { sample.now };
    let mark = |row: &mut Row, task: usize| {
        if columns > FEATURES + 12 {
            row[FEATURES + 12 + task] = 1.0;
        }
    };
    with_city(moment.state, |city| {
        let agent = |(number, agent): (usize, &AgentState)| {
            let turned = map.agent(agent);
            let mut row = agent_row(&turned, columns);
            let last = moment.last_actions[number];
            if last != NO_ACTION {
                row[FEATURES + usize::from(map.action(last))] = 1.0;
            }
            mark(&mut row, sample.now.allocation[number].into());
            (row, turned.available)
        };
        let building = |(task, building): (usize, &BuildingState)| {
            let mut row = building_row(&map.building(building), columns);
            mark(&mut row, task);
            row
        };
        Sight {
            agents: city.agents.iter().enumerate().map(agent).collect(),
            buildings: city.buildings.iter().enumerate().map(building).collect(),
        }
    })
}

/// The squared difference between the value of what a team did and its target.
fn squared_error(
    online: &UtilityNetwork,
    target: &UtilityNetwork,
    sample: &Sample<'_>,
    map: Map,
    subtask: Conditioning,
) -> f64 {
    let columns = online.shape().input;
    let [now, next] = [false, true].map(|next| sight(sample, map, columns, next));
    let task = usize::from(sample.record.task);
    let team: Vec<usize> = members(sample.team().into()).collect();
    let seen = |sight: &Sight| {
        let row = |agent: usize| sight.agents[agent].0.clone();
        match subtask {
            Conditioning::Mask => {
                let building = sight.buildings[task].clone();
                team.iter().map(|agent| row(*agent)).chain([building]).collect::<Vec<_>>()
            }
            _ => {
                let agents = (0..sight.agents.len()).map(row);
                agents.chain(sight.buildings.iter().cloned()).collect()
            }
        }
    };
    let (seen_now, seen_next) = (seen(&now), seen(&next));
    let mut value = 0.0;
    let mut wanted = f64::from(sample.record.reward);
    for agent in &team {
        let action = map.action(sample.now.actions[*agent]);
        value += outputs(online, &now.agents[*agent].0, &seen_now)[usize::from(action)];
        let (row, available) = &next.agents[*agent];
        let liked = outputs(online, row, &seen_next);
        let is_available = |action: &usize| available >> action & 1 == 1;
        let best = (0..12).filter(is_available).max_by(|a, b| liked[*a].total_cmp(&liked[*b]));
        let valued = outputs(target, row, &seen_next)[best.unwrap()];
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
        let environment = observer(&config);
        let experience = Experience { environment: &*environment, replay: &replay };
        let mut chunk = Chunk::new(&online, subtask, config.mixer.reward_factor());
        for sample in (0..replay.len()).step_by(7) {
            let symmetry = (sample % 8) as u8;
            let networks = Networks { online: &online, target: &target };
            let pick = Pick { sample: sample as u32, symmetry, draw: 0 };
            chunk.learn(networks, experience, &[pick]);
            let (record, map) = (replay.get(sample), Map(symmetry));
            let want = squared_error(&online.utility, &target.utility, &record, map, subtask);
            let what = format!("{subtask:?}, skip {skip}, record {sample}, map {symmetry}");
            assert_near(&what, chunk.squared_error(), want);
            // The mean is taken over so many.
            let networks = Networks { online: &online, target: &target };
            chunk.learn(networks, experience, &[pick; 3]);
            assert_eq!(chunk.terms(), 3, "{what}");
            assert_near(&what, chunk.squared_error(), 3.0 * want);
        }
    }
}
