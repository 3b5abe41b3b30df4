// Which state, agent and thing are shown, and everything that changes it.

const view = { at: 0, agent: 0, thing: 0 };
/** A thing that was chosen itself; otherwise the selected agent's is shown. */
let chosenThing = null;
let timer = null;
let telling = null;

const show = [
  createPicture(select),
  createAgentPanel(select),
  createSidePanel(select),
  createTimeline(go),
  showTransport,
];

function refresh() {
  const state = episode.states[view.at];
  const own = thingOf(state, state.allocation[view.agent] ?? null);
  view.thing = chosenThing ?? (own < 0 ? view.thing : own);
  show.forEach((part) => part(view));
  tellAddress();
}

/** Puts what is looked at into the address, for whoever copies it. Browsers refuse many changes in a row: the last one counts. */
function tellAddress() {
  clearTimeout(telling);
  telling = setTimeout(() => history.replaceState(null, "", addressOf(view)), 250);
}

/** Shows another state; out of range means the nearest, once all is played that there is. */
function go(at) {
  while (at > LAST && playOn());
  view.at = Math.max(0, Math.min(LAST, at));
  refresh();
}

function select({ entity }) {
  const thing = entity - episode.agents.length;
  if (thing < 0) {
    view.agent = entity;
    chosenThing = null;
  } else {
    chosenThing = thing;
  }
  refresh();
}

function pause() {
  clearInterval(timer);
  timer = null;
  refresh();
}

/** Whether the episode ends with the state that is shown. */
function isAtEnd() {
  return view.at === LAST && !isRunning();
}

/** Plays on from here, from the start where the end is reached. */
function play() {
  clearInterval(timer);
  timer = setInterval(() => (isAtEnd() ? pause() : go(view.at + 1)), 1000 / Number(byId("speed").value));
  go(isAtEnd() ? 0 : view.at);
}

function toggle() {
  (timer === null ? play : pause)();
}

/** The nearest event before or after this state. */
function goToEvent(direction) {
  const places = episode.events.map((event) => event.at).filter((at) => (at - view.at) * direction > 0);
  if (places.length) {
    go(direction > 0 ? Math.min(...places) : Math.max(...places));
  }
}

function changeSpeed(by) {
  const speed = byId("speed");
  speed.selectedIndex = Math.max(0, Math.min(speed.options.length - 1, speed.selectedIndex + by));
  if (timer !== null) {
    play();
  }
}

function showTransport() {
  const playing = timer !== null;
  const button = byId("play");
  button.textContent = playing ? "Pause" : "Play";
  const scrubber = byId("scrubber");
  scrubber.max = LAST;
  scrubber.value = view.at;
  scrubber.setAttribute("aria-valuetext", `step ${view.at} of ${LAST}`);
  byId("step").textContent = `${view.at} / ${LAST}`;
  byId("reward").textContent = signed(episode.steps[view.at - 1]?.reward ?? 0);
  byId("return").textContent = fixed(returns[view.at]);
  episode.metrics.forEach((name, metric) => {
    byId(`metric-${metric}`).textContent = counted(episode.states[view.at].metrics[metric]);
  });
  const events = eventsAt.get(view.at) ?? [];
  const happening = byId("happening");
  // While it plays, steps follow too fast to be read aloud.
  happening.setAttribute("aria-live", playing ? "off" : "polite");
  happening.textContent = events.length ? events.map((event) => event.text).join(" · ") : quiet();
  byId("jump").value = events.length ? String(view.at) : "";
}

function quiet() {
  if (isAtEnd()) {
    return "the episode is over";
  }
  return episode.states[view.at].decided && episode.allocation
    ? "the allocator decides; nobody is moved"
    : "";
}

/** A number of what is counted, where there is one. */
function counted(value) {
  return value === null ? "–" : Number.isInteger(value) ? String(value) : fixed(value);
}

function createHeader() {
  byId("title").textContent = episode.subject;
  document.title = `${episode.subject}: ${episode.env}`;
  byId("opening").textContent = episode.room
    ? `The team ${episode.subject} plays ${episode.env} in this page: step on, select an agent to see what it attends to and computes, and interfere.`
    : `One episode of ${episode.env}, played by ${episode.subject}: go through it step by step, and select an agent to see what it attends to and computes.`;
  const facts = [episode.env, episode.team];
  if (episode.allocation) {
    facts.push(`${episode.allocation} allocation`);
  }
  if (episode.episode) {
    const [seed, number] = episode.episode;
    facts.push(`episode ${number} of seed ${seed}`);
  }
  byId("facts").textContent = facts.join(" · ");
  showResult();
  byId("notes").replaceChildren(...episode.notes.map((note) => html("p", {}, note)));
}

function showResult() {
  const result = byId("result");
  result.hidden = !episode.result;
  if (episode.result) {
    result.classList.add(episode.result);
    const came = episode.result === "over" ? `return ${fixed(returns[LAST])}` : episode.result.replace("-", " ");
    result.textContent = `${came} after ${LAST} steps`;
  }
}

/** What can be jumped to. */
function listEvents() {
  const options = [...eventsAt].map(([at, events]) =>
    html("option", { value: at }, `${at}: ${events.map((event) => event.text).join(", ")}`),
  );
  byId("jump").replaceChildren(html("option", { value: "" }, `${episode.events.length} events …`), ...options);
}

function createTransport() {
  byId("scrubber").addEventListener("input", (event) => go(Number(event.target.value)));
  const buttons = {
    first: () => go(0),
    previous: () => go(view.at - 1),
    play: toggle,
    next: () => go(view.at + 1),
    last: () => go(LAST),
  };
  for (const [id, action] of Object.entries(buttons)) {
    byId(id).addEventListener("click", action);
  }
  byId("speed").addEventListener("change", () => changeSpeed(0));
  const jump = byId("jump");
  listEvents();
  jump.addEventListener("change", () => jump.value && go(Number(jump.value)));
  const figures = episode.metrics.map((name, metric) =>
    html("div", {}, html("dt", {}, name.replaceAll("_", " ")), html("dd", { id: `metric-${metric}` })),
  );
  byId("figures").append(...figures);
  byId("help-open").addEventListener("click", () => byId("help").showModal());
}

const KEYS = {
  ArrowLeft: () => go(view.at - 1),
  ArrowRight: () => go(view.at + 1),
  Home: () => go(0),
  End: () => go(LAST),
  " ": toggle,
  n: () => goToEvent(1),
  p: () => goToEvent(-1),
  "+": () => changeSpeed(1),
  "-": () => changeSpeed(-1),
  "?": () => byId("help").showModal(),
};

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey || byId("help").open) {
    return;
  }
  // Controls keep the keys that they understand themselves.
  if (event.target.matches("select, [type=number]") || (event.key === " " && event.target.matches("button"))) {
    return;
  }
  const agent = event.key.length === 1 && event.key >= "0" && event.key <= "9" ? Number(event.key) : null;
  if (agent !== null && agent < episode.agents.length) {
    select({ entity: agent });
  } else if (event.key in KEYS) {
    event.preventDefault();
    KEYS[event.key]();
  }
});

function followAddress() {
  const { at, agent } = readAddress();
  if (episode.agents[agent]) {
    select({ entity: agent });
  }
  go(Number.isInteger(at) ? at : 0);
}

createHeader();
createTransport();
window.addEventListener("hashchange", followAddress);
followAddress();
