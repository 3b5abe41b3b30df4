// The ring: cell 0 at the top, the others clockwise; "right" goes on to the next cell.

const MIDDLE = 320;
/** Room of one cell as a share of the ring's radius: nearly half of what lies between two. */
const SHARE = (Math.PI * 0.94) / Math.max(episode.cells, 3);
/** Ring, cells and their numbers fill the picture. */
const RADIUS = (MIDDLE - 26) / (1 + SHARE);
const ROOM = RADIUS * SHARE;
/** Agents turn by the golden angle around the middle of their cell, as seeds of a sunflower do. */
const GOLDEN = Math.PI * (3 - Math.sqrt(5));
const CROWD = episode.room ? episode.agents.length : Math.max(...episode.states.flatMap((state) => state.places.map((cell) => countIn(state, cell))));
const SPREAD = (ROOM * 0.82) / Math.sqrt(Math.max(CROWD, 4));
const BODY = Math.min(19, SPREAD * 0.8);

function countIn(state, cell) {
  return state.places.filter((place) => place === cell).length;
}

function middleOf(cell) {
  const angle = (2 * Math.PI * cell) / episode.cells - Math.PI / 2;
  return [MIDDLE + RADIUS * Math.cos(angle), MIDDLE + RADIUS * Math.sin(angle)];
}

/** Where an agent is drawn: by its number among those in its cell. */
function place(state, agent) {
  const cell = state.places[agent];
  const [x, y] = middleOf(cell);
  if (countIn(state, cell) === 1) {
    return [x, y];
  }
  const number = state.places.slice(0, agent).filter((other) => other === cell).length;
  const far = SPREAD * Math.sqrt(number + 0.5);
  return [x + far * Math.cos(number * GOLDEN), y + far * Math.sin(number * GOLDEN)];
}

/** Draws the ring once; the returned function shows a state of it. */
function createMap(select) {
  const map = byId("map");
  map.setAttribute("viewBox", "0 0 640 640");
  const layers = ["cells", "trails", "mates", "people", "marks"].map((name) => svg("g", { class: name }));
  const [cells, trails, mates, people, marks] = layers;
  map.append(...layers);
  cells.append(svg("circle", { cx: MIDDLE, cy: MIDDLE, r: RADIUS, class: "way" }));
  for (let cell = 0; cell < episode.cells; cell++) {
    cells.append(...createCell(cell));
  }
  const agents = episode.agents.map(({ name }, agent) => {
    const size = { "font-size": Math.min(15, (BODY * 2) / Math.max(name.length, 2)) };
    const element = svg(
      "g",
      { class: "person", "data-entity": agent },
      svg("circle", { r: BODY, class: "body" }),
      svg("text", size, name),
    );
    element.addEventListener("click", () => select({ agent }));
    people.append(tint(element, groupOf(agent)));
    return element;
  });
  createLegend();
  let shown = null;

  return function showMap(view) {
    const state = episode.states[view.at];
    people.classList.toggle("gliding", Math.abs(view.at - shown) === 1 && shown !== null);
    shown = view.at;
    agents.forEach((element, agent) => {
      const [x, y] = place(state, agent);
      element.style.transform = `translate(${x}px, ${y}px)`;
      element.classList.toggle("selected", agent === view.agent);
    });
    trails.replaceChildren(...trailLines(view, state));
    mates.replaceChildren(...mateLines(view, state));
    marks.replaceChildren(...gatheringMarks(state), ...seenMarks(view, state), ...slipMarks(view, state), sum(state));
    byId("map-text").textContent = describe(state);
  };
}

function createCell(cell) {
  const [cx, cy] = middleOf(cell);
  const far = (RADIUS + ROOM + 13) / RADIUS;
  const [x, y] = [MIDDLE + (cx - MIDDLE) * far, MIDDLE + (cy - MIDDLE) * far];
  const circle = svg("circle", { cx, cy, r: ROOM, class: "cell" });
  return ROOM < 12 && cell % 5 ? [circle] : [circle, svg("text", { x, y, class: "cell-name" }, String(cell))];
}

