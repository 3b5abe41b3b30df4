// The whole episode at a glance: the team's reward above, a lane for every agent below, a column for every state.

/** Rewards as shares of the largest. */
function sharesOf(rewards, all) {
  const largest = Math.max(1e-9, ...all.map(Math.abs));
  return rewards.map((reward) => reward / largest);
}

/** Draws the lanes; the returned function moves the cursor. */
function createTimeline(go) {
  return createLanes(go, {
    count: 1 + episode.agents.length,
    above: 1,
    draw: (number, lane, column) => (number === 0 ? teamLane(lane, column) : agentLane(number - 1, lane, column)),
  });
}

/** Rewards that made each state. */
function teamLane(lane, column) {
  const all = episode.steps.map(({ reward }) => reward);
  return svg("g", {}, laneName("team", lane), track(lane, column), ...shades(sharesOf(all, all), lane, column));
}

/** An agent's own rewards, and what it holds or says. */
function agentLane(agent, lane, column) {
  const all = episode.steps.flatMap(({ rewards }) => rewards);
  const rewards = sharesOf(episode.steps.map((step) => step.rewards[agent]), all);
  const size = Math.min(11, lane - 1);
  const letters = episode.states.flatMap((state, at) => {
    const kind = state.holds[agent];
    const text = kind === null ? state.says[agent] : episode.kinds[kind];
    const place = { x: (at + 0.5) * column, y: lane / 2, "font-size": size, class: "lane-text" };
    return text === null || column < 7 ? [] : [svg("text", place, String(text))];
  });
  const { name, takes } = episode.agents[agent];
  const label = laneName(takes === null ? name : sign(episode.states[0], agent), lane);
  return svg("g", {}, label, track(lane, column), ...shades(rewards, lane, column), ...letters);
}

function track(lane, column) {
  return svg("rect", { class: "lane-track", x: 0, y: 2, width: (LAST + 1) * column, height: lane - 4 });
}

/** Gains and losses, the darker, the larger; those of a step in the column of the state that it led to. */
function shades(shares, lane, column) {
  return shares.map((share, step) => {
    const shade = { x: (step + 1) * column, y: 2, width: column, height: lane - 4 };
    return svg("rect", { ...shade, class: share < 0 ? "lane-loss" : "lane-gain", opacity: 0.75 * Math.abs(share) });
  });
}
