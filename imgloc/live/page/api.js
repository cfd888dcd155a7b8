// What the page asks its service. Nothing else is ever asked: all addresses are relative to it.

import { inWords } from "./words.js";

const token = new URLSearchParams(location.hash.slice(1)).get("token");

const WHOLE = "Open the whole address that the service's owner has: it ends in #token=...";
const MISSING = `The service needs its token, and the address of this page has none. ${WHOLE}`;
const WRONG = `The service does not accept the token in the address of this page. ${WHOLE}`;

/** An answer of the service that is no success, in its own sentence; `reading` a file, if it was that. */
export class Problem extends Error {
  constructor(status, { title = "", detail = "" } = {}, reading = false) {
    super(inWords(detail || title || `The service answered ${status}.`, reading));
    Object.assign(this, { status, detail });
  }

  /** Whether the same may be answered a little later: the service is busy, or was not there. */
  get passes() {
    return [0, 503, 504].includes(this.status);
  }
}

const AGAIN = [500, 1000, 2000]; // milliseconds until what is busy is asked again

/** Ask again, a few times, what may be answered a little later. */
export async function patiently(work, waits = AGAIN) {
  for (const wait of waits) {
    try {
      return await work();
    } catch (error) {
      if (!(error instanceof Problem) || error.status !== 503) throw error;
      await new Promise((done) => { setTimeout(done, wait); });
    }
  }
  return work();
}

/** Ask, with what is not empty of some `values` as the query; a Problem if that is refused. */
async function ask(path, values = {}, options = {}) {
  const given = Object.entries(values).filter(([, value]) => value !== undefined && value !== null && value !== "");
  const headers = { ...options.headers, ...(token ? { Authorization: `Bearer ${token}` } : {}) };
  let response;
  try {
    response = await fetch(given.length ? `${path}?${new URLSearchParams(given)}` : path, { ...options, headers });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Problem(0, { detail: "The service does not answer. Does imgloc serve still run?" });
  }
  if (response.status === 401) throw new Problem(401, { detail: token ? WRONG : MISSING });
  if (!response.ok) throw new Problem(response.status, await response.json().catch(() => ({})), /^v1\/(maps|scans)$/.test(path));
  return response;
}

const SOON = 1000, LATEST = 10000; // milliseconds until what has no answer yet is asked again

/** Ask until there is an answer; `tell` hears each time why there is none, and may throw. */
export async function again(work, tell) {
  for (let wait = SOON; ; wait = Math.min(2 * wait, LATEST)) {
    try {
      return await work();
    } catch (error) {
      if (!error.passes) throw error;
      tell(error);
      await new Promise((done) => { setTimeout(done, wait); });
    }
  }
}

const json = async (response) => (await response).json();
const post = (path, values, body) => patiently(() => ask(path, values, { method: "POST", body }));
const get = (path, values, signal) => patiently(() => ask(path, values, { signal }));
const segment = encodeURIComponent;

/** The maps of the service, and the scans that `imgloc open` was given. */
export const maps = () => json(get("v1/maps"));

/** One map, by its id. */
export const map = (id) => json(get(`v1/maps/${segment(id)}`));

/** The cells of a map as an image: 0 wall, 254 free, 205 unknown. */
export const cells = async (map) => bitmap(await get(`v1/maps/${segment(map)}/image`));

/** Give the service a map: an image with its YAML, or with what the image does not say. */
export function uploadMap(image, yaml, said) {
  const form = new FormData();
  form.append("image", image, image.name);
  if (yaml) form.append("yaml", yaml, yaml.name);
  return json(post("v1/maps", said, form));
}

/** Give the service a file of scans, in any format that imgloc reads. */
export const uploadScans = (file, said) => json(post("v1/scans", { name: file.name, ...said }, file));

/** Some scans of a file, as they were taken. */
export const items = async (id, values) => (await json(get(`v1/scans/${segment(id)}`, values))).items;

/** Where a scan is: the row of `imgloc localize --json`. */
export const localize = (values) => json(post("v1/localize", values));

/** What most likely keeps a scan from fitting, in sentences. */
export const doubts = async (values) => (await json(post("v1/doubts", values))).hints;

/** What each reading says at a pose; `settle` moves the pose to where it fits best nearby. */
export const score = (values) => json(post("v1/score", values));
export const settle = (values) => json(post("v1/settle", values));

/** What is seen from a point. */
export const visibility = (map, at) => json(get("v1/layers/visibility", { map, at }));

/** Some spots of the atlas, from the one at `start` on. */
export const atlas = (values, signal) => json(get("v1/layers/atlas", values, signal));

/** A layer as an image, with what its greys mean. */
export async function layer(what, values, signal) {
  const response = await get(`v1/layers/${what}`, values, signal);
  const number = (name) => Number.parseFloat(response.headers.get(`Imgloc-${name}`));
  return {
    what, image: await bitmap(response), resolution: number("Resolution"),
    low: number("Low"), high: number("High"), slices: number("Slices") || 0, theta: number("Theta"),
  };
}

/** The scans at some indices with their true poses, as an NPZ. */
export const marked = async (id, poses) => {
  const options = { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ poses }) };
  return (await ask(`v1/scans/${segment(id)}/marked`, {}, options)).blob();
};

/** The polygon of a region as the image that `--region` takes. */
export const regionImage = async (map, region) => (await get("v1/layers/region", { map, region })).blob();

/** The tracker: a line in, a line out. */
export function tracker(map) {
  const here = new URL(`v1/track?${new URLSearchParams({ map, places: true })}`, location.href);
  here.protocol = here.protocol.replace("http", "ws");
  here.hash = "";
  const secret = token && btoa(token).replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
  return new WebSocket(here, token ? ["imgloc", `bearer.${secret}`] : []);
}

const bitmap = async (response) =>
  createImageBitmap(await response.blob(), { colorSpaceConversion: "none", premultiplyAlpha: "none" });

/**
 * Run an asynchronous function once at a time: while one call runs, the newest of the others waits
 * and those before it are forgotten, so that what follows the mouse is never late.
 */
export function newest(work) {
  let running = false, waiting = null;
  return async function next(...values) {
    waiting = values;
    if (running) return;
    running = true;
    try {
      while (waiting) {
        const now = waiting;
        waiting = null;
        await work(...now);
      }
    } finally {
      running = false;
    }
  };
}
