// Small helpers: elements, numbers in words, and what follows from the episode.

const SVG = document.getElementById("map").namespaceURI;

/** An SVG element with attributes and children. */
function svg(name, attributes = {}, ...children) {
  const element = document.createElementNS(SVG, name);
  setAll(element, attributes);
  element.append(...children);
  return element;
}

/** An HTML element with attributes and children. */
function html(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  setAll(element, attributes);
  element.append(...children);
  return element;
}

function setAll(element, attributes) {
  for (const [name, value] of Object.entries(attributes)) {
    element.setAttribute(name, value);
  }
}

function byId(id) {
  return document.getElementById(id);
}

/** The body of a table gets these rows. */
function fill(id, ...rows) {
  byId(id).tBodies[0].replaceChildren(...rows);
}

function mean(numbers) {
  return numbers.reduce((sum, number) => sum + number, 0) / numbers.length;
}

/** Two decimals, with a real minus sign. */
function fixed(number) {
  return number.toFixed(2).replace("-", "−").replace("−0.00", "0.00");
}

/** "+0.25", "−1.20", "0". */
function signed(number) {
  const text = fixed(number);
  if (text === "0.00") {
    return "0";
  }
  return number > 0 ? `+${text}` : text;
}

function percent(share) {
  return `${Math.round(share * 100)}`;
}

/** A bar in a table's cell, as long as this share of it. */
function barCell(share) {
  const bar = html("div", { class: "bar" });
  bar.style.width = `${100 * share}%`;
  return html("td", { class: "track" }, bar);
}

/** A cell that is the darker, the larger the weight. */
function heat(weight, kind = "heat") {
  const element = html("td", { class: kind }, percent(weight));
  element.style.setProperty("--weight", weight);
  return element;
}

/** Shares of numbers between the least and the largest of them, a little of the least. */
function shares(numbers) {
  const [low, high] = [Math.min(...numbers), Math.max(...numbers)];
  return numbers.map((number) => (2 + (98 * (number - low)) / (high - low || 1)) / 100);
}

const HUES = [205, 330, 150, 25, 265, 60, 185, 300, 100, 0, 230, 45];

/** Gives an element the colour of its number, or none. */
function tint(element, colour) {
  element.classList.toggle("tinted", colour !== undefined && colour !== null);
  element.style.setProperty("--hue", HUES[(colour ?? 0) % HUES.length]);
  return element;
}

/** What is drawn of a disc around (0, 0). */
function outline(shape, r) {
  switch (shape) {
    case "square":
      return svg("rect", { x: -r, y: -r, width: 2 * r, height: 2 * r, rx: r / 5, class: "body" });
    case "diamond":
      return svg("path", { d: `M0,${-1.25 * r} L${1.25 * r},0 L0,${1.25 * r} L${-1.25 * r},0 Z`, class: "body" });
    case "triangle":
      return svg("path", { d: `M0,${-1.25 * r} L${1.3 * r},${r} H${-1.3 * r} Z`, class: "body" });
    case "cross":
      return svg("path", { d: `M${-r},0 H${r} M0,${-r} V${r}`, class: "body cross" });
    default:
      return svg("circle", { r, class: "body" });
  }
}

/** A small picture for lists and legends. */
function icon(...shapes) {
  return svg("svg", { viewBox: "-20 -20 40 40", class: "icon", "aria-hidden": "true" }, ...shapes);
}

function discIcon(disc, kind) {
  return tint(icon(svg("g", { class: kind }, outline(disc.outline, 13))), disc.colour);
}

/** "builder B0", or "agent" where that is its name. */
function titleOf({ kind, name }) {
  return name === kind ? name : `${kind} ${name}`;
}

/** Agents and things of a state: agents come first. */
function entitiesOf(state) {
  return [...state.agents, ...state.things];
}

/** The thing that stands for a subtask; -1 where none does. */
function thingOf(state, task) {
  return state.things.findIndex((thing) => thing.task !== undefined && thing.task === task);
}

function taskName(state, task) {
  return state.things[thingOf(state, task)]?.name ?? String(task);
}

/** The agents that are assigned to what a thing stands for. */
function teamOf(state, thing) {
  const { task } = state.things[thing];
  return task === undefined ? [] : state.agents.flatMap((_, agent) => (state.allocation[agent] === task ? [agent] : []));
}

/** What an agent thinks in a state, where that is known. */
function thoughtOf(state, agent) {
  return state.thoughts?.[agent] ?? {};
}

/** What an agent does in a state, or has decided to do; nothing in the final one. */
function actionOf(at, agent) {
  return episode.steps[at]?.actions[agent] ?? episode.states[at].chosen?.[agent] ?? undefined;
}

/** What is told of an agent that decides nothing. */
function idle(state, agent) {
  return state.dead?.includes(agent)
    ? `no process acts for it: the world repeats its last action, or has it stay${absence(state, agent)}`
    : "the episode is over";
}

/** Since when an agent is left out of allocations, where it is. */
function absence(state, agent) {
  const since = state.absent?.find(([absent]) => absent === agent)?.[1];
  return since === undefined ? "" : `; absent since step ${since}`;
}

/** Rewards summed up to each state. */
const returns = [0];
episode.steps.forEach(addReward);

function addReward(step) {
  returns.push(returns.at(-1) + step.reward);
}

/** Events by the state in which they show. */
const eventsAt = new Map();
for (const event of episode.events) {
  eventsAt.set(event.at, [...(eventsAt.get(event.at) ?? []), event]);
}

