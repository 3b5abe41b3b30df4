// What a visitor does to a city: agents in other cells, other allocators, fires.

/** A step to the right, and up. */
const STRIDE = [1, 1];

function placeOf(state, agent) {
  return state.places[agent];
}

function placeAt([x, y]) {
  return [Math.floor(x / CELL), episode.side - 1 - Math.floor(y / CELL)];
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

const setFire = () => interfere("disturb", view.building);

/** Sets the controls up once; the returned function shows them in a state. */
function createOwnDeeds() {
  const allocator = byId("allocator");
  allocator.append(...opening.allocators.map((name) => html("option", { value: name }, name)));
  allocator.value = episode.allocation;
  allocator.addEventListener("change", () => allocateBy(allocator.value));
  byId("set-fire").addEventListener("click", setFire);
  Object.assign(KEYS, {
    f: setFire,
    a: () => {
      const names = opening.allocators;
      allocateBy(names[(names.indexOf(episode.allocation) + 1) % names.length]);
    },
  });

  return function showOwnDeeds(view) {
    byId("set-fire").textContent = `Set ${episode.buildings[view.building].name} on fire`;
    ["set-fire", "allocator"].forEach((id) => (byId(id).disabled = !isRunning()));
  };
}

