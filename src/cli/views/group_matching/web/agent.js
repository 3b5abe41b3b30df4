// The selected agent: what it does, what it sees, what it computes.

/** Builds the panel once; the returned function shows an agent in a state. */
function createAgentPanel(select) {
  const buttons = episode.agents.map(({ name }, agent) => {
    const button = html("button", { type: "button", "aria-label": `agent ${name}` }, groupIcon(groupOf(agent)), name);
    button.addEventListener("click", () => select({ agent }));
    return button;
  });
  byId("agents").append(...buttons);
  const rows = episode.actions.map((action) => {
    const [name, bar, value] = [html("th", { scope: "row" }, action), html("div", { class: "bar" }), html("td", { class: "number" })];
    return { name, bar, value, element: html("tr", {}, name, html("td", { class: "track" }, bar), value) };
  });
  byId("utilities").tBodies[0].append(...rows.map((row) => row.element));

  return function showAgent(view) {
    const state = episode.states[view.at];
    buttons.forEach((button, agent) => button.setAttribute("aria-pressed", agent === view.agent));
    const { name, groups } = episode.agents[view.agent];
    const names = groups.map((group) => episode.groups[group].name).join(", ");
    byId("agent-title").replaceChildren(groupIcon(groups[0]), `${name}, group${groups.length > 1 ? "s" : ""} ${names}`);
    byId("agent-text").textContent = agentText(view, state);
    showActions(rows, view, state);
    showSeen(view, state);
  };
}

function agentText(view, state) {
  const here = `in cell ${state.places[view.agent]}`;
  const action = actionOf(view.at, view.agent);
  if (action === undefined) {
    return `${here}; ${idle(state, view.agent)}.`;
  }
  const slips = episode.steps[view.at]?.slipped.includes(view.agent) ? ", but chance moves it elsewhere" : "";
  return `${here}, action: ${episode.actions[action]}${slips}`;
}

/** Bars reach from the lowest utility of this agent and state to the highest, where there are any. */
function showActions(rows, view, state) {
  const utilities = state.thoughts?.[view.agent]?.utilities;
  const [low, high] = utilities ? [Math.min(...utilities), Math.max(...utilities)] : [0, 1];
  byId("utilities-range").textContent = utilities
    ? `utilities, bars from ${fixed(low)} to ${fixed(high)}`
    : "no utilities are known";
  const taken = actionOf(view.at, view.agent);
  rows.forEach(({ name, bar, value, element }, action) => {
    element.classList.toggle("taken", action === taken);
    bar.style.width = utilities ? `${2 + (98 * (utilities[action] - low)) / (high - low || 1)}%` : "0";
    value.textContent = utilities ? fixed(utilities[action]) : "";
    const note = action === taken ? [" ", html("small", {}, "taken")] : [];
    name.replaceChildren(episode.actions[action], ...note);
  });
}

/** One row per agent that it sees; the most attended first where attention is known. */
function showSeen(view, state) {
  const attention = state.thoughts?.[view.agent]?.attention ?? [];
  const seen = state.sees[view.agent].map((agent) => {
    const weights = attention.find(({ entity }) => entity === agent)?.weights ?? [];
    return { agent, weights, average: weights.length ? mean(weights) : 0 };
  });
  seen.sort((one, other) => other.average - one.average || one.agent - other.agent);
  const heads = attention[0]?.weights ?? [];
  byId("attention-heads").textContent = heads.length
    ? "mean attention, then head by head, in percent"
    : `${seen.length} of ${episode.agents.length} agents`;
  const columns = ["cell", "group", ...(heads.length ? ["mean"] : []), ...heads.map((_, head) => String(head + 1))];
  const head = html("tr", {}, html("td"), ...columns.map((name) => html("th", { scope: "col" }, name)));
  byId("attention").tBodies[0].replaceChildren(head, ...seen.map((row) => seenRow(view, state, row)));
}

function seenRow(view, state, { agent, weights, average }) {
  const { name, groups } = episode.agents[agent];
  const own = agent === view.agent ? " (itself)" : "";
  const cell = (weight, kind) => {
    const element = html("td", { class: kind }, percent(weight));
    element.style.setProperty("--weight", weight);
    return element;
  };
  return html(
    "tr",
    {},
    html("th", { scope: "row" }, `${name}${own}`),
    html("td", {}, String(state.places[agent])),
    html("td", {}, groups.map((group) => episode.groups[group].name).join(", ")),
    ...(weights.length ? [cell(average, "mean")] : []),
    ...weights.map((weight) => cell(weight, "heat")),
  );
}
