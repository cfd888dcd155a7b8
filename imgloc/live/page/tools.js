// What is drawn by hand, with the pointer or with the keys: a region corner by corner, an arrow.

import { know, look } from "./actions.js";
import { wrap } from "./geometry.js";
import { area, CORNERS, RADIUS, TURN } from "./known.js";
import { change, state } from "./state.js";

const SMALLEST = 0.01; // m², of a region
export const HINTS = {
  move: "",
  region: "A region: drag a rectangle, or set corner after corner by clicks; the first one again closes it. With keys: arrows, then Enter.",
  arrow: "A place and a heading: press where it is, drag to where it faces. With keys: arrows, then Enter, twice.",
};

/** Take another tool, and say how it is used. */
export function takeTool(tool) {
  change({ tool, drawn: [], cursor: null, note: HINTS[tool] });
}

/** The rectangle between two corners. */
export const rectangle = ([ax, ay], [bx, by]) => [[ax, ay], [bx, ay], [bx, by], [ax, by]];

/** Take a region, if it is one. */
export function closeRegion(points = state.drawn) {
  const region = points.length === 2 ? rectangle(...points) : points;
  if (region.length < 3 || area(region) < SMALLEST) {
    change({ drawn: [], note: "This is no region: it has no area. Drag from one corner to the other." });
    return;
  }
  change({ drawn: [] });
  know({ region });
}

/** Set a corner of a region; near the first one, or where the last one is, the region is closed. */
export function setCorner({ x, y }, near) {
  const { drawn } = state, [first] = drawn, last = drawn.at(-1);
  const at = (corner) => corner && Math.hypot(corner[0] - x, corner[1] - y) < near;
  if (at(last) || (drawn.length > 2 && at(first)) || drawn.length >= CORNERS) {
    closeRegion();
  } else {
    const count = drawn.length + 1;
    change({ drawn: [...drawn, [x, y]], note: `${count} ${count === 1 ? "corner" : "corners"}: the first one again closes the region, Esc forgets it.` });
  }
}

/** Set the place of an arrow, then where it points; the same place again has any heading. */
export function setArrow({ x, y }, near) {
  const [from] = state.drawn;
  if (!from) {
    change({ drawn: [[x, y]], note: "Now where it faces; the same place again: any heading." });
    return;
  }
  const long = Math.hypot(x - from[0], y - from[1]);
  change({ drawn: [] });
  know({ near: long < near ? [...from, 0, RADIUS, Math.PI] : [...from, wrap(Math.atan2(y - from[1], x - from[0])), RADIUS, TURN] });
}

/** Whether the arrow keys point at the map, and do not move the scan. */
export const pointing = () => state.tool !== "move" || state.layer === "visibility";

/** Move the keyboard's cursor by pixels. */
export function moveCursor(view, dx, dy) {
  const at = state.cursor ?? view.point(view.width / 2, view.height / 2);
  const [px, py] = view.pixel(at.x, at.y);
  const held = (value, most) => Math.max(0, Math.min(most, value));
  const cursor = view.point(held(px + dx, view.width), held(py - dy, view.height));
  change({ cursor });
  if (state.layer === "visibility" && state.tool === "move") look(cursor);
}

/** What Enter does where the cursor is. */
export function setPoint(view) {
  const at = state.cursor ?? view.point(view.width / 2, view.height / 2), near = 6 / view.scale;
  change({ cursor: at });
  if (state.tool === "region") setCorner(at, near);
  else if (state.tool === "arrow") setArrow(at, near);
}
