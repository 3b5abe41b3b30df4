// What a visitor does on the ring: agents in other cells.

/** A step to the right is one around the ring. */
const STRIDE = [1, 0];

function placeOf({ places }, agent) {
  return [places[agent] + episode.cells, 0];
}

/** The nearest cell. */
function placeAt([x, y]) {
  const away = (cell) => Math.hypot(middleOf(cell)[0] - x, middleOf(cell)[1] - y);
  const cells = [...Array(episode.cells).keys()];
  return [cells.reduce((best, cell) => (away(cell) < away(best) ? cell : best)), 0];
}

function createOwnDeeds() {
  return () => {};
}

