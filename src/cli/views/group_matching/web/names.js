// Names and colours of groups and agents.

/** Gives an element the colour of a group. */
function tint(element, group) {
  element.classList.add("tinted");
  element.style.setProperty("--hue", Math.round((360 * group) / episode.groups.length + 205) % 360);
  return element;
}

function groupOf(agent) {
  return episode.agents[agent].groups[0];
}

/** A small round with the letter of a group. */
function groupIcon(group) {
  const round = svg("g", { class: "person" }, svg("circle", { r: 17, class: "body" }));
  const element = svg("svg", { viewBox: "-20 -20 40 40", class: "icon", "aria-hidden": "true" }, round);
  return tint(element, group);
}

function chip(agent) {
  return tint(html("span", { class: "chip" }, episode.agents[agent].name), groupOf(agent));
}

/** The cells in which members of a group stand, each once. */
function cellsOf(state, group) {
  return [...new Set(episode.groups[group].members.map((agent) => state.places[agent]))].sort((a, b) => a - b);
}

/** "cells 1 and 4", "cell 2". */
function cellList(cells) {
  const last = cells.at(-1);
  return cells.length === 1 ? `cell ${last}` : `cells ${cells.slice(0, -1).join(", ")} and ${last}`;
}
