// The selected agent: what it does and how likely, and whom its critic looks at.

/** Builds the panel once; the returned function shows an agent in a state. */
function createAgentPanel(select) {
  const buttons = episode.agents.map(({ name, role }, agent) => {
    const button = html("button", { type: "button", "aria-label": `${role} ${name}` }, agentIcon(agent), name);
    button.addEventListener("click", () => select({ agent }));
    return button;
  });
  byId("agents").append(...buttons);

  return function showAgent(view) {
    const state = episode.states[view.at];
    buttons.forEach((button, agent) => button.setAttribute("aria-pressed", agent === view.agent));
    const { name, role } = episode.agents[view.agent];
    byId("agent-title").replaceChildren(agentIcon(view.agent), `${name}, ${role}`);
    byId("agent-text").textContent = agentText(view, state);
    showChances(view, state);
    showAttention(view, state);
  };
}

function agentText(view, state) {
  const { role, actions, takes, partner, goal } = episode.agents[view.agent];
  const parts = [];
  if (state.places[view.agent]) {
    const [x, y] = state.places[view.agent];
    parts.push(`at ${fixed(x)}, ${fixed(y)}`);
  }
  if (takes !== null) {
    parts.push(`takes ${episode.kinds[takes]}`);
  } else if (TREASURES) {
    const holds = state.holds[view.agent];
    parts.push(holds === null ? "holds nothing" : `holds ${episode.kinds[holds]}`);
  }
  if (partner !== null) {
    const message = messageOf(state, view.agent);
    parts.push(role === "tower" ? `leads ${partner} to ${episode.things[goal]}` : `led by ${partner} to ${episode.things[goal]}`);
    parts.push(`${role === "tower" ? "said" : "heard"} ${message ?? "nothing"}`);
  }
  const action = actionOf(view.at, view.agent);
  parts.push(action === undefined ? idle(state, view.agent) : `action: ${actions[action]}`);
  return parts.join("; ");
}

/** A bar for each action: its chance, where scores are known. */
function showChances(view, state) {
  const { actions } = episode.agents[view.agent];
  const scores = state.thoughts?.[view.agent]?.utilities;
  const shares = scores ? chances(scores) : actions.map(() => 0);
  byId("chances-text").textContent = scores ? "chances in percent: the softmax of scores" : "no scores are known";
  const taken = actionOf(view.at, view.agent);
  const rows = actions.map((action, index) => {
    const note = index === taken ? [" ", html("small", {}, "taken")] : [];
    const bar = html("div", { class: "bar" });
    bar.style.width = `${100 * shares[index]}%`;
    return html(
      "tr",
      { class: index === taken ? "taken" : "" },
      html("th", { scope: "row" }, action, ...note),
      html("td", { class: "track" }, bar),
      html("td", { class: "number" }, scores ? percent(shares[index]) : ""),
    );
  });
  byId("chances").tBodies[0].replaceChildren(...rows);
}

/** One row for each agent that the critic looks at, the most looked at first. */
function showAttention(view, state) {
  const attention = state.thoughts?.[view.agent]?.attention ?? [];
  byId("attention").hidden = attention.length === 0;
  const rows = attention.map(({ entity, weights }) => ({ entity, weights, average: mean(weights) }));
  rows.sort((one, other) => other.average - one.average || one.entity - other.entity);
  byId("attention-heads").textContent = "mean, then head by head, in percent";
  const heads = attention[0]?.weights ?? [];
  const columns = ["mean", ...heads.map((_, head) => String(head + 1))];
  const head = html("tr", {}, html("td"), ...columns.map((name) => html("th", { scope: "col" }, name)));
  const lines = rows.map(({ entity, weights, average }) => {
    const partner = entity === episode.agents[view.agent].partner ? " (partner)" : "";
    const name = `${entity} ${episode.agents[entity].role}${partner}`;
    return html("tr", {}, html("th", { scope: "row" }, name), heat(average, "mean"), ...weights.map((weight) => heat(weight, "heat")));
  });
  byId("attention").tBodies[0].replaceChildren(head, ...lines);
}

/** A cell that is the darker, the larger the weight. */
function heat(weight, kind) {
  const element = html("td", { class: kind }, percent(weight));
  element.style.setProperty("--weight", weight);
  return element;
}
