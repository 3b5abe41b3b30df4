// What agents do.

/** What an agent does in a state, or has decided to do; nothing in the final one. */
function actionOf(at, agent) {
  return episode.steps[at]?.actions[agent] ?? episode.states[at].chosen?.[agent] ?? undefined;
}

/** What is told of an agent that does nothing. */
function idle(state, agent) {
  return state.dead?.includes(agent)
    ? `no process acts for it: the world repeats its last action, or has it stay${absence(state, agent)}`
    : "the episode is over";
}

/** Since when an agent is left out of allocations, where it is. */
function absence(state, agent) {
  const since = state.absent?.find(([absent]) => absent === agent)?.[1];
  return since === undefined ? "" : `; absent since step ${since}`;
}

