// The selected agent: what its actions are worth, and what its heads would pay and do.

/** Builds the panel once; the returned function shows an agent in a state. */
function createAgentPanel(select) {
  const buttons = episode.agents.map(({ name }, agent) => {
    const button = html("button", { type: "button", "aria-label": `agent ${name}` }, agentIcon(agent), name);
    button.addEventListener("click", () => select({ agent }));
    return button;
  });
  byId("agents").append(...buttons);

  return function showAgent(view) {
    const state = episode.states[view.at];
    buttons.forEach((button, agent) => button.setAttribute("aria-pressed", agent === view.agent));
    const { name, actions } = episode.agents[view.agent];
    const action = actionOf(view.at, view.agent);
    byId("agent-title").replaceChildren(agentIcon(view.agent), `agent ${name}`);
    byId("agent-text").textContent = [
      `row ${Math.floor(state.cells[view.agent] / COLUMNS)}, column ${state.cells[view.agent] % COLUMNS}`,
      `found ${letters(state.found[view.agent]) || "nothing"}`,
      action === undefined ? idle(state, view.agent) : `action: ${actions[action]}`,
    ].join("; ");
    showUtilities(view, state);
    showHeads(view, state);
  };
}

/** A bar for each action: the best full, the worst empty. */
function showUtilities(view, state) {
  const { actions } = episode.agents[view.agent];
  const utilities = state.thoughts?.[view.agent]?.utilities;
  const [least, most] = utilities ? [Math.min(...utilities), Math.max(...utilities)] : [0, 0];
  byId("utilities-text").textContent = utilities ? "what the agent makes of each" : "utilities are not known";
  const taken = actionOf(view.at, view.agent);
  const rows = actions.map((action, index) => {
    const note = index === taken ? [" ", html("small", {}, "taken")] : [];
    const bar = html("div", { class: "bar" });
    const share = most > least && utilities ? (utilities[index] - least) / (most - least) : 0;
    bar.style.width = `${100 * share}%`;
    return html(
      "tr",
      { class: index === taken ? "taken" : "" },
      html("th", { scope: "row" }, action, ...note),
      html("td", { class: "track" }, bar),
      html("td", { class: "number" }, utilities ? fixed(utilities[index]) : ""),
    );
  });
  byId("utilities").tBodies[0].replaceChildren(...rows);
}

/** A row for each head that the run explores by. */
function showHeads(view, state) {
  const heads = state.thoughts?.[view.agent]?.heads ?? [];
  byId("heads").hidden = heads.length === 0;
  const { actions } = episode.agents[view.agent];
  const most = Math.max(1e-9, ...heads.map(({ pays }) => pays));
  const rows = heads.map(({ name, pays, likes, acts }) => {
    const bar = html("div", { class: "bar" });
    bar.style.width = `${(100 * Math.max(0, pays)) / most}%`;
    const note = acts ? [" ", html("small", {}, "in use")] : [];
    return html(
      "tr",
      { class: acts ? "taken" : "" },
      html("th", { scope: "row" }, name === "none" ? "nothing" : name, ...note),
      html("td", { class: "track" }, bar),
      html("td", { class: "number" }, pays.toPrecision(2)),
      html("td", {}, actions[likes]),
    );
  });
  byId("heads").tBodies[0].replaceChildren(...rows);
}

