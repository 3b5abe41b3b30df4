"use strict";

// The episode, and what follows from it. State t is what the team sees before step t; the last state is final.

const episode = JSON.parse(document.getElementById("episode").textContent);
const LAST = episode.states.length - 1;

/** Whether there is more to come than is known: never of an episode that has been played. */
function isRunning() {
  return false;
}

/** Plays one step more, where there is one. */
function playOn() {
  return false;
}

/** `page.html#12` opens at step 12, `#12,1` with agent 1 selected. */
function readAddress() {
  const [at, agent] = location.hash.slice(1).split(",").map(Number);
  return { at, agent };
}

function addressOf({ at, agent }) {
  return `#${at},${agent}`;
}
