// The whole episode at a glance: lanes one below the other, a column for every state.

const GAP = 8;
/** Most columns that are kept free for states of an episode that is being played. */
const KEPT_FREE = 150;

/** What has a lane: the team, what can be reached, things that change, agents. */
function lanesOf() {
  const { agents, things } = episode.states[0];
  const changing = things.flatMap((thing, number) => (thing.bars || thing.status ? [number] : []));
  return [
    { name: "team", draw: teamLane },
    ...episode.milestones.map((name, milestone) => ({ name, draw: (...size) => goalLane(milestone, ...size) })),
    ...changing.map((thing) => ({ name: things[thing].name, draw: (...size) => thingLane(thing, ...size) })),
    ...agents.map(({ name }, agent) => ({ name, draw: (...size) => agentLane(agent, ...size) })),
  ];
}

/** Draws the lanes, again whenever the width changes or more is known; the returned function moves the cursor. */
function createTimeline(go) {
  const timeline = byId("timeline");
  const lanes = lanesOf();
  const above = lanes.length - episode.agents.length;
  const gutter = Math.max(40, 12 + 6.5 * Math.max(...lanes.map(({ name }) => name.length)));
  const lane = Math.max(9, Math.min(18, Math.floor(220 / lanes.length)));
  const height = lanes.length * lane + GAP + 2;
  const cursor = svg("rect", { class: "cursor", y: 0, height });
  let column = 1;
  let at = 0;
  let drawn = episode.changes;

  function moveCursor() {
    setAll(cursor, { x: gutter + at * column, width: Math.max(column, 2) });
  }

  function drawAll() {
    // Without the padding of the panel.
    const width = timeline.parentElement.clientWidth - 14;
    drawn = episode.changes;
    const columns = Math.max(LAST + 1, Math.min(episode.room ?? 0, KEPT_FREE));
    column = Math.min(90, Math.max(0, width - gutter - 8) / columns);
    setAll(timeline, { viewBox: `0 0 ${width} ${height}`, width, height });
    const drawings = lanes.map(({ name, draw }, number) => {
      const y = number * lane + (number < above ? 0 : GAP);
      const label = svg("text", { x: -6, y: lane / 2, class: "lane-name", "font-size": Math.min(12, lane) }, name);
      const track = svg("rect", { class: "lane-track", x: 0, y: 2, width: (LAST + 1) * column, height: lane - 4 });
      return svg("g", { transform: `translate(${gutter}, ${y})` }, label, track, ...draw(lane, column));
    });
    timeline.replaceChildren(...drawings, cursor);
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

/** The team's rewards, and what nobody alone has done. */
function teamLane(lane, column) {
  const rewards = episode.steps.map(({ reward }) => reward);
  return [...rewardShades(rewards, rewards, lane, column), ...eventMarks(null, lane, column)];
}

/** Where a milestone is an agent's goal. */
function goalLane(milestone, lane, column) {
  const isGoal = (state) => state.thoughts?.some((thought) => thought?.option?.goal === milestone);
  return runs(isGoal).map(({ from, to }) => box(from, to, lane, column, { class: "lane-cell" }));
}

/** The first bar as an area, the second as a band above it, and when its status changed. */
function thingLane(thing, lane, column) {
  const [top, bottom] = [1.5, lane - 1.5];
  const bars = episode.states.map(({ things }) => things[thing].bars ?? []);
  const heights = bars.map(([first], at) => `L${at * column},${bottom - (bottom - top) * (first?.share ?? 0)} H${(at + 1) * column}`);
  const area = svg("path", { class: "level-0", d: `M0,${bottom} ${heights.join(" ")} V${bottom} Z` });
  const bands = runs(({ things }) => Math.round((things[thing].bars?.[1]?.share ?? 0) * 4)).map(({ value, from, to }) =>
    svg("rect", { class: "level-1", x: from * column, y: top, width: (to - from) * column, height: 3.5, opacity: 0.25 + value * 0.1875 }),
  );
  return [area, ...bands, ...eventMarks(episode.agents.length + thing, lane, column)];
}

/** What an agent is assigned to, run by run, what it earned by itself, and when its status changed. */
function agentLane(agent, lane, column) {
  const first = episode.states[0];
  const tasks = runs(({ allocation }) => allocation[agent] ?? null, null).flatMap(({ value, from, to }) => {
    const size = { x: ((from + to) / 2) * column, y: lane / 2, "font-size": Math.min(11, lane - 1), class: "lane-text" };
    const label = (to - from) * column > 9 ? [svg("text", size, taskName(first, value))] : [];
    return [tint(box(from, to, lane, column, { class: "lane-cell" }), first.agents[agent].colour), ...label];
  });
  const all = episode.steps.flatMap((step) => step.agent_rewards);
  const own = episode.steps.map((step) => step.agent_rewards[agent] ?? 0);
  return [...tasks, ...rewardShades(own, all, lane, column), ...eventMarks(agent, lane, column)];
}

function box(from, to, lane, column, attributes) {
  return svg("rect", { x: from * column, y: 2, width: Math.max((to - from) * column - 0.5, 1), height: lane - 4, ...attributes });
}

/** Gains and losses, the darker, the larger; those of a step in the column of the state that it led to. */
function rewardShades(rewards, all, lane, column) {
  const largest = Math.max(1e-9, ...all.map(Math.abs));
  return rewards.flatMap((reward, step) => {
    const look = { class: reward < 0 ? "lane-loss" : "lane-gain", opacity: (0.75 * Math.abs(reward)) / largest };
    return reward ? [box(step + 1, step + 2, lane, column, look)] : [];
  });
}

/** When something happened to an entity, or to nobody alone. */
function eventMarks(entity, lane, column) {
  const own = episode.events.filter(({ of }) => of === entity);
  return own.map(({ at, text }) =>
    svg("circle", { cx: (at + 0.5) * column, cy: lane / 2, r: Math.min(3.5, lane / 4), class: "lane-event" }, svg("title", {}, `step ${at}: ${text}`)),
  );
}

/** Stretches of states with the same value that is something. */
function runs(valueOf, nothing = 0) {
  const found = [];
  episode.states.forEach((state, at) => {
    const value = valueOf(state);
    const last = found.at(-1);
    if (last?.to === at && last.value === value) {
      last.to = at + 1;
    } else if (value !== nothing && value !== false && value !== undefined) {
      found.push({ value, from: at, to: at + 1 });
    }
  });
  return found;
}

