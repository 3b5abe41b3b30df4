// The plane: x to the right, y up. Towers stand nowhere: they are lined up above it.

const SIDE = 640;
const TOWERS = episode.agents.flatMap(({ radius }, agent) => (radius === null ? [agent] : []));
const BAND = TOWERS.length ? 84 : 0;
/** Half of the side that is drawn: as far as anybody goes, within limits; where that is not known yet, farther than most go. */
const HALF = episode.room ? 1.5 : Math.min(2, Math.max(1.1, ...episode.states.flatMap(reaches)));
const SCALE = SIDE / (2 * HALF);
/** Who is farther away is drawn here, as a whole. */
const EDGE = HALF - 20 / SCALE;
/** Whether things are treasures; otherwise they are landmarks. */
const TREASURES = episode.kinds.length > 0;

/** How far from the middle each agent reaches in a state. */
function reaches({ places }) {
  return places.flatMap((place, agent) => (place ?? []).map((part) => Math.abs(part) + episode.agents[agent].radius));
}

/** A place on the picture; of what is farther away one at the edge. */
function onPlane([x, y]) {
  const within = (number) => Math.max(-EDGE, Math.min(EDGE, number));
  return [(within(x) + HALF) * SCALE, BAND + (HALF - within(y)) * SCALE];
}

/** Where an agent is drawn. */
function place(state, agent) {
  const own = state.places[agent];
  return own ? onPlane(own) : [(SIDE * (TOWERS.indexOf(agent) + 0.5)) / TOWERS.length, 34];
}

/** How large something is drawn: not so small that its letter cannot be read. */
function size(radius) {
  return Math.max(11, radius * SCALE);
}

/** Draws the plane once; the returned function shows a state of it. */
function createMap(select) {
  const map = byId("map");
  map.setAttribute("viewBox", `0 0 ${SIDE} ${SIDE + BAND}`);
  const layers = ["field", "trails", "mates", "looks", "things", "people", "marks"];
  const [field, trails, mates, looks, things, people, marks] = layers.map((name) => svg("g", { class: name }));
  map.append(field, trails, mates, looks, things, people, marks);
  const [left, top] = onPlane([-1, 1]);
  const edges = { x: left, y: top, width: 2 * SCALE, height: 2 * SCALE, class: "start" };
  field.append(svg("rect", { x: 0, y: BAND, width: SIDE, height: SIDE, class: "ground" }), svg("rect", edges));
  const agents = episode.agents.map((facts, agent) => {
    const text = svg("text", { "font-size": facts.radius > 0.1 ? 16 : 13 });
    const element = svg("g", { class: `person ${facts.role}`, "data-entity": agent }, body(facts, size(facts.radius ?? 0.06)), text);
    element.addEventListener("click", () => select({ agent }));
    people.append(element);
    return { element, text };
  });
  createLegend();
  let shown = null;

  return function showMap(view) {
    const state = episode.states[view.at];
    people.classList.toggle("gliding", Math.abs(view.at - shown) === 1 && shown !== null);
    shown = view.at;
    agents.forEach(({ element, text }, agent) => {
      const [x, y] = place(state, agent);
      element.style.transform = `translate(${x}px, ${y}px)`;
      element.classList.toggle("selected", agent === view.agent);
      element.classList.toggle("away", isAway(state, agent));
      tint(element, kindOf(state, agent));
      text.textContent = sign(state, agent);
    });
    things.replaceChildren(...thingSigns(state));
    trails.replaceChildren(...trailLines(view, state));
    mates.replaceChildren(...mateLines(view, state));
    looks.replaceChildren(...lookLines(view, state));
    marks.replaceChildren(...messages(state));
    byId("map-text").textContent = describe(state);
  };
}

/** Whether an agent is farther away than what is drawn. */
function isAway(state, agent) {
  return state.places[agent]?.some((number) => Math.abs(number) > EDGE) ?? false;
}

