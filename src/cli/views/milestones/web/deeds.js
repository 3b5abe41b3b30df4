// What a visitor does on the grid: the agent in another cell.

/** A step to the right, and up. */
const STRIDE = [1, -1];

function placeOf({ at }) {
  return [at % episode.size, Math.floor(at / episode.size)];
}

function placeAt(point) {
  return point.map((part) => Math.floor(part / CELL));
}

function createOwnDeeds() {
  return () => {};
}

