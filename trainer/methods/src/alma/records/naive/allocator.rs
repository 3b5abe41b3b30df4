//! The allocator's loss against the rules: `y = rewards + discount * f_target(s', building, the team sent next)`.

use sortie_envs::members;
use sortie_envs::save_the_city::{
    City, FEATURES, RELATIONS, agent_relation, building_relation, with_city,
};

use super::{Map, agent_row, assert_near, building_row, outputs};
use crate::alma::agents::{UtilityNetwork, UtilityShape};
use crate::alma::records::fixed::{Fixed, begin, fixed, observer, play, usual};
use crate::alma::records::team_value::{Decision, Segments, TeamValueLoss};
use crate::alma::records::{Config, Experience, Loss, Networks, Pick};
use sortie_learn::random::{Purpose, generator};

fn config() -> Config {
    let mut config = usual();
    // Decisions that differ from one another.
    (config.allocator.moved, config.allocator.moved_decisions) = (0.5, 1.0);
    (config.allocator.network.width, config.allocator.network.base) = (8, 6);
    (config.network.width, config.network.base) = (8, 6);
    config.environment.settings.insert("episode_limit".into(), 40.into());
    config
}

fn network(seed: u64, skip: bool) -> UtilityNetwork {
    let mut weights = generator(seed, Purpose::Weights, 0);
    let shape = UtilityShape { skip, ..config().allocator.shape(observer(&config()).spec()) };
    UtilityNetwork::initialise(shape, 8.0, &mut weights)
}

/// Segments of agents that act at random.
fn segments() -> Segments {
    let config = config();
    let mut method = Fixed { epsilon: 1.0, decides_from: u64::MAX, ..fixed(&config, 1_000) };
    play(&mut begin(&config, 4, &mut method), &mut method, 100);
    method.segments.unwrap()
}

/// What a network expects of the team that a decision sends to a building.
fn value(network: &UtilityNetwork, decision: &Decision, task: usize, map: Map) -> f64 {
    with_city(&decision.state, |city| value_in(network, city, &decision.allocation, task, map))
}

fn value_in(
    network: &UtilityNetwork,
    city: City<'_>,
    allocation: &[u8],
    task: usize,
    map: Map,
) -> f64 {
    let columns = FEATURES + 2 + RELATIONS;
    let building = map.building(&city.buildings[task]);
    let mut own = building_row(&building, columns);
    own[FEATURES] = 1.0;
    let mut seen = vec![own.clone()];
    for (agent, sent) in city.agents.iter().zip(allocation) {
        let agent = map.agent(agent);
        let mut row = agent_row(&agent, columns);
        row[FEATURES + 1] = f64::from(u8::from(usize::from(*sent) == task));
        row[FEATURES + 2 + agent_relation(&agent, &building)] = 1.0;
        seen.push(row);
    }
    for (number, other) in city.buildings.iter().enumerate() {
        if number != task && other.is_open() {
            let other = map.building(other);
            let mut row = building_row(&other, columns);
            row[FEATURES + 2 + building_relation(&other, &building)] = 1.0;
            seen.push(row);
        }
    }
    outputs(network, &own, &seen)[0]
}

#[test]
fn the_loss_of_every_segment_is_that_of_the_rules() {
    [false, true].into_iter().for_each(check_losses);
}

fn check_losses(skip: bool) {
    let (segments, online, target) = (segments(), network(1, skip), network(2, skip));
    let mut loss = TeamValueLoss::new(online.shape());
    let environment = observer(&config());
    let experience = Experience { environment: &*environment, replay: &segments };
    let (mut moved, mut ended, mut closed) = (0, 0, 0);
    for sample in 0..segments.len() {
        let segment = segments.get(sample);
        let symmetry = (sample % 8) as u8;
        let open = |decision: &Decision| with_city(&decision.state, |city| city.open_tasks());
        let (now, next) = (open(&segment.now), open(&segment.next));
        for (draw, task) in (0..).zip(members(now.into())) {
            let pick = Pick { sample: sample as u32, symmetry, draw };
            loss.learn(Networks { online: &online, target: &target }, experience, &[pick]);
            let mut wanted = f64::from(segment.rewards[task]);
            if next >> task & 1 == 1 {
                let next = value(&target, &segment.next, task, Map(symmetry));
                wanted += f64::from(segment.discount) * next;
                moved += usize::from(segment.next.team(task) != segment.now.team(task));
            } else {
                closed += 1;
            }
            ended += usize::from(segment.discount == 0.0);
            let error = value(&online, &segment.now, task, Map(symmetry)) - wanted;
            let what = format!("segment {sample}, building {task}, map {symmetry}");
            assert_near(&what, loss.squared_error(), error * error);
            loss.learn(Networks { online: &online, target: &target }, experience, &[pick; 3]);
            assert_eq!(loss.terms(), 3, "{what}");
        }
    }
    assert!(moved > 100 && closed > 10, "{moved} other teams, {closed} closed, {ended} ended");
}
