"use strict";

// The episode, and what follows from it. State t is what the team sees before step t; the last state is final.

const episode = JSON.parse(document.getElementById("episode").textContent);
const LAST = episode.states.length - 1;
const STATUS = ["open", "complete", "burned down"];

/** Rewards summed up to each state. */
const returns = [0];
for (const step of episode.steps) {
  returns.push(returns.at(-1) + step.reward);
}

/** Events by the state in which they show. */
const eventsAt = new Map();
for (const event of episode.events) {
  eventsAt.set(event.at, [...(eventsAt.get(event.at) ?? []), event]);
}

/** Agents come first among entities, then buildings. */
function entityName(entity) {
  const agents = episode.agents.length;
  return entity < agents ? episode.agents[entity].name : episode.buildings[entity - agents].name;
}

/** "burning" is an open building with a fire. */
function lookOf(state, building) {
  const status = state.status[building];
  return status === 0 && state.fire[building] > 0 ? "burning" : STATUS[status];
}

/** The agents that are assigned to a building. */
function teamOf(state, building) {
  return episode.agents.flatMap((_, agent) => (state.allocation[agent] === building ? [agent] : []));
}

/** What an agent does in a state; nothing in the final one. */
function actionOf(at, agent) {
  return episode.steps[at]?.actions[agent];
}

function isAvailable(state, agent, action) {
  return ((state.available[agent] >> action) & 1) === 1;
}

/** The available action of highest utility, the first of equals. */
function bestAction(state, agent) {
  const utilities = state.thoughts[agent].utilities;
  const available = [...utilities.keys()].filter((action) => isAvailable(state, agent, action));
  return available.reduce((best, action) => (utilities[action] > utilities[best] ? action : best));
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
