// The whole episode at a glance: a lane for every group and every agent, a column for every state.

/** Draws the lanes; the returned function moves the cursor. */
function createTimeline(go) {
  const groups = episode.groups.length;
  return createLanes(go, {
    count: groups + episode.agents.length,
    above: groups,
    draw: (number, lane, column) =>
      number < groups ? groupLane(number, lane, column) : agentLane(number - groups, lane, column),
  });
}

/** Filled where the group is together. */
function groupLane(group, lane, column) {
  const track = svg("rect", { class: "lane-track", x: 0, y: 2, width: (LAST + 1) * column, height: lane - 4 });
  const together = episode.states.flatMap((state, at) =>
    state.gathered[group]
      ? [svg("rect", { class: "lane-gathered", x: at * column, y: 2, width: column, height: lane - 4 })]
      : [],
  );
  return tint(svg("g", {}, laneName(episode.groups[group].name, lane), track, ...together), group);
}

/** The cell of an agent in every state; where chance moved it, a sign. */
function agentLane(agent, lane, column) {
  const size = Math.min(11, lane - 1);
  const cells = episode.states.flatMap((state, at) => {
    const box = svg("rect", { class: "lane-cell", x: at * column + 0.5, y: 1, width: Math.max(column - 1, 1), height: lane - 2, rx: 2 });
    const slips = episode.steps[at - 1]?.slipped.includes(agent);
    const label = svg(
      "text",
      { class: slips ? "lane-slip" : "lane-text", x: (at + 0.5) * column, y: lane / 2, "font-size": size },
      `${state.places[agent]}${slips ? "!" : ""}`,
    );
    return column > 14 ? [box, label] : [box];
  });
  return tint(svg("g", {}, laneName(episode.agents[agent].name, lane), ...cells), groupOf(agent));
}
