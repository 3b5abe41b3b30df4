// What the agent goes for, what it believes it can reach, and what its options came to.

/** What the agent goes for in a state; nothing where it does not decide. */
function optionAt(at) {
  return episode.states[at].thoughts?.[0]?.option;
}

/** Options that are over before a state, by their goals: how many, and how many reached it. */
function optionsBefore(at) {
  const counts = episode.milestones.map(() => ({ tried: 0, reached: 0 }));
  for (let step = 0; step < at; step += 1) {
    const goal = optionAt(step)?.goal;
    const ends = (optionAt(step + 1)?.step ?? 1) === 1;
    if (goal !== undefined && ends) {
      counts[goal].tried += 1;
      counts[goal].reached += episode.steps[step].reached === goal ? 1 : 0;
    }
  }
  return counts;
}

const bit = (set, place) => ((set >> place) & 1) === 1;

/** The returned function shows a state. */
function createAgentPanel() {
  return function showAgent(view) {
    const state = episode.states[view.at];
    const [option, { truth }] = [optionAt(view.at), state];
    const action = episode.agents[0].actions[actionOf(view.at, 0)]?.replaceAll("_", " ");
    byId("agent-title").textContent = option ? `goes for ${nameOf(option.goal)}` : idle(state, 0);
    byId("agent-text").textContent = option ? `step ${option.step} of the option; action: ${action}` : "";
    const counts = optionsBefore(view.at);
    const rows = episode.milestones.map((_, place) => milestoneRow(place, option, truth, counts[place]));
    byId("milestones").tBodies[0].replaceChildren(...rows);
  };
}

function nameOf(milestone) {
  return episode.milestones[milestone].replaceAll("_", " ");
}

function milestoneRow(place, option, truth, { tried, reached }) {
  const bar = html("div", { class: "bar" });
  const likely = option?.likelihoods[place];
  bar.style.width = `${100 * (likely ?? 0)}%`;
  const masked = option ? bit(option.mask, place) : undefined;
  const isWrong = option && masked !== bit(truth, place);
  return html(
    "tr",
    { class: place === option?.goal ? "goal" : "" },
    html("th", { scope: "row" }, nameOf(place)),
    html("td", { class: "track" }, bar),
    html("td", { class: "number" }, likely === undefined ? "" : percent(likely)),
    html("td", { class: isWrong ? "wrong" : "yes" }, masked ? "✓" : isWrong ? "–" : ""),
    html("td", { class: "yes" }, bit(truth, place) ? "✓" : ""),
    html("td", { class: "count" }, tried ? `${reached} of ${tried}` : ""),
  );
}

/** What it carries. */
function createBuildingPanel() {
  return function showCarried(view) {
    const { carried } = episode.states[view.at];
    const rows = episode.items.map((item, place) =>
      html("tr", {}, html("th", { scope: "row" }, item.replaceAll("_", " ")), html("td", { class: "count" }, String(carried[place]))),
    );
    byId("carried").tBodies[0].replaceChildren(...rows);
  };
}
