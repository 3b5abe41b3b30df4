// The whole episode at a glance: what was reached above, a lane for each milestone below, lit where the agent goes for it.

/** Draws the lanes; the returned function moves the cursor. */
function createTimeline(go) {
  return createLanes(go, {
    count: 1 + episode.milestones.length,
    above: 1,
    gutter: 96,
    draw: (number, lane, column) => (number === 0 ? reachedLane(lane, column) : goalLane(number - 1, lane, column)),
  });
}

function laneTrack(lane, column) {
  return svg("rect", { class: "lane-track", x: 0, y: 2, width: (LAST + 1) * column, height: lane - 4 });
}

/** Where milestones were reached. */
function reachedLane(lane, column) {
  const marks = episode.events.map(({ at }) =>
    svg("rect", { class: "lane-gain", x: at * column, y: 2, width: Math.max(column, 1), height: lane - 4 }),
  );
  return svg("g", {}, laneName("all", lane), laneTrack(lane, column), ...marks);
}

/** Where a milestone is the goal. */
function goalLane(milestone, lane, column) {
  const marks = episode.states.flatMap((_, at) =>
    optionAt(at)?.goal === milestone
      ? [svg("rect", { class: "lane-cell", style: "--tint: var(--taken)", x: at * column, y: 2, width: Math.max(column, 1), height: lane - 4 })]
      : [],
  );
  return svg("g", {}, laneName(nameOf(milestone), lane), laneTrack(lane, column), ...marks);
}
