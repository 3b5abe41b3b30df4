// The maze, cell by cell.

const CELL = 32;
const COLUMNS = episode.map[0].length;
const SIDE = COLUMNS * CELL;
const FIRST_DOOR = "$".charCodeAt(0);
/** States back to which an agent's trail goes. */
const TRAIL = 8;
const CELLS = [...episode.map.join("")];
const PITS = CELLS.flatMap((character, cell) => (character === "!" ? [cell] : []));
/** Whether it is known where agents were while they learned. */
const LEARNED = episode.visits !== undefined;

function corner(cell) {
  return [(cell % COLUMNS) * CELL, Math.floor(cell / COLUMNS) * CELL];
}

function middle(cell) {
  return corner(cell).map((part) => part + CELL / 2);
}

/** The tier whose end opens a door; nothing of other cells. */
function tierOf(character) {
  const door = character.charCodeAt(0) - FIRST_DOOR;
  return door >= 0 && door < 12 ? door + 1 : null;
}

/** How often an agent was in each cell: while it learned, or in this episode so far. */
function visitsOf(view) {
  if (LEARNED) {
    return episode.visits[view.agent];
  }
  const visits = CELLS.map(() => 0);
  episode.states.slice(0, view.at + 1).forEach(({ cells }) => (visits[cells[view.agent]] += 1));
  return visits;
}

/** Draws the maze once; the returned function shows a state of it. */
function createMap(select) {
  const map = byId("map");
  map.setAttribute("viewBox", `0 0 ${SIDE} ${SIDE}`);
  const layers = ["field", "visits", "things", "trails", "people"];
  const [field, visits, things, trails, people] = layers.map((name) => svg("g", { class: name }));
  map.append(field, visits, things, trails, people);
  field.append(svg("rect", { width: SIDE, height: SIDE, class: "ground" }), ...walls());
  const agents = episode.agents.map(({ name }, agent) => {
    const disc = svg("circle", { r: 12, class: "body" });
    const element = tint(svg("g", { class: "person", "data-entity": agent }, disc, svg("text", { "font-size": 14 }, name)), agent);
    element.addEventListener("click", () => select({ agent }));
    people.append(element);
    return element;
  });
  createLegend();
  let shown = null;

  return function showMap(view) {
    const state = episode.states[view.at];
    people.classList.toggle("gliding", Math.abs(view.at - shown) === 1 && shown !== null);
    shown = view.at;
    agents.forEach((element, agent) => {
      const [x, y] = middle(state.cells[agent]);
      element.style.transform = `translate(${x}px, ${y}px)`;
      element.classList.toggle("selected", agent === view.agent);
    });
    visits.replaceChildren(...visitShades(view));
    things.replaceChildren(...doors(state), ...pits(state), ...treasures(state));
    trails.replaceChildren(...episode.agents.map((_, agent) => trail(view.at, agent)));
    byId("map-text").textContent = describe(state);
  };
}

function square(cell, attributes) {
  const [x, y] = corner(cell);
  return svg("rect", { x, y, width: CELL, height: CELL, ...attributes });
}

function walls() {
  return CELLS.flatMap((character, cell) => (character === "#" ? [square(cell, { class: "wall" })] : []));
}

/** Shades by the logarithm: the most visited cells were visited a thousand times as often as others. */
function visitShades(view) {
  const visits = visitsOf(view);
  const most = Math.log1p(Math.max(1, ...visits));
  return visits.flatMap((count, cell) =>
    count ? [tint(square(cell, { opacity: (0.5 * Math.log1p(count)) / most }), view.agent)] : [],
  );
}

function doors(state) {
  return CELLS.flatMap((character, cell) => {
    const tier = tierOf(character);
    const [x, y] = corner(cell).map((part) => part + 3);
    const kind = state.tiers >= tier ? "door open" : "door";
    return tier === null ? [] : [svg("rect", { x, y, width: CELL - 6, height: CELL - 6, class: kind })];
  });
}

/** Pits with the probability in percent that they open next. */
function pits(state) {
  return PITS.map((cell, pit) => {
    const [x, y] = middle(cell);
    const kind = state.open.includes(pit) ? "pit open" : "pit";
    const place = { class: kind, transform: `translate(${x}, ${y})` };
    return svg("g", place, svg("circle", { r: 11 }), svg("text", {}, percent(state.pits[pit])));
  });
}

function treasures(state) {
  const found = letters(allFound(state));
  return CELLS.flatMap((letter, cell) => {
    if (!/[A-H]/.test(letter)) {
      return [];
    }
    const [x, y] = middle(cell);
    const place = { class: found.includes(letter) ? "treasure found" : "treasure", transform: `translate(${x}, ${y})` };
    return [svg("g", place, svg("path", { d: "M0,-14 L14,0 L0,14 L-14,0 Z" }), svg("text", {}, letter))];
  });
}

/** Where an agent came from lately: since it last fell into a pit, at most. */
function trail(at, agent) {
  const falls = episode.events.filter(({ kind, of, at: then }) => kind === "fall" && of === agent && then <= at);
  const from = Math.max(0, at - TRAIL, ...falls.map(({ at: then }) => then));
  const states = episode.states.slice(from, at + 1);
  return tint(svg("polyline", { points: states.map(({ cells }) => middle(cells[agent]).join()).join(" ") }), agent);
}

/** The maze in words. */
function describe(state) {
  const place = (cell) => `row ${Math.floor(cell / COLUMNS)}, column ${cell % COLUMNS}`;
  const agents = state.cells.map((cell, agent) => `agent ${agent} in ${place(cell)}, found ${letters(state.found[agent]) || "nothing"}`);
  const tier = CELLS.some((character) => tierOf(character) !== null) ? ` ${state.tiers} tiers are finished.` : "";
  return `${agents.join("; ")}.${tier}`;
}

function createLegend() {
  const boxed = (...shapes) => svg("svg", { viewBox: "-20 -20 40 40", class: "icon", "aria-hidden": "true" }, ...shapes);
  const shade = tint(svg("g", { class: "visits" }, svg("rect", { x: -16, y: -16, width: 32, height: 32, opacity: 0.4 })), 0);
  const entries = [
    [boxed(shade), LEARNED ? "where the selected agent was while it learned: the darker, the more often" : "where the selected agent was so far"],
    [boxed(svg("g", { class: "treasure" }, svg("path", { d: "M0,-14 L14,0 L0,14 L-14,0 Z" }))), "treasure; pale: found"],
    [boxed(svg("g", { class: "pit" }, svg("circle", { r: 13 }))), "pit, with the chance in percent that it opens next"],
    [boxed(svg("g", { class: "pit open" }, svg("circle", { r: 13 }))), "open pit"],
  ];
  if (CELLS.some((character) => tierOf(character) !== null)) {
    entries.push([boxed(svg("rect", { x: -13, y: -13, width: 26, height: 26, class: "door" })), "shut door"]);
  }
  byId("legend").append(...entries.map((entry) => html("li", {}, ...entry)));
}

