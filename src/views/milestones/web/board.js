// The grid.

const CELL = 40;
const EMPTY = 0;
const WALL = 2;

/** Two letters for each object that is ever on the grid, no two alike. */
const SIGNS = new Map();
for (const object of [...new Set(episode.states.flatMap(({ cells }) => cells))].sort((a, b) => a - b)) {
  const [first, ...rest] = episode.objects[object].split("_");
  const seconds = [...rest.map((word) => word[0]), ...first.slice(1)];
  const signs = seconds.map((second) => first[0] + second);
  SIGNS.set(object, signs.find((sign) => ![...SIGNS.values()].includes(sign)) ?? signs[0]);
}

function objectHue(object) {
  return (object * 47) % 360;
}

/** Draws the grid; the returned function shows a state on it. */
function createMap() {
  const map = byId("map");
  const side = episode.size * CELL;
  setAll(map, { viewBox: `0 0 ${side} ${side}` });
  const named = [...SIGNS].filter(([object]) => object !== EMPTY && object !== WALL);
  byId("legend").append(
    ...named.map(([object, sign]) => html("li", {}, `${sign} ${episode.objects[object].replaceAll("_", " ")}`)),
  );
  return function showMap(view) {
    const state = episode.states[view.at];
    map.replaceChildren(...state.cells.flatMap((object, cell) => drawCell(state, object, cell)), walker(state));
    byId("map-text").textContent = `agent in column ${state.at % episode.size}, row ${Math.floor(state.at / episode.size)}`;
  };
}

function drawCell(state, object, cell) {
  const [x, y] = [(cell % episode.size) * CELL, Math.floor(cell / episode.size) * CELL];
  const kind = object === EMPTY ? "cell" : object === WALL ? "cell wall" : "cell object";
  const rect = svg("rect", { class: kind, x, y, width: CELL, height: CELL, style: `--hue: ${objectHue(object)}` });
  if (object === EMPTY || object === WALL) {
    return [rect];
  }
  const sign = SIGNS.get(object);
  const text = (state.open >> object) & 1 ? `(${sign})` : sign;
  return [rect, svg("text", { class: "cell-name", x: x + CELL / 2, y: y + CELL / 2 }, text)];
}

/** A triangle that points to where the agent looks. */
function walker({ at, direction }) {
  const [x, y] = [(at % episode.size) * CELL, Math.floor(at / episode.size) * CELL];
  const turn = `rotate(${90 * direction} ${x + CELL / 2} ${y + CELL / 2})`;
  const [left, right, top, bottom] = [x + 9, x + CELL - 6, y + 8, y + CELL - 8];
  const points = `${left},${top} ${right},${y + CELL / 2} ${left},${bottom}`;
  return svg("polygon", { class: "walker", points, transform: turn });
}
