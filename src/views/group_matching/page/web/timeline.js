// The whole episode at a glance: a lane for every group and every agent, a column for every state.

const GUTTER = 40;
const GAP = 8;

/** Draws the lanes, again whenever the width changes; the returned function moves the cursor. */
function createTimeline(go) {
  const timeline = byId("timeline");
  const lanes = episode.groups.length + episode.agents.length;
  const lane = Math.max(9, Math.min(18, Math.floor(220 / lanes)));
  const height = lanes * lane + GAP + 2;
  const cursor = svg("rect", { class: "cursor", y: 0, height });
  let column = 1;
  let at = 0;

  function moveCursor() {
    setAll(cursor, { x: GUTTER + at * column, width: Math.max(column, 2) });
  }

  function draw() {
    const width = timeline.parentElement.clientWidth;
    column = Math.min(90, (width - GUTTER - 8) / (LAST + 1));
    setAll(timeline, { viewBox: `0 0 ${width} ${height}`, width, height });
    const groups = episode.groups.map((_, group) => groupLane(group, lane, column));
    const agents = episode.agents.map((_, agent) => agentLane(agent, lane, column));
    groups.forEach((element, i) => element.setAttribute("transform", `translate(${GUTTER}, ${i * lane})`));
    agents.forEach((element, i) =>
      element.setAttribute("transform", `translate(${GUTTER}, ${(groups.length + i) * lane + GAP})`),
    );
    timeline.replaceChildren(...groups, ...agents, cursor);
    moveCursor();
  }

  function pointed(event) {
    const x = event.clientX - timeline.getBoundingClientRect().left - GUTTER;
    go(Math.max(0, Math.min(LAST, Math.floor(x / column))));
  }
  timeline.addEventListener("pointerdown", (event) => {
    timeline.setPointerCapture(event.pointerId);
    pointed(event);
  });
  timeline.addEventListener("pointermove", (event) => {
    if (event.buttons) {
      pointed(event);
    }
  });
  new ResizeObserver(draw).observe(timeline.parentElement);
  draw();

  return function showTimeline(view) {
    at = view.at;
    moveCursor();
  };
}

function laneName(name, lane) {
  return svg("text", { x: -6, y: lane / 2, class: "lane-name", "font-size": Math.min(12, lane) }, name);
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
