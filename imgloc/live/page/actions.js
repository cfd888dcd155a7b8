// What can be done: each action asks the service and puts the answer into the state.

import * as api from "./api.js";
import { compose, holds } from "./geometry.js";
import { priorOf, RADIUS, TURN } from "./known.js";
import { prepared } from "./scan.js";
import { change, HAND, NOWHERE, numberOf, state, TRACKER, USUAL } from "./state.js";
import { inWords } from "./words.js";

/** Layers that are a likelihood of a scan, with a slider through their headings. */
export const METHODS = ["cbml", "cbml-o", "ght", "ght-v", "beam"];
export const LOOKING = "Looking for the pose";
const CHUNK = 50; // scans that are fetched at a time
const LONGEST = 90; // characters of a name of a map
const GONE = 404; // the service holds a few uploads: it may have dropped this one
const LATE = 504; // the service has given it up
const MINE = "imgloc maps"; // where the ids of the maps of this page are kept

let items = new Map(); // by index, scans that are here
let files = null; // what the scans were uploaded from: {file, said}

let troubled = null; // what the last trouble was with

/** Say what went wrong with something, until that goes well. */
function trouble(what, text) {
  troubled = what;
  change({ trouble: text });
}

/** Run an action that asks the service, `busy` with something unless it is quick. */
export async function attempt(busy, action) {
  if (busy) change({ busy, note: "" });
  try {
    const answer = await action();
    if (troubled === busy) trouble(null, "");
    return answer;
  } catch (error) {
    if (error.name === "AbortError") return null;
    if (!(error instanceof api.Problem)) throw error;
    trouble(busy, error.message);
    return null;
  } finally {
    if (busy && state.busy === busy) change({ busy: "" });
  }
}

/** Ask about the scans; if the service has dropped them, give them once more. */
async function aboutScans(ask) {
  try {
    return await ask(state.set.id);
  } catch (error) {
    if (error.status !== GONE || !files) throw error;
    const again = await api.uploadScans(files.file, files.said);
    change({ set: { ...state.set, id: again.id } });
    return ask(again.id);
  }
}

/** What is asked about the scan that is looked at. */
const asked = (id) => ({ map: state.map.id, scans: id, index: state.index, ...takenOf(state.taken) });

/** How the scans were taken, as parameters; nothing of what is as usual. */
export function takenOf({ flipped, ...others }) {
  const given = Object.entries(others).filter(([, value]) => value !== "");
  return { ...(flipped ? { flipped } : {}), ...Object.fromEntries(given) };
}

/** Say how the scans were taken, and look again. */
export function take(patch) {
  items = new Map();
  change({ taken: { ...state.taken, ...patch }, answer: null, verdicts: [], beliefs: [], hints: [], fit: null, scan: null });
  if (state.set) selectScan(state.index);
}

// ---- maps and scans

/** Look at a map. */
export function chooseMap(map) {
  granted = NOTHING;
  change({
    map, answer: null, refused: false, hints: [], verdicts: [], beliefs: [], fit: null, pose: null, chosen: HAND, reading: -1, seen: null,
    picture: null, marks: [], unsaved: false, known: { near: null, region: null, clearance: state.known.clearance },
  });
  if (map.warnings?.length) trouble("the map", map.warnings.map((text) => `${map.name}: ${inWords(text, true)}`).join(" "));
  showLayer();
  if (state.set) selectScan(state.index);
}

/** What a map is called: as its file; one that is called "map" as its folder, or as its image. */
function nameOf(file, image, folder) {
  const stems = [file.name, folder, image.name].map((name) => name.replace(/\.[^.]*$/, ""));
  const plain = stems.map((stem) => stem.replace(/[^\w. -]/g, "-").replace(/^[-. ]+|[-. ]+$/g, "").slice(0, LONGEST));
  return plain.find((name) => name && name !== "map") ?? "map";
}

/** What an image does not say, as `imgloc open` says how a file was read: an option, and Python's argument. */
const optionsOf = (reading) => Object.entries(reading).map(([key, value]) => [
  `--${key.replaceAll("_", "-")}${value === true ? "" : `=${value}`}`,
  `${key}=${value === true ? "True" : key === "origin" ? `(${value})` : value}`,
]);

/** Give the service a map, and look at it. */
export async function addMap(image, yaml, reading, folder = "") {
  const file = (yaml ?? image).name, name = nameOf(yaml ?? image, image, folder);
  const map = await attempt(`Reading ${image.name}`, () => api.uploadMap(image, yaml, { name, ...reading }));
  if (!map) return false;
  const known = { ...map, file, options: optionsOf(reading) };
  change({ maps: [...state.maps, known] });
  const mine = [...kept(), { id: map.id, file, options: known.options }];
  try {
    sessionStorage.setItem(MINE, JSON.stringify(mine));
  } catch { /* the browser keeps nothing: after a reload the map is gone */ }
  chooseMap(known);
  return true;
}

