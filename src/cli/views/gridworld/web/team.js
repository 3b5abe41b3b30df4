// The team: what everybody found, and how often everybody was where the selected agent is.

/** Builds the panel once; the returned function shows the team in a state. */
function createBuildingPanel(select) {
  const when = LEARNED ? "while they learned" : "so far";
  byId("team-text").textContent = `was here: visits of each to the selected agent's cell ${when}`;

  return function showTeam(view) {
    const state = episode.states[view.at];
    const here = state.cells[view.agent];
    const rows = episode.agents.map(({ name }, agent) => {
      const row = html("th", { scope: "row" }, agentIcon(agent), `agent ${name}`);
      row.addEventListener("click", () => select({ agent }));
      return html(
        "tr",
        { class: agent === view.agent ? "selected" : "" },
        row,
        html("td", {}, letters(state.found[agent]) || "–"),
        html("td", {}, `${visitsOf({ ...view, agent })[here].toLocaleString("en")} ×`),
      );
    });
    byId("team").tBodies[0].replaceChildren(...rows);
  };
}
