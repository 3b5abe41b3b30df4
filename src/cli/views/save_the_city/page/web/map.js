// The map: north is up.

const CELL = 40;
const HOUSE = 35;

function place([x, y]) {
  return [(x + 0.5) * CELL, (episode.side - y - 0.5) * CELL];
}

/** Draws the map once; the returned function shows a state of it. */
function createMap(select) {
  const map = byId("map");
  map.setAttribute("viewBox", "0 0 640 640");
  const layers = ["grid", "assignments", "trails", "houses", "people", "marks"].map((name) =>
    svg("g", { class: name }),
  );
  const [grid, assignments, trails, houses, people, marks] = layers;
  map.append(...layers);
  grid.append(gridLines());
  const buildings = episode.buildings.map((facts, building) => {
    const house = createHouse(facts, building);
    house.element.addEventListener("click", () => select({ building }));
    houses.append(house.element);
    return house;
  });
  const agents = episode.agents.map((facts, agent) => {
    const element = createPerson(facts);
    element.dataset.entity = agent;
    element.addEventListener("click", () => select({ agent }));
    people.append(element);
    return element;
  });
  createLegend();
  let shown = null;

  return function showMap(view) {
    const state = episode.states[view.at];
    // Agents glide from one state to the next, and jump elsewhere.
    people.classList.toggle("gliding", Math.abs(view.at - shown) === 1 && shown !== null);
    shown = view.at;
    buildings.forEach((house, building) => house.show(view, state, building));
    agents.forEach((element, agent) => {
      const [x, y] = place(state.places[agent]);
      element.style.transform = `translate(${x}px, ${y}px)`;
      element.classList.toggle("selected", agent === view.agent);
    });
    assignments.replaceChildren(...assignmentLines(view, state));
    trails.replaceChildren(...trailLines(view, state));
    marks.replaceChildren(...attentionMarks(view, state), ...rewardMarks(view, state));
    byId("map-text").textContent = describe(state);
  };
}

function gridLines() {
  const end = episode.side * CELL;
  const lines = Array.from(
    { length: episode.side + 1 },
    (_, i) => `M${i * CELL},0 V${end} M0,${i * CELL} H${end}`,
  );
  return svg("path", { d: lines.join(" ") });
}

/** A building: filled from below by its health, with a flame by the strength of its fire. */
function createHouse(facts, building) {
  const [x, y] = place([facts.x, facts.y]);
  const half = HOUSE / 2;
  const box = { x: -half, y: -half, width: HOUSE, height: HOUSE, rx: 5 };
  const clip = `house-${building}`;
  const health = svg("rect", { x: -half, width: HOUSE, class: "health", "clip-path": `url(#${clip})` });
  const flame = svg("g", { class: "flame" }, sign("fire"));
  const done = svg("g", { transform: `translate(${half - 5}, ${half - 5})` });
  const element = svg(
    "g",
    { class: "house", transform: `translate(${x}, ${y})`, "data-building": building },
    svg("clipPath", { id: clip }, svg("rect", box)),
    svg("rect", { ...box, class: "ground" }),
    health,
    svg("rect", { ...box, class: "walls" }),
    svg("text", { class: "name", y: 1 }, facts.name),
    flame,
    done,
  );
  return {
    element,
    show(view, state) {
      const look = lookOf(state, building);
      element.setAttribute("class", `house ${look.replace(" ", "-")}`);
      element.classList.toggle("selected", building === view.building);
      const height = HOUSE * state.health[building];
      setAll(health, { y: half - height, height });
      const scale = look === "burning" ? 0.7 + 0.9 * state.fire[building] : 0;
      flame.setAttribute("transform", `translate(${half - 3}, ${-half + 2}) scale(${scale})`);
      const end = { complete: "complete", "burned down": "burned-down" }[look];
      done.replaceChildren(...(end ? [svg("circle", { r: 9 }), sign(end, 0.85)] : []));
    },
  };
}

function createPerson(facts) {
  const text = svg("text", { class: facts.name.length > 2 ? "long" : "" }, facts.name);
  return svg("g", { class: `person ${facts.kind}` }, agentShape(facts.kind), text);
}

/** Lines from agents to the buildings that they are assigned to. */
function assignmentLines(view, state) {
  return episode.agents.flatMap((facts, agent) => {
    const building = state.allocation[agent];
    if (building === null) {
      return [];
    }
    const { x, y } = episode.buildings[building];
    const [x1, y1] = place(state.places[agent]);
    const [x2, y2] = place([x, y]);
    const selected = agent === view.agent ? "selected" : "";
    return [svg("line", { x1, y1, x2, y2, class: `${facts.kind} ${selected}` })];
  });
}