const kept = () => {
  try {
    return JSON.parse(sessionStorage.getItem(MINE) ?? "[]");
  } catch {
    return [];
  }
};

/** The maps that this page has sent before it was loaded again, as far as the service has them. */
export async function ownMaps() {
  const found = await Promise.all(kept().map(async (one) => {
    const map = await api.map(one.id).catch(() => null);
    return map && { ...map, ...one };
  }));
  return found.filter(Boolean);
}

/** Give the service a file of scans, and look at the first; of a log with several lasers, one must be named. */
export async function addScans(file, said = {}) {
  const lasers = state.lasers?.file === file ? state.lasers.names : [];
  const set = await attempt(`Reading ${file.name}`, async () => {
    try {
      return await api.uploadScans(file, said);
    } catch (error) {
      const named = [...(error.detail ?? "").matchAll(/(\S+) \(\d+\)/g)].map(([, name]) => name);
      if (error.detail?.includes("`topic`")) change({ lasers: { file, names: named, topic: "" } });
      throw error;
    }
  });
  if (!set) return;
  const { topic } = said;
  change({ lasers: topic ? { file, names: lasers, topic } : null });
  openSet({ ...set, name: file.name, options: topic ? [[`--topic=${topic}`, `topic=${JSON.stringify(topic)}`]] : [] }, { file, said });
  if (set.warnings.length) trouble("the scans", set.warnings.map((text) => inWords(text, true)).join(" "));
}

/** Look at the first of some scans that the service holds; how they were taken is theirs alone. */
export function openSet(set, from = null) {
  items = new Map();
  files = from;
  const said = Object.entries(set.taken).filter(([, value]) => value !== null).map(([key, value]) => [key, value === true || String(value)]);
  change({ set, taken: { ...USUAL, ...Object.fromEntries(said) }, scan: null, pose: null, answer: null, refused: false, hints: [], verdicts: [], beliefs: [], marks: [], unsaved: false, fit: null, reading: -1, chosen: HAND });
  selectScan(0);
}

/** A scan of the file, as scan.js prepares it. */
export async function item(index) {
  const here = items; // others, if somebody says meanwhile that they were taken in another way
  if (!here.has(index)) {
    const start = index - (index % CHUNK), { id } = state.set;
    const some = await aboutScans((now) => api.items(now, { start, count: CHUNK, ...takenOf(state.taken) }));
    if (id !== state.set.id && !files) return null;
    for (const one of some) here.set(one.index, prepared(one));
  }
  return here.get(index);
}

/** Look at a scan, and find where it is. */
export const selectScan = api.newest(async (index) => {
  if (!state.set) return;
  const { set } = state, at = Math.max(0, Math.min(set.scans - 1, index));
  change({ index: at });
  if (at !== index) change({ note: at ? "This is the last scan." : "This is the first scan." });
  const scan = await attempt("", () => item(at));
  if (!scan || state.index !== at || state.set.name !== set.name) return;
  change({ scan, reading: -1 }); // answer and fit stay, of another scan, until the new ones are there
  if (!state.following) locate();
});

// ---- answers

const NOTHING = { near: null, region: null, clearance: 0 };
let granted = NOTHING; // what was known when the service answered last
const BAD = [400, 422]; // it will refuse the same again

/** Show no answer; what the service has refused to know is not known. */
function withdraw(known, status) {
  const { index, chosen } = state, verdicts = [...state.verdicts];
  verdicts[index] = null;
  const drawn = chosen >= 0 ? { pose: null, fit: null, chosen: HAND } : {}; // of the answer
  change({ answer: null, verdicts, reading: -1, refused: true, ...drawn });
  if (BAD.includes(status) && known === state.known) change({ known: granted });
}

/** Find where the scan is, with what is known. */
export const locate = api.newest(async () => {
  const { map, scan, index, known, method } = state;
  if (!map || !scan) return;
  const said = { ...priorOf(known), method };
  let status = 0;
  const answer = await attempt(LOOKING, async () => {
    try {
      return await aboutScans((id) => api.localize({ ...asked(id), ...said }));
    } catch (error) {
      status = error.status;
      throw error;
    }
  });
  if (scan !== state.scan || map !== state.map) return;
  if (!answer) {
    withdraw(known, status);
    return;
  }
  granted = known;
  const verdicts = [...state.verdicts];
  verdicts[index] = answer.verdict;
  change({ answer, verdicts, reading: -1, refused: false, hints: [] });
  if (answer.verdict !== "unique") doubt();
  if (answer.hypotheses.length) chooseHypothesis(0);
  else if (!state.pose) place(compose(map.origin, { x: (map.width * map.resolution) / 2, y: (map.height * map.resolution) / 2 }), NOWHERE);
  else place(state.pose, state.chosen >= 0 ? NOWHERE : state.chosen);
});

