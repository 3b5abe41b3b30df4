// All buildings, and what is known of the selected one.

/** Builds the panel once; the returned function shows the buildings in a state. */
function createBuildingPanel(select) {
  const rows = episode.buildings.map((facts, building) => {
    const row = createBuildingRow(facts);
    row.element.addEventListener("click", () => select({ building }));
    return row;
  });
  byId("buildings").append(...rows.map((row) => row.element));
  byId("buildings").classList.toggle("many", rows.length > 8);

  return function showBuildings(view) {
    const state = episode.states[view.at];
    rows.forEach((row, building) => row.show(view, state, building));
    const facts = episode.buildings[view.building];
    byId("building-title").textContent = `Building ${facts.name}, ${facts.kind} burning`;
    byId("building-facts").replaceChildren(
      ...buildingFacts(view, state).map(([name, value]) =>
        html("div", {}, html("dt", {}, name), html("dd", {}, value)),
      ),
    );
    showValues(view, state);
  };
}

function createBuildingRow({ name }) {
  const look = html("span", { class: "look" });
  const health = html("span", { class: "health-bar" }, html("i"));
  const fire = html("span", { class: "fire-bar" }, html("i"));
  const team = html("span", { class: "team" });
  const element = html("button", { type: "button" }, html("b", {}, name), look, health, fire, team);
  return {
    element,
    show(view, state, building) {
      const word = lookOf(state, building);
      element.className = word.replace(" ", "-");
      element.setAttribute("aria-pressed", building === view.building);
      look.textContent = word;
      health.firstChild.style.width = `${100 * state.health[building]}%`;
      fire.firstChild.style.width = `${100 * state.fire[building]}%`;
      const members = teamOf(state, building);
      team.replaceChildren(
        ...members.map((agent) => {
          const { name: agentName, kind } = episode.agents[agent];
          return html("span", { class: `chip ${kind}` }, agentName);
        }),
      );
      const crew = members.length ? `team ${members.map(entityName).join(" ")}` : "nobody assigned";
      const [whole, ablaze] = [state.health[building], state.fire[building]].map(percent);
      element.setAttribute(
        "aria-label",
        `building ${name}, ${word}, health ${whole} percent, fire ${ablaze} percent, ${crew}`,
      );
    },
  };
}

/** Names and values of what is known of a building. */
function buildingFacts(view, state) {
  const building = view.building;
  const earned = episode.steps.slice(0, view.at).map((step) => step.task_rewards[building]);
  const facts = [
    ["health, fire", `${percent(state.health[building])} %, ${percent(state.fire[building])} %`],
    [
      "rewarded",
      `${signed(earned.at(-1) ?? 0)} last step, ${signed(earned.reduce((sum, reward) => sum + reward, 0))} in all`,
    ],
  ];
  if (state.status[building] === 0) {
    const { period } = episode.buildings[building];
    facts.push(["ignition in", `${state.next_fire[building]} of ${period} steps (hidden from agents)`]);
  }
  return facts;
}

/** The values of the team that is there, of nobody and of other teams, if a learned allocator has any. */
function showValues(view, state) {
  const values = state.values?.[view.building];
  const table = byId("values");
  table.hidden = !values;
  if (!values) {
    return;
  }
  const team = teamOf(state, view.building);
  const rows = values.others.map(([agents, value]) => [agents.map(entityName).join(" "), value, ""]);
  rows.push(["nobody", values.nobody, team.length ? "" : "chosen"]);
  if (team.length) {
    rows.push([team.map(entityName).join(" "), values.chosen, "chosen"]);
  }
  rows.sort(([, one], [, other]) => other - one);
  const numbers = rows.map(([, value]) => value);
  const [low, high] = [Math.min(...numbers), Math.max(...numbers)];
  table.tBodies[0].replaceChildren(
    ...rows.map(([name, value, note]) => {
      const bar = html("div", { class: "bar" });
      bar.style.width = `${2 + (98 * (value - low)) / (high - low || 1)}%`;
      const label = html("th", { scope: "row" }, name, ...(note ? [" ", html("small", {}, note)] : []));
      return html(
        "tr",
        note ? { class: "taken" } : {},
        label,
        html("td", { class: "track" }, bar),
        html("td", { class: "number" }, fixed(value)),
      );
    }),
  );
}