/** Where agents came from in the last step. */
function trailLines(view, state) {
  const before = episode.states[view.at - 1];
  return episode.agents.flatMap((facts, agent) => {
    if (!before) {
      return [];
    }
    const [x1, y1] = place(before.places[agent]);
    const [x2, y2] = place(state.places[agent]);
    return x1 === x2 && y1 === y2 ? [] : [svg("line", { x1, y1, x2, y2, class: facts.kind })];
  });
}

/** Rings around what the selected agent attends to, wider for more weight. */
function attentionMarks(view, state) {
  const attention = state.thoughts?.[view.agent]?.attention ?? [];
  return attention.map(({ entity, weights }) => {
    const [x, y] = place(entityPlace(state, entity));
    const weight = mean(weights);
    return svg("circle", { cx: x, cy: y, r: 25, "stroke-width": 0.5 + 11 * weight, class: "attention" });
  });
}

function entityPlace(state, entity) {
  const building = episode.buildings[entity - episode.agents.length];
  return building ? [building.x, building.y] : state.places[entity];
}

/** Cells beside a building where its reward may stand: the first that is free. */
const CORNERS = [
  [-1, 1],
  [1, 1],
  [-1, -1],
  [1, -1],
];

function freeCorner(state, { x, y }) {
  const houses = episode.buildings.map((building) => [building.x, building.y]);
  const taken = new Set([...state.places, ...houses].map(String));
  const isInside = (value) => value >= 0 && value < episode.side;
  const isFree = ([dx, dy]) =>
    isInside(x + dx) && isInside(y + dy) && !taken.has(String([x + dx, y + dy]));
  return CORNERS.find(isFree) ?? CORNERS[0];
}

/** What the last step earned, beside the building that earned it. */
function rewardMarks(view, state) {
  const rewards = episode.steps[view.at - 1]?.task_rewards ?? [];
  return rewards.flatMap((reward, building) => {
    const text = signed(reward);
    if (text === "0") {
      return [];
    }
    const { x, y } = episode.buildings[building];
    const [cx, cy] = place([x, y]);
    const [right, up] = freeCorner(state, { x, y });
    const side = right > 0 ? "right" : "left";
    const kind = reward > 0 ? "gain" : "loss";
    return [svg("text", { x: cx + 13 * right, y: cy - 25 * up, class: `earned ${side} ${kind}` }, text)];
  });
}

/** The map in words. */
function describe(state) {
  const buildings = episode.buildings.map(
    ({ name }, building) =>
      `building ${name} ${lookOf(state, building)}, health ${percent(state.health[building])} %`,
  );
  const agents = episode.agents.map(({ name, kind }, agent) => {
    const [x, y] = state.places[agent];
    const task = state.allocation[agent];
    const where = task === null ? "unassigned" : `assigned to ${episode.buildings[task].name}`;
    return `${kind} ${name} at ${x}, ${y}, ${where}`;
  });
  return `${buildings.join("; ")}. ${agents.join("; ")}.`;
}

function createLegend() {
  const agent = (kind) => [icon(agentShape(kind), `person ${kind}`), kind];
  const house = (look, name, ...signs) => {
    const half = HOUSE / 2;
    const box = { x: -half, y: -half, width: HOUSE, height: HOUSE, rx: 5 };
    const health = svg("rect", { x: -half, y: 2, width: HOUSE, height: half - 2, class: "health" });
    const shape = svg(
      "g",
      { class: `house ${look}` },
      svg("rect", { ...box, class: "ground" }),
      health,
      svg("rect", { ...box, class: "walls" }),
      ...signs,
    );
    return [icon(shape), name];
  };
  const line = svg("line", { x1: -16, y1: 8, x2: 16, y2: -8, class: "sample" });
  const ring = svg("circle", { r: 15, "stroke-width": 4, class: "attention" });
  const earned = svg("text", { class: "earned gain" }, "+1");
  const entries = [
    agent("firefighter"),
    agent("builder"),
    agent("generalist"),
    house("open", "open, filled by health"),
    house("burning", "burning", sign("fire", 1.5)),
    house("complete", "complete", sign("complete", 1.3)),
    house("burned-down", "burned down", sign("burned-down", 1.3)),
    [icon(line), "assigned to"],
    [icon(ring), "the selected agent attends to it: wider is more"],
    [icon(earned), "reward of the last step"],
  ];
  byId("legend").append(...entries.map((entry) => html("li", {}, ...entry)));
}