/** Ask what keeps the scan from fitting. */
const doubt = api.newest(async () => {
  const { map, scan, known } = state;
  const hints = await attempt("", () => aboutScans((id) => api.doubts({ ...asked(id), ...priorOf(state.known) })));
  if (hints && scan === state.scan && map === state.map && known === state.known) change({ hints: hints.map((text) => inWords(text)) });
});

/** Draw the scan at a hypothesis. */
export function chooseHypothesis(k) {
  const h = state.answer?.hypotheses[k];
  if (h) place({ x: h.x, y: h.y, theta: h.theta }, k);
}

/** Draw the scan at a pose, of the hypothesis `chosen` or set by hand, and ask what it says there. */
export function place(pose, chosen = HAND) {
  change({ pose, chosen });
  askScore();
}

const fitAt = ({ x, y, theta }) => {
  const said = state.answer?.evidence;
  return { pose: [x, y, theta].map((value) => value.toFixed(5)).join(","), scale: said?.scale, thinner: said?.thinner, bent: said?.bent };
};

let settled = 0; // how often: a score that was asked before is of another pose

const askScore = api.newest(async () => {
  const { map, scan, pose } = state, before = settled;
  if (!map || !scan || !pose) return;
  const fit = await attempt("", () => aboutScans((id) => api.score({ ...asked(id), ...fitAt(pose) })));
  if (!fit || scan !== state.scan || map !== state.map || before !== settled) return;
  const { answer, chosen } = state;
  const best = answer && chosen === 0 && pose === state.pose ? { answer: { ...answer, counted: fit.counts } } : {};
  change({ fit: { ...fit, of: scan }, ...best });
});

/** Move the pose to where the scan fits best nearby. */
export async function settle() {
  const { scan, pose } = state;
  if (!scan || !pose) return;
  const fit = await attempt("Settling", () => aboutScans((id) => api.settle({ ...asked(id), ...fitAt(pose) })));
  if (!fit || scan !== state.scan || pose !== state.pose) return;
  settled += 1;
  change({ pose: fit.pose, chosen: HAND, fit: { ...fit, of: scan } });
}

/** Say what is known, and ask again. */
export function know(patch) {
  change({ known: { ...state.known, ...patch }, tool: "move" });
  locate();
}

/** Take the pose that is shown for what is known of it. */
export function knowPose() {
  const { pose } = state;
  if (pose) know({ near: [pose.x, pose.y, pose.theta, RADIUS, TURN] });
}

// ---- true poses

/** Mark the pose as the true one of its scan, or take the mark away if it is there already. */
export function mark() {
  const { pose, index } = state, marks = [...state.marks], old = marks[index];
  if (!pose) return;
  marks[index] = old && old.x === pose.x && old.y === pose.y && old.theta === pose.theta ? null : { ...pose };
  change({ marks, unsaved: marks.some(Boolean), note: `Scan ${numberOf()} is ${marks[index] ? "marked" : "not marked any more"}.` });
}

/** The marked scans with their true poses, as a file. */
export async function saved() {
  const poses = state.marks.flatMap((m, k) => (m ? [[k, m.x, m.y, m.theta]] : []));
  return poses.length ? attempt("Saving", () => aboutScans((id) => api.marked(id, poses))) : null;
}

// ---- layers

let wanted = new AbortController(); // of the layer that is computed

/** Show the layer that is chosen; the one that is still computed is given up. */
export function showLayer() {
  wanted.abort();
  wanted = new AbortController();
  draw(wanted.signal);
}

/** Give up the layer that is computed. */
export function stopLayer() {
  change({ layer: "", slice: -1 });
}

const draw = api.newest(async (signal) => {
  const { map, layer, slice, scan } = state, likely = METHODS.includes(layer);
  change({ spots: [], ...(layer === "visibility" ? {} : { seen: null }) });
  if (!map || !layer || layer === "visibility" || layer === "atlas" || (likely && !scan)) {
    change({ picture: null });
    if (map && layer === "atlas" && scan) await survey(map, scan, signal);
    return;
  }
  const of = { method: layer, slice: slice < 0 ? "max" : slice };
  const ask = () => (likely
    ? aboutScans((id) => api.layer("likelihood", { ...asked(id), ...of }, signal))
    : api.layer(layer, { map: map.id }, signal));
  const picture = await stoppable(layer, signal, () => attempt("the layer", () => api.again(ask, (error) => {
    if (error.status === LATE) throw error; // it would be late again
  })));
  if (!signal.aborted) change({ picture: picture && { ...picture, layer } });
});

