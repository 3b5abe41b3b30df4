/** Rewards summed up to each state. */
const returns = [0];
episode.steps.forEach(addReward);

function addReward(step) {
  returns.push(returns.at(-1) + step.reward);
}

/** Events by the state in which they show. */
const eventsAt = new Map();
for (const event of episode.events) {
  eventsAt.set(event.at, [...(eventsAt.get(event.at) ?? []), event]);
}

