// Names, colours and signs of agents, and what they do.

/** Gives an element the colour of a kind of treasure, or takes it away. */
function tint(element, kind) {
  const is = kind !== null && kind !== undefined;
  element.classList.toggle("tinted", is);
  if (is) {
    element.style.setProperty("--hue", Math.round((360 * kind) / episode.kinds.length + 205) % 360);
  }
  return element;
}

/** "3", "3a" where it holds a, "6A" of the bank that takes a. */
function sign(state, agent) {
  const { name, takes } = episode.agents[agent];
  const holds = state.holds[agent];
  if (takes !== null) {
    return name + episode.kinds[takes].toUpperCase();
  }
  return holds === null ? name : name + episode.kinds[holds];
}

/** The kind that an agent takes or holds. */
function kindOf(state, agent) {
  return episode.agents[agent].takes ?? state.holds[agent];
}

/** The letter of a treasure or a landmark. */
function thingName(state, thing) {
  return episode.things[thing] ?? episode.kinds[state.kinds[thing]];
}

/** The body of an agent: banks are squares, towers triangles, all others discs. */
function body({ role }, r) {
  if (role === "bank") {
    return svg("rect", { x: -r, y: -r, width: 2 * r, height: 2 * r, rx: 3, class: "body" });
  }
  return role === "tower"
    ? svg("path", { d: `M0,${-1.25 * r} L${1.3 * r},${r} H${-1.3 * r} Z`, class: "body" })
    : svg("circle", { r, class: "body" });
}

/** A small picture of an agent. */
function agentIcon(agent) {
  const shape = svg("g", { class: "person" }, body(episode.agents[agent], 14));
  const icon = svg("svg", { viewBox: "-20 -20 40 40", class: "icon", "aria-hidden": "true" }, shape);
  return tint(icon, episode.agents[agent].takes);
}

/** Chances of actions: the softmax of their scores. */
function chances(scores) {
  const largest = Math.max(...scores);
  const powers = scores.map((score) => Math.exp(score - largest));
  const sum = powers.reduce((a, b) => a + b, 0);
  return powers.map((power) => power / sum);
}

/** What an agent was told last, or said last. */
function messageOf(state, agent) {
  const { role, partner } = episode.agents[agent];
  return state.says[role === "tower" ? agent : partner] ?? null;
}

/** Mean weights by agent that an agent's critic gives in a state; empty where that is not known. */
function looksOf(state, agent) {
  const attention = state.thoughts?.[agent]?.attention ?? [];
  return new Map(attention.map(({ entity, weights }) => [entity, mean(weights)]));
}
