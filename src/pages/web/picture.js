// The picture: squares, discs with their bars and names, and lines between what belongs together.

const LONGEST = 640;
const FIELD = episode.field;
/** Picture units for one unit of a place. */
const SCALE = FIELD ? LONGEST / Math.max(...[0, 1].map((axis) => Math.abs(FIELD.to[axis] - FIELD.from[axis]))) : 0;
const [WIDTH, HEIGHT] = [0, 1].map((axis) => (FIELD ? Math.abs(FIELD.to[axis] - FIELD.from[axis]) * SCALE : LONGEST));
const CELL = FIELD ? FIELD.cell * SCALE : 0;
/** What is nowhere, but has something to tell, is lined up above the rest. */
const APART = entitiesOf(episode.states[0]).flatMap(({ place, status, about }, entity) => (place === null && (status || about) ? [entity] : []));
const BAND = APART.length && FIELD ? 64 : 0;
/** States back to which trails go, and how far nobody comes in one step. */
const TRAIL = 4;
const FAR = FIELD?.is_grid ? 2.5 * CELL : 0.7 * LONGEST;

/** A place on the picture; of what is farther away one at the edge. */
function onPicture(place) {
  const [x, y] = [0, 1].map((axis) => (place[axis] - FIELD.from[axis]) / (FIELD.to[axis] - FIELD.from[axis]));
  const within = (share, length) => Math.max(10, Math.min(length - 10, share * length));
  return [within(x, WIDTH), BAND + within(y, HEIGHT)];
}

/** The place that is shown at a point: in a grid its cell. */
function placeAt([x, y]) {
  const shares = [x / WIDTH, (y - BAND) / HEIGHT];
  const place = shares.map((share, axis) => FIELD.from[axis] + share * (FIELD.to[axis] - FIELD.from[axis]));
  return FIELD.is_grid ? place.map(Math.round) : place;
}

/** Where an agent or a thing is drawn; nothing of what is nowhere. */
function middleOf(disc, entity) {
  if (disc.place) {
    return onPicture(disc.place);
  }
  const number = APART.indexOf(entity);
  return number < 0 ? null : [(WIDTH * (number + 0.5)) / APART.length, 24];
}

/** How large it is drawn: not so small that its name cannot be read. */
function radiusOf({ radius, place }) {
  return place ? Math.max(11, (radius ?? 0.4 * FIELD.cell) * SCALE) : 15;
}

const grounds = [];

/** All squares of a state; states tell of those that have changed. */
function cellsOf(at) {
  for (let next = grounds.length; next <= at; next += 1) {
    grounds[next] = [...(grounds[next - 1] ?? [])];
    episode.states[next].cells.forEach(([number, cell]) => (grounds[next][number] = cell));
  }
  return grounds[at];
}

/** Draws the picture once; the returned function shows a state of it. */
function createPicture(select) {
  const map = byId("map");
  map.toggleAttribute("hidden", !FIELD);
  map.setAttribute("viewBox", `0 0 ${WIDTH} ${HEIGHT + BAND}`);
  const layers = ["ground", "visits", "trails", "links", "things", "people", "marks"].map((name) => svg("g", { class: name }));
  const [ground, visits, trails, links, things, people, marks] = layers;
  map.append(svg("rect", { y: BAND, width: WIDTH, height: HEIGHT, class: "field" }), ...(FIELD?.is_grid ? [gridLines()] : []), ...layers);
  map.addEventListener("pointerdown", (event) => {
    const entity = event.target.closest("[data-entity]")?.dataset.entity;
    if (entity !== undefined) {
      select({ entity: Number(entity) });
    }
  });
  const legend = createLegend();
  const agents = episode.agents.map((_, agent) => svg("g", { "data-entity": agent }));
  people.append(...agents);
  let shown = null;

  return function showPicture(view) {
    const state = episode.states[view.at];
    const cells = cellsOf(view.at);
    byId("map-text").textContent = describe(state);
    legend(state, cells);
    if (!FIELD) {
      return;
    }
    people.classList.toggle("gliding", Math.abs(view.at - shown) === 1 && shown !== null);
    shown = view.at;
    ground.replaceChildren(...cells.flatMap(square));
    visits.replaceChildren(...visitShades(view));
    trails.replaceChildren(...episode.agents.map((_, agent) => trail(view.at, agent)));
    links.replaceChildren(...linkLines(view, state), ...assignmentLines(view, state));
    const discs = state.things.map((thing, number) => drawDisc(svg("g", {}), thing, number + state.agents.length, view));
    things.replaceChildren(...discs);
    state.agents.forEach((agent, number) => drawDisc(agents[number], agent, number, view));
    marks.replaceChildren(...attentionMarks(view, state), ...rewardMarks(view, state));
  };
}

