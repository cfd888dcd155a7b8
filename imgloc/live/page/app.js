// Puts the page together: the state on one side, the map, the panel and the controls on the other.

import * as actions from "./actions.js";
import * as api from "./api.js";
import { onScheme } from "./colours.js";
import { command, REGION, script } from "./copy.js";
import { $, download, make, say } from "./dom.js";
import { acceptFiles } from "./files.js";
import { boxOf, corners, radians } from "./geometry.js";
import { startKeys } from "./keys.js";
import { regionText } from "./known.js";
import { Cells, heat } from "./map.js";
import { paint, paintStrip } from "./paint.js";
import { showTip, startPanel } from "./panel.js";
import { listen } from "./pointer.js";
import { change, numberOf, state, watch } from "./state.js";
import { takeTool } from "./tools.js";
import { View } from "./view.js";

const canvas = $("canvas"), context = canvas.getContext("2d"), view = new View();
let cells = null, layer = null, sketch = null, asked = false;

// ---- drawing

/** Draw everything anew, once for all changes until the next frame. */
function redraw() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(() => {
    asked = false;
    const ratio = devicePixelRatio;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    paint(context, view, state, { cells, layer, sketch });
    paintStrip($("strip"), state);
    showTip(view);
  });
}

/** Fit the canvas to its place on the page, and the map to the canvas unless somebody has moved it. */
function resize() {
  const { width, height } = $("stage").getBoundingClientRect(), free = view.width <= 1 || view.untouched;
  Object.assign(view, { width, height });
  canvas.width = Math.round(width * devicePixelRatio);
  canvas.height = Math.round(height * devicePixelRatio);
  if (free) fit();
  redraw();
}

function fit() {
  if (state.map) view.fit(boxOf(corners(state.map, cells?.known)));
  redraw();
}

/** Load the map; while the service has no time for it, say so and ask again. */
async function loadCells() {
  const { map } = state, here = () => map && map === state.map;
  cells = null;
  change({ blank: "" });
  redraw();
  const tell = (error) => here() && change({ blank: `The map cannot be shown: ${error.message.replace(/\.?$/, ".")}${error.passes ? " The page asks again." : ""}` });
  try {
    const image = map && await api.again(() => here() && api.cells(map.id), tell);
    if (!here() || !image) return;
    cells = new Cells(image);
    change({ blank: "" });
    fit();
  } catch (error) { // also of the browser, which does not take each image
    tell(error);
  }
}

function loadLayer() {
  const { picture } = state;
  layer = picture && {
    resolution: picture.resolution,
    image: picture.layer === "vmap" /* has colours of its own */ ? picture.image : heat(picture.image),
  };
  redraw();
}

// ---- controls

function showMaps() {
  const { maps, map } = state;
  const called = ({ id, name }) => {
    const alike = maps.filter((other) => other.name === name);
    return alike.length > 1 ? `${name} (${1 + alike.findIndex((other) => other.id === id)})` : name;
  };
  $("map").replaceChildren(...maps.map((one) => make("option", { value: one.id, selected: one.id === map?.id }, called(one))));
  $("map").disabled = !maps.length;
  document.body.classList.toggle("empty", !map);
}

function showLog() {
  const { set, index, following } = state, range = $("index");
  $("log").hidden = !set;
  if (!set) return;
  range.max = set.scans - 1;
  range.value = index;
  say($("file"), set.name);
  const words = `Scan ${numberOf()}`, last = set.scans - 1;
  say($("number"), last ? `${words}. The first is ${numberOf(0)}, the last ${numberOf(last)}.` : `${words}, the only one.`);
  range.setAttribute("aria-valuetext", words);
  const button = $("follow");
  button.disabled = !set.odom;
  button.title = set.odom ? "Follow the robot through the log (T)" : "The file has no odometry, which the tracker needs";
  say(button, following ? "Stop" : "Follow");
}

function showTool() {
  for (const name of ["move", "region", "arrow"]) $(`tool-${name}`).setAttribute("aria-pressed", String(state.tool === name));
  canvas.dataset.cursor = state.tool === "move" ? "" : "draw";
}

