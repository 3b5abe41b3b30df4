// The team: what each agent earns, and whose critic looks at whom.

/** Rewards of an agent summed up to a state. */
function ownReturn(at, agent) {
  return episode.steps.slice(0, at).reduce((sum, { rewards }) => sum + rewards[agent], 0);
}

/** Builds the panel once; the returned function shows the team in a state. */
function createBuildingPanel(select) {
  const named = (agent, text) => {
    const name = html("th", { scope: "row" }, text);
    name.addEventListener("click", () => select({ agent }));
    return name;
  };
  const known = episode.states.some((state) => looksOf(state, 0).size);
  byId("looks").hidden = !known;
  byId("looks-text").textContent = "mean over heads, in percent";

  return function showTeam(view) {
    const state = episode.states[view.at];
    const rewards = episode.steps[view.at - 1]?.rewards;
    const selected = (agent) => ({ class: agent === view.agent ? "selected" : "" });
    const rows = episode.agents.map(({ role }, agent) =>
      html(
        "tr",
        selected(agent),
        named(agent, `${sign(state, agent)} ${role}`),
        html("td", {}, rewards ? signed(rewards[agent]) : ""),
        html("td", {}, fixed(ownReturn(view.at, agent))),
      ),
    );
    byId("team").tBodies[0].replaceChildren(...rows);
    if (known) {
      byId("looks").tBodies[0].replaceChildren(...matrix(state, selected, named));
    }
  };
}

/** A row for each agent that looks, a column for each that is looked at. */
function matrix(state, selected, named) {
  const names = episode.agents.map(({ name }) => html("th", { scope: "col" }, name));
  const rows = episode.agents.map(({ name }, agent) => {
    const looks = looksOf(state, agent);
    const cells = episode.agents.map((_, other) =>
      looks.has(other) ? heat(looks.get(other), "heat") : html("td", { class: "own" }, other === agent ? "·" : ""),
    );
    return html("tr", selected(agent), named(agent, name), ...cells);
  });
  return [html("tr", {}, html("td"), ...names), ...rows];
}
