// The panels: the selected agent with what it computes, the team, and all things.

/** Builds the panel once; the returned function shows an agent in a state. */
function createAgentPanel(select) {
  const buttons = episode.agents.map(({ name, kind }, agent) => {
    const { agents } = episode.states[0];
    const button = html("button", { type: "button", "aria-label": `${kind} ${name}` }, discIcon(agents[agent], "person"), name);
    button.addEventListener("click", () => select({ entity: agent }));
    return button;
  });
  byId("agents").append(...buttons);

  return function showAgent(view) {
    const state = episode.states[view.at];
    buttons.forEach((button, agent) => button.setAttribute("aria-pressed", agent === view.agent));
    const { name, kind } = episode.agents[view.agent];
    const title = name === kind ? [name] : [name, `, ${kind}`];
    byId("agent-title").replaceChildren(discIcon(state.agents[view.agent], "person"), ...title);
    byId("agent-text").textContent = agentText(view, state);
    showUtilities(view, state);
    showAttention(view, state);
    showHeads(view, state);
    showMilestones(view, state);
  };
}

function agentText(view, state) {
  const { status, about } = state.agents[view.agent];
  const { option } = thoughtOf(state, view.agent);
  const action = actionOf(view.at, view.agent);
  const task = state.allocation[view.agent] ?? null;
  const isDead = state.dead?.includes(view.agent);
  return [
    status,
    about,
    task === null ? "" : `assigned to ${taskName(state, task)}`,
    option ? `goes for ${episode.milestones[option.goal]}, step ${option.step} of the option` : "",
    action === undefined ? "" : `action: ${episode.agents[view.agent].actions[action]}`,
    action === undefined || isDead ? idle(state, view.agent) : "",
  ].filter(Boolean).join("; ");
}

/** A bar for each action, from the lowest utility of this agent and state to the highest. */
function showUtilities(view, state) {
  const { utilities } = thoughtOf(state, view.agent);
  const { actions } = episode.agents[view.agent];
  const closed = new Set(state.unavailable[view.agent]);
  const taken = actionOf(view.at, view.agent);
  const allowed = actions.flatMap((_, action) => (closed.has(action) ? [] : [action]));
  const best = utilities && allowed.reduce((best, action) => (utilities[action] > utilities[best] ? action : best));
  const lengths = utilities ? shares(utilities) : [];
  byId("utilities-text").textContent = utilities
    ? `bars from ${fixed(Math.min(...utilities))} to ${fixed(Math.max(...utilities))}`
    : "none known in this state";
  const rows = actions.map((name, action) => {
    const note = action === taken ? "taken" : action === best ? "best" : "";
    const notes = [note, closed.has(action) ? "unavailable" : ""].filter(Boolean);
    return html(
      "tr",
      { class: `${action === taken ? "taken" : ""} ${closed.has(action) ? "unavailable" : ""}` },
      html("th", { scope: "row" }, name, ...notes.flatMap((note) => [" ", html("small", {}, note)])),
      barCell(lengths[action] ?? 0),
      html("td", { class: "number" }, utilities ? fixed(utilities[action]) : ""),
    );
  });
  fill("utilities", ...rows);
}

function headRow(names) {
  return html("tr", {}, html("td"), ...names.map((name) => html("th", { scope: "col" }, name)));
}

/** One row for each entity that it attends to, the most attended first. */
function showAttention(view, state) {
  const attention = thoughtOf(state, view.agent).attention ?? [];
  const entities = entitiesOf(state);
  byId("attention").hidden = attention.length === 0;
  const rows = attention.map(({ entity, weights }) => ({ entity, weights, average: mean(weights) }));
  rows.sort((one, other) => other.average - one.average || one.entity - other.entity);
  const own = (entity) => {
    const link = state.links.find(({ from, to }) => [from, to].includes(view.agent) && [from, to].includes(entity));
    return entity === view.agent ? " (itself)" : link ? ` (${link.name})` : "";
  };
  const lines = rows.map(({ entity, weights, average }) => {
    const disc = entities[entity];
    const title = entity < state.agents.length ? disc.name : titleOf(disc);
    const label = html("th", { scope: "row" }, `${title}${own(entity)}`);
    return html("tr", {}, label, heat(average, "mean"), ...weights.map((weight) => heat(weight)));
  });
  const heads = attention[0]?.weights ?? [];
  fill("attention", headRow(["mean", ...heads.map((_, head) => String(head + 1))]), ...lines);
}

