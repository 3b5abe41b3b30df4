//! Recorded episodes, schema `sortie-golden/group-matching/1`, replayed exactly.
//!
//! A file holds the sizes, the groups, the first cells and the actions that happened after the noise,
//! which determine an episode, and beside them everything that follows. Masks in the files are
//! inverted: 1 means masked or absent.

use crc::{CRC_32_ISO_HDLC, Crc};
use serde_json::{Value, json};

use super::environment::{GroupMatching, write_row};
use super::parameters::{MAX_AGENTS, MAX_CELLS, MAX_GROUPS, Parameters};
use super::ring::{ACTIONS, Ring, State, member_bytes, same_group};
use crate::environment::{Environment, Step};
use crate::recorded::{Comparison, Field, GoldenError, Recordings, Replay};

/// The schema that files must name.
pub const SCHEMA: &str = "sortie-golden/group-matching/1";

/// How they are found.
pub(super) const RECORDINGS: Recordings = Recordings { schema: SCHEMA, replay, record: None };

const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Replays an episode given as text; `file` names it in the mismatches.
pub fn replay(file: &str, text: &str) -> Result<Replay, GoldenError> {
    let value = serde_json::from_str(text).map_err(GoldenError::Json)?;
    let root = Field::root(&value);
    let length = root.episode_length(SCHEMA, &["name", "policy"])?;
    let steps = root.get("steps")?.exactly(length)?;
    let frames = root.get("frames")?.exactly(length + 1)?;
    let mut world = restore(&root)?;

    let mut comparison = Comparison::new(file);
    comparison.compare(&root.get("static_masks")?, &masks(&world))?;
    comparison.compare(&root.get("initial_features")?, &json!(rows(&world)))?;
    comparison.compare(&frames[0], &frame(&world))?;
    for (index, (want, frame_after)) in steps.iter().zip(&frames[1..]).enumerate() {
        comparison.step = index;
        let executed = read_actions(&want.get("executed")?, &world)?;
        read_actions(&want.get("actions")?, &world)?;
        let outcome = match world.step_executed(0, &executed) {
            Ok(outcome) => outcome,
            Err(error) => {
                comparison.note(want.path(), want.value(), &error.to_string().into());
                return Ok(comparison.finish(index));
            }
        };
        comparison.compare(want, &step(&world, &outcome))?;
        comparison.step = index + 1;
        comparison.compare(frame_after, &frame(&world))?;
    }
    Ok(comparison.finish(length))
}

/// Sets up the ring that the file describes, in its first state.
fn restore(root: &Field<'_>) -> Result<GroupMatching, GoldenError> {
    let config = root.get("config")?;
    let size = |name: &str, most: usize| -> Result<usize, GoldenError> {
        Ok(config.get(name)?.integer(1..=most as u64)? as usize)
    };
    let parameters = Parameters {
        agents: size("n_agents", MAX_AGENTS)?,
        cells: size("n_states", MAX_CELLS)?,
        groups: size("n_groups", MAX_GROUPS)?,
        noise: config.get("rand_trans")?.number()?,
        episode_limit: config.get("episode_limit")?.integer(1..=u32::MAX.into())? as u32,
        fixed_groups: config.get("fixed_scen")?.flag()?,
        ..Parameters::default()
    };
    let agents = parameters.agents;
    let initial = root.get("initial")?;
    let mut cells = Vec::new();
    for cell in initial.get("loc")?.exactly(agents)? {
        cells.push(cell.integer(0..=parameters.cells as u64 - 1)? as u8);
    }
    let bytes = member_bytes(agents);
    let mut members = vec![0; parameters.groups * bytes];
    let groups = initial.get("groups")?.exactly(parameters.groups)?;
    for (members, group) in members.chunks_exact_mut(bytes).zip(groups) {
        for member in group.items()? {
            let member = member.integer(0..=agents as u64 - 1)? as usize;
            members[member / 8] |= 1 << (member % 8);
        }
    }
    let refuse = |error: &dyn std::fmt::Display| initial.refuse(format!("cannot be used: {error}"));
    let mut world = GroupMatching::new(parameters, 1).map_err(|error| refuse(&error))?;
    let ring = Ring { cells: &cells, members: &members };
    let mut state = Vec::new();
    State { steps: 0, episode_return: 0.0, ring }.write(&mut state);
    world.load(0, &state).map_err(|error| refuse(&error))?;
    Ok(world)
}

fn read_actions(actions: &Field<'_>, world: &GroupMatching) -> Result<Vec<u16>, GoldenError> {
    let actions = actions.exactly(world.parameters().agents)?;
    actions.iter().map(|action| Ok(action.integer(0..=ACTIONS as u64 - 1)? as u16)).collect()
}

/// The masks that stay the same for an episode.
fn masks(world: &GroupMatching) -> Value {
    let (ring, agents) = (world.ring(0), 0..world.parameters().agents);
    let in_group = |agent: usize| same_group(world.parameters(), ring, 0, agent);
    let masked = |agent: usize| agents.clone().map(move |other| 1 - (in_group(agent) >> other & 1));
    json!({
        "obs_mask": vec![vec![0; agents.len()]; agents.len()],
        "entity_mask": vec![0; agents.len()],
        "gt_mask": agents
            .clone()
            .map(|agent| masked(agent).map(|bit| bit as u8).collect())
            .collect::<Vec<Vec<u8>>>(),
    })
}

fn rows(world: &GroupMatching) -> Vec<Vec<f32>> {
    let parameters = world.parameters();
    let row = |agent| {
        let mut row = vec![f32::NAN; parameters.features()];
        write_row(parameters, world.ring(0), agent, &mut row);
        row
    };
    (0..parameters.agents).map(row).collect()
}

fn frame(world: &GroupMatching) -> Value {
    let bytes = rows(world).concat().into_iter().flat_map(f32::to_le_bytes).collect::<Vec<_>>();
    json!({
        "loc": world.ring(0).cells,
        "matches": world.metrics(0).matches,
        "feat_crc": CRC.checksum(&bytes),
    })
}

/// What the file says of a step but its actions.
fn step(world: &GroupMatching, step: &Step) -> Value {
    let mut info = json!({ "solved": world.metrics(0).solved });
    if step.timed_out {
        info["episode_limit"] = true.into();
    }
    json!({ "reward": step.reward, "done": step.done(), "info": info })
}
