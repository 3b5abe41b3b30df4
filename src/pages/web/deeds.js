// What a visitor does to a team: agents and things put elsewhere, dead processes, other allocators and episodes; and the same bits
// as on the machine that made the page.

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

/** Moves the selected agent a cell to the right, or up. */
function nudge([right, up]) {
  const { place } = episode.states[LAST].agents[view.agent];
  if (place) {
    const steps = [right, -up].map((step, axis) => step * FIELD.cell * Math.sign(FIELD.to[axis] - FIELD.from[axis]));
    put(view.agent, [place[0] + steps[0], place[1] + steps[1]]);
  }
}

const disturb = () => interfere("disturb", view.thing);

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
  // Before it is selected, which draws it anew.
  map.addEventListener("pointerdown", (event) => {
    const element = event.target.closest("[data-entity]");
    if (element && event.button === 0 && isRunning()) {
      grabbed = { entity: Number(element.dataset.entity), from: pointed(event), isDragged: false };
      map.setPointerCapture(event.pointerId);
    }
  }, { capture: true });
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
  document.querySelectorAll(".live").forEach((element) => (element.hidden = false));
  letDrag();
  byId("misread").textContent = misread.length ? `Note: ${misread.join("; ")}.` : "";
  byId("allocation").hidden = opening.allocators.length === 0;
  byId("allocator").append(...opening.allocators.map((name) => html("option", { value: name }, name)));
  byId("allocator").value = episode.allocation;
  byId("allocator").addEventListener("change", (event) => allocateBy(event.target.value));
  byId("disturb").hidden = !episode.disturbance;
  byId("disturb").addEventListener("click", disturb);
  byId("kill").addEventListener("click", killOrRevive);
  byId("seed").value = seed;
  byId("number").value = number;
  byId("start").addEventListener("submit", (event) => {
    event.preventDefault();
    openEpisode(byId("seed").value, byId("number").value);
  });
  byId("another").addEventListener("click", () => openEpisode(seed, number + 1));

  return function showDeeds(view) {
    const { dead, absent } = episode.states[view.at];
    for (const element of document.querySelectorAll("#map [data-entity]")) {
      element.classList.toggle("dead", dead.includes(Number(element.dataset.entity)));
    }
    const left = absent.map(([agent, since]) => `${episode.agents[agent].name} since step ${since}`);
    byId("absent").textContent = left.length ? `Absent, left out of allocations: ${left.join(", ")}.` : "";
    const isDead = episode.states[LAST].dead.includes(view.agent);
    byId("kill").textContent = `${isDead ? "Revive" : "Kill"} ${episode.agents[view.agent].name}`;
    byId("disturb").textContent = `${episode.states[view.at].things[view.thing]?.name}: ${episode.disturbance}`;
    ["kill", "disturb", "allocator"].forEach((id) => (byId(id).disabled = !isRunning()));
    byId("touched").hidden = !episode.isTouched;
  };
}

Object.assign(KEYS, {
  k: killOrRevive,
  f: disturb,
  a: () => allocateBy(opening.allocators[(opening.allocators.indexOf(episode.allocation) + 1) % opening.allocators.length]),
  e: () => openEpisode(seed, number + 1),
  w: () => nudge([0, 1]),
  s: () => nudge([0, -1]),
  d: () => nudge([1, 0]),
  q: () => nudge([-1, 0]),
});

/** Milliseconds for which the page computes before it draws again. */
const SLICE = 8;

function hexadecimal(hash) {
  return BigInt.asUintN(64, hash).toString(16).padStart(16, "0");
}

function showHash(id, hash, wanted) {
  const isEqual = hash === wanted;
  byId(id).replaceChildren(html("code", {}, hash), isEqual ? " the same bits" : ` OTHER BITS than ${wanted}`);
  byId(id).className = isEqual ? "gain" : "loss";
}

const nextFrame = () => new Promise((resolve) => requestAnimationFrame(resolve));

/** Plays the first episodes of the stated seed in an instance of its own, which is not shown. */
async function rehearse() {
  const { seed: ofSeed, decisions, played } = page.hashes;
  byId("rehearse").disabled = true;
  const unseen = await begin(ofSeed, 0);
  let counted = 0;
  while (counted < decisions) {
    const until = performance.now() + SLICE;
    while (counted < decisions && performance.now() < until) {
      counted = unseen.call("rehearse", decisions);
      if (counted < 0) {
        throw new Error("the team could not play on");
      }
    }
    byId("played").textContent = `${counted} of ${decisions} decisions`;
    await nextFrame();
  }
  showHash("played", hexadecimal(unseen.call("rehearsed")), played);
  byId("rehearse").disabled = false;
}

/** Repeats the selected agent's decision until the clock can tell how long it takes. */
function timeDecision() {
  const [calls, enough] = [8, 2];
  let times = 0;
  const start = performance.now();
  let took = 0;
  while (took < enough) {
    if (team.call("repeat_decision", view.agent, calls) <= 0) {
      return null;
    }
    times += calls;
    took = performance.now() - start;
  }
  return (1000 * took) / times;
}

function createBits() {
  const { decisions, seed: ofSeed, golden } = page.hashes;
  byId("rehearse").textContent = `Play ${decisions} decisions of seed ${ofSeed}`;
  byId("rehearse").addEventListener("click", rehearse);
  // Once the first state is drawn.
  requestAnimationFrame(() => setTimeout(() => showHash("golden", hexadecimal(team.call("golden")), golden)));
  let shown = null;

  return function showBits(view) {
    const isDead = episode.states[LAST].dead.includes(view.agent);
    const what = `${view.agent},${isDead},${episode.changes >> 3}`;
    // Now and then is enough.
    if (what !== shown && isRunning()) {
      shown = what;
      const took = timeDecision();
      byId("took").textContent = took === null ? "nothing to decide" : `${took.toFixed(took < 10 ? 1 : 0)} µs`;
    }
  };
}

show.push(createDeeds(), createBits());

function isOther(name, own) {
  const address = new URLSearchParams(location.hash.slice(1));
  return address.has(name) && address.get(name) !== String(own);
}

window.addEventListener("hashchange", () => {
  if (isOther("seed", seed) || isOther("episode", number)) {
    location.reload();
  }
});
refresh();
requestAnimationFrame(() => {
  document.documentElement.dataset.firstFrame = Math.round(performance.now());
});