/** A row for each head that the run explores by. */
function showHeads(view, state) {
  const heads = thoughtOf(state, view.agent).heads ?? [];
  byId("heads").hidden = heads.length === 0;
  const most = Math.max(1e-9, ...heads.map(({ pays }) => pays));
  const rows = heads.map(({ name, pays, likes, acts }) =>
    html(
      "tr",
      { class: acts ? "taken" : "" },
      html("th", { scope: "row" }, name === "none" ? "nothing" : name, ...(acts ? [" ", html("small", {}, "in use")] : [])),
      barCell(Math.max(0, pays) / most),
      html("td", { class: "number" }, pays.toPrecision(2)),
      html("td", {}, episode.agents[view.agent].actions[likes]),
    ),
  );
  fill("heads", ...rows);
}

/** Options that are over before a state, by their goals: how many, and how many reached it. */
function optionsBefore(at, agent) {
  const counts = episode.milestones.map(() => ({ tried: 0, reached: 0 }));
  episode.states.slice(0, at).forEach((state, step) => {
    const goal = thoughtOf(state, agent).option?.goal;
    const ends = (thoughtOf(episode.states[step + 1], agent).option?.step ?? 1) === 1;
    if (goal !== undefined && ends) {
      counts[goal].tried += 1;
      counts[goal].reached += episode.steps[step].milestone === goal ? 1 : 0;
    }
  });
  return counts;
}

/** What can be reached next, as an agent that runs options believes and in truth. */
function showMilestones(view, state) {
  byId("milestones").hidden = episode.milestones.length === 0;
  const { option } = thoughtOf(state, view.agent);
  const bit = (set, place) => ((set >> place) & 1) === 1;
  const counts = optionsBefore(view.at, view.agent);
  const rows = episode.milestones.map((name, place) => {
    const [likely, { tried, reached }] = [option?.likelihoods[place], counts[place]];
    const masked = option ? bit(option.mask, place) : undefined;
    const isWrong = option && masked !== bit(state.affordances, place);
    return html(
      "tr",
      { class: place === option?.goal ? "goal" : "" },
      html("th", { scope: "row" }, name),
      barCell(likely ?? 0),
      html("td", { class: "number" }, likely === undefined ? "" : percent(likely)),
      html("td", { class: isWrong ? "wrong" : "yes" }, masked ? "✓" : isWrong ? "–" : ""),
      html("td", { class: "yes" }, bit(state.affordances, place) ? "✓" : ""),
      html("td", { class: "number" }, tried ? `${reached} of ${tried}` : ""),
    );
  });
  fill("milestones", ...rows);
}

/** The team and all things; the returned function shows them in a state. */
function createSidePanel(select) {
  const { things } = episode.states[0];
  const listed = things.flatMap((thing, number) => (thing.status || thing.bars || thing.about ? [number] : []));
  const buttons = listed.map((thing) => {
    const button = html("button", { type: "button" });
    button.addEventListener("click", () => select({ entity: episode.agents.length + thing }));
    return button;
  });
  byId("things").append(...buttons);
  byId("things-panel").hidden = buttons.length === 0;
  const earns = (step) => step.agent_rewards.length > 0;
  const isAttending = (state) => state.thoughts?.some((thought) => thought?.attention.some(({ entity }) => entity < episode.agents.length));

  return function showSide(view) {
    const state = episode.states[view.at];
    listed.forEach((thing, place) => showThing(buttons[place], view, state, thing));
    showSelected(view, state);
    byId("team").hidden = !episode.steps.some(earns) && state.agents.every(({ status, about }) => !status && !about);
    const rows = episode.agents.map((facts, agent) => {
      const { status, about } = state.agents[agent];
      const rewards = episode.steps.slice(0, view.at).filter(earns).map((step) => step.agent_rewards[agent]);
      const numbers = rewards.length ? [signed(rewards.at(-1)), fixed(rewards.reduce((sum, reward) => sum + reward, 0))] : ["", ""];
      const told = [status, about].filter(Boolean).join(", ");
      return named(select, view, agent, titleOf(facts), ...[told, ...numbers].map((text) => html("td", {}, text)));
    });
    fill("team", ...rows);
    byId("looks").hidden = !isAttending(state);
    fill("looks", headRow(episode.agents.map(({ name }) => name)), ...looks(select, view, state));
  };
}

