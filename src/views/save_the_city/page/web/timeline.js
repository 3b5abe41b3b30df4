// The whole episode at a glance: a lane for every building and every agent, a column for every state.

const GUTTER = 34;
const GAP = 8;

/** Draws the lanes, again whenever the width changes; the returned function moves the cursor. */
function createTimeline(go) {
  const timeline = byId("timeline");
  const lanes = episode.buildings.length + episode.agents.length;
  const lane = Math.max(8, Math.min(15, Math.floor(180 / lanes)));
  const height = lanes * lane + GAP + 2;
  const cursor = svg("rect", { class: "cursor", y: 0, height });
  let column = 1;
  let at = 0;
  let drawn = episode.changes;

  function moveCursor() {
    setAll(cursor, { x: GUTTER + at * column, width: Math.max(column, 2) });
  }

  function draw() {
    const width = timeline.parentElement.clientWidth;
    drawn = episode.changes;
    column = (width - GUTTER - 8) / Math.max(LAST + 1, episode.room ?? 0);
    setAll(timeline, { viewBox: `0 0 ${width} ${height}`, width, height });
    const buildings = episode.buildings.map((facts, building) => buildingLane(building, facts, lane, column));
    const agents = episode.agents.map((facts, agent) => agentLane(agent, facts, lane, column));
    buildings.forEach((element, i) => element.setAttribute("transform", `translate(${GUTTER}, ${i * lane})`));
    agents.forEach((element, i) =>
      element.setAttribute("transform", `translate(${GUTTER}, ${(buildings.length + i) * lane + GAP})`),
    );
    timeline.replaceChildren(...buildings, ...agents, cursor);
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
    (drawn === episode.changes ? moveCursor : draw)();
  };
}

function laneName(name, lane) {
  return svg("text", { x: -6, y: lane / 2, class: "lane-name", "font-size": Math.min(12, lane) }, name);
}

/** Health as an area, fire as a band above it, events as signs. */
function buildingLane(building, { name }, lane, column) {
  const [top, bottom] = [1.5, lane - 1.5];
  const width = (LAST + 1) * column;
  const open = episode.states.findIndex((state) => state.status[building] !== 0);
  const end = open < 0 ? LAST + 1 : open;
  const heights = episode.states.slice(0, end).map((state, at) => {
    const y = bottom - (bottom - top) * state.health[building];
    return `L${at * column},${y} H${(at + 1) * column}`;
  });
  const area = svg("path", { class: "lane-health", d: `M0,${bottom} ${heights.join(" ")} V${bottom} Z` });
  const fires = runs(episode.states.slice(0, end), (state) => Math.round(state.fire[building] * 4)).flatMap(
    ({ value, from, to }) =>
      value > 0
        ? [
            svg("rect", {
              class: "lane-fire",
              x: from * column,
              y: top,
              width: (to - from) * column,
              height: 3.5,
              opacity: 0.25 + value * 0.1875,
            }),
          ]
        : [],
  );
  const track = svg("rect", { class: "lane-track", x: 0, y: top, width: end * column, height: bottom - top });
  const rest = svg("line", { class: "lane-rest", x1: end * column, x2: width, y1: lane / 2, y2: lane / 2 });
  const signs = episode.events
    .filter((event) => event.building === building)
    .map((event) => {
      const x = (event.at + 0.5) * column;
      const element = svg(
        "g",
        { transform: `translate(${x}, ${lane / 2})` },
        sign(event.kind, lane / 20),
        svg("title", {}, `step ${event.at}: ${event.text}`),
      );
      return element;
    });
  return svg("g", {}, laneName(name, lane), track, area, rest, ...fires, ...signs);
}

/** The building that an agent is assigned to, run by run. */
function agentLane(agent, { name, kind }, lane, column) {
  const parts = runs(episode.states, (state) => state.allocation[agent]).flatMap(({ value, from, to }) => {
    if (value === null) {
      return [];
    }
    const [x, width] = [from * column, (to - from) * column];
    const box = svg("rect", { x: x + 0.5, y: 1, width: Math.max(width - 1, 1), height: lane - 2, rx: 2 });
    const label = svg(
      "text",
      { x: x + width / 2, y: lane / 2, "font-size": Math.min(11, lane - 1) },
      episode.buildings[value].name,
    );
    return width > 9 ? [box, label] : [box];
  });
  return svg("g", { class: `agent-lane ${kind}` }, laneName(name, lane), ...parts);
}

/** Stretches of states with the same value. */
function runs(states, valueOf) {
  const found = [];
  states.forEach((state, at) => {
    const value = valueOf(state);
    const last = found.at(-1);
    if (last?.value === value) {
      last.to = at + 1;
    } else {
      found.push({ value, from: at, to: at + 1 });
    }
  });
  return found;
}
