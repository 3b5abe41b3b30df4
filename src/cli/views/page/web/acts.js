// What agents do.

/** What an agent does in a state, or has decided to do; nothing in the final one. */
function actionOf(at, agent) {
  return episode.steps[at]?.actions[agent] ?? episode.states[at].chosen?.[agent] ?? undefined;
}

/** What is told of an agent that does nothing. */
function idle(state, agent) {
  return state.dead?.includes(agent)
    ? "no process acts for it: the world repeats its last action, or has it stay"
    : "the episode is over";
}

