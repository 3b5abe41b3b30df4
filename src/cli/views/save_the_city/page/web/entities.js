/** Agents come first among entities, then buildings. */
function entityName(entity) {
  const agents = episode.agents.length;
  return entity < agents ? episode.agents[entity].name : episode.buildings[entity - agents].name;
}

/** "burning" is an open building with a fire. */
function lookOf(state, building) {
  const status = state.status[building];
  return status === 0 && state.fire[building] > 0 ? "burning" : STATUS[status];
}

/** The agents that are assigned to a building. */
function teamOf(state, building) {
  return episode.agents.flatMap((_, agent) => (state.allocation[agent] === building ? [agent] : []));
}

function isAvailable(state, agent, action) {
  return ((state.available[agent] >> action) & 1) === 1;
}

/** The available action of highest utility, the first of equals. */
function bestAction(state, agent) {
  const utilities = state.thoughts[agent].utilities;
  const available = [...utilities.keys()].filter((action) => isAvailable(state, agent, action));
  return available.reduce((best, action) => (utilities[action] > utilities[best] ? action : best));
}

