// What the page shows, in one object, and who wants to hear of its changes.

/** Where a pose is from that is no hypothesis: set by hand, by the tracker, or nobody has found any. */
export const HAND = -1, TRACKER = -2, NOWHERE = -3;

/** How scans are taken, unless somebody says otherwise. */
export const USUAL = { flipped: false, range_max: "", range_scale: "", sensor: "" };

export const state = {
  maps: [], // rows of the service: {name, width, height, resolution, origin, path ...}
  map: null, // the one that is looked at
  set: null, // the scans: {id, name, scans: how many, poses, odom, stamps}
  index: 0, // of the scan that is looked at
  scan: null, // that scan, as scan.js prepares it; null until it is here
  method: "fused",
  lasers: null, // of a log with several: {file, names, topic: the one that is read, "" until it is named}
  taken: USUAL, // how the scans were taken
  known: { near: null, region: null, clearance: 0 },
  busy: "", // what the service is asked at the moment
  trouble: "", // the last error, in a sentence
  note: "", // news that are no error
  waiting: "", // a layer that is computed, which can be stopped
  blank: "", // why the map is not drawn
  hints: [], // what most likely keeps the scan from fitting
  answer: null, // of the scan `index`, as `imgloc localize --json` prints it
  refused: false, // whether the service has refused to answer the scan
  verdicts: [], // of the scans that were answered, by index
  pose: null, // {x, y, theta} of the sensor, where its scan is drawn
  chosen: HAND, // the hypothesis that this is, or who else has set it
  fit: null, // what each reading says at the pose, and the scan that it is `of`
  reading: -1, // the reading that is asked about
  layer: "",
  slice: -1, // of a layer with headings; -1 is the best of all
  picture: null, // the layer: {image, resolution, low, high, slices, theta}
  spots: [], // of the atlas: {x, y, theta, kind}
  seen: null, // what is seen from a point: {at, polygon, surface}
  beliefs: [], // of the tracker, by index
  following: null, // the WebSocket of the tracker while it runs
  marks: [], // true poses, by index
  unsaved: false, // whether marks are in no file yet
  tool: "move",
  drawn: [], // corners that the tool has set, [[x, y]...]
  cursor: null, // {x, y} of the map frame, where the keyboard points
};

/** The number in its file of a scan that is here: of that which is looked at, unless another is named. */
export const numberOf = (index = state.index) => state.set?.indices?.[index] ?? index;

const listeners = [];

/** Call `listener` after each change of one of the `keys`. */
export function watch(keys, listener) {
  listeners.push([new Set(keys), listener]);
}

/** Change the state, and tell those who watch what has changed. */
export function change(patch) {
  const changed = Object.keys(patch).filter((key) => state[key] !== patch[key]);
  Object.assign(state, patch);
  for (const [keys, listener] of listeners) {
    if (changed.some((key) => keys.has(key))) listener(state);
  }
}