function gridLines() {
  const lines = (length, draw) => Array.from({ length: Math.round(length / CELL) + 1 }, (_, number) => draw(number * CELL));
  const across = lines(HEIGHT, (y) => `M0,${BAND + y} H${WIDTH}`);
  return svg("path", { class: "grid", d: [...lines(WIDTH, (x) => `M${x},${BAND} v${HEIGHT}`), ...across].join(" ") });
}

function square({ place, kind, label, is_solid: isSolid, colour }) {
  const [x, y] = onPicture(place);
  const edges = { x: x - CELL / 2, y: y - CELL / 2, width: CELL, height: CELL };
  const rect = tint(svg("rect", { ...edges, class: isSolid ? "cell solid" : kind ? "cell" : "cell free" }), colour);
  return label ? [rect, svg("text", { x, y, class: "cell-name" }, label)] : [rect];
}

/** Draws an agent or a thing as it is now. */
function drawDisc(element, disc, entity, view) {
  const middle = middleOf(disc, entity);
  const agents = episode.agents.length;
  element.replaceChildren();
  element.setAttribute("class", `${entity < agents ? "person" : "thing"} ${disc.kind}`);
  if (!middle) {
    return element;
  }
  const r = radiusOf(disc);
  const name = disc.label ?? disc.name;
  const beside = disc.outline === "cross" ? { x: r, y: -r } : {};
  element.append(
    outline(disc.outline, r),
    svg("text", { ...beside, "font-size": Math.min(16, (2.2 * r) / Math.max(name.length, 2)) }, name),
    ...(disc.bars ?? []).map(({ share }, bar) => svg("rect", { x: -r, y: r + 2 + 5 * bar, width: 2 * r * share, height: 4, class: `level level-${bar}` })),
  );
  if (!disc.place && disc.status) {
    element.append(svg("text", { y: r + 12, class: "message" }, disc.status));
  }
  element.append(svg("title", {}, describeDisc(disc)));
  element.dataset.entity = entity;
  element.style.transform = `translate(${middle[0]}px, ${middle[1]}px)`;
  element.classList.toggle("selected", entity === view.agent || entity - agents === view.thing);
  return tint(element, disc.colour);
}

/** Where the selected agent was while it learned: shades by the logarithm, for some cells are visited a thousand times as often. */
function visitShades(view) {
  const visits = episode.visits?.[view.agent] ?? [];
  const columns = FIELD.to[0] - FIELD.from[0];
  const most = Math.log1p(Math.max(1, ...visits));
  return visits.flatMap((count, cell) => {
    if (!count) {
      return [];
    }
    const [x, y] = onPicture([cell % columns, Math.floor(cell / columns)]);
    const shade = { x: x - CELL / 2, y: y - CELL / 2, width: CELL, height: CELL, opacity: (0.5 * Math.log1p(count)) / most };
    return [tint(svg("rect", shade), view.agent)];
  });
}

/** Where an agent was lately, since it last came from far away. */
function trail(at, agent) {
  const points = [];
  for (let then = at; then >= Math.max(0, at - TRAIL); then -= 1) {
    const { place } = episode.states[then].agents[agent];
    const [x, y] = place ? onPicture(place) : [Infinity, 0];
    const [nextX, nextY] = points.at(-1) ?? [x, y];
    if (!(Math.hypot(x - nextX, y - nextY) < FAR)) {
      break;
    }
    points.push([x, y]);
  }
  return tint(svg("polyline", { points: points.join(" ") }), episode.states[at].agents[agent].colour);
}

/** From the selected agent to what it belongs to, and to all that follows from there. */
function linkLines(view, state) {
  const entities = entitiesOf(state);
  return state.links.flatMap(({ from, to, name }) => {
    const ends = [from, to].map((entity) => middleOf(entities[entity], entity));
    return [from, to].includes(view.agent) && ends.every(Boolean) ? [line(ends, `link ${name}`)] : [];
  });
}

