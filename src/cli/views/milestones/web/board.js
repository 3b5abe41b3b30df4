// The grid.

const CELL = 40;
const EMPTY = 0;
const WALL = 2;

/** Two letters for each object that has been on the grid, no two alike. */
const SIGNS = new Map();

/** Gives signs to objects that have none, and explains them. */
function learnSigns(states) {
  const objects = [...new Set(states.flatMap(({ cells }) => cells))].sort((a, b) => a - b);
  for (const object of objects.filter((object) => !SIGNS.has(object))) {
    const [first, ...rest] = episode.objects[object].split("_");
    const seconds = [...rest.map((word) => word[0]), ...first.slice(1)];
    const signs = seconds.map((second) => first[0] + second);
    const sign = signs.find((sign) => ![...SIGNS.values()].includes(sign)) ?? signs[0];
    SIGNS.set(object, sign);
    if (object !== EMPTY && object !== WALL) {
      byId("legend").append(html("li", {}, `${sign} ${episode.objects[object].replaceAll("_", " ")}`));
    }
  }
}

function objectHue(object) {
  return (object * 47) % 360;
}

/** Draws the grid; the returned function shows a state on it. */
function createMap() {
  const map = byId("map");
  const side = episode.size * CELL;
  setAll(map, { viewBox: `0 0 ${side} ${side}` });
  learnSigns(episode.states);
  return function showMap(view) {
    const state = episode.states[view.at];
    learnSigns([state]);
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
  const [x, y] = [at % episode.size, Math.floor(at / episode.size)].map((part) => (part + 0.5) * CELL);
  const body = svg("polygon", { points: "-11,-12 14,0 -11,12", transform: `rotate(${90 * direction})` });
  return svg("g", { class: "walker", "data-entity": 0, style: `transform: translate(${x}px, ${y}px)` }, body);
}
