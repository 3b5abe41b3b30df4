// The selected agent: what it does, its utilities, its attention.

/** Builds the panel once; the returned function shows an agent in a state. */
function createAgentPanel(select) {
  const buttons = episode.agents.map(({ name, kind }, agent) => {
    const button = html(
      "button",
      { type: "button", "aria-label": `${kind} ${name}` },
      icon(agentShape(kind), `person ${kind}`),
      name,
    );
    button.addEventListener("click", () => select({ agent }));
    return button;
  });
  byId("agents").append(...buttons);
  const rows = episode.actions.map(createUtilityRow);
  byId("utilities").tBodies[0].append(...rows.map((row) => row.element));

  return function showAgent(view) {
    const state = episode.states[view.at];
    buttons.forEach((button, agent) => button.setAttribute("aria-pressed", agent === view.agent));
    const { name, kind } = episode.agents[view.agent];
    byId("agent-title").replaceChildren(icon(agentShape(kind), `person ${kind}`), `${name}, ${kind}`);
    byId("agent-text").textContent = agentText(view, state);
    showUtilities(rows, view, state);
    showAttention(view, state);
  };
}

function agentText(view, state) {
  const task = state.allocation[view.agent];
  const action = actionOf(view.at, view.agent);
  const isDead = state.dead?.includes(view.agent);
  if (action === undefined) {
    return isDead
      ? `No process acts for it: the world repeats its last action, or has it stay${absence(state, view.agent)}.`
      : "The episode is over.";
  }
  const where = task === null ? "unassigned" : `assigned to ${episode.buildings[task].name}`;
  const bounced = episode.steps[view.at]?.bounced.includes(view.agent)
    ? ", but runs into another and goes back"
    : isDead
      ? `, which the world repeats: its process is dead${absence(state, view.agent)}`
      : "";
  return `${where}, action: ${episode.actions[action]}${bounced}`;
}

function createUtilityRow(action) {
  const name = html("th", { scope: "row" }, action);
  const bar = html("div", { class: "bar" });
  const value = html("td", { class: "number" });
  return { name, bar, value, element: html("tr", {}, name, html("td", { class: "track" }, bar), value) };
}

/** Bars reach from the lowest utility of this agent and state to the highest. */
function showUtilities(rows, view, state) {
  const utilities = state.thoughts?.[view.agent]?.utilities;
  const [low, high] = utilities ? [Math.min(...utilities), Math.max(...utilities)] : [0, 1];
  byId("utilities-range").textContent = utilities
    ? `bars from ${fixed(low)} to ${fixed(high)}`
    : "none known in this state";
  const taken = actionOf(view.at, view.agent);
  const best = utilities && bestAction(state, view.agent);
  rows.forEach(({ name, bar, value, element }, action) => {
    const available = (taken !== undefined || isRunning()) && isAvailable(state, view.agent, action);
    element.classList.toggle("unavailable", !available);
    element.classList.toggle("taken", action === taken);
    bar.style.width = utilities ? `${2 + (98 * (utilities[action] - low)) / (high - low || 1)}%` : "0";
    value.textContent = utilities ? fixed(utilities[action]) : "";
    const notes = [];
    if (action === taken) {
      notes.push("taken");
    } else if (action === best) {
      notes.push("best");
    }
    if (!available) {
      notes.push("unavailable");
    }
    name.replaceChildren(episode.actions[action], ...notes.flatMap((note) => [" ", html("small", {}, note)]));
  });
}

/** One row per visible entity, the most attended first. */
function showAttention(view, state) {
  const table = byId("attention");
  const attention = state.thoughts?.[view.agent]?.attention ?? [];
  table.hidden = attention.length === 0;
  const rows = attention
    .map(({ entity, weights }) => ({ entity, weights, average: mean(weights) }))
    .sort((one, other) => other.average - one.average)
    .map(({ entity, weights, average }) => attentionRow(view, entity, average, weights));
  const heads = attention[0]?.weights ?? [];
  const head = html(
    "tr",
    {},
    html("td"),
    html("th", { scope: "col" }, "mean"),
    ...heads.map((_, index) => html("th", { scope: "col" }, `head ${index + 1}`)),
  );
  table.tBodies[0].replaceChildren(head, ...rows);
}

function attentionRow(view, entity, average, weights) {
  const own = entity === view.agent ? " (itself)" : "";
  const cell = (weight, name) => {
    const element = html("td", { class: name }, percent(weight));
    element.style.setProperty("--weight", weight);
    return element;
  };
  const label = entity < episode.agents.length ? entityName(entity) : `building ${entityName(entity)}`;
  return html(
    "tr",
    {},
    html("th", { scope: "row" }, `${label}${own}`),
    cell(average, "mean"),
    ...weights.map((weight) => cell(weight, "heat")),
  );
}
