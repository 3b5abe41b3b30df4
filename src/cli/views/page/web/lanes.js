// Lanes across the whole episode, one below the other: a column for every state.

const GAP = 8;
/** Most columns that are kept free for states of an episode that is being played. */
const KEPT_FREE = 150;

/**
 * Draws as many lanes, with a gap below the first `above` and room for names on the left, again whenever the width
 * changes; the returned function moves the cursor. `draw(number, lane, column)` is one lane of this height with columns of
 * this width.
 */
function createLanes(go, { count, above, gutter = 40, draw }) {
  const timeline = byId("timeline");
  const lane = Math.max(9, Math.min(18, Math.floor(220 / count)));
  const height = count * lane + GAP + 2;
  const cursor = svg("rect", { class: "cursor", y: 0, height });
  let column = 1;
  let at = 0;
  let drawn = episode.changes;

  function moveCursor() {
    setAll(cursor, { x: gutter + at * column, width: Math.max(column, 2) });
  }

  function drawAll() {
    const width = timeline.parentElement.clientWidth;
    drawn = episode.changes;
    const columns = Math.max(LAST + 1, Math.min(episode.room ?? 0, KEPT_FREE));
    column = Math.min(90, Math.max(0, width - gutter - 8) / columns);
    setAll(timeline, { viewBox: `0 0 ${width} ${height}`, width, height });
    const lanes = Array.from({ length: count }, (_, number) => {
      const element = draw(number, lane, column);
      const y = number * lane + (number < above ? 0 : GAP);
      element.setAttribute("transform", `translate(${gutter}, ${y})`);
      return element;
    });
    timeline.replaceChildren(...lanes, cursor);
    moveCursor();
  }

  function pointed(event) {
    const x = event.clientX - timeline.getBoundingClientRect().left - gutter;
    go(Math.max(0, Math.min(LAST, Math.floor(x / column))));
  }
  timeline.addEventListener("pointerdown", (event) => {
    timeline.setPointerCapture(event.pointerId);
    pointed(event);
  });
  timeline.addEventListener("pointermove", (event) => {
    if (event.buttons) {
      pointed(event);
    }
  });
  new ResizeObserver(drawAll).observe(timeline.parentElement);
  drawAll();

  return function showTimeline(view) {
    at = view.at;
    (drawn === episode.changes ? moveCursor : drawAll)();
  };
}

function laneName(name, lane) {
  return svg("text", { x: -6, y: lane / 2, class: "lane-name", "font-size": Math.min(12, lane) }, name);
}
