"use strict";

// The episode, and what follows from it. State t is what the team sees before step t; the last state is final.

const episode = JSON.parse(document.getElementById("episode").textContent);
const LAST = episode.states.length - 1;