let copying = null; // what makes the text that was copied: command or script

/** Copy what is seen; a file that the text needs, and only the page can make, is named. */
async function copy(make) {
  const text = make(state), what = make === command ? "command" : "Python";
  const needs = make === command && state.set && state.known.region ? `It reads ${REGION}: press “Save region”, and run it where that file is.` : "";
  try {
    await navigator.clipboard.writeText(text);
    change({ note: `Copied as ${what}. ${needs}` });
  } catch { // the page is no secure context, or that is not allowed: it can be copied by hand
    change({ note: needs });
  }
  copying = make;
  say($("copied-needs"), needs);
  $("copied").value = text;
  $("copied").rows = Math.min(16, text.split("\n").length);
  $("copied").hidden = false;
  closeCopied();
}

/** Do not show any more what was copied, once something else is seen. */
function closeCopied() {
  if ($("copied").hidden || $("copied").value === copying(state)) return;
  $("copied").value = "";
  $("copied").hidden = true;
  say($("copied-needs"), "");
}

const on = (id, type, listener) => $(id).addEventListener(type, listener);
const onClick = (id, listener) => on(id, "click", listener);

function listenToControls() {
  on("map", "change", ({ target }) => actions.chooseMap(state.maps.find(({ id }) => id === target.value)));
  on("method", "change", ({ target }) => {
    change({ method: target.value });
    actions.locate();
  });
  onClick("open", () => $("files").click());
  onClick("welcome-open", () => $("files").click());
  onClick("help", () => $("sheet").showModal());
  onClick("sheet-close", () => $("sheet").close());
  onClick("trouble-close", () => change({ trouble: "" }));
  onClick("stop", () => actions.stopLayer());
  onClick("reading-cancel", () => $("reading").close(""));
  for (const name of ["move", "region", "arrow"]) onClick(`tool-${name}`, () => { takeTool(name); canvas.focus(); });
  onClick("fit", fit);
  onClick("larger", () => { view.zoom(1.4); redraw(); });
  onClick("smaller", () => { view.zoom(1 / 1.4); redraw(); });
  onClick("settle", () => actions.settle());
  onClick("mark", () => actions.mark());
  onClick("previous", () => actions.selectScan(state.index - 1));
  onClick("next", () => actions.selectScan(state.index + 1));
  on("index", "input", ({ target }) => actions.selectScan(Number(target.value)));
  onClick("follow", () => actions.follow());
  listenToKnown();
  listenToTaken();
  on("layer", "change", ({ target }) => {
    change({ layer: target.value, slice: -1 });
    $("stage").scrollIntoView({ block: "nearest" }); // on a narrow page it is above
  });
  onClick("next-layer", () => {
    const select = $("layer");
    select.selectedIndex = (select.selectedIndex + 1) % select.options.length;
    change({ layer: select.value, slice: -1 });
  });
  on("slice", "input", ({ target }) => change({ slice: Number(target.value) }));
  on("slice", "step", ({ detail }) => {
    const count = state.picture.slices + 1; // with the best of all headings, -1
    change({ slice: ((state.slice + 1 + detail + count) % count) - 1 });
  });
  onClick("save", async () => {
    const file = await actions.saved();
    if (!file) return;
    download(file, `${state.set.name.replace(/^.*[/\\]|\.[^.]*$/g, "")}-marked.npz`);
    change({ unsaved: false });
  });
  onClick("copy-command", () => state.map && copy(command));
  onClick("copy-python", () => state.map && copy(script));
}

const TAKEN = [["reach", "range_max"], ["unit", "range_scale"], ["sensor", "sensor"]]; // texts

function showTaken() {
  $("flipped").checked = state.taken.flipped;
  for (const [id, key] of TAKEN) $(id).value = state.taken[key];
}

function showReading() {
  const { lasers, set } = state;
  $("laser").hidden = !lasers;
  $("topic").value = lasers?.topic ?? "";
  $("lasers").replaceChildren(...(lasers?.names ?? []).map((value) => make("option", { value })));
  if (lasers && !lasers.topic) $("topic").focus();
  const words = lasers ? "" : (set?.options ?? []).map(([typed]) => typed).join(" ");
  say($("opened-with"), words && `Opened with ${words}`);
}