/** Treasures as diamonds, landmarks as crosses, each with its letter. */
function thingSigns(state) {
  return state.things.flatMap((at, thing) => {
    if (!at) {
      return [];
    }
    const [x, y] = onPlane(at);
    const kind = state.kinds[thing];
    const shape = kind === null
      ? svg("path", { d: "M-9,0 H9 M0,-9 V9", class: "landmark" })
      : svg("path", { d: "M0,-13 L13,0 L0,13 L-13,0 Z", class: "treasure" });
    const name = svg("text", kind === null ? { x: 14, y: -11 } : {}, thingName(state, thing));
    return [tint(svg("g", { style: `transform: translate(${x}px, ${y}px)`, class: "thing", "data-entity": episode.agents.length + thing }, shape, name), kind)];
  });
}

/** Where agents came from in the last step. */
function trailLines(view, state) {
  const before = episode.states[view.at - 1];
  return episode.agents.flatMap((_, agent) => {
    if (!before || !state.places[agent]) {
      return [];
    }
    const [[x1, y1], [x2, y2]] = [place(before, agent), place(state, agent)];
    return [tint(svg("line", { x1, y1, x2, y2 }), kindOf(state, agent))];
  });
}

/** From the selected agent to its partner, and from the one of both that moves to where it should be. */
function mateLines(view, state) {
  const { partner, goal } = episode.agents[view.agent];
  if (partner === null) {
    return [];
  }
  const rover = state.places[view.agent] ? view.agent : partner;
  const pairs = [[place(state, view.agent), place(state, partner)], [place(state, rover), onPlane(state.things[goal])]];
  return pairs.map(([[x1, y1], [x2, y2]], way) => svg("line", { x1, y1, x2, y2, class: way ? "way" : "pair" }));
}

/** From the selected agent to all that its critic looks at: the wider, the more. */
function lookLines(view, state) {
  const [x1, y1] = place(state, view.agent);
  return [...looksOf(state, view.agent)].map(([other, weight]) => {
    const [x2, y2] = place(state, other);
    return svg("line", { x1, y1, x2, y2, "stroke-width": 0.5 + 13 * weight });
  });
}

/** What towers said last, beneath them. */
function messages(state) {
  return TOWERS.map((tower) => {
    const [x] = place(state, tower);
    const said = state.says[tower];
    return svg("text", { x, y: 68, class: "message" }, said === null ? "–" : `says ${said}`);
  });
}

/** The plane in words. */
function describe(state) {
  const at = ([x, y]) => `at ${fixed(x)}, ${fixed(y)}`;
  const agents = episode.agents.map(({ role }, agent) => {
    const where = state.places[agent] ? at(state.places[agent]) : `says ${state.says[agent] ?? "nothing"}`;
    return `${role} ${sign(state, agent)} ${where}`;
  });
  const things = state.things.flatMap((where, thing) =>
    where ? [`${state.kinds[thing] === null ? "landmark" : "treasure"} ${thingName(state, thing)} ${at(where)}`] : [],
  );
  return `${agents.join(", ")}. ${things.join(", ")}.`;
}

function createLegend() {
  const boxed = (...shapes) => svg("svg", { viewBox: "-20 -20 40 40", class: "icon", "aria-hidden": "true" }, ...shapes);
  const line = (layer, attributes) => boxed(svg("g", { class: layer }, svg("line", { x1: -16, y1: 8, x2: 16, y2: -8, ...attributes })));
  const roles = [...new Set(episode.agents.map(({ role }) => role))];
  const thing = svg("g", { class: "thing" }, svg("path", TREASURES
    ? { d: "M0,-13 L13,0 L0,13 L-13,0 Z", class: "treasure" }
    : { d: "M-9,0 H9 M0,-9 V9", class: "landmark" }));
  const entries = roles.map((role) => [agentIcon(episode.agents.findIndex((agent) => agent.role === role)), role]);
  entries.push([boxed(tint(thing, TREASURES ? 0 : null)), TREASURES ? "treasure; 3a holds a, 6A takes a" : "landmark"]);
  entries.push([line("trails", {}), "its last move"]);
  if (TOWERS.length) {
    entries.push([line("mates", { class: "pair" }), "pair"], [line("mates", { class: "way" }), "way to its goal"]);
  }
  if (episode.states.some((state) => looksOf(state, 0).size)) {
    entries.push([line("looks", { "stroke-width": 6 }), "the selected agent's critic looks there: the wider, the more"]);
  }
  byId("legend").append(...entries.map((entry) => html("li", {}, ...entry)));
}

