// What a visitor does to any team: agents and things put elsewhere, dead processes, other episodes. The environment's own script
// says where things are in the program's numbers (`placeOf`, `placeAt`, `STRIDE`), and what else can be done (`createOwnDeeds`).

/** Interferes with the newest state; the reason where that is refused. */
function interfere(name, ...values) {
  go(LAST);
  const refusal = byId("refusal");
  refusal.textContent = "";
  try {
    learn(team.tell(name, ...values));
    episode.isTouched = true;
  } catch (error) {
    refusal.textContent = `Refused: ${error.message}.`;
  }
  refresh();
}

const killOrRevive = () => interfere("kill_or_revive", view.agent);

/** Another episode has an instance of its own: the page begins anew. */
function openEpisode(ofSeed, episodeNumber) {
  clearTimeout(telling);
  location.hash = new URLSearchParams({ seed: ofSeed, episode: episodeNumber });
}

function put(entity, [x, y]) {
  interfere("place", entity, x, y);
}

/** Moves the selected agent a little. */
function nudge([right, up]) {
  const place = placeOf(episode.states[LAST], view.agent);
  if (place) {
    put(view.agent, [place[0] + right * STRIDE[0], place[1] + up * STRIDE[1]]);
  }
}

/** Lets agents and things be dragged elsewhere: whatever on the map says which entity it is. */
function letDrag() {
  const map = byId("map");
  let grabbed = null;
  const pointed = (event) => {
    const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(map.getScreenCTM().inverse());
    return [x, y];
  };
  // What is drawn of it changes with every state.
  const drawn = () => map.querySelector(`[data-entity="${grabbed.entity}"]`);
  map.addEventListener("pointerdown", (event) => {
    const element = event.target.closest("[data-entity]");
    if (!element || event.button !== 0) {
      return;
    }
    const entity = Number(element.dataset.entity);
    if (entity < episode.agents.length) {
      select({ agent: entity });
    }
    if (isRunning()) {
      grabbed = { entity, from: pointed(event), isDragged: false };
      map.setPointerCapture(event.pointerId);
    }
  });
  map.addEventListener("pointermove", (event) => {
    if (!grabbed) {
      return;
    }
    const [x, y] = pointed(event);
    if (!grabbed.isDragged) {
      if (Math.hypot(x - grabbed.from[0], y - grabbed.from[1]) < 10) {
        return;
      }
      grabbed.isDragged = true;
      pause();
      go(LAST);
    }
    const element = drawn();
    element?.classList.add("dragged");
    element?.style.setProperty("transform", `translate(${x}px, ${y}px)`);
  });
  const letGo = (event) => {
    const held = grabbed;
    if (!held) {
      return;
    }
    const element = drawn();
    element?.classList.remove("dragged");
    grabbed = null;
    if (held.isDragged && event.type === "pointerup") {
      put(held.entity, placeAt(pointed(event)));
    }
    refresh();
  };
  map.addEventListener("pointerup", letGo);
  map.addEventListener("pointercancel", letGo);
}

function createDeeds() {
  letDrag();
  const showOwn = createOwnDeeds();
  byId("kill").addEventListener("click", killOrRevive);
  byId("seed").value = seed;
  byId("number").value = number;
  byId("start").addEventListener("submit", (event) => {
    event.preventDefault();
    openEpisode(byId("seed").value, byId("number").value);
  });
  byId("another").addEventListener("click", () => openEpisode(seed, number + 1));

  return function showDeeds(view) {
    const { dead, absent = [] } = episode.states[view.at];
    for (const element of document.querySelectorAll("#map [data-entity]")) {
      element.classList.toggle("dead", dead.includes(Number(element.dataset.entity)));
    }
    const left = absent.map(([agent, since]) => `${episode.agents[agent].name} since step ${since}`);
    byId("absent").textContent = left.length ? `Absent, left out of allocations: ${left.join(", ")}.` : "";
    const isDead = episode.states[LAST].dead.includes(view.agent);
    byId("kill").textContent = `${isDead ? "Revive" : "Kill"} ${episode.agents[view.agent].name}`;
    byId("kill").disabled = !isRunning();
    showOwn(view);
    byId("touched").hidden = !episode.isTouched;
  };
}

Object.assign(KEYS, {
  k: killOrRevive,
  e: () => openEpisode(seed, number + 1),
  w: () => nudge([0, 1]),
  s: () => nudge([0, -1]),
  d: () => nudge([1, 0]),
  q: () => nudge([-1, 0]),
});

