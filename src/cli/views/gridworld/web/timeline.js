// The whole episode at a glance: finds, falls and tiers of the team above, those of each agent below.

/** Draws the lanes; the returned function moves the cursor. */
function createTimeline(go) {
  return createLanes(go, {
    count: 1 + episode.agents.length,
    above: 1,
    draw: (number, lane, column) => (number === 0 ? eventLane("team", null, lane, column) : eventLane(`${number - 1}`, number - 1, lane, column)),
  });
}

/** Events of an agent, or of all. */
function eventLane(name, agent, lane, column) {
  const track = svg("rect", { class: "lane-track", x: 0, y: 2, width: (LAST + 1) * column, height: lane - 4 });
  const events = episode.events.filter(({ of }) => agent === null || of === agent);
  const marks = events.map(({ at, kind }) => {
    const place = { x: at * column, y: 2, width: Math.max(column, 3), height: lane - 4 };
    return svg("rect", { ...place, class: kind === "fall" ? "lane-loss" : "lane-gain" });
  });
  return svg("g", {}, laneName(name, lane), track, ...marks);
}

