// What a visitor does to the team: another allocator, fires, dead processes, agents put elsewhere.

/** Interferes with the newest state; the reason where that is refused. */
function interfere(name, ...values) {
  go(LAST);
  const refusal = byId("refusal");
  refusal.textContent = "";
  try {
    learn(team.tell(name, ...values));
    episode.isTouched = true;
  } catch (error) {
    refusal.textContent = `Refused: ${error.message.replace("impossible state: ", "")}.`;
  }
  refresh();
}

function allocateBy(name) {
  const choice = opening.allocators.indexOf(name);
  if (choice < 0 || name === episode.allocation) {
    return;
  }
  const isUntouched = LAST === 0 && !episode.isTouched;
  interfere("choose_allocator", choice);
  episode.allocation = name;
  // From the first state on it is part of the address.
  episode.isTouched = !isUntouched;
  byId("allocator").value = name;
  createHeader();
  tellAddress();
}

const setFire = () => interfere("set_fire", view.building);
const killOrRevive = () => interfere("kill_or_revive", view.agent);

/** Another episode has an instance of its own: the page begins anew. */
function openEpisode(ofSeed, episodeNumber) {
  clearTimeout(telling);
  location.hash = new URLSearchParams({ seed: ofSeed, episode: episodeNumber });
}

/** Moves the selected agent by one cell. */
function nudge([right, up]) {
  const [x, y] = episode.states[LAST].places[view.agent];
  placeAgent(view.agent, [x + right, y + up]);
}

function placeAgent(agent, [x, y]) {
  const isOnMap = [x, y].every((value) => value >= 0 && value < episode.side);
  if (isOnMap) {
    interfere("place", agent, x, y);
  }
}

/** Lets an agent be dragged to another cell. */
function letDrag(element, agent) {
  let grabbed = null;
  const pointed = (event) => {
    const map = byId("map");
    const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(map.getScreenCTM().inverse());
    return [x, y];
  };
  const letGo = () => {
    grabbed = null;
    element.classList.remove("dragged");
  };
  element.addEventListener("pointerdown", (event) => {
    if (isRunning() && event.button === 0) {
      select({ agent });
      grabbed = pointed(event);
      element.setPointerCapture(event.pointerId);
    }
  });
  element.addEventListener("pointermove", (event) => {
    const [x, y] = pointed(event);
    if (!grabbed || Math.hypot(x - grabbed[0], y - grabbed[1]) < CELL / 4) {
      return;
    }
    if (!element.classList.contains("dragged")) {
      pause();
      go(LAST);
      element.classList.add("dragged");
    }
    element.style.transform = `translate(${x}px, ${y}px)`;
  });
  element.addEventListener("pointerup", (event) => {
    const isDragged = element.classList.contains("dragged");
    letGo();
    if (isDragged) {
      const [x, y] = pointed(event).map((value) => Math.floor(value / CELL));
      placeAgent(agent, [x, episode.side - 1 - y]);
      refresh();
    }
  });
  element.addEventListener("pointercancel", () => {
    letGo();
    refresh();
  });
}

function createDeeds() {
  const people = [...document.querySelectorAll("#map .person")];
  people.forEach(letDrag);
  const allocator = byId("allocator");
  allocator.append(...opening.allocators.map((name) => html("option", { value: name }, name)));
  allocator.value = episode.allocation;
  allocator.addEventListener("change", () => allocateBy(allocator.value));
  byId("set-fire").addEventListener("click", setFire);
  byId("kill").addEventListener("click", killOrRevive);
  byId("seed").value = seed;
  byId("number").value = number;
  byId("start").addEventListener("submit", (event) => {
    event.preventDefault();
    openEpisode(byId("seed").value, byId("number").value);
  });
  byId("another").addEventListener("click", () => openEpisode(seed, number + 1));

  return function showDeeds(view) {
    const state = episode.states[view.at];
    people.forEach((element, agent) => element.classList.toggle("dead", state.dead.includes(agent)));
    const isDead = episode.states[LAST].dead.includes(view.agent);
    byId("kill").textContent = `${isDead ? "Revive" : "Kill"} ${episode.agents[view.agent].name}`;
    byId("set-fire").textContent = `Set ${episode.buildings[view.building].name} on fire`;
    ["kill", "set-fire", "allocator"].forEach((id) => (byId(id).disabled = !isRunning()));
    byId("touched").hidden = !episode.isTouched;
  };
}

Object.assign(KEYS, {
  f: setFire,
  k: killOrRevive,
  a: () => {
    const names = opening.allocators;
    allocateBy(names[(names.indexOf(episode.allocation) + 1) % names.length]);
  },
  e: () => openEpisode(seed, number + 1),
  w: () => nudge([0, 1]),
  s: () => nudge([0, -1]),
  d: () => nudge([1, 0]),
  q: () => nudge([-1, 0]),
});
