// The same bits as on the machine that made the page, and the time that decisions take here.

/** Milliseconds for which the page computes before it draws again. */
const SLICE = 8;

function hexadecimal(hash) {
  return BigInt.asUintN(64, hash).toString(16).padStart(16, "0");
}

function showHash(id, hash, wanted) {
  const isEqual = hash === wanted;
  byId(id).replaceChildren(html("code", {}, hash), isEqual ? " the same bits" : ` OTHER BITS than ${wanted}`);
  byId(id).className = isEqual ? "gain" : "loss";
}

const nextFrame = () => new Promise((resolve) => requestAnimationFrame(resolve));

/** Plays the first episodes of the stated seed in an instance of its own, which is not shown. */
async function rehearse() {
  const { seed: ofSeed, decisions, played } = page.hashes;
  byId("rehearse").disabled = true;
  const unseen = await begin(ofSeed, 0);
  let counted = 0;
  while (counted < decisions) {
    const until = performance.now() + SLICE;
    while (counted < decisions && performance.now() < until) {
      counted = unseen.call("rehearse", decisions);
      if (counted < 0) {
        throw new Error("the team could not play on");
      }
    }
    byId("played").textContent = `${counted} of ${decisions} decisions`;
    await nextFrame();
  }
  showHash("played", hexadecimal(unseen.call("rehearsed")), played);
  byId("rehearse").disabled = false;
}

/** Repeats the selected agent's decision until the clock can tell how long it takes. */
function timeDecision() {
  const [calls, enough] = [8, 2];
  let times = 0;
  const start = performance.now();
  let took = 0;
  while (took < enough) {
    if (team.call("repeat_decision", view.agent, calls) <= 0) {
      return null;
    }
    times += calls;
    took = performance.now() - start;
  }
  return (1000 * took) / times;
}

function createBits() {
  const { decisions, seed: ofSeed, golden } = page.hashes;
  byId("rehearse").textContent = `Play ${decisions} decisions of seed ${ofSeed}`;
  byId("rehearse").addEventListener("click", rehearse);
  // Once the first state is drawn.
  requestAnimationFrame(() => setTimeout(() => showHash("golden", hexadecimal(team.call("golden")), golden)));
  let shown = null;

  return function showBits(view) {
    const isDead = episode.states[LAST].dead.includes(view.agent);
    const what = `${view.agent},${isDead},${episode.changes >> 3}`;
    // Now and then is enough.
    if (what !== shown && isRunning()) {
      shown = what;
      const took = timeDecision();
      byId("took").textContent = took === null ? "nothing to decide" : `${took.toFixed(took < 10 ? 1 : 0)} µs`;
    }
  };
}