function listenToTaken() {
  on("topic", "change", ({ target }) => actions.addScans(state.lasers.file, { topic: target.value.trim() }));

  on("flipped", "change", ({ target }) => actions.take({ flipped: target.checked }));
  for (const [id, key] of TAKEN) {
    on(id, "change", ({ target }) => {
      const value = target.value.replaceAll(" ", "");
      if (target.reportValidity()) actions.take({ [key]: value });
    });
  }
}

function listenToKnown() {
  onClick("in-view", () => state.map && actions.know({ region: view.corners().map(({ x, y }) => [x, y]) }));
  onClick("forget", () => {
    $("clearance").value = "";
    actions.know({ near: null, region: null, clearance: 0 });
  });
  const changeNear = () => {
    const near = [...state.known.near];
    near[3] = Math.max(0.01, Number($("radius").value) || near[3]);
    near[4] = radians(Math.min(180, Math.max(1, Number($("turn").value) || 1)));
    actions.know({ near });
  };
  on("radius", "change", changeNear);
  on("turn", "change", changeNear);
  on("clearance", "change", ({ target }) => actions.know({ clearance: Math.max(0, Number(target.value) || 0) }));
  onClick("save-region", async () => {
    const { map, known } = state;
    const image = await actions.attempt("Drawing", () => api.regionImage(map.id, regionText(known.region)));
    if (image) download(image, REGION);
  });
}

// ---- start

async function start() {
  startPanel();
  startKeys(view, redraw);
  listenToControls();
  acceptFiles();
  listen(canvas, view, { redraw, sketch: (drawn) => { sketch = drawn; redraw(); } });
  watch(["map"], loadCells);
  watch(["maps", "map"], showMaps);
  watch(["picture"], loadLayer);
  watch(["layer", "slice"], () => actions.showLayer());
  watch(["layer"], () => { $("layer").value = state.layer; });
  watch(["taken"], showTaken);
  watch(["lasers", "set"], showReading);
  watch(["map", "set", "index", "scan", "taken", "known", "method", "layer", "seen", "beliefs", "pose", "chosen"], closeCopied);
  watch(["scan"], () => { if (actions.METHODS.includes(state.layer)) actions.showLayer(); });
  watch(["set", "index", "following"], showLog);
  watch(["tool"], showTool);
  watch(["map", "scan", "pose", "fit", "answer", "chosen", "reading", "known", "seen", "spots", "beliefs", "marks", "verdicts", "index", "drawn", "cursor", "tool", "layer"], redraw);
  addEventListener("beforeunload", (event) => { if (state.unsaved) event.preventDefault(); });
  onScheme(() => { cells?.repaint(); redraw(); });
  new ResizeObserver(resize).observe($("stage"));
  showMaps();
  showLog();
  addEventListener("hashchange", () => location.reload()); // it has another token
  const found = await askForMaps();
  if (found?.opened) actions.openSet(found.opened);
}

const AGAIN = 1000; // milliseconds, while maps are being prepared
const pause = (time) => new Promise((done) => { setTimeout(done, time); });

/** Ask for the maps until all of them are prepared, and look at the first. */
async function askForMaps() {
  for (;;) {
    const found = await actions.attempt("Asking for maps", api.maps);
    document.body.classList.toggle("shut", !found);
    if (!found) return null;
    const here = new Map(state.maps.map((map) => [map.id, map])), mine = state.maps.filter((map) => map.uploaded);
    change({ maps: [...found.maps.map((map) => here.get(map.id) ?? map), ...(mine.length ? mine : await actions.ownMaps())] });
    if (!state.map && state.maps.length) actions.chooseMap(state.maps[0]);
    const words = found.preparing.length ? `The service is preparing ${found.preparing.join(", ")} …` : "";
    say($("preparing"), words);
    $("preparing").hidden = !words;
    if (!words) return found;
    await pause(AGAIN);
  }
}

start();
