// What a visitor does on the plane: agents, treasures and landmarks put elsewhere.

/** A step to the right, and up. */
const STRIDE = [0.1, 0.1];

function placeOf({ places }, agent) {
  return places[agent];
}

function placeAt([x, y]) {
  return [x / SCALE - HALF, HALF - (y - BAND) / SCALE];
}

function createOwnDeeds() {
  return () => {};
}

