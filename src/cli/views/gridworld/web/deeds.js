// What a visitor does in the maze: agents in other cells.

/** A step to the right, and up. */
const STRIDE = [1, -1];

function placeOf({ cells }, agent) {
  return [cells[agent] % COLUMNS, Math.floor(cells[agent] / COLUMNS)];
}

function placeAt(point) {
  return point.map((part) => Math.floor(part / CELL));
}

function createOwnDeeds() {
  return () => {};
}