/** Do what takes long: how long, is said, and that it can be stopped. */
async function stoppable(what, signal, work) {
  const begin = performance.now();
  const tell = () => {
    const seconds = Math.round((performance.now() - begin) / 1000);
    if (seconds && !signal.aborted) change({ waiting: `Computing ${what}: ${seconds} s` });
  };
  const clock = setInterval(tell, 500);
  try {
    return await work();
  } finally {
    clearInterval(clock);
    change({ waiting: "" });
  }
}

const PLACES = 300; // of an atlas, about
const AROUND = 5.5; // radians: a laser that sees so much needs one heading at each place

/** How an atlas is made for a scan's laser: metres between places, and headings at each. */
export function surveyOf(map, scan) {
  const step = Math.max(0.5, Math.round(2 * Math.sqrt(map.free_m2 / PLACES)) / 2);
  const wide = Math.max(...scan.angles) - Math.min(...scan.angles) > AROUND;
  return { step, headings: wide ? 1 : 4 };
}

/** Simulate the laser of the scan all over the map, some places at a time. */
async function survey(map, scan, signal) {
  for (let start = 0; start !== null && !signal.aborted;) {
    const part = await attempt("the atlas", () => aboutScans((id) => api.atlas({ ...asked(id), ...surveyOf(map, scan), start }, signal)));
    if (!part || signal.aborted) break;
    start = part.next;
    change({ spots: [...state.spots, ...part.spots], waiting: start === null ? "" : `The atlas: ${start} of ${part.of} poses` });
  }
  change({ waiting: "" });
}

/** Show what is seen from a point. */
export const look = api.newest(async ({ x, y }) => {
  const { map } = state;
  if (!map || !holds(map, { x, y })) return;
  const seen = await attempt("", () => api.visibility(map.id, `${x.toFixed(3)},${y.toFixed(3)}`));
  if (seen && state.layer === "visibility" && map === state.map) change({ seen });
});

// ---- a log

/** Follow the robot through the log from its first scan, or stop. */
export async function follow() {
  if (state.following) {
    state.following.close();
    change({ following: null });
    return;
  }
  const { map, set } = state;
  if (!set?.odom) change({ note: "The file has no odometry, which the tracker needs." });
  if (!map || !set?.odom) return;
  const socket = api.tracker(map.id), answers = [], lines = "the tracker";
  trouble(null, "");
  change({ following: socket, beliefs: [] });
  const running = () => state.following === socket && map === state.map && set.name === state.set.name;
  let wake = () => {}, why = "The tracker has ended: its connection is closed.";
  socket.onmessage = ({ data }) => { answers.push(JSON.parse(data)); wake(); };
  socket.onclose = () => { answers.push(null); wake(); };
  const next = () => new Promise((done) => { wake = done; if (answers.length) done(); }).then(() => answers.shift());
  await new Promise((done) => { socket.onopen = done; socket.addEventListener("close", done); });
  for (let k = 0; running(); k += 1) {
    if (k === set.scans) why = "";
    const scan = k < set.scans && await attempt(lines, () => item(k));
    if (!scan || socket.readyState !== WebSocket.OPEN) break;
    if (!scan.given.odom) continue; // the tracker leaves it out, too
    socket.send(JSON.stringify(scan.given));
    const belief = await next();
    if (!belief?.verdict) {
      why = belief?.detail ?? why;
      break;
    }
    if (running()) showBelief(k, scan, belief);
  }
  socket.close();
  if (!running()) return;
  if (why && !state.trouble) trouble(lines, why);
  change({ following: null });
  locate();
}

/** Look at a scan with what the tracker believes there, and ask what its readings say there. */
function showBelief(index, scan, belief) {
  const beliefs = [...state.beliefs], pose = poseOf(belief, scan) ?? state.pose;
  beliefs[index] = belief;
  change({ index, scan, beliefs, pose, answer: null, hints: [], chosen: TRACKER, reading: -1 });
  askScore();
}

/** The sensor's pose by a belief, whose places are the robot's. */
function poseOf(belief, scan) {
  const best = belief.pose ?? belief.places?.[0];
  return best ? compose(best, scan.given.mount ?? { x: 0, y: 0, theta: 0 }) : null;
}