/** Where agents came from in the last step. */
function trailLines(view, state) {
  const before = episode.states[view.at - 1];
  return episode.agents.flatMap((_, agent) => {
    if (!before || before.places[agent] === state.places[agent]) {
      return [];
    }
    const [x1, y1] = middleOf(before.places[agent]);
    const [x2, y2] = place(state, agent);
    return [tint(svg("line", { x1, y1, x2, y2 }), groupOf(agent))];
  });
}

/** From the selected agent to those of its groups. */
function mateLines(view, state) {
  const [x1, y1] = place(state, view.agent);
  return episode.agents[view.agent].groups.flatMap((group) =>
    episode.groups[group].members
      .filter((agent) => agent !== view.agent)
      .map((agent) => {
        const [x2, y2] = place(state, agent);
        return tint(svg("line", { x1, y1, x2, y2 }), group);
      }),
  );
}

/** A ring around the cell where a group has gathered, inside those of other groups there. */
function gatheringMarks(state) {
  const rings = new Map();
  return episode.groups.flatMap(({ members }, group) => {
    if (!state.gathered[group] || members.length < 2) {
      return [];
    }
    const cell = state.places[members[0]];
    const before = rings.get(cell) ?? 0;
    rings.set(cell, before + 1);
    const [cx, cy] = middleOf(cell);
    return [tint(svg("circle", { cx, cy, r: Math.max(2, ROOM - 2 - 5 * before), class: "gathering" }), group)];
  });
}

/** Dashed rings around all that the selected agent sees; where it attends to them, as wide as it does. */
function seenMarks(view, state) {
  const attention = state.thoughts?.[view.agent]?.attention;
  return state.sees[view.agent].map((agent) => {
    const [cx, cy] = place(state, agent);
    const weights = attention?.find(({ entity }) => entity === agent)?.weights;
    const width = weights ? { "stroke-width": 0.5 + 11 * mean(weights) } : {};
    return svg("circle", { cx, cy, r: BODY + 4, class: weights ? "seen weighed" : "seen", ...width });
  });
}

/** Agents that chance moved in the last step. */
function slipMarks(view, state) {
  return (episode.steps[view.at - 1]?.slipped ?? []).map((agent) => {
    const [x, y] = place(state, agent);
    return svg("text", { x: x + BODY, y: y - BODY, class: "slip" }, "!");
  });
}

function sum(state) {
  const gathered = state.gathered.filter(Boolean).length;
  return svg("text", { x: MIDDLE, y: MIDDLE, class: "sum" }, `${gathered} of ${state.gathered.length} groups together`);
}

/** The ring in words. */
function describe(state) {
  const agents = episode.agents.map(({ name }, agent) => `${name} in cell ${state.places[agent]}`);
  const groups = episode.groups.map(
    ({ name }, group) => `group ${name} ${state.gathered[group] ? "together" : "apart"}`,
  );
  return `${agents.join(", ")}. ${groups.join(", ")}.`;
}

function createLegend() {
  const boxed = (...shapes) => svg("svg", { viewBox: "-20 -20 40 40", class: "icon", "aria-hidden": "true" }, ...shapes);
  const tinted = (name, shape) => boxed(svg("g", { class: name }, tint(shape, 0)));
  const groups = episode.groups.slice(0, 6).map(({ name }, group) => [groupIcon(group), `group ${name}`]);
  const entries = [
    ...groups,
    [tinted("mates", svg("line", { x1: -16, y1: 8, x2: 16, y2: -8 })), "of the selected agent's group"],
    [tinted("trails", svg("line", { x1: -16, y1: 8, x2: 16, y2: -8 })), "its last move"],
    [tinted("marks", svg("circle", { r: 15, class: "gathering" })), "a group has gathered"],
    [boxed(svg("circle", { r: 15, class: "seen" })), "the selected agent sees it"],
    [boxed(svg("text", { class: "slip" }, "!")), "chance moved it"],
  ];
  byId("legend").append(...entries.map((entry) => html("li", {}, ...entry)));
}
