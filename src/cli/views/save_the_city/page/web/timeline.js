// The whole episode at a glance: a lane for every building and every agent, a column for every state.

/** Draws the lanes; the returned function moves the cursor. */
function createTimeline(go) {
  const buildings = episode.buildings.length;
  return createLanes(go, {
    count: buildings + episode.agents.length,
    above: buildings,
    draw: (number, lane, column) =>
      number < buildings
        ? buildingLane(number, episode.buildings[number], lane, column)
        : agentLane(number - buildings, episode.agents[number - buildings], lane, column),
  });
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
