// The keyboard: everything on the page has a key, and the help sheet is this table.

import * as actions from "./actions.js";
import { $, make } from "./dom.js";
import { radians, wrap } from "./geometry.js";
import { change, state } from "./state.js";
import { moveCursor, pointing, setPoint, takeTool } from "./tools.js";

const STEP = 0.05, TURN = 1; // metres and degrees; ten times as much with Shift
const PIXELS = 8; // that the cursor is moved
const OF_SCAN = "The scan", OF_LOG = "The log"; // sections whose keys need a scan

const shift = (view, dx, dy) => (event) => {
  const { pose } = state, times = event.shiftKey ? 10 : 1, by = STEP * times;
  if (pointing()) moveCursor(view, PIXELS * times * dx, PIXELS * times * dy);
  else if (pose) actions.place({ ...pose, x: pose.x + by * dx, y: pose.y + by * dy });
};
const turn = (sign) => (event) => {
  const { pose } = state, by = radians(TURN * (event.shiftKey ? 10 : 1));
  if (pose) actions.place({ ...pose, theta: wrap(pose.theta + sign * by) });
};
const tool = (name) => () => takeTool(state.tool === name ? "move" : name);
const reading = (step) => () => {
  const { scan } = state;
  if (scan) change({ reading: (state.reading + step + scan.ranges.length) % scan.ranges.length });
};
const slice = (step) => () => {
  const { picture } = state;
  if (picture?.slices) $("slice").dispatchEvent(new CustomEvent("step", { detail: step }));
  else change({ note: "No likelihood is shown, whose headings this would change: choose a layer (G)." });
};
const press = (id) => () => $(id).click();

/** Keys, what they do, and the action; keys without an action belong to a line before. */
function table(view, redraw) {
  const zoom = (factor) => () => { view.zoom(factor); redraw(); };
  return [
    [OF_SCAN],
    [["ArrowLeft"], "move it 5 cm, with Shift 50 cm; with a tool, point at the map", shift(view, -1, 0)],
    [["ArrowRight"], "", shift(view, 1, 0)],
    [["ArrowUp"], "", shift(view, 0, 1)],
    [["ArrowDown"], "", shift(view, 0, -1)],
    [["q", "Q"], "turn it left by 1°; with Shift 10°", turn(1)],
    [["e", "E"], "turn it right", turn(-1)],
    [["s"], "settle: move it to where it fits best nearby", () => actions.settle()],
    [["1"], "put it at a hypothesis", () => actions.chooseHypothesis(0)],
    ...[2, 3, 4, 5, 6, 7, 8, 9].map((k) => [[String(k)], "", () => actions.chooseHypothesis(k - 1)]),
    [[","], "what the reading before says", reading(-1)],
    [["."], "what the next reading says", reading(1)],
    [["m"], "mark its pose as the true one", () => actions.mark()],
    [OF_LOG],
    [["PageUp", "["], "the scan before", () => actions.selectScan(state.index - 1)],
    [["PageDown", "]"], "the next scan", () => actions.selectScan(state.index + 1)],
    [["l"], "locate the scan again", () => actions.locate()],
    [["t"], "follow the robot, or stop", () => actions.follow()],
    ["What is known"],
    [["r"], "draw a region: arrows and Enter set its corners, the last one twice", tool("region")],
    [["v"], "the part in view is the region", press("in-view")],
    [["a"], "draw an arrow: arrows and Enter set the place, then where it faces", tool("arrow")],
    [["Enter"], "set the point", () => setPoint(view)],
    [["k"], "about where the scan is drawn now", () => actions.knowPose()],
    [["x"], "forget what is known", press("forget")],
    ["The map"],
    [["g"], "the next layer", press("next-layer")],
    [["<"], "the heading before, of a likelihood", slice(-1)],
    [[">"], "the next heading", slice(1)],
    [["f"], "show all of the map", press("fit")],
    [["+", "="], "larger", zoom(1.25)],
    [["-"], "smaller", zoom(0.8)],
    ["The page"],
    [["o"], "open files", press("open")],
    [["c"], "copy as command", press("copy-command")],
    [["y"], "copy as Python", press("copy-python")],
    [["z"], "stop the layer that is computed", press("stop")],
    [["Escape"], "lay the tool down", () => { takeTool("move"); change({ reading: -1, trouble: "" }); }],
    [["?"], "this sheet", press("help")],
  ];
}

const NAMES = { 1: "1 to 9", ",": ", comma", ".": ". period", ArrowLeft: "← → ↑ ↓", PageUp: "Page ↑", PageDown: "Page ↓", Escape: "Esc", Enter: "Enter", q: "Q", e: "E" };
const nameOf = (key) => NAMES[key] ?? key.toUpperCase();

/** Listen to the keyboard, and write the help sheet. */
export function startKeys(view, redraw) {
  const rows = table(view, redraw), actionOf = new Map();
  let section = "";
  for (const [keys, , action] of rows) {
    if (!action) section = keys;
    else for (const key of keys) actionOf.set(key, [action, [OF_SCAN, OF_LOG].includes(section) || key === "k"]);
  }
  const sheet = $("keys");
  let list = null;
  for (const [keys, words, action] of rows) {
    if (!action) {
      list = make("dl");
      sheet.append(make("section", {}, make("h3", {}, keys), list));
    } else if (words) {
      const shown = keys.filter((key) => key !== "=" && !/^[QE]$/.test(key)).map((key) => make("kbd", {}, nameOf(key)));
      list.append(make("dt", {}, ...shown), make("dd", {}, words));
    }
  }
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
    const { target } = event, range = target.type === "range";
    const typing = target.matches("input:not([type=range], [type=checkbox]), select, textarea");
    if (typing || (range && /^(Arrow|Page|Home|End)/.test(event.key))) return;
    const [action, ofScan] = actionOf.get(event.key) ?? [];
    if (!action || (event.key === "Enter" && target.id !== "canvas")) return;
    event.preventDefault();
    if (ofScan && !state.scan && !pointing()) change({ note: "There is no scan yet: open a file of scans (O)." });
    else action(event);
  });
}
