// Names, colours and signs of agents and treasures, and what agents do.

/** Gives an element the colour of an agent. */
function tint(element, agent) {
  element.classList.add("tinted");
  element.style.setProperty("--hue", (205 + 90 * agent) % 360);
  return element;
}

/** A small picture of an agent. */
function agentIcon(agent) {
  const person = svg("g", { class: "person" }, svg("circle", { r: 14, class: "body" }));
  return tint(svg("svg", { viewBox: "-20 -20 40 40", class: "icon", "aria-hidden": "true" }, person), agent);
}

/** Letters of treasures, given as bits. */
function letters(found) {
  return [..."ABCDEFGH"].filter((_, kind) => (found >> kind) & 1).join("");
}

/** What all agents found. */
function allFound(state) {
  return state.found.reduce((all, own) => all | own, 0);
}