function named(select, view, agent, name, ...cells) {
  const label = html("th", { scope: "row" }, name);
  label.addEventListener("click", () => select({ entity: agent }));
  return html("tr", { class: agent === view.agent ? "selected" : "" }, label, ...cells);
}

/** A row for each agent that attends, a column for each that is attended to. */
function looks(select, view, state) {
  return episode.agents.map(({ name }, agent) => {
    const attention = thoughtOf(state, agent).attention ?? [];
    const cells = episode.agents.map((_, other) => {
      const weights = attention.find(({ entity }) => entity === other)?.weights;
      return weights ? heat(mean(weights)) : html("td", {}, "·");
    });
    return named(select, view, agent, name, ...cells);
  });
}

/** A line for each thing: how it stands, and who works on it. */
function showThing(button, view, state, number) {
  const thing = state.things[number];
  const levels = (thing.bars ?? []).map(({ share }, bar) => {
    const level = html("i", { class: `level-${bar}` });
    level.style.width = `${100 * share}%`;
    return html("span", { class: "bar-track" }, level);
  });
  const team = teamOf(state, number).map((agent) => tint(html("span", { class: "chip" }, episode.agents[agent].name), state.agents[agent].colour));
  button.replaceChildren(html("b", {}, thing.name), html("span", { class: "look" }, thing.status ?? thing.about ?? ""), ...levels, html("span", { class: "chips" }, ...team));
  button.setAttribute("aria-pressed", number === view.thing);
  button.setAttribute("aria-label", describeDisc(thing));
}

/** What is known of the selected thing, and what teams are worth there. */
function showSelected(view, state) {
  const thing = state.things[view.thing];
  byId("thing-title").textContent = thing ? titleOf(thing) : "";
  const earned = episode.steps.slice(0, view.at).map((step) => step.task_rewards[thing?.task]);
  const rewarded = earned.at(-1) === undefined ? "" : `rewarded ${signed(earned.at(-1))} last step, ${signed(earned.reduce((sum, reward) => sum + reward, 0))} in all`;
  const levels = (thing?.bars ?? []).map((bar) => `${bar.name} ${percent(bar.share)} %`);
  byId("thing-text").textContent = [thing?.status, ...levels, thing?.about, rewarded].filter(Boolean).join("; ");
  const values = state.values?.[thing?.task];
  byId("values").hidden = !values;
  if (!values) {
    return;
  }
  const names = (team) => team.map((agent) => episode.agents[agent].name).join(" ");
  const team = teamOf(state, view.thing);
  const known = values.others.map(([agents, value]) => [names(agents), value, false]);
  known.push(["nobody", values.nobody, team.length === 0]);
  if (team.length) {
    known.push([names(team), values.chosen, true]);
  }
  known.sort(([, one], [, other]) => other - one);
  const lengths = shares(known.map(([, value]) => value));
  const rows = known.map(([name, value, isChosen], row) =>
    html(
      "tr",
      { class: isChosen ? "taken" : "" },
      html("th", { scope: "row" }, name, ...(isChosen ? [" ", html("small", {}, "chosen")] : [])),
      barCell(lengths[row]),
      html("td", { class: "number" }, fixed(value)),
    ),
  );
  fill("values", ...rows);
}