/** From agents to what they are assigned to. */
function assignmentLines(view, state) {
  return state.agents.flatMap((agent, number) => {
    const thing = thingOf(state, state.allocation[number]);
    const ends = thing < 0 ? [] : [middleOf(agent, number), middleOf(state.things[thing], state.agents.length + thing)];
    const kind = `assigned ${number === view.agent ? "selected" : ""}`;
    return ends.length && ends.every(Boolean) ? [tint(line(ends, kind), agent.colour)] : [];
  });
}

function line([[x1, y1], [x2, y2]], kind) {
  return svg("line", { x1, y1, x2, y2, class: kind });
}

/** Rings around what the selected agent attends to, wider for more weight. */
function attentionMarks(view, state) {
  const entities = entitiesOf(state);
  return (thoughtOf(state, view.agent).attention ?? []).flatMap(({ entity, weights }) => {
    const middle = entities[entity] && middleOf(entities[entity], entity);
    const width = { r: middle && radiusOf(entities[entity]) + 6, "stroke-width": 0.5 + 11 * mean(weights) };
    return middle ? [svg("circle", { cx: middle[0], cy: middle[1], ...width, class: "attention" })] : [];
  });
}

/** What the last step earned, beside what earned it. */
function rewardMarks(view, state) {
  const rewards = episode.steps[view.at - 1]?.task_rewards ?? [];
  return rewards.flatMap((reward, task) => {
    const thing = thingOf(state, task);
    const middle = thing < 0 ? null : middleOf(state.things[thing], state.agents.length + thing);
    const text = signed(reward);
    if (!middle || text === "0") {
      return [];
    }
    const r = radiusOf(state.things[thing]);
    const y = middle[1] - r < 20 ? middle[1] + r + 22 : middle[1] - r - 9;
    return [svg("text", { x: middle[0], y, class: `earned ${reward > 0 ? "gain" : "loss"}` }, text)];
  });
}

/** A disc in words. */
function describeDisc(disc) {
  const { place, status, about, bars = [] } = disc;
  const where = place ? ` at ${place.map((part) => (FIELD.is_grid ? part : fixed(part))).join(", ")}` : "";
  const levels = bars.map((bar) => `${bar.name} ${percent(bar.share)} %`);
  return [`${titleOf(disc)}${where}`, status, ...levels, about].filter(Boolean).join(", ");
}

/** The picture in words. */
function describe(state) {
  const agents = state.agents.map((agent, number) => {
    const task = state.allocation[number] ?? null;
    return describeDisc(agent) + (task === null ? "" : `, assigned to ${taskName(state, task)}`);
  });
  return `${[...agents, ...state.things.map(describeDisc)].join("; ")}.`;
}

/** Explains signs and kinds as they come up. */
function createLegend() {
  const known = new Set();
  const add = (kind, ...entry) => {
    if (!known.has(kind)) {
      known.add(kind);
      byId("legend").append(html("li", {}, ...entry));
    }
  };
  const sample = (kind) => icon(line([[-16, 8], [16, -8]], kind));
  return (state, cells) => {
    state.agents.forEach((agent) => add(agent.kind, discIcon(agent, "person"), agent.kind));
    state.things.forEach((thing) => add(thing.kind, discIcon(thing, "thing"), thing.kind));
    cells.filter(({ label }) => label).forEach(({ kind, label }) => add(`cell ${kind}`, html("span", { class: "sign" }, label), ` ${kind}`));
    entitiesOf(state).forEach(({ bars = [] }) => bars.forEach(({ name }, bar) => add(name, icon(svg("rect", { x: -16, y: -3, width: 32, height: 6, class: `level level-${bar}` })), name)));
    if (state.allocation.length) {
      add("assigned to", sample("assigned"), "assigned to");
    }
    if (thoughtOf(state, 0).attention?.length) {
      add("attends to", icon(svg("circle", { r: 15, "stroke-width": 4, class: "attention" })), "attended to: wider is more");
    }
    if (episode.visits) {
      add("was here", icon(tint(svg("rect", { x: -16, y: -16, width: 32, height: 32, opacity: 0.4, class: "visit" }), 0)), "where the selected agent was while it learned: darker is more often");
    }
  };
}

