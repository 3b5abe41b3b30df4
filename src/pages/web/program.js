// The program of the page: world, team and allocator. It plays one episode, of which the address tells seed and number.

const page = JSON.parse(document.getElementById("episode").textContent);

const asked = new URLSearchParams(location.hash.slice(1));
/** What the address asks for that cannot be. */
const misread = [];

/** A whole number of the address, as text. */
function askedNumber(name, digits, otherwise) {
  const text = asked.get(name) ?? String(otherwise);
  if (new RegExp(`^\\d{1,${digits}}$`).test(text)) {
    return text;
  }
  misread.push(`the address asks for ${name} “${text}”, which is no whole number of at most ${digits} digits: this is ${name} ${otherwise}`);
  return otherwise;
}

/** As text: a number of a script could not hold it. */
const seed = askedNumber("seed", 19, page.seed);
const number = Number(askedNumber("episode", 9, page.number));

/** Bytes that the page holds as text. */
function bytesOf(text) {
  const letters = atob(text);
  const bytes = new Uint8Array(letters.length);
  for (let place = 0; place < letters.length; place += 1) {
    bytes[place] = letters.charCodeAt(place);
  }
  return bytes;
}

async function unpacked(bytes, format) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream(format));
  return new Response(stream).arrayBuffer();
}

const code = await WebAssembly.compile(await unpacked(bytesOf(page.program), "gzip"));
const cast = new Uint8Array(await unpacked(bytesOf(page.cast), "deflate"));

/** An instance that begins an episode: its functions by name, the program given. */
async function begin(ofSeed, episodeNumber) {
  const { exports } = await WebAssembly.instantiate(code);
  const place = exports.room(cast.length);
  new Uint8Array(exports.memory.buffer, place, cast.length).set(cast);
  const program = exports.open(place, cast.length, BigInt(ofSeed), episodeNumber);
  if (!program) {
    throw new Error("the page's program does not take its team");
  }
  const call = (name, ...values) => exports[name](program, ...values);
  const text = () =>
    new TextDecoder().decode(new Uint8Array(exports.memory.buffer, call("text"), call("text_bytes")));
  return {
    call,
    /** What a function tells: an object, nothing, or an error with the reason. */
    tell(name, ...values) {
      const told = call(name, ...values);
      if (told < 0) {
        throw new Error(text());
      }
      return told === 0 ? null : JSON.parse(text());
    },
  };
}

const team = await begin(seed, number);
const opening = team.tell("opening");
/** Who allocates, by the place in the list. */
const first = Math.max(0, opening.allocators.indexOf(asked.get("allocation")));
if (first > 0) {
  Object.assign(opening, team.tell("choose_allocator", first));
}

/** The episode as far as it has been played, as pages of recorded ones have it. */
const episode = {
  ...page,
  ...opening,
  episode: [seed, number],
  allocation: opening.allocators[first],
  states: [opening.state],
  steps: [],
  /** The states of the longest episode. */
  room: opening.limit + 1,
  /** How often anything has become known. */
  changes: 0,
  /** Whether somebody has interfered: the address leads to the episode without. */
  isTouched: false,
};
/** Grows as the team plays. */
let LAST = 0;

function isRunning() {
  return !episode.result;
}

function playOn() {
  const news = isRunning() ? team.tell("step") : null;
  if (news) {
    learn(news);
  }
  return news !== null;
}

/** Adds a state that is new, or has changed. */
function learn({ at, step, state, events, result }) {
  if (step) {
    episode.steps.push(step);
    addReward(step);
  }
  episode.states[at] = state;
  grounds.length = Math.min(grounds.length, at);
  episode.events = episode.events.filter((event) => event.at !== at).concat(events);
  eventsAt.delete(at);
  if (events.length) {
    eventsAt.set(at, events);
  }
  episode.changes += 1;
  LAST = at;
  listEvents();
  if (result) {
    episode.result = result;
    showResult();
  }
}

function readAddress() {
  const address = new URLSearchParams(location.hash.slice(1));
  const [at, agent] = ["step", "agent"].map((name) => Number(address.get(name) ?? 0));
  return { at: Math.min(at, opening.limit), agent };
}

function addressOf({ at, agent }) {
  const allocation = episode.allocation === opening.allocators[0] ? {} : { allocation: episode.allocation };
  return `#${new URLSearchParams({ seed, episode: number, step: at, agent, ...allocation })}`;
}
